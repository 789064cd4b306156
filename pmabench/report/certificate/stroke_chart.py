"""The third figure of the certificate: one stroke, measured and run freely by the fitted muscle, the residual below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.plotting.chart import MOST_POINTS, Chart, Series, with_common_sides
from pmabench.plotting.pictures import Picture, column, has, head, label, numbers, of_charts, unit_of
from pmabench.plotting.plots import BLUE, BROWN, FAINT, QUIET, Array
from pmabench.plotting.wording import half_width
from pmabench.store.analyses.results import Analysis, Trace

WIDTH, HIGH, LOW = 510.0, 142.0, 82.0


def stroke_picture(analyses: Sequence[Analysis]) -> tuple[Picture, Trace] | None:
    """The figure and the trace that it shows, the one with the largest stroke; None where no test has a free run."""
    able = [
        (trace, analysis)
        for analysis in analyses
        for trace in analysis.traces
        if trace.figure == "overlay" and has(trace, "t", "displacement", "model")
    ]
    if not able:
        return None
    trace, analysis = max(able, key=lambda pair: float(np.nanmax(np.abs(pair[0].columns["displacement"]))))
    t, x, model = (_thin(column(trace, name)) for name in ("t", "displacement", "model"))
    apart = model - x
    rms = float(np.sqrt(np.mean(apart[np.isfinite(apart)] ** 2)))
    unit, where = unit_of(trace, "displacement").unit, head(trace)
    stamp = "SIMULATED" if analysis.simulated else ""
    misfit = f"{half_width(rms)} {unit} rms"
    share = 100 * rms / float(np.ptp(x[np.isfinite(x)]) or 1.0)
    upper = Chart(
        x_label=label(trace, "t"),
        y_label=f"contraction x [{unit}]",
        series=(
            Series("measured", t, x, FAINT, width=4.0, name_color=QUIET),
            Series("free run", t, model, BLUE, width=1.4),
        ),
        width=WIDTH,
        height=HIGH,
        alt=f"Contraction over time at {where}: measured, and the fitted muscle on it.",
        together="stroke",
        stamp=stamp,
        x_named=False,
    )
    lower = Chart(
        x_label=label(trace, "t"),
        y_label=f"free run − measured [{unit}]",
        series=(Series("residual", t, apart, BROWN, width=1.0),),
        width=WIDTH,
        height=LOW,
        alt=f"Their difference, {misfit}.",
        words=misfit,
        y_ticks=3,
        together="stroke",
    )
    alt = f"{upper.alt} {lower.alt}"
    caption = (
        f"The fitted muscle with the measured pressure as its only input, from the first sample on. It "
        f"misses this trial by {misfit}, {share:.2g} % of the stroke."
    )
    title = f"One stroke, {where}: measured and free run"
    table = numbers([("", trace)], ("t", "displacement", "model"))
    charts = with_common_sides((upper, lower))
    return of_charts(charts, title, caption, alt, table, simulated=analysis.simulated, stacked=True), trace


def _thin(values: Array) -> Array:
    return values[:: max(1, -(-len(values) // MOST_POINTS))]
