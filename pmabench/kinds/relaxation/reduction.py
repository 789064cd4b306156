"""Reduction of relaxation: s per decade, force at 1 s, exponentials, at each contraction and pressure.

One trial is the force after the step divided by the measured pressure (`course`). Also the figure, and with
`one_trial` the values of one trial for the display.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.shared.student import half_of_trials
from pmabench.analysis.shared.trials import Reduction
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.relaxation import RESULTS
from pmabench.kinds.relaxation.course import BEFORE, JUMP, UNPROPORTIONAL, Course, measure
from pmabench.kinds.relaxation.relaxing import TIMES
from pmabench.plotting.chart import PALETTE, Chart, Series
from pmabench.plotting.pictures import Drawn, column, head, of_some, unit_of
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import RunData, TrialData

KIND = "relaxation"
LINE, PRONY = "relaxation, log t", "relaxation, Prony"
LEAST = 0.05
"""Smallest s per decade to which effects are compared [1]: 2 % of it is the wanted accuracy of 0.1 % per decade."""
ALONE = (
    "one trial at each operating point: a cell whose gain changes between two trials, or within the begin of a hold, "
    "gives forces that another muscle would have, and nothing shows it. Do the first operating point again at the end"
)
ONE = "one trial: the repeats part is its noise, and repeated tests may scatter more"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Relaxation s [1 per decade], F_1 [N] and shares g [1] of exponentials at each contraction [m] and pressure [Pa].

    F = F_1 (1 - s log10(t/1 s)), with t counted from half of the pressure step, used from `begin` on. `options`:
    `begin` [s], in place of the plan's.
    """
    result = Reduction.of(KIND, RESULTS, runs, options, measure)
    cells, jumps = result.cells(_place), [one for one in result.measured if one.relaxing.jump[0]]
    for (x, P), group in cells:
        at = {"pressure": P, "contraction": x}
        result.estimates += [*_line(at, group, result.scales, jumps), *_prony(at, group, result.scales)]
        result.traces.append(_trace(x, P, group[0]))
    result.findings += [Finding("doubt", one.of_jump) for one in jumps]
    if 1 < len(cells) == len(result.measured):
        result.findings.append(Finding("note", ALONE))
    result.estimates.sort(key=lambda e: e.method != LINE)
    result.note_lack(("force",))
    return result.analysis(cells=len(cells))


def _place(one: Course) -> tuple[float, float]:
    """Contraction [m] and pressure [Pa] of a trial."""
    point = one.trial.point
    return round(point.get("contraction", 0.0), 6), round(point.get("pressure", 0.0), 3)


def _line(at: Mapping[str, float], group: Sequence[Course], scales: Scales, jumps: Sequence[Course]) -> list[Estimate]:
    """Relaxation s and F_1 of one cell, with the largest doubts of its trials; `jumps` are the trials with a jump."""
    names = tuple(one.trial.name for one in group)
    note = ONE if len(group) == 1 else ""
    s, F = [one.per_decade for one in group], [one.start for one in group]
    half = half_of_trials(s, [one.half for one in group])
    level, P = float(np.mean(F)), at.get("pressure", 0.0)
    # the force is scaled to the pressure of the step, and relaxation is relative to the force
    zeros = {"force": 1.0} | ({"pressure": level / P} if P > 0 else {})
    by_zero = scales.part({}, {"force": float(np.mean(s)) / level}) if level else None
    n, parts = len(group), Parts(half, calibration=by_zero)
    slope = Estimate("s", float(np.mean(s)), "1", "ratio", LINE, dict(at), parts, n, note=note, trials=names)
    whole = [one.relaxing.half(np.full(len(one.relaxing.t), 1 / len(one.relaxing.t))) for one in group]
    noise = [one.half * one.start * float(one.relaxing.decades.mean()) + w for one, w in zip(group, whole, strict=True)]
    by_scales = scales.part(dict.fromkeys(("force", "pressure"), level), zeros)
    parts = Parts(half_of_trials(F, noise), calibration=by_scales)
    start = Estimate("F_1", level, "N", "force", LINE, dict(at), parts, n, note=note, trials=names)
    left = Doubt(BEFORE, "drift", max(one.left_behind for one in group), seen=False)
    # the scaling to the pressure of the step assumes a proportional force
    most = UNPROPORTIONAL * max(one.off * abs(one.start) for one in group)
    share = Doubt("mean pressure", "method", most, seen=False)
    doubts, of_start = _largest([one.doubts() for one in group]), _largest([one.doubts_of_start() for one in group])
    # what was right, the trials before the jump or those after it, is not known
    of_start += [
        Doubt(JUMP, "drift", level * abs(one.relaxing.jump[0] / one.start) + own, True, one.of_jump)
        for one in jumps
        for own in [abs(one.jumped.line[0]) if one in group else 0.0]
    ]
    return [weighed(slope, doubts, max(LEAST, abs(slope.value or 0.0))), weighed(start, [*of_start, left, share])]


def _largest(of_trials: Sequence[Sequence[Doubt]]) -> list[Doubt]:
    """For each kind of doubt the largest of all trials, significant ones first."""
    return [max(same, key=lambda d: (d.seen, d.half)) for same in zip(*of_trials, strict=True)]


def _prony(at: Mapping[str, float], group: Sequence[Course], scales: Scales) -> list[Estimate]:
    """Shares of the exponentials of one cell."""
    found = []
    names = tuple(one.trial.name for one in group)
    fits, level = [one.relaxing.prony for one in group], float(np.mean([one.start for one in group]))
    begin, end = (group[0].relaxing.t[i] for i in (0, -1))
    for i, T in enumerate(TIMES, 1):
        size, parts, doubts = None, Parts(), list[Doubt]()
        note = f"the samples are from {begin:.3g} to {end:.3g} s after the step and do not show {show(T, 'time')}"
        if all(one.relaxing.shows(T) for one in group):
            values = [sizes[i] / one.start for (sizes, _, _), one in zip(fits, group, strict=True)]
            noise = [halves[i] / one.start for (_, _, halves), one in zip(fits, group, strict=True)]
            size, note = float(np.mean(values)), ONE if len(group) == 1 else ""
            parts = Parts(half_of_trials(values, noise), calibration=scales.part({}, {"force": size / level}))
            doubts = _largest([one.doubts_of_share(i) for one in group])
        g = Estimate("g", size, "1", "ratio", PRONY, dict(at), parts, len(group), note=note, trials=names,
                     coordinate=show(T, "time"))  # fmt: skip
        found.append(weighed(g, doubts, max(LEAST, abs(size or 0.0))))
    return found


def _trace(x: float, P: float, course: Course) -> Trace:
    """Means over equal parts of log t, with line and exponentials."""
    one = course.relaxing
    start, slope = one.line
    sizes = one.prony[0]
    curve = sizes[0] + sum(size * one.means(np.exp(-one.t / T)) for size, T in zip(sizes[1:], TIMES, strict=True))
    columns = {"t": 10**one.decades, "force": one.means(one.y), "line": start + slope * one.decades, "curve": curve}
    quantities = {name: "time" if name == "t" else "force" for name in columns}
    title = f"{show(x, 'length')}, {show(P, 'pressure')}: force over time after the step"
    return Trace(f"relaxation-{x:g}-{P:g}", "relaxation", title, columns, quantities, {"s": course.per_decade})


def per_decade(run: RunData, trial: TrialData) -> float:
    """Relaxation s of one trial [1]; raises `NotUsable`."""
    return measure(run, trial, {}).per_decade


COURSES = 4


@of_some("Force over time after the step", COURSES, "t", "force", "line")
def courses(traces: Sequence[Trace]) -> Drawn:
    """One figure with the force over log t of all points."""
    labels = "decades of time after the step, log10(t / 1 s)", unit_of(traces[0], "force").label("force")
    values = "".join(f"; {head(t)}: s = {t.marks['s']:.2%} per decade" for t in traces)
    caption = (
        "Marks: means of the force over equal parts of log t, the pressure divided out; lines: F = F_1 (1 − s log10 t)"
        f"{values}."
    )
    series = [one for i, trace in enumerate(traces) for one in _series(trace, PALETTE[i % len(PALETTE)])]
    return [[Chart(*labels, tuple(series), legend=True)]], caption


def _series(trace: Trace, color: str) -> list[Series]:
    x = np.log10(column(trace, "t"))
    return [Series("", x, column(trace, "line"), color), Series(head(trace), x, column(trace, "force"), color, "o")]


def one_trial(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Relaxation per decade and force at 1 s, with doubts about other causes."""
    try:
        course = measure(run, trial, {})
    except NotUsable as reason:
        return [Measured("s", "ratio", None)], [str(reason)]
    doubts = [one.reason for one in course.doubts() if one.seen and one.half > course.half]
    s = Measured("s", "ratio", course.per_decade, noise=course.half)
    return [s, Measured("F_1", "force", course.start)], doubts
