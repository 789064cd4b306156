"""Figures of positions in closed loop and of a model's validation; draws through `position_plots` and `time_plots`."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.analysis.results import Analysis, Trace
from pmabench.kinds.positioning import plots as position_plots
from pmabench.plotting.pictures import (
    Picture,
    bound,
    has,
    head,
    how_many,
    label,
    numbers,
    panel,
    picture,
    spread,
    unit_of,
)
from pmabench.plotting.plots import Panel

MOST = 12
"""Most set-points or steps of a figure."""
APPROACH = 2.0
"""Time of the approach that is shown above [s]."""


def positions(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
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
    return [picture(draw, "Positions in closed loop", caption, alt, table, wide=True, simulated=analysis.simulated)]
