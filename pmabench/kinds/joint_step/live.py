"""What one trial of a joint in closed loop says by itself, for the display."""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.joint_step.course import Swung, course_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """End error and settling time of a step; gain and phase of a sine."""
    try:
        one = course_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("e_th", "angle", None), Measured("t_s", "time", None)], [str(reason)]
    if isinstance(one, Swung):
        answer = complex(one.answers.mean())
        return [
            Measured("g_th", "ratio", abs(answer)),
            Measured("phi_th", "angle", float(np.angle(answer))),
        ], []
    doubts = [] if one.response.settling is not None else ["the angle does not come into the band about its goal"]
    return [
        Measured("e_th", "angle", -one.sign * one.response.error),
        Measured("t_s", "time", one.response.settling),
    ], doubts
