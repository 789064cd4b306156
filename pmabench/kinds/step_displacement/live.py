"""What one trial says by itself, for the display."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.samples import NotUsable, left
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
    further = left([step.later for step in steps])
    moves = further.seen and abs(further.size) > DRIFT * beyond > 0
    doubts = [f"the force would still change by {show(further.size, 'force', 2)}"] if moves else []
    return [
        Measured("K", "stiffness", K, expected.at("K", P) if expected is not None and P is not None else None),
        Measured("overshoot", "force", beyond, noise=3 * steps[0].noise),
    ], doubts
