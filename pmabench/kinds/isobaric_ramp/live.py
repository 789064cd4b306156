"""What one trial says by itself, for the display."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.ramp_loop import measure_as_planned
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.store.records import RunData, TrialData

DISTORTED = 0.05
"""Rms of what a sine leaves of the displacement, over its own rms, that is doubted."""


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
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
