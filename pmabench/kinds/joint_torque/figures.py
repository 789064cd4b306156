"""Figures of isometric torques of a joint: torque and stiffness over angle for each pair of pressures.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.joint_torque.staircase import staircase_of
from pmabench.plotting import time_plots
from pmabench.plotting.pictures import Picture, bound, has, how_many, label, numbers, panel, picture, spread, unit_of
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

MOST = 6
"""Most pairs of pressures in the figure."""


def maps(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Torque above, stiffness below, a line for each pair of pressures."""
    found = []
    for trace in traces:
        names = [name.removeprefix("torque at ") for name in trace.columns if name.startswith("torque at ")]
        able = [name for name in names if has(trace, f"torque at {name}")]
        if not able:
            continue
        chosen = spread(able, MOST)
        panels = []
        for name in chosen:
            columns = {"x": "angle", "y": f"torque at {name}", "gap": f"stiffness at {name}"}
            panels.append(panel(trace, columns, name.replace(" kPa and ", ", ")))
        units = (unit_of(trace, f"{what} at {chosen[0]}").label(what) for what in ("torque", "stiffness"))
        labels = dict(zip(("x", "y", "gap"), (label(trace, "angle"), *units), strict=True))
        caption = (
            "Above the torque that the joint holds at each angle, the mean of both sides; below its stiffness, minus "
            f"the slope of that torque. A line for each pair of pressures of muscle 1 and muscle 2."
            f"{how_many(chosen, able)}"
        )
        alt = f"{labels['y']} and {labels['gap']} over {labels['x']} at {', '.join(chosen)}."
        drawn, table = bound(time_plots.means, panels, labels), numbers([("", trace)])
        title = "Torque and stiffness over angle"
        found.append(picture(drawn, title, caption, alt, table, wide=False, simulated=analysis.simulated))
    return found


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Gap between both sides, and the stiffness at the angle in the middle."""
    try:
        one = staircase_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("K_th", "torsional stiffness", None), Measured("H_tau", "torque", None)], [str(reason)]
    why = one.why_no_stiffness
    stiffness = None if why else float(one.stiffness().mean(axis=0)[one.open.sum() // 2])
    K, gap = Measured("K_th", "torsional stiffness", stiffness), float(one.gap[:, one.open].mean())
    return [K, Measured("H_tau", "torque", gap, noise=one.rests.noise)], [why] if why else []
