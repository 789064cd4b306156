"""Figures of a joint in closed loop: reference, angle and one pressure over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pmabench.plotting import time_plots
from pmabench.plotting.pictures import Picture, bound, has, how_many, label, numbers, panel, picture, spread
from pmabench.store.analyses.results import Analysis, Trace

MOST = 3
"""Most trials in the figure."""


def courses(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Angle with its goal, and the pressure of muscle 1, for the last trial of each operating point."""
    able = [trace for trace in traces if has(trace, "t", "angle", "reference")]
    if not able:
        return []
    chosen = spread(able, MOST)
    columns = {"t": "t", "x": "reference", "y": "angle"}
    if all(has(trace, "pressure_1") for trace in chosen):
        columns["P"] = "pressure_1"
    panels = [replace(panel(trace, columns, trace.title), marks={}) for trace in chosen]
    labels = {new: label(chosen[0], old) for new, old in columns.items()}
    caption = (
        "The reference, the angle that followed, and the pressure of muscle 1, in the last trial of each point; "
        f"muscle 2 does the opposite.{how_many(chosen, able)}"
    )
    alt = f"{labels['y']} over {labels['t']} below its reference: {', '.join(trace.title for trace in chosen)}."
    table = numbers([(trace.title, trace) for trace in chosen])
    drawn = bound(time_plots.steps, panels, labels)
    wide = len(panels) > 1
    return [picture(drawn, "Angle in closed loop", caption, alt, table, wide=wide, simulated=analysis.simulated)]
