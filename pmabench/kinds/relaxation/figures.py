"""Figure of relaxation: force over the logarithm of time, with the straight line.

`measure`: what one trial says by itself, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.relaxation.reduction import measure as course_of
from pmabench.plotting import plots
from pmabench.plotting.pictures import Picture, bound, column, has, head, how_many, numbers, picture, spread, unit_of
from pmabench.plotting.plots import Points
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

COURSES = 4


def courses(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure with the force over log t of all points."""
    able = [t for t in traces if has(t, "t", "force", "line")]
    chosen = spread(able, COURSES)
    if not chosen:
        return []
    points = [_points(trace, i) for i, trace in enumerate(chosen)]
    labels = "decades of time after the step, log10(t / 1 s)", unit_of(chosen[0], "force").label("force")
    pairs = zip(points, chosen, strict=True)
    values = "".join(f"; {p.label}: s = {t.marks['s']:.2%} per decade" for p, t in pairs)
    caption = (
        "Marks: means of the force over equal parts of log t, the pressure divided out; lines: F = F_1 (1 − s log10 t)"
        f"{values}.{how_many(chosen, able)}"
    )
    alt = f"{labels[1]} over {labels[0]} at {len(points)} points; {'; '.join(p.label for p in points)}."
    table = numbers([(p.label, t) for p, t in zip(points, chosen, strict=True)])
    draw = bound(plots.coefficients, points, *labels)
    return [
        picture(draw, "Force over time after the step", caption, alt, table, wide=False, simulated=analysis.simulated)
    ]


def _points(trace: Trace, i: int) -> Points:
    x = np.log10(column(trace, "t"))
    none = np.full(len(x), np.nan)
    curve = x, column(trace, "line"), np.zeros(len(x))
    return Points(head(trace), x, column(trace, "force"), none, none, primary=i == 0, group=i, mark=i, curve=curve)


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Relaxation per decade and force at 1 s, with doubts about other causes."""
    try:
        course = course_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("s", "ratio", None)], [str(reason)]
    doubts = [one.reason for one in course.doubts() if one.seen and one.half > course.half]
    s = Measured("s", "ratio", course.per_decade, noise=course.half)
    return [s, Measured("F_1", "force", course.start)], doubts
