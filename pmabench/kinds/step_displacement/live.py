"""What one trial says by itself, for the display."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.step_displacement.relaxation import measure as steps_of
from pmabench.store.records import RunData, TrialData

DISTORTED = 0.05
"""Rms of what a sine leaves of the displacement, over its own rms, that is doubted."""


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K from relaxed forces, and the peak of the force beyond them, of the steps away from the start."""
    P = trial.point.get("pressure")
    try:
        steps = steps_of(run, trial, {}).there
    except NotUsable as reason:
        return [Measured("K", "stiffness", None)], [str(reason)]
    K = float(np.mean([step.static for step in steps]))
    beyond = float(np.mean([abs(step.peak - step.relaxed) for step in steps]))
    drift = max((abs(step.drift) for step in steps if abs(step.drift) > 3 * step.noise), default=0.0)
    doubts = [f"the force still drifts by {show(drift, 'force', 2)}"] if drift > DRIFT * beyond > 0 else []
    return [
        Measured("K", "stiffness", K, expected.at("K", P) if expected is not None and P is not None else None),
        Measured("overshoot", "force", beyond, noise=3 * steps[0].noise),
    ], doubts
