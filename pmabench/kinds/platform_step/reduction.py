"""From steps of a platform's attitude to time, overshoot, end error and openings of valves, each with an interval."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import MOST_HIDDEN, weighed
from pmabench.analysis.shared.lines import mean_half
from pmabench.analysis.shared.samples import settings_of
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.kinds.platform_step import RESULTS
from pmabench.kinds.platform_step.course import (
    ACCELERATIONS,
    BAND,
    LAST,
    MUSCLES,
    VALVES,
    Course,
    G,
    Seen,
    course_of,
    seen_in,
    wanted,
)
from pmabench.model.platform_control import Lags
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, RunData

KIND = "platform-step"
HEIGHTS = (0.8, 1.2)
"""The accelerometer's height is known this well: what comes out differently with either is in the interval."""
PEAK = 3.0
"""The highest of many smoothed samples is up to so many of their standard deviations too high."""
THINNED = 100.0
"""Samples a second of a figure [Hz]."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """t_1 [s], OS_q [rad], e_q [rad] and n_v [Hz] of each attitude and chain.

    t_1 is withheld where one of the trials did not settle in the first half of its hold.
    """
    chains = sorted({str(settings_of(run).get("chain", "")) for run in runs})
    if len(chains) > 1:
        raise UsageError(
            f"runs with the chains {' and '.join(chains)} are no repeats of each other: process each by itself, then "
            "compare the two analyses"
        )
    scales = Scales.of(runs)
    courses, dropped = measured_trials(runs, course_of)
    estimates, findings, traces = list[Estimate](), list[Finding](), list[Trace]()
    cells = grouped(courses, lambda one: (str(one.law["chain"]), round(one.goal[0], 9), round(one.goal[1], 9)))
    for (chain, phi, psi), members in cells.items():
        where = {"phi": phi, "psi": psi}
        estimates += _estimates(f"chain {chain}", where, members, scales, seen_in(courses))
        traces.append(_trace(chain, members[-1]))
    findings += [Finding("doubt", f"{one.trial}: {one.reason}") for one in dropped]
    for one in (one for one in courses if one.law["saturated"] > 0):
        share = show(float(one.law["saturated"]), "ratio", 2)
        text = f"{one.trial.name}: in {share} of the periods limits of pressures forbade the wanted moment"
        findings.append(Finding("note", text))
    if estimates and (lack := scales.lack((), ACCELERATIONS[:2])):
        findings.append(Finding("note", lack))
    facts = {"options": dict(options or {}), "trials": len(courses)}
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates, dropped=dropped, findings=findings, traces=traces, facts=facts
    )


def _estimates(
    method: str, at: Mapping[str, float], members: Sequence[Course], scales: Scales, seen: Seen
) -> Iterator[Estimate]:
    """Everything of one cell."""
    others = [[course_of(one.run, one.trial, heights) for heights in HEIGHTS] for one in members]
    offset = max(scales.offsets.get(name, 0.0) for name in ACCELERATIONS) / G

    def made(
        symbol: str, quantity: tuple[str, str], values: Sequence[float], extra: float, known: float | None
    ) -> Estimate:
        numbers = np.array(values)
        parts = Parts(mean_half(numbers, []), extra, known)
        note = "" if len(values) > 1 else "one trial: how far another one would be off is not known"
        trials = tuple(one.trial.name for one in members)
        return Estimate(
            symbol, float(numbers.mean()), *quantity, method, at, parts, len(values), note=note, trials=trials
        )

    size = math.hypot(*at.values())
    times, by_height, by_band, why = _time(members, others, math.hypot(offset, seen.attitude.half, seen.wobble))
    t_1 = made("t_1", ("s", "time"), times, by_height, by_band)
    if not why and t_1.value is not None and seen.attitude.seen and seen.attitude.half > MOST_HIDDEN * size:
        why = seen.attitude.reason
    yield withhold(t_1, why) if why else weighed(t_1, [seen.time])
    pairs = [(one, other) for one, both in zip(members, others, strict=True) for other in both]
    shape = max(abs(other.overshoot - one.overshoot) for one, other in pairs)
    shape = math.hypot(shape, PEAK * max(one.noise for one in members), seen.wobble)
    OS_q = made("OS_q", ("rad", "angle"), [one.overshoot for one in members], shape, offset or None)
    yield weighed(OS_q, [seen.attitude], size)
    misses = [math.hypot(*one.ends()) for one in members]
    drifts = max(math.dist(one.ends(LAST, 0.5 * LAST), one.ends(0.5 * LAST)) / 2 for one in members)
    drifts = math.hypot(drifts, max(one.noise for one in members), seen.wobble)
    yield weighed(made("e_q", ("rad", "angle"), misses, drifts, offset or None), [seen.attitude], size)
    busiest = [max(one.openings().values()) for one in members]
    yield made("n_v", ("Hz", "frequency"), busiest, max(1 / one.hold for one in members), 0.0)


def _time(
    members: Sequence[Course], others: Sequence[Sequence[Course]], offset: float
) -> tuple[list[float], float, float | None, str]:
    """Times to within 1 deg, the method and the calibration part, and why there is none.

    The interval holds the times of a band that is wider and narrower by what is not known.
    """
    off = [math.hypot(offset, 2 * one.noise) for one in members]
    times = [one.settled() for one in members]
    sure = [[one.settled(BAND + sign * by) for sign in (-1, 1)] for one, by in zip(members, off, strict=True)]
    shaped = [[other.settled() for other in both] for both in others]
    known = [time for time in times if time is not None]
    if len(known) < len(members):
        many = f"{len(members) - len(known)} of {len(members)} trials"
        return known or [math.inf], 0.0, None, f"{many} did not stay within 1 deg in the second half of the hold"
    if any(time is None for several in (*sure, *shaped) for time in several):
        why = "whether it settles depends on how well the attitude is known: it ends near 1 deg off"
        return known, 0.0, None, why
    by_band, by_height = (
        max(abs(time - own) for own, several in zip(known, cases, strict=True) for time in several if time is not None)
        for cases in (sure, shaped)
    )
    return known, by_height + 0.5 / members[0].run.rate, by_band, ""


def _trace(chain: str, one: Course) -> Trace:
    """The whole of one trial, thinned."""
    stride = max(1, round(one.run.rate / THINNED))
    aims, reference = wanted(one), _reference(one)
    angles = {"phi": one.phi, "psi": one.psi, "reference_phi": reference[0], "reference_psi": reference[1]}
    pressures = {name: np.asarray(one.trial.channels[name]) for name in MUSCLES}
    pressures |= {f"wanted_{i + 1}": aims[name] for i, name in enumerate(MUSCLES)}
    thin = {name: values[::stride] for name, values in ({"t": one.t} | angles | pressures).items()}
    thin |= {valve: _open_share(one, valve, thin["t"], stride / one.run.rate) for valve in VALVES}
    quantities = {"t": "time", **dict.fromkeys(angles, "angle"), **dict.fromkeys(pressures, "pressure")}
    quantities |= dict.fromkeys(VALVES, "ratio")
    phi, psi = (show(angle, "angle", 4) for angle in one.goal)
    marks = {"phi": one.goal[0], "psi": one.goal[1], "hold": one.hold}
    name = f"attitude-{chain}-{one.trial.number}"
    return Trace(name, "attitude", f"To phi {phi}, psi {psi}, chain {chain}", thin, quantities, marks)


def _reference(one: Course) -> tuple[Array, Array]:
    """What the attitude is to follow, at each sample: the goals through the law's two lags."""
    lags = Lags(float(one.law["reference_lag"]), (float(one.phi[0]), float(one.psi[0])))
    goals = [(float(begin), (float(phi), float(psi))) for begin, phi, psi in one.law["goals"]]
    start = float(one.law["t0"])
    rows = []
    for t, h in zip(one.trial.t, np.diff(one.trial.t, prepend=one.trial.t[0]), strict=True):
        goal = next((at for begin, at in reversed(goals) if t - start >= begin - 1e-9), goals[0][1])
        rows.append(lags.update(float(h), goal))
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


def _open_share(one: Course, valve: str, t: Array, step: float) -> Array:
    """Share of each interval of `step` [s] from `t` on in which a valve is commanded open."""
    share = np.zeros(len(t))
    for begin, name, seconds in one.pulses:
        if name == valve:
            share += np.clip(np.minimum(begin + seconds, t + step) - np.maximum(begin, t), 0.0, step) / step
    return np.minimum(share, 1.0)
