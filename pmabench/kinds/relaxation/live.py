"""What one trial says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.relaxation.course import measure as course_of
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Relaxation per decade and the force at 1 s, and what else than the rubber is seen in them."""
    try:
        course = course_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("s", "ratio", None)], [str(reason)]
    doubts = [one.reason for one in course.doubts() if one.seen and one.half > course.half]
    return [
        Measured("s", "ratio", course.per_decade, noise=course.half),
        Measured("F_1", "force", course.start),
    ], doubts
