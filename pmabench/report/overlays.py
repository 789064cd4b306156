"""Published or catalogue points compared with results of runs: what can be matched, marks in figures, mean differences.

Published values become an analysis of kind `published` and points in traces; they enter no fit and no verdict.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pmabench.base.errors import InvalidFile, Problem
from pmabench.base.quantities import QUANTITIES
from pmabench.kinds import registry
from pmabench.plotting.wording import Frame, clean, number, point_shown, rounded, shown
from pmabench.report.document.provenance import get
from pmabench.report.figures import OVER_PRESSURE
from pmabench.store.analyses.results import PUBLISHED, Analysis, Estimate, PublishedPoints, Trace
from pmabench.store.records import Array, RunData, is_number

HEADS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("pressure", "pressure", ("pressure", "P", "p")),
    ("contraction", "ratio", ("contraction", "eps", "strain")),
    ("displacement", "length", ("displacement", "contraction", "x")),
    ("force", "force", ("force", "F")),
    ("F_ce", "force", ("F_ce", "force_ce")),
    ("K", "stiffness", ("K", "S", "stiffness")),
    ("B", "damping", ("B", "D", "damping")),
    ("B_c", "damping", ("B_c", "D_c", "damping_contract")),
    ("B_r", "damping", ("B_r", "D_r", "damping_relax")),
)
"""What a column of a published table may be: name, quantity, heads."""
SYMBOLS = ("F_ce", "K", "B", "B_c", "B_r")
COORDINATES = ("pressure", "contraction", "displacement")
NEAR = {"pressure": (2e3, 0.02), "displacement": (0.2e-3, 0.0)}
"""How far a published point may lie from the operating point of a panel: absolute [SI], and as a share."""


@dataclass(frozen=True)
class Published:
    """One table of published points, SI, columns by the names of `HEADS`."""

    label: str
    source: str
    path: Path
    columns: Mapping[str, Array]


@dataclass(frozen=True)
class Comparison:
    """One quantity compared with what is published of it."""

    name: str
    over: str
    label: str
    places: str
    points: int
    """How many lie within the range of one's own."""
    mean: float | None
    """Mean of (own - published) / published."""
    size: float | None
    """Mean of its size."""


def length_of(runs: Sequence[RunData]) -> float | None:
    """The one nominal length of all specimens [m]; None where runs have several or none."""
    lengths = {get(run.manifest, "specimen", "nominal_length") for run in runs}
    known = {float(value) for value in lengths if is_number(value)}
    return known.pop() if len(known) == 1 else None


def with_published(
    analyses: Sequence[Analysis], published: Sequence[Published], length: float | None
) -> tuple[list[Analysis], list[Analysis], list[Comparison]]:
    """The analyses with published points in their traces, an analysis of each published table, and comparisons.

    `length` [m] makes displacements of contraction ratios. Raises InvalidFile for tables that match no figure.
    """
    others = [_as_analysis(table, analyses) for table in published]
    compared: list[Comparison] = []
    for table, other in zip(published, others, strict=True):
        compared += _coefficients(table, other, analyses)
    with_points = []
    for analysis in analyses:
        traces = []
        for trace in analysis.traces:
            found = [(table, points) for table in published if (points := _in_trace(table, trace, length)) is not None]
            traces.append(replace(trace, published=tuple(points for _, points in found)) if found else trace)
            if found and trace.figure != LOOPS and _slowest(trace, analysis.traces):
                compared += [_apart(trace, table, points) for table, points in found]
        with_points.append(replace(analysis, traces=tuple(traces)))
    drawn = {c.label for c in compared}
    problems = [_no_match(table) for table in published if table.label not in drawn]
    if problems:
        raise InvalidFile(problems)
    return with_points, [other for other in others if other.estimates], compared


def _no_match(table: Published) -> Problem:
    held, heads = ", ".join(table.columns), ", ".join(name for name, _, _ in HEADS)
    return Problem(str(table.path), 0, 0, f"matches no figure of this report: it holds {held}; what is read: {heads}")


LOOPS = "isobaric"
"""Kind of trace whose loops get published points drawn; it is the mean curve through them that is compared."""
BINS = 60
"""In which the branches of a trace are averaged."""
FURTHER = 0.5
"""Points further off than this share of the own range are not drawn into a trace's figure: they would squeeze it."""
QUANTITY = {name: quantity for name, quantity, _ in HEADS}
MARKS = {"displacement": "contraction", "pressure": "pressure"}
"""Coordinate -> the mark of a trace that holds it."""


def _figures() -> dict[str, tuple[str, str, str]]:
    """Kind of trace -> its axes, and what is the same in all of it, as kinds of test declare it."""
    return {figure: axes for kind in registry.all_kinds().values() for figure, axes in kind.published.items()}


def _place(trace: Trace, fixed: str) -> float | None:
    """The operating point of a trace [SI]; the rubber's is no pressure."""
    return 0.0 if trace.figure == "rubber" else trace.marks.get(MARKS[fixed])


def _plain(e: Estimate, symbol: str) -> bool:
    """Whether it is in the figure of that symbol over pressure."""
    known = e.symbol == symbol and not e.coordinate and e.value is not None
    return known and "pressure" in e.at and set(e.at) <= OVER_PRESSURE


def _as_analysis(table: Published, analyses: Sequence[Analysis]) -> Analysis:
    """Coefficients over pressure as estimates, where an analysis has the same."""
    estimates = []
    for symbol in SYMBOLS:
        there = {symbol, "pressure"} <= set(table.columns)
        if there and any(_plain(e, symbol) for a in analyses for e in a.estimates):
            unit = QUANTITIES[QUANTITY[symbol]].unit
            for P, value in zip(table.columns["pressure"], table.columns[symbol], strict=True):
                if np.isfinite(P) and np.isfinite(value):
                    at = {"pressure": float(P)}
                    estimates.append(Estimate(symbol, float(value), unit, QUANTITY[symbol], table.label, at))
    return Analysis(PUBLISHED, (), simulated=False, estimates=tuple(estimates))


def _coefficients(table: Published, other: Analysis, analyses: Sequence[Analysis]) -> list[Comparison]:
    """Own values of each test's first method, joined by straight lines, at the published pressures within them."""
    found = []
    for symbol in dict.fromkeys(e.symbol for e in other.estimates):
        theirs = [(e.at["pressure"], e.value or 0.0) for e in other.estimates if e.symbol == symbol]
        for analysis in analyses:
            known = [e for e in analysis.estimates if _plain(e, symbol)]
            own: dict[float, list[float]] = {}
            for e in known:
                if e.method == known[0].method:
                    own.setdefault(e.at["pressure"], []).append(e.value or 0.0)
            if own:
                x = np.array(sorted(own))
                y = np.array([np.mean(own[float(P)]) for P in x])
                where = clean(known[0].method, 60)
                found.append(_compared(symbol, f"pressure, {where}", table.label, "pressure", x, y, theirs))
    return found


def _in_trace(table: Published, trace: Trace, length: float | None) -> PublishedPoints | None:
    """The published points of the trace's operating point, on its axes."""
    axes = _figures().get(trace.figure)
    if axes is None:
        return None
    x, y, fixed = axes
    columns = dict(table.columns)
    if "displacement" not in columns and "contraction" in columns and length is not None:
        columns["displacement"] = columns["contraction"] * length
    place = _place(trace, fixed)
    if place is None or not {x, y, fixed} <= set(columns):
        return None
    least, share = NEAR[fixed]
    near = np.abs(columns[fixed] - place) <= max(least, share * abs(place))
    near &= np.isfinite(columns[x]) & np.isfinite(columns[y])
    own = trace.columns[x][np.isfinite(trace.columns[x])]
    room = FURTHER * float(np.ptp(own))
    near &= (columns[x] >= own.min() - room) & (columns[x] <= own.max() + room)
    return PublishedPoints(table.label, {x: columns[x][near], y: columns[y][near]}) if near.any() else None


def _slowest(trace: Trace, traces: Sequence[Trace]) -> bool:
    """Whether a loop is the slowest at its pressure: nearest to a curve without speed. Others have no speed."""
    alike = [t for t in traces if t.figure == trace.figure and t.marks.get("pressure") == trace.marks.get("pressure")]
    lowest = min(t.marks.get("frequency", 0.0) for t in alike)
    return trace.figure != "loop" or trace.marks.get("frequency", 0.0) == lowest


def _apart(trace: Trace, table: Published, points: PublishedPoints) -> Comparison:
    """A trace at the published places within it: branches are averaged in narrow bins."""
    x, y, fixed = _figures()[trace.figure]
    known = np.isfinite(trace.columns[x]) & np.isfinite(trace.columns[y])
    own, values = _one_curve(trace.columns[x][known], trace.columns[y][known])
    unit = shown(QUANTITY[fixed])
    place = f"{number((_place(trace, fixed) or 0.0) / unit.scale)} {unit.unit}"
    named = "contraction" if fixed == "displacement" else fixed
    over = f"{'contraction' if x == 'displacement' else x} at {named} {place}"
    over += f", {number(trace.marks['frequency'])} Hz" if "frequency" in trace.marks else ""
    theirs = list(zip(points.columns[x].tolist(), points.columns[y].tolist(), strict=True))
    return _compared(y, over, table.label, x, own, values, theirs)


def _one_curve(x: Array, y: Array) -> tuple[Array, Array]:
    """One curve y(x): points with rising x as they are; branches averaged in bins and extended to the ends."""
    if len(x) < 2 or np.all(np.diff(x) > 0):
        return x, y
    edges = np.linspace(x.min(), x.max(), BINS + 1)
    member = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
    middle, mean = (np.array([values[member == i].mean() for i in np.unique(member)]) for values in (x, y))
    if len(middle) < 2:
        return middle, mean
    slopes = (mean[1] - mean[0]) / (middle[1] - middle[0]), (mean[-1] - mean[-2]) / (middle[-1] - middle[-2])
    ends = mean[0] + slopes[0] * (x.min() - middle[0]), mean[-1] + slopes[1] * (x.max() - middle[-1])
    return np.array([x.min(), *middle, x.max()]), np.array([ends[0], *mean, ends[1]])


def _compared(
    name: str, over: str, label: str, axis: str, x: Array, y: Array, theirs: Sequence[tuple[float, float]]
) -> Comparison:
    slack = 1e-9 * float(np.abs(x).max(initial=0.0))
    within = [(at, value) for at, value in theirs if x.min() - slack <= at <= x.max() + slack and value != 0]
    _, unit = point_shown(axis if axis != "displacement" else "contraction")
    ends = sorted(at / unit.scale for at, _ in within)
    places = " to ".join(dict.fromkeys(f"{end:.4g}" for end in (*ends[:1], *ends[-1:])))
    places += f" {unit.unit}" if within else ""
    ratios = [(float(np.interp(at, x, y)) - value) / abs(value) for at, value in within]
    mean, size = (float(np.mean(ratios)), float(np.mean(np.abs(ratios)))) if ratios else (None, None)
    return Comparison(name, over, label, places, len(within), mean, size)


def comparison_table(compared: Sequence[Comparison]) -> Frame:
    """A row for each comparison; text."""
    rows = [
        {
            "quantity": c.name,
            "over": clean(c.over, 90),
            "published by": clean(c.label, 80),
            "points": str(c.points),
            "where": c.places,
            "mean difference [%]": "" if c.mean is None else rounded(100 * c.mean, None, 3),
            "mean size of it [%]": "" if c.size is None else rounded(100 * c.size, None, 3),
        }
        for c in compared
    ]
    return Frame(rows)
