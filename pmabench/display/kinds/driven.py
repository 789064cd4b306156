"""One trial whose free end is moved: a ramp, a step or a sine of displacement."""

from __future__ import annotations

from math import pi

import numpy as np

from pmabench.analysis.driven.ramp_loop import measure_as_planned
from pmabench.analysis.driven.sine_loop import measure as harmonic
from pmabench.analysis.driven.step_relaxation import measure as steps_of
from pmabench.analysis.shared.rest import left
from pmabench.analysis.shared.samples import NotUsable
from pmabench.base.quantities import show
from pmabench.display.expected import Expected
from pmabench.display.quantities import DRIFT, Found, Measured, Quick
from pmabench.store.records import RunData, TrialData

DISTORTED = 0.05
"""Rms of what a sine leaves of the displacement, over its own rms, that is doubted."""


def sine(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K, and B at this frequency, with what Coulomb friction adds to it: -Im(F/x)/omega = B + 4 F_c/(pi omega A)."""
    settings = run.plan.get("settings") or {}
    P = trial.point.get("pressure")
    try:
        sine = harmonic(run, trial, float(settings.get("discard", 1)))
    except NotUsable as reason:
        return [Measured("K", "stiffness", None), Measured("B", "damping", None)], [str(reason)]
    K_e = B_e = None
    if expected is not None and P is not None:
        K_e = expected.at("K", P)
        B_c, B_r = expected.at("B_c", P), expected.at("B_r", P)
        if B_c is not None and B_r is not None:
            B_e = 0.5 * (B_c + B_r) + 4 * expected.F_c / (pi * sine.speed)
    doubts = []
    if sine.distortion > DISTORTED:
        doubts.append(f"the displacement is no sine: {sine.distortion:.0%} of it is something else")
    asked = trial.point.get("amplitude", settings.get("amplitude"))
    if isinstance(asked, int | float) and asked > 0 and abs(sine.amplitude / asked - 1) > 0.05:
        doubts.append(f"amplitude {show(sine.amplitude, 'length', 3)}, asked for {show(float(asked), 'length', 3)}")
    pressure = None if np.isnan(sine.pressure) else sine.pressure
    return [
        Measured("K", "stiffness", sine.stiffness, K_e),
        Measured("B", "damping", sine.loss / sine.speed, B_e, tolerance=0.25 * B_e if B_e else 0.0),
        Measured("P", "pressure", pressure, P),
        Measured("A", "length", sine.amplitude),
    ], doubts


def ramp(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K of the mean curve, the gap of its branches at mid stroke, and the pressure."""
    P, speed = trial.point.get("pressure"), trial.point.get("speed", 0.0)
    try:
        loop = measure_as_planned(run, trial, {})
    except NotUsable as reason:
        return [Measured("K", "stiffness", None), Measured("H", "force", None)], [str(reason)]
    gap = float(loop.middle_gap.mean())
    K_e = gap_e = None
    if expected is not None and P is not None:
        K_e, B_c, B_r = (expected.at(name, P) for name in ("K", "B_c", "B_r"))
        if B_c is not None and B_r is not None:
            gap_e = 2 * expected.F_c + (B_c + B_r) * speed
    doubts = []
    if gap < -max(loop.noise, 1e-3):
        doubts.append("the contracting branch is the upper one: a wrong sign, or force and displacement apart in time")
    return [
        Measured("K", "stiffness", -float(np.polyfit(loop.x, loop.mean.mean(axis=0), 1)[0]), K_e),
        Measured("H", "force", gap, gap_e, tolerance=0.25 * gap_e if gap_e else 0.0, noise=loop.noise),
        Measured("P", "pressure", None if np.isnan(loop.pressure) else loop.pressure, P or None),
    ], doubts


def step(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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
