"""What one step of a platform says by itself, for the display."""

from __future__ import annotations

import math

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.platform_step.course import course_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Time to within 1 deg, overshoot and end error."""
    try:
        one = course_of(run, trial)
    except NotUsable as reason:
        return [Measured("t_1", "time", None), Measured("OS_q", "angle", None)], [str(reason)]
    time = one.settled()
    doubts = [] if time is not None else ["it does not stay within 1 deg in the second half of the hold"]
    found = [Measured("t_1", "time", time), Measured("OS_q", "angle", one.overshoot, noise=one.noise)]
    return [*found, Measured("e_q", "angle", math.hypot(*one.ends()), noise=one.noise)], doubts
