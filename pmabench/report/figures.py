"""Which figures an analysis has, and those of coefficients over an operating point: dots with 95 % bars, curves, bands.

A trace of an unknown kind becomes a generic line plot, so a new reduction needs no entry here. The certificate has up
to three panels with the coefficients of the test with most values: its primary method is drawn, others are in the same
data, for the buttons of the page. Appendices and comparisons have a figure for each plot, in which other methods are
drawn open. Values with two coordinates, as F and K of a surface, are over the contraction, at each pressure in its
colour.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import floor, log10, nan

import numpy as np

from pmabench.base.kind import Result, load
from pmabench.kinds import registry
from pmabench.plotting.chart import (
    BROWN,
    COLUMN,
    DARK,
    GAP,
    GREEN,
    HIGH,
    INK,
    PAGE,
    PALETTE,
    Array,
    Chart,
    Series,
    small_multiples,
)
from pmabench.plotting.pictures import Picture, column, curve, drawable, has, label, of_charts, of_traces, spread
from pmabench.plotting.svg import capital
from pmabench.plotting.wording import (
    COLUMNS,
    POINTS,
    RAISED,
    Frame,
    Shown,
    clean,
    in_order,
    listed,
    number,
    point_head,
    point_shown,
    shown,
    spoken,
    symbol_text,
)
from pmabench.report.certificate.force_chart import FIGURE, READABLE, blue
from pmabench.report.document.tables import cell, least
from pmabench.report.words import declared
from pmabench.store.analyses.results import AGREEMENT, PUBLISHED, Analysis, Curve, Estimate, Trace

GENERIC, FEW = 6, 30
"""Most figures of traces that no kind of test draws, and points up to which they may be marks."""


def front_pictures(
    analyses: Sequence[Analysis], most: int, without: Sequence[str] = ()
) -> tuple[list[Picture], list[str]]:
    """At most so many plots for the first pages, by what the kinds declare, and the names of the traces in them.

    `without` names traces that are shown already.
    """
    analyses = [drawable(analysis) for analysis in analyses]
    found: list[Picture] = []
    used: list[str] = []
    for analysis in analyses:
        kind = registry.find(analysis.kind)
        for wanted, target in kind.front.items() if kind else ():
            traces = [t for t in analysis.traces if t.figure == wanted and t.name not in without]
            if not traces or len(found) >= most or (without and wanted == "overlay"):
                continue
            hero = max(traces, key=_stroke)
            pictures = load(target)(traces if len(traces) == 2 and wanted != "overlay" else [hero], analysis)
            found += pictures[:1]
            used += [hero.name] if pictures and wanted == "overlay" and len(traces) > 2 else []
    titles = {picture.title for picture in found}
    for analysis in analyses if len(found) < most else ():
        more = kind_pictures(analysis, [*without, *used])
        # a picture of all contractions would repeat that of one: `Force over pressure, x = 0 mm`
        found += [one for one in more if not any(title.startswith(one.title) for title in titles)]
    return found[:most], used


def _stroke(trace: Trace) -> float:
    """The largest displacement of a trace, to choose one for the first page."""
    values = np.abs(column(trace, "displacement")) if "displacement" in trace.columns else np.zeros(1)
    return float(np.max(values, where=np.isfinite(values), initial=0.0))


def kind_pictures(analysis: Analysis, without: Sequence[str] = ()) -> list[Picture]:
    """All further figures of an analysis; `without` names traces that are shown elsewhere."""
    analysis = drawable(analysis)
    found = others(analysis)
    traces = [t for t in analysis.traces if t.name not in without]
    left = {t.figure for t in traces} - {FIGURE}  # in the second figure of the certificate
    for target, kinds in _drawn_by(analysis.kind).items():
        mine = [t for t in traces if t.figure in kinds]
        left -= kinds
        if mine:
            found += load(target)(mine, analysis) or _generic(mine, analysis)
    return found + _generic([t for t in traces if t.figure in left], analysis)


def _drawn_by(kind: str) -> dict[str, set[str]]:
    """Drawing function -> kinds of traces that it draws: those of the kind of test first, then those of others."""
    own = registry.find(kind)
    found: dict[str, set[str]] = {}
    known: set[str] = set()
    for figures in [own.figures if own else {}, *(other.figures for other in registry.all_kinds().values())]:
        for figure, target in figures.items():
            if figure not in known:
                found.setdefault(target, set()).add(figure)
        known |= set(figures)
    return found


def _generic(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    found = []
    for trace in spread(traces, GENERIC):
        names = [name for name in trace.columns if has(trace, name)]
        if len(names) < 2:
            continue
        x, rest = names[0], names[1:9]
        rows = small_multiples([_lines(trace, x, rest)], 1, width=PAGE)
        title = clean(trace.title, 120) or clean(trace.name, 80)
        found.append(of_traces(rows, title, "", analysis, [trace]))
    return found


def _lines(trace: Trace, x: str, names: Sequence[str]) -> list[Chart]:
    """Columns over another one, a chart for each axis label; few points as marks."""
    at, axes = column(trace, x), [_axis(trace, name, names) for name in names]
    mark = "o" if len(at) <= FEW and not np.all(np.diff(at) > 0) else ""
    series: dict[str, list[Series]] = {}
    for n, (name, axis) in enumerate(zip(names, axes, strict=True)):
        said, color = _word(name) if axes.count(axis) > 1 else "", PALETTE[n % len(PALETTE)]
        series.setdefault(axis, []).append(curve(trace, x, name, said, color, mark, dashed=n % 2 > 0 and bool(said)))
    return [Chart(label(trace, x), axis, tuple(mine), height=128.0, legend=True) for axis, mine in series.items()]


def _word(name: str) -> str:
    return COLUMNS.get(name) or clean(name, 40)


def _axis(trace: Trace, name: str, names: Sequence[str]) -> str:
    """Columns of one quantity share an axis, which has the name of the first."""
    quantity = trace.quantities.get(name, "")
    first = next(other for other in names if trace.quantities.get(other, "") == quantity)
    return shown(quantity).label(_word(first) if quantity else _word(name))


COLORS = {"B_c": GREEN, "B_r": BROWN, "B": DARK}
"""Colours of symbols; all others are blue, or in turn where they share a panel."""
HEIGHT, HIGHER = 118.0, 150.0
"""Heights of the panels of the certificate, and of those by two coordinates [pt]."""
MOST = 3
"""Most panels of the certificate, and of those by two coordinates."""
LETTERS = 98
"""Letters of a figure's title on one line of the certificate."""
TOGETHER = (("K",), ("B_c", "B_r", "B"), ("F_ce",))
"""Symbols that are drawn over all tests together, those of one plot together."""
OVER_PRESSURE = {"pressure", "mean", "amplitude"}
"""Coordinates that a value in a plot over pressure may have: means and amplitudes of sines are drawn side by side."""
MOST_SERIES = 8
"""Most series of own values of a plot; published ones are drawn besides."""
FEWEST = 3
"""Places that a plot of further coefficients needs; for fewer the tables are enough."""
CURVE_POINTS = 60
ASIDE = 0.012
"""How far dots of each further method lie aside, as a share of the range."""
SHORT = 8
"""Letters of names that stand at their last point; longer ones are above the axes."""
Member = tuple[Analysis, Estimate]
Way = tuple[str, str]
"""Symbol with its coordinate, and method."""


def coefficient_picture(
    analyses: Sequence[Analysis], members: Sequence[Estimate], over: str, less: float
) -> Picture | None:
    """The panels for the values of the first table, `members` over `over`, lower by `less` [pt]; None without two."""
    results = declared(analyses)
    primary = {_way(e) for e in members}
    names = _at(analyses, members) | {over, "mass", "mean", "amplitude"}
    every = [
        (a, e)
        for a in analyses
        for e in a.estimates
        if a.kind != AGREEMENT and not e.coordinate and over in e.at and set(e.at) <= names
    ]
    panels: list[tuple[list[str], list[Member]]] = []
    for symbols in _plots(results, [e.symbol for e in members]).values():
        mine = [(a, e) for a, e in every if e.symbol in symbols]
        if _drawable([e for _, e in mine if _way(e) in primary], over):
            panels.append((symbols, mine))
    panels = panels[:MOST]
    drawn = [member for _, mine in panels for member in mine]
    if not panels:
        return None
    titled = listed([_title(symbols, results) for symbols, _ in panels])
    title = f"{capital(titled)} over {spoken(over)}"
    size = (PAGE - GAP * (len(panels) - 1)) / len(panels), HEIGHT - less - _second_line(title)
    made = [_chart(symbols, mine, over, primary, size) for symbols, mine in panels]
    own = [e for a, e in drawn if _way(e) in primary and a.kind != PUBLISHED]
    methods = listed(list(dict.fromkeys(clean(e.method, 60) for e in own)))
    bars = "bars and bands: 95 % intervals" if any(e.ci95 for e in own) else "without intervals"
    caption = f"Dots: {methods}; {bars}, often smaller than a dot.{_crosses(drawn)}{missing_words(own, over, 4)}"
    simulated = any(a.simulated for a, _ in drawn)
    return of_charts([made], title, caption, table_of([e for _, e in drawn], over), simulated=simulated)


def _second_line(title: str) -> float:
    """Height of the second line of a figure's title [pt]; 0 where it has one."""
    return 15.0 if len(title) > LETTERS else 0.0


def _at(analyses: Sequence[Analysis], members: Sequence[Estimate]) -> set[str]:
    """Coordinates of the values of the table, also of those that it leaves out because they are the same in all."""
    known = {_way(e) for e in members}
    whole = [e for a in analyses for e in a.estimates if _way(e) in known]
    return {name for e in whole if any(replace(e, at=m.at) == m for m in members) for name in e.at}


def _plots(results: Mapping[str, Result], symbols: Sequence[str]) -> dict[str, list[str]]:
    """Symbols by the plot that they share; others have one of their own."""
    found: dict[str, list[str]] = {}
    for symbol in dict.fromkeys(symbols):
        result = results.get(symbol)
        found.setdefault((result.plot if result else "") or f" {symbol}", []).append(symbol)
    return found


def _title(symbols: Sequence[str], results: Mapping[str, Result]) -> str:
    first = results.get(symbols[0])
    named = (first.plot.lower() if len(symbols) > 1 else "") or first.title if first else ""
    return f"{clean(named)} {', '.join(clean(s, 40) for s in symbols)}".strip()


def _way(e: Estimate) -> Way:
    return symbol_text(e.symbol, e.coordinate), e.method


def _drawable(members: Sequence[Estimate], over: str) -> bool:
    """Whether values of one unit are known at two places or more, and not all below resolution."""
    known = [e for e in members if e.value is not None]
    if len({e.at[over] for e in known}) < 2 or len({shown(e.quantity, e.unit) for e in known}) != 1:
        return False
    return any(abs(e.value or 0.0) >= least(e) * shown(e.quantity, e.unit).scale for e in known)


def over_pressure(analyses: Sequence[Analysis], results: Mapping[str, Result], sides: Sequence[str]) -> list[Picture]:
    """K, damping and F_ce over pressure of both `sides` of a comparison, whose names are the methods."""
    found = []
    every = [(a, e) for a in analyses for e in a.estimates if "pressure" in e.at and set(e.at) <= OVER_PRESSURE]
    for symbols in TOGETHER:
        members = [(a, e) for a, e in every if e.symbol in symbols and not e.coordinate]
        found.append(_figure(symbols, results, "pressure", members, sides))
    return [drawn for drawn in found if drawn is not None]


def others(analysis: Analysis) -> list[Picture]:
    """Every further coefficient of an analysis that varies with exactly one coordinate of its operating point."""
    found = []
    results = declared([analysis])
    for group in _plots(results, list(results)).values():
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
    members: Sequence[Member],
    sides: Sequence[str] = (),
) -> Picture | None:
    """One plot, of the two `sides` of a comparison if given; None where fewer than two values can be drawn."""
    known = [e for _, e in members if e.value is not None]
    if not _drawable([e for _, e in members], over):
        return None
    mine = [(a, e) for a, e in members if a.kind != PUBLISHED]
    main = set(sides[:1]) or {a.estimates[0].method for a, _ in mine}
    methods_of: dict[str, str] = {}
    for _, e in sorted(mine, key=lambda member: member[1].method not in main):
        methods_of.setdefault(*_way(e))
    primary = set(methods_of.items())
    chart = _chart(in_order((e.symbol for e in known), symbols), members, over, primary, (COLUMN, HIGH), still=True)
    titled = {e.symbol: results.get(e.symbol) for e in known}
    names = listed([clean(f"{result.title if result else ''} {s}".strip()) for s, result in titled.items()])
    leading = next(iter(titled.values()))
    named = capital(names) if leading and leading.title else names
    title = f"{clean(leading.plot) if leading and leading.plot else named} over {spoken(over)}"
    caption = "95 % intervals" if any(e.ci95 for e in known) else "Values without intervals"
    if any(_way(e) not in primary for _, e in mine if e.value is not None):
        filled, hollow = map(clean, sides) if sides else ("primary method", "others")
        caption += f"; filled: {filled}, open: {hollow}, a little aside"
    caption += f".{_crosses(members)}{missing_words([e for _, e in members], over, 6)}"
    table = table_of([e for _, e in members], over)
    simulated = any(analysis.simulated for analysis, _ in members)
    return of_charts([[chart]], title, caption, table, simulated=simulated)


def _chart(
    symbols: Sequence[str],
    members: Sequence[Member],
    over: str,
    primary: set[Way],
    size: tuple[float, float],
    *,
    still: bool = False,
) -> Chart:
    """Values over an operating point, those of `primary` with their curve; others open if `still`, else by a switch."""
    known = [e for _, e in members if e.value is not None and (still or _way(e) in primary)]
    unit, (x_label, x_unit) = _sized(known), point_shown(over)
    groups: dict[Way, list[Member]] = {}
    for a, e in members:
        if e.value is not None and shown(e.quantity, e.unit) == shown(known[0].quantity, known[0].unit):
            groups.setdefault(_way(e), []).append((a, e))
    own = [way for way, group in groups.items() if group[0][0].kind != PUBLISHED]
    groups = {way: group for way, group in groups.items() if not still or way not in own[MOST_SERIES:]}
    variants, methods = (list(dict.fromkeys(way[n] for way in groups)) for n in (0, 1))
    others = list(dict.fromkeys(way[1] for way in own if way not in primary))
    series: list[Series] = []
    for n, (way, group) in enumerate(groups.items()):
        at = sorted(group, key=lambda member: member[1].at[over])
        variant, method = way[0], clean(way[1], 60)
        first, theirs, positive = way in primary, at[0][0].kind == PUBLISHED, all(e.positive for _, e in at)
        x, y, half = _columns([e for _, e in at], over, unit)
        color = COLORS.get(at[0][1].symbol) or PALETTE[variants.index(variant) % len(PALETTE)]
        if theirs or (not first and len(variants) == 1):
            color = INK if theirs else PALETTE[n % len(PALETTE)]
        through = curve_of(at, over, unit.scale, x_unit.scale) if first else None
        if through is not None:
            series.append(Series("", through[0], through[1], color, half=through[2], positive=positive, hidden=True))
        if still and not (first or theirs):
            x = x + (others.index(way[1]) + 1) * ASIDE * float(np.ptp([e.at[over] for e in known])) / x_unit.scale
        name = method if theirs else variant
        if still and len(methods) > 1 and not theirs:
            name = method if len(variants) == 1 else f"{variant}, {method}"
        label = name if len(variants) > 1 or theirs or (still and len(methods) > 1) else ""
        other = "" if first or theirs or still else method
        said = f"{name}, {other}" if other else name
        drawn = Series(label, x, y, color, "x" if theirs else "o", half, positive, method=other, said=said)
        series.append(replace(drawn, hollow=not (first or theirs)))
    values = sorted((e.value or 0.0) / unit.scale for e in known)
    zero = values[0] >= 0 and values[0] < 0.45 * values[-1]
    labels = x_unit.label(x_label), unit.label(", ".join(clean(s, 40) for s in symbols))
    legend = max((len(s.label) for s in series), default=0) > SHORT
    return Chart(*labels, tuple(series), *size, zero=zero, together="over", legend=legend)


def _columns(values: Sequence[Estimate], over: str, unit: Shown) -> tuple[Array, Array, Array]:
    """Place, value and half width of each, in the units that are shown."""
    x = np.array([e.at[over] for e in values]) / point_shown(over)[1].scale
    y = np.array([e.value for e in values], dtype=np.float64) / unit.scale
    return x, y, np.array([reach_of(e) for e in values]) / unit.scale


def _crosses(members: Sequence[Member]) -> str:
    """A sentence on published values."""
    theirs = dict.fromkeys(clean(e.method, 60) for a, e in members if a.kind == PUBLISHED and e.value is not None)
    return f" Crosses: {listed(list(theirs))}, not measured here." if theirs else ""


def missing_words(estimates: Sequence[Estimate], over: str, most: int) -> str:
    """A sentence for values that are not identifiable, and one for those that are withheld; at most so many places."""
    text, unit = "", point_shown(over)[1]
    for withheld, word in ((False, "Not identifiable"), (True, "Withheld")):
        missing = [e for e in estimates if e.value is None and e.withheld == withheld]
        places = [(symbol_text(e.symbol), number(e.at[over] / unit.scale)) for e in missing[:most]]
        where = [f"{symbol} at {place} {unit.unit}".strip() for symbol, place in places]
        text += f" {word}: {listed(where)}{' and others' if len(missing) > most else ''}." if where else ""
    return text


def _sized(known: Sequence[Estimate]) -> Shown:
    """The unit with a power of ten before it where values or intervals would ask for an exponent at the axis."""
    unit = shown(known[0].quantity, known[0].unit)
    largest = max(abs(end) for e in known for end in e.ci95 or [e.value or 0.0]) / unit.scale
    if largest == 0 or 1e-3 <= largest < 1e5:
        return unit
    power = 3 * floor(log10(largest) / 3)
    return Shown(f"10{str(power).translate(RAISED)} {unit.unit}".rstrip(), unit.scale * 10.0**power)


def reach_of(e: Estimate) -> float:
    """How far the interval reaches above the value [SI]; NaN without one."""
    return nan if e.ci95 is None or e.value is None else e.ci95[1] - e.value


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
    half = np.interp(x, at, [reach_of(e) for _, e in members])
    residual = closest.residual_rms if np.isfinite(closest.residual_rms) else 0.0
    band = np.hypot(half, 1.96 * residual)
    return np.asarray(x / x_scale), np.asarray(y / scale), np.asarray(band / scale)


def table_of(estimates: Sequence[Estimate], over: str) -> Frame:
    """The numbers of a plot: one row for each estimate, with `over` first; text."""
    differ = (name for e in estimates for name, value in e.at.items() if value != estimates[0].at.get(name))
    names = in_order([over, *(name for name in differ if name != "mass")], [over, *POINTS])
    rows = [
        {
            "method": clean(e.method),
            "symbol": symbol_text(e.symbol, e.coordinate),
            **{point_head(name): number(e.at[name] / point_shown(name)[1].scale) for name in names if name in e.at},
            shown(e.quantity, e.unit).label("value"): cell(e),
            "trials": str(e.n),
        }
        for e in estimates
    ]
    return Frame(rows)


def surface_picture(
    analyses: Sequence[Analysis], members: Sequence[Estimate], over: str, across: str, less: float
) -> Picture | None:
    """Values of the methods of `members` over one coordinate, dots of each place in the other in a colour.

    The axis is that with more places, or else `across`; lower by `less` [pt]. None where no symbol is known at two
    places.
    """
    own = {e.symbol: e.method for e in members}
    every = [e for a in analyses for e in a.estimates if e.value is not None and set(e.at) - {"mass"} == {over, across}]
    known = [e for e in every if e.method in own.values() and e.method == own.get(e.symbol, e.method)]
    if len({e.at[over] for e in known}) > len({e.at[across] for e in known}):
        over, across = across, over
    order = [symbol for symbol in declared(analyses) if len([e for e in known if e.symbol == symbol]) > 1][:MOST]
    if not order:
        return None
    width = (PAGE - GAP * (len(order) - 1)) / len(order)
    simulated = any(a.simulated for a in analyses)
    drawn = [[e for e in known if e.symbol == symbol] for symbol in order]
    shown_ones = [e for mine in drawn for e in mine]
    names = listed([f"{declared(analyses)[symbol].title} {symbol}" for symbol in order])
    title = f"{capital(names)} over {spoken(across)}, at each {spoken(over)}"
    size = width, HIGHER - less - _second_line(title)
    charts = tuple(_surface_chart(mine, over, across, size) for mine in drawn)
    caption = f"Dots: {listed([clean(method, 60) for method in dict.fromkeys(e.method for e in shown_ones)])}"
    caption += f"{'; bars: 95 % intervals' if any(e.ci95 for e in shown_ones) else ', without intervals'}."
    return of_charts([charts], title, caption, table_of(shown_ones, over), simulated=simulated)


def _surface_chart(known: Sequence[Estimate], over: str, across: str, size: tuple[float, float]) -> Chart:
    unit, at_unit = shown(known[0].quantity, known[0].unit), point_shown(over)[1]
    places = sorted({e.at[over] for e in known})
    series = []
    for n, place in enumerate(places):
        mine = sorted((e for e in known if e.at[over] == place), key=lambda e: e.at[across])
        share = n / max(1, len(places) - 1)
        x, y, half = _columns(mine, across, unit)
        name = f"{number(place / at_unit.scale)} {at_unit.unit}"
        series.append(Series("", x, y, blue(share), width=0.8, hidden=True))
        positive = all(e.positive for e in mine)
        name_color = blue(max(share, READABLE))
        series.append(Series(name, x, y, blue(share), "o", half, positive, name_color=name_color))
    zero = min(e.value or 0.0 for e in known) >= 0
    return Chart(point_head(across), unit.label(symbol_text(known[0].symbol)), tuple(series), *size, zero=zero)
