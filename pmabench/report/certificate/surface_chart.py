"""The first figure of a certificate whose values have two coordinates: F and K over contraction at each pressure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.plotting.chart import Chart, Series
from pmabench.plotting.pictures import Picture, of_charts
from pmabench.plotting.wording import number, point_head, point_shown, shown, symbol_text
from pmabench.report.certificate.force_chart import READABLE, blue
from pmabench.report.figures.coefficient_figures import reach_of, table_of
from pmabench.report.words import declared
from pmabench.store.analyses.results import Analysis, Estimate

WIDTH, GAP, HEIGHT = 510.0, 12.0, 150.0
PANELS = 2


def surface_picture(
    analyses: Sequence[Analysis], members: Sequence[Estimate], over: str, across: str, less: float
) -> Picture | None:
    """Values of the method of `members` over `across`, dots of each `over` in a colour; lower by `less` [pt].

    None where no symbol is known at two places.
    """
    methods = {e.method for e in members}
    known = [
        e
        for a in analyses
        for e in a.estimates
        if e.method in methods and set(e.at) - {"mass"} == {over, across} and e.value is not None
    ]
    order = [symbol for symbol in declared(analyses) if len([e for e in known if e.symbol == symbol]) > 1][:PANELS]
    if not order:
        return None
    width = (WIDTH - GAP * (len(order) - 1)) / len(order)
    simulated = any(a.simulated for a in analyses)
    drawn = [[e for e in known if e.symbol == symbol] for symbol in order]
    charts = tuple(_chart(mine, over, across, (width, HEIGHT - less), simulated=simulated) for mine in drawn)
    names = " and ".join(f"{declared(analyses)[symbol].title} {symbol}" for symbol in order)
    title = f"{names[:1].upper()}{names[1:]} over contraction, at each pressure"
    caption = "Dots: values of the fit, half way between both directions; bars: 95 % intervals."
    alt = f"{title}. " + " ".join(chart.alt for chart in charts)
    table = table_of([e for mine in drawn for e in mine], over)
    return of_charts(charts, title, caption, alt, table, simulated=simulated)


def _chart(known: Sequence[Estimate], over: str, across: str, size: tuple[float, float], *, simulated: bool) -> Chart:
    unit, at_unit, x_unit = shown(known[0].quantity, known[0].unit), point_shown(over)[1], point_shown(across)[1]
    places = sorted({e.at[over] for e in known})
    series = []
    for n, place in enumerate(places):
        mine = sorted((e for e in known if e.at[over] == place), key=lambda e: e.at[across])
        share = n / max(1, len(places) - 1)
        x = np.array([e.at[across] for e in mine]) / x_unit.scale
        y = np.array([e.value for e in mine], dtype=np.float64) / unit.scale
        half = np.array([reach_of(e)[1] for e in mine]) / unit.scale
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
