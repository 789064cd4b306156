"""Reduction of relaxation: s per decade, force at 1 s, exponentials, at each contraction and pressure.

Knows the samples. One trial is measured in `course`, the lines and their noise are in `fit`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.base.quantities import show
from pmabench.kinds.relaxation import RESULTS
from pmabench.kinds.relaxation.course import BEFORE, TIMES, Course, measure
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import RunData, TrialData

KIND = "relaxation"
LINE, PRONY = "relaxation, log t", "relaxation, Prony"
LEAST = 0.05
"""Effects are compared with this or a larger s per decade [1]: 2 % of it is the 0.1 % per decade that is wanted."""
ONE = "one trial: the repeats part is its noise, and repeated tests may scatter more"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Relaxation s [1 per decade], F_1 [N] and shares g [1] of exponentials at each contraction [m] and pressure [Pa].

    F = F_1 (1 - s log10(t/1 s)), t from half of the pressure's step on, from `begin` on. `options`: `begin` [s], in
    place of the plan's.
    """
    courses, dropped = measured_trials(runs, lambda run, trial: measure(run, trial, options or {}))
    cells = grouped(courses, _place)
    scales = Scales.of(runs)
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    for (x, P), group in sorted(cells.items()):
        at = {"pressure": P, "contraction": x}
        estimates += [*_line(at, group, scales), *_prony(at, group, scales)]
        findings.append(_words(at, group))
    if estimates and (lack := scales.lack(("force",))):
        findings.append(Finding("note", lack))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=sorted(estimates, key=lambda e: e.method != LINE),
        dropped=dropped,
        findings=findings,
        traces=[_trace(x, P, group[0]) for (x, P), group in sorted(cells.items())],
        facts={"options": dict(options or {}), "trials": len(courses), "cells": len(cells)},
    )


def _place(one: Course) -> tuple[float, float]:
    """Contraction [m] and pressure [Pa] of a trial."""
    point = one.trial.point
    return round(point.get("contraction", 0.0), 6), round(point.get("pressure", 0.0), 3)


def _repeats(values: Sequence[float], noise: Sequence[float]) -> float:
    """Half width of the mean of trials: of their noise or of their scatter, whichever is larger."""
    own = sqrt(float(np.mean(np.square(noise))) / len(noise))
    return max(own, spread(values) or 0.0)


def _line(at: Mapping[str, float], group: Sequence[Course], scales: Scales) -> list[Estimate]:
    """Relaxation s and F_1 of one cell; the doubts are those of the trial that has the largest."""
    names = tuple(one.trial.name for one in group)
    note = ONE if len(group) == 1 else ""
    s, F = [one.per_decade for one in group], [one.start for one in group]
    half = _repeats(s, [one.half for one in group])
    level, P = float(np.mean(F)), at.get("pressure", 0.0)
    # the force is brought to the pressure of the step, and relaxation is a share of the force
    zeros = {"force": 1.0} | ({"pressure": level / P} if P > 0 else {})
    by_zero = scales.part({}, {"force": float(np.mean(s)) / level}) if level else None
    slope = Estimate(
        "s", float(np.mean(s)), "1", "ratio", LINE, dict(at), Parts(half, calibration=by_zero), len(group), note=note,
        trials=names,
    )  # fmt: skip
    whole = [one.relaxing.half(np.full(len(one.relaxing.t), 1 / len(one.relaxing.t))) for one in group]
    start = Estimate(
        "F_1", level, "N", "force", LINE, dict(at),
        Parts(_repeats(F, [one.half * one.start * float(one.relaxing.decades.mean()) + w
                           for one, w in zip(group, whole, strict=True)]),
              calibration=scales.part(dict.fromkeys(("force", "pressure"), level), zeros)),
        len(group), note=note, trials=names,
    )  # fmt: skip
    left = Doubt(BEFORE, "drift", max(one.left_behind for one in group), seen=False)
    # the force need not grow in proportion to the pressure by which it is brought to that of the step
    share = Doubt("mean pressure", "method", 0.5 * max(one.off * abs(one.start) for one in group), seen=False)
    doubts = _largest([one.doubts() for one in group])
    of_start = [left, share, *_largest([one.doubts_of_start() for one in group])]
    return [weighed(slope, doubts, max(LEAST, abs(slope.value or 0.0))), weighed(start, of_start)]


def _largest(of_trials: Sequence[Sequence[Doubt]]) -> list[Doubt]:
    """Of the same doubts of each trial the largest, those that are seen first."""
    return [max(same, key=lambda d: (d.seen, d.half)) for same in zip(*of_trials, strict=True)]


def _prony(at: Mapping[str, float], group: Sequence[Course], scales: Scales) -> list[Estimate]:
    """Shares of the exponentials of one cell."""
    found = []
    for i, T in enumerate(TIMES, 1):
        names = tuple(one.trial.name for one in group)
        fits = [one.relaxing.prony for one in group]
        where = show(T, "time")
        if not all(one.relaxing.shows(T) for one in group):
            begin, end = (group[0].relaxing.t[i] for i in (0, -1))
            why = f"the samples are from {begin:.3g} to {end:.3g} s after the step and do not show {where}"
            found.append(Estimate("g", None, "1", "ratio", PRONY, dict(at), n=len(group), note=why, trials=names,
                                  coordinate=where))  # fmt: skip
            continue
        values = [sizes[i] / one.start for (sizes, _, _), one in zip(fits, group, strict=True)]
        noise = [halves[i] / one.start for (_, halves, _), one in zip(fits, group, strict=True)]
        note = ONE if len(group) == 1 else ""
        size, level = float(np.mean(values)), float(np.mean([one.start for one in group]))
        parts = Parts(_repeats(values, noise), calibration=scales.part({}, {"force": size / level}))
        found.append(Estimate("g", size, "1", "ratio", PRONY, dict(at), parts, len(group), note=note,
                              trials=names, coordinate=where))  # fmt: skip
    return found


def _words(at: Mapping[str, float], group: Sequence[Course]) -> Finding:
    """How well line and exponentials follow the course."""
    one = group[0].relaxing
    start, slope = one.line
    off = float(np.sqrt(np.mean((one.means(one.y) - start - slope * one.decades) ** 2)))
    text = (
        f"{show(at['contraction'], 'length')}, {show(at['pressure'], 'pressure')}: over {np.ptp(one.decades):.1f} "
        f"decades the line over log t leaves {show(off, 'force', 2)}, the exponentials "
        f"{show(one.prony[2], 'force', 2)}; parts of them differ by {group[0].bend.size:.2%} per decade"
    )
    return Finding("note", text)


def _trace(x: float, P: float, course: Course) -> Trace:
    """Means over equal parts of log t, with line and exponentials."""
    one = course.relaxing
    start, slope = one.line
    sizes = one.prony[0]
    curve = sizes[0] + sum(size * one.means(np.exp(-one.t / T)) for size, T in zip(sizes[1:], TIMES, strict=True))
    columns = {"t": 10**one.decades, "force": one.means(one.y), "line": start + slope * one.decades, "curve": curve}
    return Trace(
        f"relaxation-{x:g}-{P:g}",
        "relaxation",
        f"{show(x, 'length')}, {show(P, 'pressure')}: force over time after the step",
        columns,
        {"t": "time", "force": "force", "line": "force", "curve": "force"},
        {"s": course.per_decade},
    )


def per_decade(run: RunData, trial: TrialData) -> float:
    """Relaxation s of one trial [1]; raises `NotUsable`."""
    return measure(run, trial, {}).per_decade
