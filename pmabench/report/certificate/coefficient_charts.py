"""The first figure of the certificate: up to three panels with the coefficients of one test over their operating point.

The primary method of the test with most values is drawn; other methods are in the same data, for the page's buttons.
Values with two coordinates, as F and K of a surface, are over the contraction, at each pressure in its colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench.base.kind import Result
from pmabench.plotting.chart import GAP, Chart, Series
from pmabench.plotting.pictures import Picture, of_charts
from pmabench.plotting.plots import BLUE, BROWN, DARK, GREEN, INK, PALETTE, Array
from pmabench.plotting.wording import Shown, clean, listed, number, point_head, point_shown, shown, spoken, symbol_text
from pmabench.report.certificate.force_chart import READABLE, blue
from pmabench.report.figures.coefficient_figures import curve_of, missing_words, reach_of, table_of
from pmabench.report.words import declared
from pmabench.store.analyses.results import AGREEMENT, PUBLISHED, Analysis, Estimate

COLORS = {"B_c": GREEN, "B_r": BROWN, "B": DARK}
"""Colours of symbols; all others are blue, or in turn where they share a panel."""
WIDTH, HEIGHT = 510.0, 118.0
MOST = 3
"""Panels."""
Member = tuple[Analysis, Estimate]


def coefficient_picture(
    analyses: Sequence[Analysis], members: Sequence[Estimate], over: str, less: float
) -> Picture | None:
    """The panels for the values of the first table, `members` over `over`, lower by `less` [pt]; None without two."""
    results = declared(analyses)
    primary = {(e.symbol, e.method) for e in members}
    panels: dict[str, list[str]] = {}
    for symbol in dict.fromkeys(e.symbol for e in members):
        result = results.get(symbol)
        panels.setdefault((result.plot if result else "") or f" {symbol}", []).append(symbol)
    names = _at(analyses, members) | {over, "mass", "mean", "amplitude"}
    every = [
        (a, e)
        for a in analyses
        for e in a.estimates
        if a.kind != AGREEMENT and not e.coordinate and over in e.at and set(e.at) <= names
    ]
    charts: list[tuple[list[str], list[Estimate], list[Member]]] = []
    for symbols in panels.values():
        mine = [(a, e) for a, e in every if e.symbol in symbols]
        known = [e for _, e in mine if e.value is not None and (e.symbol, e.method) in primary]
        if len({e.at[over] for e in known}) < 2 or len({shown(e.quantity, e.unit) for e in known}) != 1:
            continue
        charts.append((symbols, known, mine))
    charts = charts[:MOST]
    drawn = [member for _, _, mine in charts for member in mine]
    if not charts:
        return None
    width = (WIDTH - GAP * (len(charts) - 1)) / len(charts)
    simulated = any(a.simulated for a, _ in drawn)
    made = tuple(_chart(symbols, known, mine, over, primary, (width, HEIGHT - less)) for symbols, known, mine in charts)
    titled = listed([_title(symbols, results) for symbols, _, _ in charts])
    caption = _caption(drawn, primary, over)
    alt = f"{titled} over {spoken(over)}: " + " ".join(chart.alt for chart in made)
    title = f"{titled[:1].upper()}{titled[1:]} over {spoken(over)}"
    return of_charts(made, title, caption, alt, table_of([e for _, e in drawn], over), simulated=simulated)


def _at(analyses: Sequence[Analysis], members: Sequence[Estimate]) -> set[str]:
    """Coordinates of the values of the table, also of those that it leaves out because they are the same in all."""
    known = {(e.symbol, e.method) for e in members}
    whole = [e for a in analyses for e in a.estimates if (e.symbol, e.method) in known]
    return {name for e in whole if any(replace(e, at=m.at) == m for m in members) for name in e.at}


def _title(symbols: Sequence[str], results: dict[str, Result]) -> str:
    first = results.get(symbols[0])
    named = (first.plot.lower() if len(symbols) > 1 else "") or first.title if first else ""
    return f"{clean(named)} {', '.join(clean(s, 40) for s in symbols)}".strip()


def _chart(
    symbols: Sequence[str],
    known: Sequence[Estimate],
    mine: Sequence[Member],
    over: str,
    primary: set[tuple[str, str]],
    size: tuple[float, float],
) -> Chart:
    unit, (x_label, x_unit) = shown(known[0].quantity, known[0].unit), point_shown(over)
    series: list[Series] = []
    groups: dict[tuple[str, str], list[Member]] = {}
    for a, e in mine:
        if e.value is not None and shown(e.quantity, e.unit) == unit:
            groups.setdefault((e.symbol, e.method), []).append((a, e))
    for (symbol, method), group in groups.items():
        at = sorted(group, key=lambda member: member[1].at[over])
        first, theirs = (symbol, method) in primary, at[0][0].kind == PUBLISHED
        color = COLORS.get(symbol) or (BLUE if len(symbols) == 1 else PALETTE[symbols.index(symbol) % len(PALETTE)])
        if not first:
            color = INK if theirs else PALETTE[(len(series) + 1) % len(PALETTE)]
        x, y, half = _columns([e for _, e in at], over, unit)
        name = clean(method, 60) if theirs else symbol_text(symbol)
        other = "" if first or theirs else clean(method, 60)
        through = curve_of(at, over, unit.scale, x_unit.scale) if first else None
        if through is not None:
            series.append(Series("", through[0], through[1], color, half=through[2], hidden=True))
        label = name if len(symbols) > 1 or theirs else ""
        said = f"{name}, {other}" if other else name
        series.append(Series(label, x, y, color, True, half, method=other, hollow=bool(other), cross=theirs, said=said))
    values = sorted((e.value or 0.0) / unit.scale for e in known)
    names = ", ".join(clean(s, 40) for s in symbols)
    return Chart(
        x_label=x_unit.label(x_label),
        y_label=unit.label(names),
        series=tuple(series),
        width=size[0],
        height=size[1],
        alt=f"{names} between {values[0]:.4g} and {values[-1]:.4g} {unit.unit}.".replace(" .", "."),
        zero=min(values) >= 0 and min(values) < 0.45 * max(values),
        together="over",
        stamp="SIMULATED" if any(a.simulated for a, _ in mine) else "",
    )


def _columns(values: Sequence[Estimate], over: str, unit: Shown) -> tuple[Array, Array, Array]:
    """Place, value and half width of each, in the units that are shown."""
    x = np.array([e.at[over] for e in values]) / point_shown(over)[1].scale
    y = np.array([e.value for e in values], dtype=np.float64) / unit.scale
    return x, y, np.array([reach_of(e)[1] for e in values]) / unit.scale


def _caption(drawn: Sequence[Member], primary: set[tuple[str, str]], over: str) -> str:
    """What marks, bars and bands are; what is missing; where crosses come from."""
    own = [e for a, e in drawn if (e.symbol, e.method) in primary and a.kind != PUBLISHED]
    methods = listed(list(dict.fromkeys(clean(e.method, 60) for e in own)))
    bars = "bars and bands: 95 % intervals" if any(e.ci95 for e in own) else "without intervals"
    caption = f"Dots: {methods}; {bars}, often smaller than a dot."
    theirs = list(dict.fromkeys(clean(e.method, 60) for a, e in drawn if a.kind == PUBLISHED))
    if theirs:
        caption += f" Crosses: {listed(theirs)}, not measured here."
    return caption + missing_words(own, over, 4)


HIGH = 150.0
PANELS = 2
"""Of values by two coordinates: height of a panel [pt], and most panels."""


def surface_picture(
    analyses: Sequence[Analysis], members: Sequence[Estimate], over: str, across: str, less: float
) -> Picture | None:
    """Values of the method of `members` over `across`, dots of each `over` in a colour; lower by `less` [pt].

    None where no symbol is known at two places.
    """
    methods = {e.method for e in members}
    every = [e for a in analyses for e in a.estimates if e.method in methods and e.value is not None]
    known = [e for e in every if set(e.at) - {"mass"} == {over, across}]
    order = [symbol for symbol in declared(analyses) if len([e for e in known if e.symbol == symbol]) > 1][:PANELS]
    if not order:
        return None
    width = (WIDTH - GAP * (len(order) - 1)) / len(order)
    simulated = any(a.simulated for a in analyses)
    drawn = [[e for e in known if e.symbol == symbol] for symbol in order]
    charts = tuple(_surface_chart(mine, over, across, (width, HIGH - less), simulated=simulated) for mine in drawn)
    names = " and ".join(f"{declared(analyses)[symbol].title} {symbol}" for symbol in order)
    title = f"{names[:1].upper()}{names[1:]} over contraction, at each pressure"
    caption = "Dots: values of the fit, half way between both directions; bars: 95 % intervals."
    alt = f"{title}. " + " ".join(chart.alt for chart in charts)
    table = table_of([e for mine in drawn for e in mine], over)
    return of_charts(charts, title, caption, alt, table, simulated=simulated)


def _surface_chart(
    known: Sequence[Estimate], over: str, across: str, size: tuple[float, float], *, simulated: bool
) -> Chart:
    unit, at_unit = shown(known[0].quantity, known[0].unit), point_shown(over)[1]
    places = sorted({e.at[over] for e in known})
    series = []
    for n, place in enumerate(places):
        mine = sorted((e for e in known if e.at[over] == place), key=lambda e: e.at[across])
        share = n / max(1, len(places) - 1)
        x, y, half = _columns(mine, across, unit)
        name = f"{number(place / at_unit.scale)} {at_unit.unit}"
        series.append(Series("", x, y, blue(share), width=0.8, hidden=True))
        series.append(Series(name, x, y, blue(share), True, half, name_color=blue(max(share, READABLE))))
    values = [(e.value or 0.0) / unit.scale for e in known]
    symbol = symbol_text(known[0].symbol)
    return Chart(
        x_label=point_head(across),
        y_label=unit.label(symbol),
        series=tuple(series),
        width=size[0],
        height=size[1],
        alt=f"{symbol} between {min(values):.4g} and {max(values):.4g} {unit.unit}.",
        zero=min(values) >= 0,
        stamp="SIMULATED" if simulated else "",
    )
