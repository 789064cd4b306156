"""Figures of sweeps of a joint: loops of torque over angle and their mean curves; draws by `time_plots`.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.joint_sweep.sweep import sweep_of
from pmabench.plotting import time_plots
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
    reach,
    spread,
)
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

PANELS = 6
"""Most panels."""


def loops(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """The last loop of each operating point, and the mean of its branches."""
    able = [trace for trace in traces if has(trace, "angle", "torque")]
    if not able:
        return []
    chosen = spread(able, PANELS)
    panels = []
    for trace in chosen:
        mean = panel(trace, {"x": "angle", "y": "mean"}, "") if has(trace, "mean") else None
        panels.append((head(trace), [("loop", panel(trace, {"x": "angle", "y": "torque"}, ""))], mean))
    labels = {"x": label(chosen[0], "angle"), "y": label(chosen[0], "torque")}
    gaps, slopes = (reach([trace.marks[name] for trace in chosen]) for name in ("H_tau", "K_th"))
    caption = (
        "The last cycle, and the mean of its branches without what the turns leave in it: what a model without "
        f"hysteresis is to give. Gap at mid sweep, falling minus rising angle: {gaps} N·m; stiffness there: {slopes} "
        f"N·m/rad.{how_many(chosen, able)}"
    )
    alt = f"{labels['y']} over {labels['x']} as loops: {', '.join(title for title, *_ in panels)}, with the mean curve."
    table = numbers([(head(trace), trace) for trace in chosen])
    wide = len(panels) > 1
    drawn = bound(time_plots.loops, panels, labels)
    return [picture(drawn, "Torque over angle", caption, alt, table, wide=wide, simulated=analysis.simulated)]


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Stiffness, and gap of the branches at mid sweep."""
    try:
        one = sweep_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("K_th", "torsional stiffness", None), Measured("H_tau", "torque", None)], [str(reason)]
    gap, noise = float(one.loop.middle_gap.mean()), one.loop.noise
    wrong = "the torque is larger while the angle rises: a wrong sign, or angle and torque apart in time"
    K = Measured("K_th", "torsional stiffness", float(one.stiffness.mean()))
    return [K, Measured("H_tau", "torque", gap, noise=noise)], [wrong] if gap < -max(noise, 1e-3) else []
