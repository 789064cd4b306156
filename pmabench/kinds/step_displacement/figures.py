"""Figure of steps of displacement: displacement, force and pressure over time.

`measure`: what one trial says by itself, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.shared.samples import NotUsable, left
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.step_displacement.step import measure as steps_of
from pmabench.plotting import time_plots
from pmabench.plotting.pictures import Picture, bound, column, has, head, how_many, label, numbers, picture, spread
from pmabench.plotting.plots import Array, Panel
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

STEPS = 4
"""Most panels."""


def steps(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Displacement, force and pressure over time around steps of displacement."""
    able = [t for t in traces if has(t, "t", "force", "displacement")]
    chosen = spread(able, STEPS)
    if not chosen:
        return []
    panels, names, scale = [], {"t": "t", "x": "displacement", "y": "force"}, shown("force").scale
    for trace in chosen:
        columns = _around(trace, names | ({"P": "pressure"} if has(trace, "pressure") else {}))
        marks = {name: value / scale for name, value in trace.marks.items() if name in ("before", "peak", "relaxed")}
        panels.append(Panel(head(trace), columns, marks))
    labels = {new: label(chosen[0], old) for new, old in names.items()} | {"P": shown("pressure").label("pressure")}
    caption = (
        "Around the last step of a trial. Dashed: force before the step, at its peak and relaxed; the rest after the "
        f"step is longer than what is drawn.{how_many(chosen, able)}"
    )
    alt = (
        f"Contraction, force and pressure over time around steps of displacement: {'; '.join(p.title for p in panels)}."
    )
    draw = bound(time_plots.steps, panels, labels)
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)])
    title = "Steps of displacement"
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)]


def _around(trace: Trace, names: dict[str, str]) -> dict[str, Array]:
    """The columns from shortly before the step to well after its motion, six times its duration."""
    x = column(trace, "displacement")
    moving = np.flatnonzero(np.abs(x - x[-1]) > 0.05 * np.ptp(x))
    t = column(trace, "t")
    end = float(t[moving[-1]]) if len(moving) else float(t[-1])
    rows = (t >= -end) & (t <= max(6 * end, end + 0.1))
    return {new: column(trace, old)[rows] for new, old in names.items()}


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K from relaxed forces, and the peak of the force beyond them, of the steps away from the start."""
    P = trial.point.get("pressure")
    try:
        steps = steps_of(run, trial, {}).there
    except NotUsable as reason:
        return [Measured("K", "stiffness", None)], [str(reason)]
    K = float(np.mean([step.static for step in steps]))
    beyond = float(np.mean([abs(step.peak - step.relaxed) for step in steps]))
    further = left([step.later for step in steps])
    moves = further.seen and abs(further.size) > DRIFT * beyond > 0
    doubts = [f"the force would still change by {show(further.size, 'force', 2)}"] if moves else []
    return [
        Measured("K", "stiffness", K, expected.at("K", P) if expected is not None and P is not None else None),
        Measured("overshoot", "force", beyond, noise=3 * steps[0].noise),
    ], doubts
