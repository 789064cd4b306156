"""Figures of positions in closed loop and of a model's validation; draws through `position_plots` and `time_plots`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.results import Trace
from pmabench.report.figures import position_plots, time_plots
from pmabench.report.figures.pictures import (
    Picture,
    bound,
    has,
    head,
    how_many,
    label,
    numbers,
    panel,
    picture,
    reach,
    spread,
    unit_of,
)
from pmabench.report.figures.plots import Panel

MOST = 12
"""Most set-points or steps of a figure."""
APPROACH = 2.0
"""Time of the approach that is shown above [s]."""


def positions(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Reference, measured and simulated position of every set-point."""
    able = [t for t in traces if has(t, "t", "displacement", "setpoint") and "setpoint" in t.marks]
    if not able:
        return []
    chosen = spread(able, MOST)
    modelled = all(has(t, "model") for t in chosen)
    names = {"t": "t", "setpoint": "setpoint", "measured": "displacement"} | ({"model": "model"} if modelled else {})
    panels = []
    for trace in chosen:
        scale = unit_of(trace, "displacement").scale
        base = panel(trace, names, head(trace))
        panels.append(Panel(base.title, base.columns, {**base.marks, "setpoint": trace.marks["setpoint"] / scale}))
    unit = unit_of(chosen[0], "displacement").unit
    labels = {"t": label(chosen[0], "t"), "measured": f"contraction [{unit}]", "error": f"x − set-point [{unit}]"}
    caption = (
        "Above: the approach from rest; dashed: reference, grey: measured"
        + ("; red: the same loop simulated around the model" if modelled else "")
        + ". Below: distance from the set-point over the whole hold, on one scale; blue: measured"
        + ("; red: simulated" if modelled else "")
        + ". The dotted line begins the window of steady-state error and limit cycle."
        + how_many(chosen, able)
    )
    alt = (
        f"Position over time in closed loop, reference, measured{' and simulated' if modelled else ''}, and the "
        f"distance from the set-point, at {'; '.join(p.title for p in panels)}."
    )
    table = numbers([(head(t), t) for t in chosen], ("t", "setpoint", "displacement", "model", "pressure_command"))
    draw = bound(position_plots.held, panels, APPROACH, labels)
    return [picture(draw, "Positions in closed loop", caption, alt, table, wide=True, simulated=simulated)]


def validations(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Measured and simulated contraction after each step of pressure."""
    able = [t for t in traces if has(t, "t", "displacement", "model")]
    if not able:
        return []
    chosen = spread(able, MOST)
    panels = [panel(t, {"t": "t", "measured": "displacement", "model": "model"}, head(t)) for t in chosen]
    unit = unit_of(chosen[0], "displacement").unit
    labels = {"t": label(chosen[0], "t"), "measured": f"contraction [{unit}]", "residual": f"diff. [{unit}]"}
    misfits = [float(np.sqrt(np.nanmean((p.columns["measured"] - p.columns["model"]) ** 2))) for p in panels]
    caption = (
        "Grey: measured; red: the model that the protocol names, driven by the measured pressure. Below: their "
        f"difference, rms {reach(misfits)} {unit}. It was fitted to nothing in this run.{how_many(chosen, able)}"
    )
    steps = "; ".join(p.title for p in panels)
    alt = f"Contraction over time after steps of pressure, measured and simulated, at {steps}."
    table = numbers([(head(t), t) for t in chosen])
    draw = bound(time_plots.overlay, panels, labels)
    title = "Measured and simulated steps"
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=simulated)]
