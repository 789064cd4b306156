"""Figures of tests of a joint: maps over the angle, loops of sweeps, courses in closed loop; draws by `time_plots`.

`measure_torque`, `measure_sweep`, `measure_step`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.joint.staircase import staircase_of
from pmabench.kinds.joint.step import Swung, course_of
from pmabench.kinds.joint.sweep import sweep_of
from pmabench.plotting import pictures, time_plots
from pmabench.plotting.pictures import Picture, has, head, how_many, label, panel
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

MOST, COURSES = 6, 3
"""Most pairs of pressures or loops in a figure, and most courses."""


def maps(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Torque above, stiffness below, a line for each pair of pressures."""
    found = []
    for trace in traces:
        names = [name.removeprefix("torque at ") for name in trace.columns if name.startswith("torque at ")]
        able = [name for name in names if has(trace, f"torque at {name}")]
        if not able:
            continue
        chosen = pictures.spread(able, MOST)
        panels = []
        for name in chosen:
            columns = {"x": "angle", "y": f"torque at {name}", "gap": f"stiffness at {name}"}
            panels.append(panel(trace, columns, name.replace(" kPa and ", ", ")))
        units = (pictures.unit_of(trace, f"{what} at {chosen[0]}").label(what) for what in ("torque", "stiffness"))
        labels = dict(zip(("x", "y", "gap"), (label(trace, "angle"), *units), strict=True))
        caption = (
            "Above the torque that the joint holds at each angle, the mean of both sides; below its stiffness, minus "
            f"the slope of that torque. A line for each pair of pressures of muscle 1 and muscle 2."
            f"{how_many(chosen, able)}"
        )
        alt = f"{labels['y']} and {labels['gap']} over {labels['x']} at {', '.join(chosen)}."
        drawn, table = pictures.bound(time_plots.means, panels, labels), pictures.numbers([("", trace)])
        title, simulated = "Torque and stiffness over angle", analysis.simulated
        found.append(pictures.picture(drawn, title, caption, alt, table, wide=False, simulated=simulated))
    return found


def loops(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """The last loop of each operating point, and the mean of its branches."""
    able = [trace for trace in traces if has(trace, "angle", "torque")]
    if not able:
        return []
    chosen = pictures.spread(able, MOST)
    panels = []
    for trace in chosen:
        mean = panel(trace, {"x": "angle", "y": "mean"}, "") if has(trace, "mean") else None
        panels.append((head(trace), [("loop", panel(trace, {"x": "angle", "y": "torque"}, ""))], mean))
    labels = {"x": label(chosen[0], "angle"), "y": label(chosen[0], "torque")}
    gaps, slopes = (pictures.reach([trace.marks[name] for trace in chosen]) for name in ("H_tau", "K_th"))
    caption = (
        "The last cycle, and the mean of its branches without what the turns leave in it: what a model without "
        f"hysteresis is to give. Gap at mid sweep, falling minus rising angle: {gaps} N·m; stiffness there: {slopes} "
        f"N·m/rad.{how_many(chosen, able)}"
    )
    alt = f"{labels['y']} over {labels['x']} as loops: {', '.join(title for title, *_ in panels)}, with the mean curve."
    table = pictures.numbers([(head(trace), trace) for trace in chosen])
    drawn, wide = pictures.bound(time_plots.loops, panels, labels), len(panels) > 1
    simulated = analysis.simulated
    return [pictures.picture(drawn, "Torque over angle", caption, alt, table, wide=wide, simulated=simulated)]


def courses(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Angle with its goal, and the pressure of muscle 1, for the last trial of each operating point."""
    able = [trace for trace in traces if has(trace, "t", "angle", "reference")]
    if not able:
        return []
    chosen = pictures.spread(able, COURSES)
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
    table = pictures.numbers([(trace.title, trace) for trace in chosen])
    drawn, wide = pictures.bound(time_plots.steps, panels, labels), len(panels) > 1
    simulated = analysis.simulated
    return [pictures.picture(drawn, "Angle in closed loop", caption, alt, table, wide=wide, simulated=simulated)]


NO_TORQUE = [Measured("K_th", "torsional stiffness", None), Measured("H_tau", "torque", None)]


def measure_torque(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Gap between both sides, and the stiffness at the angle in the middle."""
    try:
        one = staircase_of(run, trial, {})
    except NotUsable as reason:
        return NO_TORQUE, [str(reason)]
    why = one.why_no_stiffness
    stiffness = None if why else float(one.stiffness().mean(axis=0)[one.open.sum() // 2])
    K, gap = Measured("K_th", "torsional stiffness", stiffness), float(one.gap[:, one.open].mean())
    return [K, Measured("H_tau", "torque", gap, noise=one.rests.noise)], [why] if why else []


def measure_sweep(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Stiffness, and gap of the branches at mid sweep."""
    try:
        one = sweep_of(run, trial, {})
    except NotUsable as reason:
        return NO_TORQUE, [str(reason)]
    gap, noise = float(one.loop.middle_gap.mean()), one.loop.noise
    wrong = "the torque is larger while the angle rises: a wrong sign, or angle and torque apart in time"
    K = Measured("K_th", "torsional stiffness", float(one.stiffness.mean()))
    return [K, Measured("H_tau", "torque", gap, noise=noise)], [wrong] if gap < -max(noise, 1e-3) else []


def measure_step(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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
