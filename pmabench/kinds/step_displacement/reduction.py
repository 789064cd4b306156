"""Reduction of steps of displacement at constant pressure: static and instantaneous stiffness, the way back to rest.

Of one step: force before, at its peak and relaxed, and how force and pressure come back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import MOST_HIDDEN, Doubt, force_from_cycle_to_cycle, weighed
from pmabench.analysis.shared.lines import left_by, mean_of_cycles
from pmabench.analysis.shared.samples import (
    UNDECLARED,
    Held,
    NotUsable,
    ends,
    left,
    noise_of,
    on_time,
    refuse_unusable,
    settings_of,
)
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.analysis.verdict.agreement import Offer, exactly, values_of, weighted
from pmabench.base.quantities import show
from pmabench.kinds.step_displacement import RESULTS
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, Command, RunData, TrialData

LAST = 0.2
"""Share of each rest at its end whose mean counts as relaxed."""
SEEN = 6.0
"""A recovery counts where it is larger than so many standard deviations of the noise."""
THERE = 0.01
"""Share of the step by which the displacement may still be off when its motion counts as over."""
FEWEST = 8
"""Samples that a recovery needs within three time constants."""


@dataclass(frozen=True, eq=False)
class Recovery:
    """y = end + size exp(-t/tau) after the motion; size as y, tau [s]."""

    size: float
    tau: float
    apart: float
    """How far tau is from that of the later part of the way back, from half a time constant on, or from that of a
    fit with a drift [s]: a course that is no single exponential shows in it."""


@dataclass(frozen=True, eq=False)
class Relaxation:
    """One step, there or back. Forces [N], pressures [Pa]; above 0 it contracts."""

    moved: float
    """Measured displacement of the step [m]."""
    before: float
    peak: float
    relaxed: float
    earlier: Held
    """The force along the second half of the rest before [N]."""
    later: Held
    """The same of the rest after [N]."""
    blunted: float
    """What a filter of the force cell of `filter_of` would change the peak by [N]."""
    sampled: float
    """Change of the force over the sample before its peak [N]: so far the peak may lie beyond it."""
    pressure_peak: float
    """Largest difference of the pressure from that before; nan where it is not recorded."""
    pressure_noise: float
    """Of the pressure [Pa]: the largest difference is that of the noise where the pressure stays."""
    force_back: Recovery | None
    pressure_back: Recovery | None
    noise: float
    """Of the force [N]."""

    @property
    def static(self) -> float:
        """Stiffness from relaxed forces [N/m]."""
        return -(self.relaxed - self.before) / self.moved

    @property
    def instant(self) -> float:
        """Stiffness from the peak [N/m]: damping and pressure are in it."""
        return -(self.peak - self.before) / self.moved


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps of one trial, and the samples around the last step away from the start."""

    run: RunData
    trial: TrialData
    there: tuple[Relaxation, ...]
    back: tuple[Relaxation, ...]
    last: dict[str, Array]
    """`t` from the command on [s], `force`, `displacement`, `pressure` where it is recorded."""


def measure(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Steps:
    """One trial from its samples, without the cycles at its start that `options`, else the plan, `discard`.

    Raises `NotUsable` where it ended early, lacks a channel or a whole step.
    """
    refuse_unusable(trial, "displacement", "force")
    found: dict[str, list[Relaxation]] = {"step": [], "back": []}
    ramps = [c for c in trial.commands if c.output == "displacement" and c.kind == "ramp" and c.phase in found]
    if not ramps:
        raise NotUsable("it holds no step")
    ends = [*(c.t for c in ramps[1:]), float(trial.t[-1]) + 1e-9]
    begins = [float(trial.t[0]), *(c.t for c in ramps[:-1])]
    values = {name: on_time(run, trial, name) for name in ("displacement", "force", "pressure")}
    for ramp, begin, end in zip(ramps, begins, ends, strict=True):
        found[ramp.phase].append(_one(run, trial, values, ramp, begin, end))
    discard = int(settings_of(run, options).get("discard", 1))
    found = {phase: steps[discard:] for phase, steps in found.items()}
    if not found["step"] or not found["back"]:
        raise NotUsable("it holds no step there and back beyond those left out")
    place = max(i for i, ramp in enumerate(ramps) if ramp.phase == "step")
    rows = (trial.t >= ramps[place].t - 0.1 * (ends[place] - ramps[place].t)) & (trial.t < ends[place]) & trial.usable
    last = {name: column[rows] for name, column in values.items() if np.isfinite(column).all()}
    return Steps(run, trial, tuple(found["step"]), tuple(found["back"]), {"t": trial.t[rows] - ramps[place].t, **last})


def _one(
    run: RunData, trial: TrialData, values: dict[str, Array], ramp: Command, begin: float, end: float
) -> Relaxation:
    """The step of one command; `begin` and `end` [s] are those of the rests before and after it."""
    arrived = ends(ramp) if ramp.data.get("rate", 0.0) > 0 else ramp.t
    t, good = trial.t, trial.usable
    before = good & (t >= ramp.t - LAST * (ramp.t - begin)) & (t < ramp.t - 1e-9)
    after = good & (t >= end - LAST * (end - arrived)) & (t < end)
    moving = good & (t >= ramp.t) & (t < end)
    rest = good & (t > arrived + 1e-9) & (t < end)
    if min(before.sum(), after.sum()) < 3 or rest.sum() < 2 * FEWEST:
        raise NotUsable("fewer than 3 samples at the end of a rest")
    x, F, P = values["displacement"], values["force"], values["pressure"]
    level, relaxed = float(F[before].mean()), float(F[after].mean())
    moved = float(x[after].mean() - x[before].mean())
    if abs(moved) <= 6 * noise_of(x[rest]) or moved == 0:
        raise NotUsable("the displacement does not move above its noise")
    away = F[moving] - level
    place = int(np.argmax(-np.sign(moved) * away))
    early = good & (t >= 0.5 * (begin + ramp.t)) & (t < ramp.t - 1e-9)
    late = good & (t >= 0.5 * (arrived + end)) & (t < end)
    known = bool(np.isfinite(P).all())
    # the measured motion is over when it stays within `THERE` of its end; not before the command
    beyond = t[moving][np.abs(x[moving] - float(x[after].mean())) > THERE * abs(moved)]
    still = rest & (t > (max(float(beyond[-1]), arrived) if len(beyond) else arrived))
    if still.sum() < 2 * FEWEST:
        raise NotUsable("the displacement comes to rest too late")
    since = t[still] - t[still][0]
    off = P[moving] - float(P[before].mean())
    return Relaxation(
        moved=moved,
        before=level,
        peak=level + float(away[place]),
        relaxed=relaxed,
        earlier=Held.of(t[early], F[early], ramp.t - LAST * (ramp.t - begin)),
        later=Held.of(t[late], F[late], end - LAST * (end - arrived)),
        blunted=_blunted(t[moving], away, moved, filter_of(run)),
        sampled=abs(float(away[place] - away[max(0, place - 1)])),
        pressure_peak=float(off[np.argmax(np.abs(off))]) if known else float("nan"),
        pressure_noise=noise_of(P[moving]) if known else 0.0,
        force_back=recovery(since, F[still]),
        pressure_back=recovery(since, P[still]) if known else None,
        noise=noise_of(F[rest]),
    )


def filter_of(run: RunData) -> float:
    """Time constant of the force cell's filter [s], as declared, or what one may have where none is."""
    declared = run.channels["force"].sensor_lag if "force" in run.channels else 0.0
    return declared if declared > 0 else UNDECLARED


def _blunted(t: Array, away: Array, moved: float, constant: float) -> float:
    """How much lower the peak is once more behind a filter of first order, shape (n,) both."""
    keep = float(np.exp(-np.median(np.diff(t)) / constant))
    slower = np.asarray(lfilter([1 - keep], [1, -keep], away - away[0]) + away[0])
    way = -np.sign(moved)
    return abs(float(np.max(way * away) - np.max(way * slower)))


def recovery(t: Array, y: Array) -> Recovery | None:
    """The exponential by which `y` comes to rest, from `t` = 0 [s] on; None where none shows above the noise."""
    tau, inside = _time_constant(t, y)
    design = np.column_stack([np.ones_like(t), np.exp(-t / tau)])
    terms, *_ = np.linalg.lstsq(design, y, rcond=None)
    size, left = float(terms[1]), float(np.mean((y - design @ terms) ** 2))
    if not inside or np.count_nonzero(t < 3 * tau) < FEWEST:
        return None
    if abs(size) < max(SEEN * noise_of(y), 3 * left**0.5, 1e-6 * float(np.max(np.abs(y)))):
        return None
    late = t >= 0.5 * tau
    others = [_time_constant(t, y, 1)[0]]
    if late.sum() > FEWEST:
        others.append(_time_constant(t[late] - t[late][0], y[late])[0])
    return Recovery(size, tau, max(abs(other - tau) for other in others))


def _time_constant(t: Array, y: Array, order: int = 0) -> tuple[float, bool]:
    """The time constant that leaves least [s], and whether it is within the range that is looked at."""
    step = float(np.median(np.diff(t)))
    grid = np.log(np.geomspace(step, 0.5 * float(t[-1]), 30))
    fixed = np.stack([np.ones_like(t), *[t] * order])

    def left(logarithms: Array) -> Array:
        return left_by(fixed, np.exp(-t / np.exp(logarithms)[:, None])[:, None], y) / len(t)

    best = int(np.argmin(left(grid)))
    low, high = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    found = minimize_scalar(
        lambda s: left(np.array([s]))[0], bounds=(low, high), method="bounded", options={"xatol": 1e-5}
    )
    return float(np.exp(found.x)), best not in (0, len(grid) - 1)


def stiffness_of(run: RunData, trial: TrialData) -> float:
    """Stiffness of one trial's steps away from the start, by relaxed forces [N/m]; raises `NotUsable`."""
    return float(np.mean([step.static for step in measure(run, trial, {}).there]))


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
"""Share of the rise to a peak above which what a filter may have taken off it is not left to its interval."""
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
        findings += _findings(group)
        traces.append(_trace(at, group[0]))
    if estimates and (lack := scales.lack(("force", "displacement"))):
        findings.append(Finding("note", lack))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=sorted(estimates, key=lambda e: (RELAXED, PEAK, BACK).index(e.method)),
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
    of_peak = (both[0], replace(blunt, half=blunt.half / moved, most=BLUNT))
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
    peak, before = (float(np.mean([getattr(one, name) for one in every])) for name in ("peak", "before"))
    most = BLUNT * abs(peak - before) / max(abs(peak), 1e-9)
    return Doubt("filter of the force cell", "method", half, True, reason, most)


def _still_moving(rests: Sequence[Held]) -> Doubt:
    """What motion of the force at the end of the rests is worth [N]."""
    further = left(rests)
    text = f"the force is not at rest: after the hold it may still change by {show(further.most, 'force', 2)}"
    return Doubt("motion of the force after the rest", "method", further.most, further.seen, f"{text}. Hold longer")


def _findings(group: Sequence[Steps]) -> Iterator[Finding]:
    """What catches the eye."""
    for member in group:
        where = f"trial {member.trial.name}"
        for steps in (member.there, member.back):
            further, size = left([one.later for one in steps]), abs(steps[0].relaxed - steps[0].before)
            if further.seen and abs(further.size) > DRIFTS * size:
                text = f"{where}: after a rest the force would still change by {show(further.size, 'force', 2)}"
                yield Finding("doubt", f"{text}; K is not static yet, hold longer")
        if any(one.static <= 0 for one in (*member.there, *member.back)):
            text = f"{where}: the force rises with contraction: a sign is wrong, or the step is lost"
            yield Finding("fault", text)


def _trace(at: Mapping[str, float], member: Steps) -> Trace:
    """Around the last step away from the start."""
    stride, step = max(1, -(-len(member.last["t"]) // LONGEST_TRACE)), member.there[-1]
    kinds = {"pressure": "pressure", "step": "length", "speed": "speed"}
    places = ", ".join(show(at[name], quantity) for name, quantity in kinds.items() if name in at)
    return Trace(
        "step-" + "-".join(f"{value:g}" for value in at.values()),
        "displacement-step",
        f"{places}: step of displacement",
        {name: values[::stride] for name, values in member.last.items()},
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
