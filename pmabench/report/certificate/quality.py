"""The second page of the certificate but for its figure, and what the results do not hold for, in short lines.

- fit statistics, checks next to the residual, findings that matter
- where the uncertainty comes from: one bar for each coefficient, shares of the variance by cause, at the middle
- which operating points the results rest on: a matrix of trials used over two coordinates of the sweep, where the
  runs are at hand
- limits: beyond the tested range, stroke and speed, and what no test here looked at; every line is made from what the
  runs and analyses hold, and where these do not say it, the line says that
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from pmabench.analysis.verdict.checks import checks_of
from pmabench.plotting.chart import BLUE, BROWN, DARK, GREEN, QUIET
from pmabench.plotting.pictures import column, has, unit_of, usable
from pmabench.plotting.svg import capital
from pmabench.plotting.wording import (
    POINTS,
    RESOLVED,
    brief,
    clean,
    in_order,
    number,
    point_head,
    point_shown,
    point_text,
    printed,
    rounded,
    shown,
    symbol_text,
)
from pmabench.report.document.provenance import get, span
from pmabench.report.document.tables import mappings
from pmabench.report.foremost import costliest, left_out, widest_half
from pmabench.report.words import reverses
from pmabench.store.analyses.results import Analysis, Curve, Estimate
from pmabench.store.records import RunData, is_number

LINES = 4
LONGEST = 230
"""Letters of a finding on the certificate; the whole text is in the appendix."""
SHORT = {
    "repeat_spread": "repeats scatter by",
    "drift": "first to last trial changes by",
    "held_out": "loads predicted by a fit to the others, error",
    "other_direction": "relaxation predicted from contraction, error",
    "first_repeat": "first repeat differs by",
    "free_run": "free run, NRMSE",
}
"""Checks in the order in which they matter, in a few words."""


def statistics(analysis: Analysis) -> list[tuple[str, str]]:
    """Up to four lines: residual against noise, fitted curves."""
    found = []
    residual = next((f.text for f in analysis.findings if f.text.startswith("residual ")), "")
    if residual:
        found.append(("Residual", printed(brief(residual.removeprefix("residual "), 120))))
    curves: dict[str, Curve] = {}
    for curve in sorted(analysis.curves, key=lambda c: c.residual_rms):
        if curve.method == analysis.estimates[0].method and curve.terms and not curve.normalised:
            curves.setdefault(curve.symbol, curve)
    for symbol, curve in curves.items():
        unit = shown(curve.terms[0].quantity, curve.terms[0].unit)
        rms = f"{rounded(curve.residual_rms / unit.scale, None, 2)} {unit.unit}"
        found.append((symbol_text(symbol), f"{clean(curve.form, 40)} over {clean(curve.against, 40)} within {rms} rms"))
    return found[:LINES]


def checks(analysis: Analysis) -> list[tuple[str, str, str]]:
    """Up to four lines of level (`good` or `doubt`), words and value; doubts first."""
    known = {check.name: check for check in checks_of(analysis) if check.quantity == "ratio"}
    order = sorted((n for n in SHORT if n in known), key=lambda n: known[n].level != "doubt")
    return [
        (
            "doubt" if known[name].level == "doubt" else "good",
            SHORT[name],
            f"{rounded(100 * abs(known[name].value), None, 2)}\u00a0%",
        )
        for name in order[:LINES]
    ]


def findings(tests: Sequence[Analysis], failed: Sequence[str]) -> list[str]:
    """What costs most, at most three."""
    found, _ = costliest(tests, failed)
    return [capital(brief(text, LONGEST)) for text in found]


COLORS = {"repeats": BLUE, "calibration": BROWN, "method": GREEN, "drift": QUIET, "skew": DARK}
"""Cause -> its colour; the same words are in the appendix."""
BARS = 5
SMALL = 0.005
"""Share of the variance below which a piece is not drawn."""


@dataclass(frozen=True)
class Bar:
    """One coefficient: half width in words, pieces (cause, colour, share from 0 to 1), its largest single source."""

    symbol: str
    half: str
    pieces: list[tuple[str, str, float]]
    largest: str


@dataclass(frozen=True)
class Sources:
    """Bars at one operating point, and the causes that are in them."""

    where: str
    bars: list[Bar]
    causes: list[tuple[str, str]]


def sources(members: Sequence[Estimate], over: str) -> Sources | None:
    """The bars for the values of the first table, each symbol at the middle of `over`; None without any interval."""
    known = [e for e in members if e.value and e.parts.combined]
    places = sorted({e.at.get(over, 0.0) for e in known})
    if not places:
        return None
    here = {e.symbol: e for e in known if e.at.get(over, 0.0) == places[len(places) // 2]}
    bars = [_bar(e) for e in list(here.values())[:BARS]]
    used = {cause for bar in bars for cause, _, _ in bar.pieces}
    at = next(iter(here.values())).at
    where = point_text({over: at[over]} if over in at else at)
    return Sources(where, bars, [(cause, color) for cause, color in COLORS.items() if cause in used])


def _bar(e: Estimate) -> Bar:
    combined = e.parts.combined or 1.0
    shares = {cause: ((part or 0.0) / combined) ** 2 for cause, part in vars(e.parts).items()}
    pieces = [(cause, COLORS[cause], shares[cause]) for cause in COLORS if shares.get(cause, 0.0) >= SMALL]
    largest = max(e.budget, key=lambda s: s.half or 0.0, default=None)
    words = ""
    if largest is not None and largest.half:
        words = f"{clean(largest.name, 60)}, {100 * min(1.0, largest.half / combined) ** 2:.0f} %"
    elif pieces:
        cause, _, share = max(pieces, key=lambda piece: piece[2])
        words = f"{cause}, {100 * share:.0f} %"
    return Bar(symbol_text(e.symbol), widest_half([e]), pieces, words)


MOST_ROWS, MOST_COLUMNS = 9, 12
FOLLOWING = ("mass", "cycles", "speed", "side")
"""Coordinates that follow from others, or are a direction."""
Point = Mapping[str, float]


@dataclass(frozen=True)
class Box:
    """Trials of one operating point: how many are used, and how many were left out."""

    used: int
    left: int

    @property
    def text(self) -> str:
        """What is printed: `2`, `1 !` where others were left out, nothing where none was planned."""
        return f"{self.used or ''}{' !' if self.left and self.used else ''}".strip()

    @property
    def look(self) -> str:
        """`used`, `none` (all were left out) or `empty`."""
        return "used" if self.used else "none" if self.left else "empty"


@dataclass(frozen=True)
class Coverage:
    """The matrix; `down` and `across` name its sides with their units."""

    down: str
    across: str
    columns: list[str]
    rows: list[tuple[str, list[Box]]]
    used: int
    left: int
    words: str
    """Why trials were left out; empty where none was."""


def coverage(analysis: Analysis, runs: Sequence[RunData]) -> Coverage | None:
    """The matrix of one analysis; None where its trials name no operating point."""
    used, left = _counts(analysis, runs)
    every = [dict(point) for point in (*used, *left)]
    all_names = in_order((key for point in every for key in point if key not in FOLLOWING), POINTS)
    names = [n for n in all_names if len({point.get(n) for point in every}) > 1] or all_names[:1]
    if not names:
        return None
    across = "pressure" if "pressure" in names else names[0]
    down = next((name for name in names if name != across), "")
    columns = sorted({point[across] for point in every if across in point})
    rows = sorted({point[down] for point in every if down in point}, reverse=True) if down else [0.0]
    if not columns or not rows:
        return None
    columns, rows = columns[:: -(-len(columns) // MOST_COLUMNS)], rows[:: -(-len(rows) // MOST_ROWS)]

    def box(row: float, column: float) -> Box:
        here = {(across, column), *([(down, row)] if down else [])}
        return Box(*(sum(n for key, n in counts.items() if here <= set(key)) for counts in (used, left)))

    return Coverage(
        point_head(down) if down else "",
        point_head(across),
        [_value(across, column) for column in columns],
        [(_value(down, row) if down else "all", [box(row, column) for column in columns]) for row in rows],
        used.total(),
        left.total(),
        left_out(analysis.dropped),
    )


Key = tuple[tuple[str, float], ...]


def _counts(analysis: Analysis, runs: Sequence[RunData]) -> tuple[Counter[Key], Counter[Key]]:
    """Trials that are used and left out, by operating point."""
    left = Counter(_key(one.point) for one in analysis.dropped)
    out = {one.trial for one in analysis.dropped}
    mine = [t for run in runs if run.id in analysis.runs for t in run.trials]
    return Counter(_key(t.point) for t in mine if t.name not in out and t.status == "finished"), left


def _key(point: Point) -> Key:
    return tuple(sorted((k, float(f"{v:.6g}")) for k, v in point.items() if k not in FOLLOWING))


def _value(name: str, value: float) -> str:
    return number(float(f"{value / point_shown(name)[1].scale:.4g}"))


MOST_RANGES = 3
WINDOW = 0.02
"""Time over which a speed is taken from recorded motion [s]."""
Line = tuple[str, str]


def limits(analysis: Analysis | None, analyses: Sequence[Analysis], runs: Sequence[RunData]) -> list[Line]:
    """Up to six lines of a word and a sentence; `analysis`: the one whose values the first table has."""
    mine = [run for run in runs if analysis is not None and run.id in analysis.runs] or list(runs)
    found = [_range(analysis, mine), _stroke(analysis, mine), _speed(analysis, mine)]
    found.append(("Temperature", "the record holds none: values are those of the day of the test"))
    found.append(_wear(mine))
    stiffness = analysis is not None and any(e.symbol == "K" for e in analysis.estimates)
    if stiffness and not any(reverses(a.kind) for a in analyses):
        found.append(("Small reversals", "not tested: K is that of whole strokes, a small loop is stiffer"))
    return [line for line in found if line is not None]


def _points(analysis: Analysis | None, runs: Sequence[RunData]) -> list[dict[str, float]]:
    """Operating points of the trials that are used; those of the values where the runs are not at hand."""
    out = {one.trial for one in analysis.dropped} if analysis else set()
    points = [dict(t.point) for run in runs for t in run.trials if t.name not in out and t.status == "finished"]
    if not points and analysis is not None:
        points = [dict(e.at) for e in analysis.estimates if e.value is not None]
    return points


def _range(analysis: Analysis | None, runs: Sequence[RunData]) -> Line | None:
    points = _points(analysis, runs)
    parts = []
    for name in in_order((key for point in points for key in point if key in POINTS), POINTS):
        values = [point[name] for point in points if is_number(point.get(name))]
        if name not in FOLLOWING and values:
            least = RESOLVED * max(map(abs, values))  # a zero of another unit may be a rounding error
            parts.append(span(name, [value if abs(value) > least else 0.0 for value in values], " "))
    return ("Range", f"outside {', '.join(parts[:MOST_RANGES])}") if parts else None


def _stroke(analysis: Analysis | None, runs: Sequence[RunData]) -> Line | None:
    far = [float(step["x_inf"]) for step in mappings(analysis.facts.get("steps") if analysis else None)
           if is_number(step.get("x_inf"))]  # fmt: skip
    for trace in analysis.traces if analysis else ():
        if has(trace, "displacement"):
            far.append(float(np.nanmax(column(trace, "displacement"))) * unit_of(trace, "displacement").scale)
    length = next((v for run in runs if is_number(v := get(run.manifest, "specimen", "nominal_length"))), None)
    if not far or max(far) <= 0:
        return None
    share = f", {rounded(100 * max(far) / length, None, 2)} % of the nominal length" if length else ""
    return "Stroke", f"contractions beyond {rounded(1e3 * max(far), None, 3)} mm{share}"


def _speed(analysis: Analysis | None, runs: Sequence[RunData]) -> Line | None:
    """The fastest motion: of sines and ramps as commanded, else as the recorded strokes show it."""
    points = _points(analysis, runs)
    fastest = [2 * pi * p["frequency"] * p["amplitude"] for p in points if {"frequency", "amplitude"} <= set(p)]
    fastest += [abs(p["speed"]) for p in points if is_number(p.get("speed"))]
    if not fastest and analysis is not None:
        fastest = list(_recorded(analysis))
    if not fastest or max(fastest) <= 0:
        return None
    return "Speed", f"motion faster than {rounded(1e3 * max(fastest), None, 2)} mm/s, the fastest here"


def _recorded(analysis: Analysis) -> Iterator[float]:
    for trace in filter(usable, analysis.traces):
        if not {"t", "displacement"} <= set(trace.columns):
            continue
        t, x = (column(trace, name) * unit_of(trace, name).scale for name in ("t", "displacement"))
        step = float(np.median(np.diff(t))) if len(t) > 2 else 0.0
        n = max(1, round(WINDOW / step)) if step > 0 else 0
        if n and len(t) > 2 * n:
            with np.errstate(all="ignore"):
                speed = np.abs(x[n:] - x[:-n]) / (t[n:] - t[:-n])
            if np.isfinite(speed).any():
                yield float(np.nanmax(np.where(np.isfinite(speed), speed, np.nan)))


def _wear(runs: Sequence[RunData]) -> Line:
    before = next((v for run in runs if is_number(v := get(run.manifest, "specimen", "cycles_before"))), None)
    done = f"this one had done {number(before)} cycles before" if before is not None else "its cycles are not recorded"
    return "Wear, others", f"other specimens, or this one after many more cycles: {done}"
