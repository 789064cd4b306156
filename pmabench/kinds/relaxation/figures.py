"""Figure of relaxation: force over the logarithm of time, with the straight line.

`measure`: what one trial says by itself, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.relaxation.reduction import measure as course_of
from pmabench.plotting.chart import Series, of_points
from pmabench.plotting.pictures import Picture, column, has, head, how_many, numbers, of_charts, spread, unit_of
from pmabench.plotting.plots import PALETTE
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

COURSES = 4


def courses(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure with the force over log t of all points."""
    able = [t for t in traces if has(t, "t", "force", "line")]
    chosen = spread(able, COURSES)
    if not chosen:
        return []
    labels = "decades of time after the step, log10(t / 1 s)", unit_of(chosen[0], "force").label("force")
    values = "".join(f"; {head(t)}: s = {t.marks['s']:.2%} per decade" for t in chosen)
    caption = (
        "Marks: means of the force over equal parts of log t, the pressure divided out; lines: F = F_1 (1 − s log10 t)"
        f"{values}.{how_many(chosen, able)}"
    )
    alt = f"{labels[1]} over {labels[0]} at {len(chosen)} points; {'; '.join(map(head, chosen))}."
    table = numbers([(head(t), t) for t in chosen])
    title, simulated = "Force over time after the step", analysis.simulated
    series = [one for i, trace in enumerate(chosen) for one in _series(trace, PALETTE[i % len(PALETTE)])]
    chart = of_points(series, *labels, alt, simulated=simulated)
    return [of_charts([[chart]], title, caption, alt, table, simulated=simulated, still=True)]


def _series(trace: Trace, color: str) -> list[Series]:
    x = np.log10(column(trace, "t"))
    return [Series("", x, column(trace, "line"), color), Series(head(trace), x, column(trace, "force"), color, True)]


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Relaxation per decade and force at 1 s, with doubts about other causes."""
    try:
        course = course_of(run, trial, {})
    except NotUsable as reason:
        return [Measured("s", "ratio", None)], [str(reason)]
    doubts = [one.reason for one in course.doubts() if one.seen and one.half > course.half]
    s = Measured("s", "ratio", course.per_decade, noise=course.half)
    return [s, Measured("F_1", "force", course.start)], doubts
