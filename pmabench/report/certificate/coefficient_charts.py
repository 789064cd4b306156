"""The first figure of the certificate: up to three panels with the coefficients of one test over their operating point.

The primary method of the test with most values is drawn; other methods are in the same data, for the page's buttons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench.base.kind import Result
from pmabench.plotting.chart import Chart, Series
from pmabench.plotting.frame import Frame
from pmabench.plotting.pictures import Picture, of_charts
from pmabench.plotting.plots import BLUE, BROWN, DARK, GREEN, INK, PALETTE
from pmabench.plotting.wording import clean, number, point_shown, shown, spoken, symbol_text
from pmabench.report.figures.coefficient_figures import curve_of, reach_of, table_of
from pmabench.report.words import declared
from pmabench.store.analyses.results import AGREEMENT, PUBLISHED, Analysis, Estimate

COLORS = {"B_c": GREEN, "B_r": BROWN, "B": DARK}
"""Colours of symbols; all others are blue, or in turn where they share a panel."""
WIDTH, GAP, HEIGHT = 510.0, 12.0, 118.0
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
    names = _at(analyses, members)
    charts: list[tuple[list[str], list[Estimate], list[Member]]] = []
    drawn: list[Member] = []
    for symbols in list(panels.values()):
        mine = [
            (a, e)
            for a in analyses
            for e in a.estimates
            if a.kind != AGREEMENT and e.symbol in symbols and not e.coordinate and _fits(e, over, names)
        ]
        known = [e for _, e in mine if e.value is not None and (e.symbol, e.method) in primary]
        if len({e.at[over] for e in known}) < 2 or len({shown(e.quantity, e.unit) for e in known}) != 1:
            continue
        if len(charts) == MOST:
            break
        charts.append((symbols, known, mine))
        drawn += mine
    if not charts:
        return None
    width = (WIDTH - GAP * (len(charts) - 1)) / len(charts)
    simulated = any(a.simulated for a, _ in drawn)
    made = tuple(_chart(symbols, known, mine, over, primary, (width, HEIGHT - less)) for symbols, known, mine in charts)
    titled = _and([_title(symbols, results) for symbols, _, _ in charts])
    caption = _caption(drawn, primary, over)
    alt = f"{titled} over {spoken(over)}: " + " ".join(chart.alt for chart in made)
    title = f"{titled[:1].upper()}{titled[1:]} over {spoken(over)}"
    return of_charts(made, title, caption, alt, _table(drawn, over), simulated=simulated)


def _at(analyses: Sequence[Analysis], members: Sequence[Estimate]) -> set[str]:
    """Coordinates of the values of the table, also of those that it leaves out because they are the same in all."""
    known = {(e.symbol, e.method) for e in members}
    whole = [e for a in analyses for e in a.estimates if (e.symbol, e.method) in known]
    return {name for e in whole if any(replace(e, at=m.at) == m for m in members) for name in e.at}


def _fits(e: Estimate, over: str, names: set[str]) -> bool:
    return over in e.at and set(e.at) - {over, "mass"} <= names | {"mean", "amplitude"}


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
        x = np.array([e.at[over] for _, e in at]) / x_unit.scale
        y = np.array([e.value for _, e in at], dtype=np.float64) / unit.scale
        half = np.array([reach_of(e)[1] for _, e in at]) / unit.scale
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


def _caption(drawn: Sequence[Member], primary: set[tuple[str, str]], over: str) -> str:
    """What marks, bars and bands are; what is missing; where crosses come from."""
    own = [e for a, e in drawn if (e.symbol, e.method) in primary and a.kind != PUBLISHED]
    methods = _and(list(dict.fromkeys(clean(e.method, 60) for e in own)))
    bars = "bars and bands: 95 % intervals" if any(e.ci95 for e in own) else "without intervals"
    caption = f"Dots: {methods}; {bars}, often smaller than a dot."
    theirs = list(dict.fromkeys(clean(e.method, 60) for a, e in drawn if a.kind == PUBLISHED))
    if theirs:
        caption += f" Crosses: {_and(theirs)}, not measured here."
    x_unit = point_shown(over)[1]
    for withheld, word in ((False, "Not identifiable"), (True, "Withheld")):
        missing = [e for e in own if e.value is None and e.withheld == withheld]
        where = [
            f"{symbol_text(e.symbol)} at {number(e.at[over] / x_unit.scale)} {x_unit.unit}".rstrip() for e in missing
        ]
        if where:
            caption += f" {word}: {_and(where[:4])}{' and others' if len(where) > 4 else ''}."
    return caption


def _table(drawn: Sequence[Member], over: str) -> Frame:
    return table_of([e for _, e in drawn], over)


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
