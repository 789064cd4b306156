"""Figures of a joint in closed loop: reference, angle and one pressure over time.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.joint_step.reduction import Swung, course_of
from pmabench.plotting import time_plots
from pmabench.plotting.pictures import Picture, bound, has, how_many, label, numbers, panel, picture, spread
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

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


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """End error and settling time of a step; gain and phase of a sine."""
    try:
        one = course_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("e_th", "angle", None), Measured("t_s", "time", None)], [str(reason)]
    if isinstance(one, Swung):
        answer = complex(one.answers.mean())
        return [Measured("g_th", "ratio", abs(answer)), Measured("phi_th", "angle", float(np.angle(answer)))], []
    doubts = [] if one.values["t_s"] is not None else ["the angle does not come into the band about its goal"]
    return [Measured("e_th", "angle", one.values["e_th"]), Measured("t_s", "time", one.values["t_s"])], doubts
