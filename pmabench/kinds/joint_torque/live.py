"""What one trial of isometric torques says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.joint_torque.staircase import staircase_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Gap between both sides, and the stiffness at the angle in the middle."""
    try:
        one = staircase_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("K_th", "torsional stiffness", None), Measured("H_tau", "torque", None)], [str(reason)]
    why = one.why_no_stiffness
    stiffness = None if why else float(one.stiffness().mean(axis=0)[one.open.sum() // 2])
    gap = float(one.gap[:, one.open].mean())
    return [
        Measured("K_th", "torsional stiffness", stiffness),
        Measured("H_tau", "torque", gap, noise=one.noise),
    ], [why] if why else []
