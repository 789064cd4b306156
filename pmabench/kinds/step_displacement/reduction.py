"""Reduction of steps of displacement at constant pressure: static and instantaneous stiffness, the way back to rest.

Knows the samples. One trial is measured in `relaxation`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import hypot
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import MOST_HIDDEN, Doubt, force_from_cycle_to_cycle, weighed
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.samples import Held, left
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.analysis.verdict.agreement import Offer, exactly, values_of, weighted
from pmabench.base.quantities import show
from pmabench.kinds.step_displacement import RESULTS
from pmabench.kinds.step_displacement.relaxation import Relaxation, Steps, filter_of, measure
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import RunData

KIND = "step-displacement"
RELAXED, PEAK, BACK = "step, relaxed", "step, peak", "step, recovery"
EXTREME = 3.0
"""Standard deviations of the noise by which a peak lies beyond the signal."""
TAIL = 0.1
"""What the end of the motion, where the actuator creeps in, may make of a time constant, as a share of it."""
CELL = ("pressure", "start", "step", "speed")
STEPS_OF_ONE = "one trial: the repeats part is the scatter of its steps, and repeated tests may scatter more"
ONE_STEP = "no repeats part: one step"
DRIFTS = 0.02
"""What the force would still change by after a rest, as a share of its step, that is doubted."""
BLUNT = 0.25
"""Share of the peak above which what a filter may have taken off it is not left to its interval."""
SEVERAL = 0.4
"""Share of a time constant by which that of the later part may differ where there is one exponential."""
LONGEST_TRACE = 1500
UNTURNED = 0.05
"""Share of the friction between two rests that a small step may not have turned round yet."""
RUBS = "friction between the two rests is in it"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m] from relaxed forces and from the peak, forces [N] around each step, time constants [s] of the recovery.

    Static stiffness is -(F relaxed - F before)/(step as measured), the instantaneous one has the peak in place of the
    relaxed force: damping (K + B v/step for three elements) and the pressure that the step makes are in it. Steps there
    and back differ by their sign: above 0 the muscle contracts. The time constants are those of one exponential
    from the end of the motion on. `options`: `discard`
    (cycles at the start; else the plan's setting, else 1).
    """
    members, dropped = measured_trials(runs, lambda run, trial: measure(run, trial, options or {}))
    scales = Scales.of(runs)
    cells = grouped(
        members, lambda one: tuple((name, round(one.trial.point[name], 9)) for name in CELL if name in one.trial.point)
    )
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    traces: list[Trace] = []
    for key, group in sorted(cells.items()):
        at = dict(key)
        for sign, of in ((1.0, lambda steps: steps.there), (-1.0, lambda steps: steps.back)):
            here = {**at, "step": sign * at.get("step", 0.0)}
            estimates += _estimates(here, group, of, scales)
        findings += _findings(at, group)
        traces.append(_trace(at, group[0]))
    if estimates and (lack := scales.lack(("force", "displacement"))):
        findings.append(Finding("note", lack))
    order = {RELAXED: 0, PEAK: 1}
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=sorted(estimates, key=lambda e: order.get(e.method, 2)),
        dropped=dropped,
        findings=findings,
        traces=traces,
        facts={"options": dict(options or {}), "trials": len(members), "cells": len(cells)},
    )


def _estimates(
    at: Mapping[str, float], group: Sequence[Steps], of: Callable[[Steps], tuple[Relaxation, ...]], scales: Scales
) -> list[Estimate]:
    """All of one direction of one cell."""
    each = [of(member) for member in group]
    names = tuple(member.trial.name for member in group)
    every = [one for steps in each for one in steps]
    noise = max(one.noise for one in every)
    moved = abs(float(np.mean([one.moved for one in every])))
    extreme = hypot(EXTREME * noise, max(one.sampled for one in every))
    before, after = (_still_moving([getattr(one, name) for one in every]) for name in ("earlier", "later"))
    both = tuple(replace(one, half=one.half / moved) for one in (before, after))
    blunt = _blunt(group, every)
    of_peak = (both[0], replace(blunt, half=blunt.half / moved))
    estimates: list[Estimate] = []

    def estimate(
        symbol: str, kind: tuple[str, str], method: str, value: Callable[[Relaxation], float],
        powers: Mapping[str, int], extra: float, coordinate: str = "", doubts: Sequence[Doubt] = (),
    ) -> None:  # fmt: skip
        values = [np.array([value(one) for one in steps]) for steps in each]
        mean, half = mean_of_cycles(values)
        gains = {name: mean * power for name, power in powers.items()}
        # a sensor with backlash is off one way at one end of the step and the other way at the other end
        offsets = {"displacement": 2 * mean / moved} if symbol == "K" else {}
        if symbol == "F":  # as a force that grows with the pressure, along the stiffness
            P, K = at.get("pressure", 0.0), float(np.mean([one.static for one in every]))
            gains |= {"pressure": mean} if P > 0 else {}
            offsets = {"force": 1.0, "displacement": K} | ({"pressure": mean / P} if P > 0 else {})
        part = scales.part(gains, offsets)
        note = ONE_STEP if half is None else STEPS_OF_ONE if len(group) == 1 else ""
        if part is None and set(powers) - {"force", "displacement"}:
            note = sentences(note, scales.lack(powers))
        e = Estimate(symbol, mean, *kind, method, dict(at), Parts(half, extra, part), len(group), note=note,
                     trials=names, coordinate=coordinate)  # fmt: skip
        estimates.append(weighed(e, [*doubts, *(force_from_cycle_to_cycle(values) if symbol == "F" else ())]))

    stiffness, newton, second = ("N/m", "stiffness"), ("N", "force"), ("s", "time")
    slope = {"force": 1, "displacement": -1}
    estimate("K", stiffness, RELAXED, lambda one: one.static, slope, 0.0, doubts=both)
    estimate("K", stiffness, PEAK, lambda one: one.instant, slope, extreme / moved, doubts=of_peak)
    estimate("F", newton, RELAXED, lambda one: one.before, {"force": 1}, 0.0, "before", (before,))
    estimate("F", newton, PEAK, lambda one: one.peak, {"force": 1}, extreme, "peak", (blunt,))
    estimate("F", newton, RELAXED, lambda one: one.relaxed, {"force": 1}, 0.0, "relaxed", (after,))
    leap = EXTREME * max(one.pressure_noise for one in every)
    if all(np.isfinite(one.pressure_peak) for one in every):
        estimate("P_err", ("Pa", "pressure"), PEAK, lambda one: one.pressure_peak, {"pressure": 1}, leap)
    for symbol, name in (("tau_F", "force_back"), ("tau_p", "pressure_back")):
        back = [getattr(one, name) for one in every]
        if None in back:
            note = "no recovery shows above the noise, or it is over within a few samples"
            estimates.append(Estimate(symbol, None, *second, BACK, dict(at), n=len(group), note=note, trials=names))
            continue
        estimate(symbol, second, BACK, lambda one, name=name: getattr(one, name).tau, {}, 0.0)  # type: ignore[misc]
        size = float(np.mean([abs(one.size) for one in back]))
        restless = name == "force_back" and after.seen and after.half > MOST_HIDDEN * size
        tau = _one_time(estimates.pop(), max(one.apart for one in back))
        estimates.append(withhold(tau, after.reason) if restless else tau)
    return estimates


def _one_time(tau: Estimate, apart: float) -> Estimate:
    """A time constant with what its later part differs by in its interval, or withheld where there are several."""
    value = abs(tau.value or 0.0)
    if apart > SEVERAL * value:
        later = f"the later part of the way back has a time constant that differs by {apart / value:.0%}"
        return withhold(tau, f"{later} (below {SEVERAL:.0%} is accepted): it is not one exponential")
    note = sentences(tau.note, "no calibration part: a time has no scale")
    return replace(tau, parts=Parts(tau.parts.repeats, hypot(TAIL * value, apart)), note=note)


def _blunt(group: Sequence[Steps], every: Sequence[Relaxation]) -> Doubt:
    """What a filter of the force cell may have taken off the peaks [N]: no channel shows it."""
    constant = max(filter_of(member.run) for member in group)
    half = max(one.blunted for one in every)
    text = f"a filter of the force cell of {show(constant, 'time', 2)} would take {show(half, 'force', 2)} off the peak"
    reason = f"{text}: declare the `sensor_lag` of the channel, use a faster cell, or step more slowly"
    rise = abs(float(np.mean([one.peak - one.before for one in every])))
    return Doubt("filter of the force cell", "method", half, seen=True, reason=reason if half > BLUNT * rise else "")


def _still_moving(rests: Sequence[Held]) -> Doubt:
    """What motion of the force at the end of the rests is worth [N]."""
    further = left(rests)
    text = f"the force is not at rest: after the hold it may still change by {show(further.most, 'force', 2)}"
    return Doubt("motion of the force after the rest", "method", further.most, further.seen, f"{text}. Hold longer")


def _findings(at: Mapping[str, float], group: Sequence[Steps]) -> list[Finding]:
    """What catches the eye."""
    lines = []
    for member in group:
        for steps in (member.there, member.back):
            further, size = left([one.later for one in steps]), abs(steps[0].relaxed - steps[0].before)
            if further.seen and abs(further.size) > DRIFTS * size:
                change = show(further.size, "force", 2)
                text = f"trial {member.trial.name}: after a rest the force would still change by {change}"
                lines.append(Finding("doubt", f"{text}; K is not static yet, hold longer"))
        if any(one.static <= 0 for one in (*member.there, *member.back)):
            text = f"trial {member.trial.name}: the force rises with contraction: a sign is wrong, or the step is lost"
            lines.append(Finding("fault", text))
    return lines


def _trace(at: Mapping[str, float], member: Steps) -> Trace:
    """Around the last step away from the start."""
    columns = member.last
    stride = max(1, -(-len(columns["t"]) // LONGEST_TRACE))
    step = member.there[-1]
    places = [show(at[name], quantity) for name, quantity in
            (("pressure", "pressure"), ("step", "length"), ("speed", "speed")) if name in at]  # fmt: skip
    return Trace(
        "step-" + "-".join(f"{value:g}" for value in at.values()),
        "displacement-step",
        f"{', '.join(places)}: step of displacement",
        {name: values[::stride] for name, values in columns.items()},
        {"t": "time", "force": "force", "displacement": "length", "pressure": "pressure"},
        {"before": step.before, "peak": step.peak, "relaxed": step.relaxed},
    )


def offers(analysis: Analysis) -> Iterator[Offer]:
    """K and F from forces at rest, where friction only adds to one and has one sign in the other.

    At rest the force is above the mean of both directions after stretching and below it after contracting, by a
    friction f. A step s takes -K s - 2 f, so that two steps of different size from one start have K between them.
    """
    cells: dict[tuple[float, ...], list[Estimate]] = {}
    for e in values_of(analysis, "K", RELAXED):
        P, start, step = (e.at.get(name, 0.0) for name in ("pressure", "start", "step"))
        if step > 0:
            yield replace(exactly("K", {(P, start + step / 2): e}, "at rest"), side=1, why=RUBS)
            cells.setdefault((P, start, e.at.get("speed", 0.0)), []).append(e)
    for (P, start, _), steps in cells.items():
        for one, two in pairwise(sorted(steps, key=lambda e: e.at["step"])):
            s_1, s_2 = one.at["step"], two.at["step"]
            found = weighted([(two, s_2 / (s_2 - s_1)), (one, -s_1 / (s_2 - s_1))], "K")
            rubbed = abs((one.value or 0.0) - (found.value or 0.0)) * s_1 / (s_2 - s_1)
            parts = replace(found.parts, method=hypot(found.parts.method or 0.0, UNTURNED * rubbed))
            yield exactly("K", {(P, start + (s_1 + s_2) / 2): replace(found, parts=parts)}, "steps of two sizes")
    for e in analysis.estimates:
        if (e.symbol, e.method) == ("F", RELAXED) and e.value is not None and e.at.get("step", 0.0) > 0:
            before = e.coordinate == "before"
            x = e.at.get("start", 0.0) + (0.0 if before else e.at["step"])
            words = f"after {'stretching' if before else 'contracting'}"
            yield replace(exactly("F", {(e.at["pressure"], x): e}, words), side=1 if before else -1, why=RUBS)
