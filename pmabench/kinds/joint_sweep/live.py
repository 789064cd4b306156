"""What one sweep of a joint says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.joint_sweep.reduction import sweep_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Stiffness, and gap of the branches at mid sweep."""
    try:
        one = sweep_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("K_th", "torsional stiffness", None), Measured("H_tau", "torque", None)], [str(reason)]
    gap = float(one.loop.middle_gap.mean())
    doubts = []
    if gap < -max(one.loop.noise, 1e-3):
        doubts.append("the torque is larger while the angle rises: a wrong sign, or angle and torque apart in time")
    return [
        Measured("K_th", "torsional stiffness", float(one.stiffness.mean())),
        Measured("H_tau", "torque", gap, noise=one.loop.noise),
    ], doubts
