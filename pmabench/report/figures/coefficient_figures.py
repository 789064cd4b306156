"""Figures of coefficients over an operating point, with 95 % bars, curves and bands; and of repeats over each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor, log10, nan
from typing import TYPE_CHECKING

import numpy as np

from pmabench.base.kind import Result
from pmabench.plotting import plots
from pmabench.plotting.pictures import Picture, bound, column, has, numbers, picture, unit_of
from pmabench.plotting.plots import BROWN, FAINT, HALF, PALETTE, QUIET, Array, Points, blank, few_ticks, grid
from pmabench.plotting.wording import (
    POINTS,
    RAISED,
    Frame,
    Shown,
    clean,
    in_order,
    listed,
    number,
    point_shown,
    shown,
    spoken,
    symbol_text,
)
from pmabench.report.document.tables import cell, least
from pmabench.report.words import declared
from pmabench.store.analyses.results import PUBLISHED, Analysis, Curve, Estimate, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOGETHER = (("K",), ("B_c", "B_r", "B"), ("F_ce",))
"""Symbols that are drawn over all tests together, those of one plot together."""
OVER_PRESSURE = {"pressure", "mean", "amplitude"}
"""Coordinates that a value in a plot over pressure may have: means and amplitudes of sines are drawn side by side."""
MOST_SERIES = 8
FEWEST = 3
"""Places that a plot of further coefficients needs; for fewer the tables are enough."""
CURVE_POINTS = 60


def over_pressure(
    analyses: Sequence[Analysis], results: Mapping[str, Result] | None = None, sides: Sequence[str] = ()
) -> list[Picture]:
    """K, damping and F_ce over pressure, of all tests and methods together; `results`: where others declare them.

    `sides`: two methods that are compared; the second is drawn open and a little aside.
    """
    results = declared(analyses) if results is None else results
    found = []
    every = [(a, e) for a in analyses for e in a.estimates if "pressure" in e.at and set(e.at) <= OVER_PRESSURE]
    for symbols in TOGETHER:
        members = [(a, e) for a, e in every if e.symbol in symbols and not e.coordinate]
        found.append(_figure(symbols, results, "pressure", _without_variants(members), sides))
    return [drawn for drawn in found if drawn is not None]


def _without_variants(members: Sequence[tuple[Analysis, Estimate]]) -> list[tuple[Analysis, Estimate]]:
    """Without `mean-curve, turns left in` where there is `mean-curve`: variants are in the tables."""
    methods = {e.method for _, e in members}
    return [
        (a, e)
        for a, e in members
        if a.kind == PUBLISHED or "," not in e.method or e.method.partition(", ")[0] not in methods
    ]


def others(analysis: Analysis) -> list[Picture]:
    """Every further coefficient of an analysis that varies with exactly one coordinate of its operating point."""
    found = []
    results = declared([analysis])
    groups: dict[str, list[str]] = {}
    for result in results.values():
        groups.setdefault(result.plot or f" {result.symbol}", []).append(result.symbol)
    for group in groups.values():
        members = [e for e in analysis.estimates if e.symbol in group and e.at]
        over = _varying(members)
        shown_already = over == "pressure" and any(set(group) <= set(symbols) for symbols in TOGETHER)
        drawn = {t.figure for t in analysis.traces}
        elsewhere = (
            shown_already or ("bode" in drawn and over == "frequency") or ("section" in drawn and group == ["m"])
        )
        if over is not None and not elsewhere and len({e.at[over] for e in members}) >= FEWEST:
            found.append(_figure(group, results, over, [(analysis, e) for e in members]))
    return [drawn for drawn in found if drawn is not None]


def _varying(estimates: Sequence[Estimate]) -> str | None:
    """The one coordinate that varies; None for none or several."""
    names = in_order((name for e in estimates for name in e.at), POINTS)
    varying = [name for name in names if name != "mass" and len({e.at.get(name) for e in estimates}) > 1]
    return varying[0] if len(varying) == 1 and all(varying[0] in e.at for e in estimates) else None


def _figure(
    symbols: Sequence[str],
    results: Mapping[str, Result],
    over: str,
    members: Sequence[tuple[Analysis, Estimate]],
    sides: Sequence[str] = (),
) -> Picture | None:
    """One plot, `sides` as in `over_pressure`; None where fewer than two values can be drawn."""
    known = [e for _, e in members if e.value is not None]
    units = {shown(e.quantity, e.unit) for e in known}
    if len(known) < 2 or len({e.at[over] for e in known}) < 2 or len(units) != 1:
        return None
    if all(abs(e.value or 0.0) < least(e) * shown(e.quantity, e.unit).scale for e in known):
        return None
    unit, (x_label, x_unit) = _sized(units.pop(), known), point_shown(over)
    points = _points(members, over, unit, x_unit, sides)
    titled = {e.symbol: results.get(e.symbol) for e in known}
    names = listed([clean(f"{result.title if result else ''} {s}".strip()) for s, result in titled.items()])
    y_label = unit.label(", ".join(clean(s) for s in in_order(titled, results)))
    ends = sorted(e.at[over] / x_unit.scale for e in known)
    values = sorted((e.value or 0.0) / unit.scale for e in known)
    reach = f"from {number(ends[0])} to {number(ends[-1])} {x_unit.unit}".rstrip()
    methods = dict.fromkeys(clean(e.method, 60) for e in known)
    alt = (
        f"Plot of {names} over {x_label}, {reach}; values between {values[0]:.4g} and {values[-1]:.4g} {unit.unit}, "
        f"by {listed(list(methods))}. The numbers are in the table below the figure."
    )
    leading = next(iter(titled.values()))
    named = names[:1].upper() + names[1:] if leading and leading.title else names
    title = f"{clean(leading.plot) if leading and leading.plot else named} over {spoken(over)}"
    return picture(
        lambda: plots.coefficients(points, x_unit.label(x_label), y_label),
        title,
        _caption(points, members, over, sides),
        alt,
        table_of([e for _, e in members], over),
        wide=False,
        simulated=any(analysis.simulated for analysis, _ in members),
    )


def _points(
    members: Sequence[tuple[Analysis, Estimate]], over: str, unit: Shown, x_unit: Shown, sides: Sequence[str]
) -> list[Points]:
    """Series to draw: at most `MOST_SERIES` series of symbol and method, then the published ones."""
    series: dict[tuple[str, str, str], list[tuple[Analysis, Estimate]]] = {}
    for analysis, e in members:
        if e.value is not None:
            series.setdefault((e.symbol, e.coordinate, e.method), []).append((analysis, e))
    variants = list(dict.fromkeys(key[:2] for key in series))
    methods = list(dict.fromkeys(key[2] for key in series))
    several = len(variants) > 1
    first = {*sides[:1]} or {a.estimates[0].method for a, _ in members if a.kind != PUBLISHED}
    keys = sorted(series, key=lambda key: (variants.index(key[:2]), methods.index(key[2])))
    theirs = [key for key in keys if series[key][0][0].kind == PUBLISHED]
    points: list[Points] = []
    for key in [key for key in keys if key not in theirs][:MOST_SERIES] + theirs:
        symbol, coordinate, method = key
        name_text = symbol_text(symbol, coordinate)
        name = clean(method, 60)
        at = sorted(series[key], key=lambda member: member[1].at[over])
        reaches = np.array([reach_of(e) for _, e in at]) / unit.scale
        mark = methods.index(method) if several and len(methods) > 1 else len(points)
        points.append(
            Points(
                label=(name_text if len(methods) == 1 else f"{name_text}, {name}") if several else name,
                x=np.array([e.at[over] for _, e in at]) / x_unit.scale,
                y=np.array([e.value for _, e in at], dtype=np.float64) / unit.scale,
                below=reaches[:, 0],
                above=reaches[:, 1],
                primary=key not in theirs and (method in first or len(methods) == 1),
                group=variants.index(key[:2]) if several else methods.index(method),
                mark=theirs.index(key) if key in theirs else mark,
                curve=curve_of(at, over, unit.scale, x_unit.scale),
                published=key in theirs,
            )
        )
    return points


def _caption(
    points: Sequence[Points], members: Sequence[tuple[Analysis, Estimate]], over: str, sides: Sequence[str]
) -> str:
    """Caption: what marks and bars mean, the source of published values, and what is missing."""
    caption = "95 % intervals" if any(np.isfinite(p.above).any() for p in points) else "Values without intervals"
    mixed = not all(p.primary or p.published for p in points)
    filled, hollow = map(clean, sides) if sides else ("primary method of each test", "others")
    aside = ", a little aside" if sides else ""
    caption += f"; filled: {filled}, open: {hollow}{aside}." if mixed else "."
    theirs = [clean(e.method, 60) for a, e in members if a.kind == PUBLISHED and e.value is not None]
    if theirs:
        caption += f" Crosses: {listed(list(dict.fromkeys(theirs)))}, not measured here."
    return caption + missing_words([e for _, e in members], over, 6)


def missing_words(estimates: Sequence[Estimate], over: str, most: int) -> str:
    """A sentence for values that are not identifiable, and one for those that are withheld; at most so many places."""
    text, unit = "", point_shown(over)[1]
    for withheld, word in ((False, "Not identifiable"), (True, "Withheld")):
        missing = [e for e in estimates if e.value is None and e.withheld == withheld]
        places = [(symbol_text(e.symbol), number(e.at[over] / unit.scale)) for e in missing[:most]]
        where = [f"{symbol} at {place} {unit.unit}".strip() for symbol, place in places]
        text += f" {word}: {listed(where)}{' and others' if len(missing) > most else ''}." if where else ""
    return text


def _sized(unit: Shown, known: Sequence[Estimate]) -> Shown:
    """The unit with a power of ten before it where values would ask for an exponent at the axis."""
    largest = max(abs(e.value or 0.0) for e in known) / unit.scale
    if largest == 0 or 1e-3 <= largest < 1e5:
        return unit
    power = 3 * floor(log10(largest) / 3)
    return Shown(f"10{str(power).translate(RAISED)} {unit.unit}".rstrip(), unit.scale * 10.0**power)


def reach_of(e: Estimate) -> tuple[float, float]:
    """How far the interval reaches below and above the value [SI]; NaN without one."""
    ends = e.ci95
    return (nan, nan) if ends is None or e.value is None else (max(0.0, e.value - ends[0]), ends[1] - e.value)


def curve_of(
    members: Sequence[tuple[Analysis, Estimate]], over: str, scale: float, x_scale: float
) -> tuple[Array, Array, Array] | None:
    """The analysis' closest curve through these points with its band, in display units; None without one.

    Half width of the band: that of the points, joined by straight lines, and 1.96 times the residual, as squares.
    """
    analysis, first = members[0]
    matching: list[Curve] = [
        c
        for c in analysis.curves
        if c.symbol == first.symbol and c.method == first.method and c.against == over and c.domain[0] < c.domain[1]
    ]
    if not matching or any(term.value is None for term in matching[0].terms):
        return None
    closest = min(matching, key=lambda c: c.residual_rms)
    x = np.linspace(*closest.domain, CURVE_POINTS)
    y = closest.values(x)
    at = np.array([e.at[over] for _, e in members])
    half = np.interp(x, at, [reach_of(e)[1] for _, e in members])
    residual = closest.residual_rms if np.isfinite(closest.residual_rms) else 0.0
    band = np.hypot(half, 1.96 * residual)
    return np.asarray(x / x_scale), np.asarray(y / scale), np.asarray(band / scale)


def table_of(estimates: Sequence[Estimate], over: str) -> Frame:
    """The numbers of a plot: one row for each estimate; text."""
    head, unit = point_shown(over)
    rows = [
        {
            "method": clean(e.method),
            "symbol": symbol_text(e.symbol, e.coordinate),
            unit.label(head): number(e.at[over] / unit.scale),
            shown(e.quantity, e.unit).label("value"): cell(e),
            "trials": str(e.n),
        }
        for e in estimates
    ]
    return Frame(rows)


WORDS = {"length": "contraction", "force": "force"}


def repeats(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for each trace with at least two repeats."""
    return [found for trace in traces if (found := _repeats(trace, analysis.simulated)) is not None]


def _repeats(trace: Trace, simulated: bool) -> Picture | None:
    names = [name for name in trace.columns if name.startswith("repeat ") and has(trace, "t", name)]
    if len(names) < 2:
        return None
    where, t = clean(trace.title.partition(":")[0], 140), column(trace, "t")
    values = np.array([column(trace, name) for name in names])
    mean = values.mean(axis=0)
    unit = unit_of(trace, names[0]).unit
    spread = float(np.sqrt(np.mean(values.var(axis=0, ddof=1))))
    first = float(np.sqrt(np.mean((values[0] - values[1:].mean(axis=0)) ** 2)))
    word = WORDS.get(trace.quantities.get(names[0], ""), "value")
    last = "the second" if len(names) == 2 else "the mean of the later ones"
    caption = (
        f"{len(names)} trials at {where}, the first in red. Below: each less the mean of all. Standard deviation "
        f"between repeats {spread:.2g} {unit}, over the whole time; the first is {first:.2g} {unit} rms off {last}."
    )
    alt = (
        f"{word.capitalize()} over time of {len(names)} repeats at {where}, which scatter by {spread:.2g} "
        f"{unit}; the first is {first:.2g} {unit} rms off {last}."
    )
    draw = bound(drawing_of, t, values, mean, unit_of(trace, "t").label("time"), word, unit)
    return picture(draw, "Repeats", caption, alt, numbers([("", trace)]), wide=False, simulated=simulated)


def drawing_of(t: Array, values: Array, mean: Array, x_label: str, word: str, unit: str) -> Figure:
    """Values (repeats, n) above, what they are off their mean (n,) below."""
    figure = blank(HALF, 2.9)
    cell = grid(figure, 1, 1, top=0.42, left=0.6)[0]
    upper, lower = plots.above_each_other(figure, cell, (1.6, 1), 0.12, shared=True)
    others = [color for color in PALETTE if color != BROWN]
    lower.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
    for i in reversed(range(len(values))):
        color = BROWN if i == 0 else others[(i - 1) % len(others)] if len(values) < 4 else QUIET
        label = ("first" if i == 0 else "second" if len(values) == 2 else "later") if i < 2 else None
        upper.plot(t, values[i], color=color, linewidth=0.8 if i else 1.0, label=label)
        lower.plot(t, values[i] - mean, color=color, linewidth=0.8)
    upper.set_ylabel(f"{word} [{unit}]")
    lower.set(ylabel=f"off mean [{unit}]", xlabel=x_label)
    few_ticks(upper)
    few_ticks(lower, y=3)
    figure.align_ylabels([upper, lower])
    handles, labels = upper.get_legend_handles_labels()
    plots.legend_above(figure, 2, (handles[::-1], labels[::-1]))
    return figure
