"""The rests of an arm's staircase of pressure: one trial up and down under one load; grouped by load.

And what departures do to its angles: no rest at the end of a hold, a cable that slips, a zero that is off as far as the
record shows it, an angle read in steps, another curve than the form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.samples import Held, Left, NotUsable, ends, left, noise_of, refuse_incomplete, step_of
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.base.quantities import show
from pmabench.kinds.arm_angle.creep import Step, still_to_come
from pmabench.store.analyses.results import Dropped, Estimate, withhold
from pmabench.store.records import Array, Command, RunData, TrialData

LAST = 0.2
"""Share of each rest at its end whose mean counts."""
LATER = 0.6
"""Share of it that shows whether it is a rest."""
FEWEST = 5
"""Samples that it needs."""
UNUSABLE_SHARE = 0.5
FOLLOWS = 0.5
"""Share of the commanded change that the measured pressure must show between the rests [1]."""
MANY = 3
"""Trials of which one can be known from the others."""
SURE = 8.0
"""Standard deviations of the noise of a rest from which on a trial that does not come back is seen."""
SOON, LATER_ON = 0.03, 0.3
"""So long after the first command no pressure is there yet, and so long after the last ramp it is gone [s]."""
LIKE = 3.0
"""Two sensors differ by a zero where that is so many times what else they differ by (root mean square)."""
PHASES = {"preload": -1, "up": -1, "down": 1}
"""Phase of a ramp -> the side from which its pressure is reached: -1 from below."""


@dataclass(frozen=True)
class Rest:
    """One pressure of one trial, at rest."""

    set: float
    """Commanded [Pa]."""
    side: int
    pressure: float
    """[Pa]."""
    angle: float
    """[rad]."""
    drift: float
    """What the angle still changes by over the last fifth of the hold [rad]."""
    noise: float
    """Of the mean [rad]."""
    held: Held
    """The angle over the later part of the hold."""
    moved: float
    """Middle of the ramp before it [s]."""
    since: float
    """Begin of `held` [s]."""
    arc: float
    """Contraction of the bending muscle by the radius [rad]; nan where one of them is not known."""
    coarse: float
    """What the steps in which the angle is read leave open of the mean [rad]."""


@dataclass(frozen=True, eq=False)
class Stair:
    """One trial."""

    run: RunData
    trial: TrialData
    rests: tuple[Rest, ...]
    vented: tuple[float, ...]
    """What the pressure reads before and after the trial, without pressure [Pa]; each as near to 0 as noise lets it."""
    start: float
    """Angle before the first ramp [rad]."""

    def column(self, sets: Sequence[float], side: int, of: str = "angle") -> Array:
        """`of` the rests that were reached from one side, at the commanded pressures; nan where there is none."""
        values = {round(rest.set): float(getattr(rest, of)) for rest in self.rests if rest.side == side}
        return np.array([values.get(round(P), np.nan) for P in sets])


@dataclass(frozen=True, eq=False)
class Loaded:
    """One load and its trials."""

    mass: float
    """At the arm's end [kg]."""
    stairs: tuple[Stair, ...]
    sets: tuple[float, ...]
    """Commanded pressures that every trial has on its way up, rising [Pa]."""
    scales: Scales
    radius: float
    """From the arm's middle to where the displacement is measured [m]; nan where it is not known."""

    @cached_property
    def pressure(self) -> Array:
        """Measured, the mean of all rests at each [Pa]; shape (n,)."""
        each = [stair.column(self.sets, side, "pressure") for side in (-1, 1) for stair in self.stairs]
        return np.asarray(np.nanmean(each, axis=0))

    @cached_property
    def up(self) -> Array:
        """Angles reached from below [rad]; shape (trials, n)."""
        return np.array([stair.column(self.sets, -1) for stair in self.stairs])

    @cached_property
    def down(self) -> Array:
        """Angles reached from above [rad]; nan at the top, where it turns; shape (trials, n)."""
        return np.array([stair.column(self.sets, 1) for stair in self.stairs])

    @property
    def both(self) -> bool:
        """Whether every trial came down again."""
        return len(self.sets) > 1 and bool(np.isfinite(self.down[:, :-1]).all())

    @cached_property
    def mean(self) -> Array:
        """Mean of both ways and all trials [rad]; of the way up alone where there is no other; shape (n,)."""
        there = np.isfinite(self.down)
        return np.asarray(np.where(there, 0.5 * (self.up + np.where(there, self.down, 0.0)), self.up).mean(axis=0))

    @cached_property
    def gaps(self) -> Array:
        """From above less from below [rad]; shape (trials, n)."""
        return self.down - self.up

    @property
    def widest(self) -> int | None:
        """Where both ways are furthest apart; None where there is one way only."""
        return int(np.argmax(np.abs(self.gaps[:, :-1].mean(axis=0)))) if self.both else None

    def motion(self, place: int, side: int) -> Left:
        """What the angle would still change by at one pressure, reached from one side [rad]."""
        rests = [rest for stair in self.stairs for rest in stair.rests if rest.side == side]
        found = left([rest.held for rest in rests if round(rest.set) == round(self.sets[place])])
        slow = self.creep.get((side, round(self.sets[place])), 0.0)
        return replace(found, most=max(found.most, slow), seen=found.seen or slow > 0)

    @cached_property
    def creep(self) -> dict[tuple[int, int], float]:
        """Side and commanded pressure -> what creep that is slower than a hold still adds there [rad]."""
        steps = []
        for stair in self.stairs:
            before = (stair.start, *(rest.angle for rest in stair.rests))
            steps.append(
                [Step(r.moved, r.angle - b, r.since, r.held) for r, b in zip(stair.rests, before, strict=False)]
            )
        places = [(rest.side, round(rest.set)) for rest in self.stairs[0].rests]
        return dict(zip(places, still_to_come(steps).tolist(), strict=False))

    @property
    def noise(self) -> float:
        """Of the mean of a rest, the largest [rad]."""
        return max(rest.noise for stair in self.stairs for rest in stair.rests)

    @property
    def coarse(self) -> float:
        """What steps of the angle leave open of the mean of a rest, the largest [rad]."""
        return max(rest.coarse for stair in self.stairs for rest in stair.rests)

    @cached_property
    def zero(self) -> float:
        """What the pressure reads without pressure, beyond its calibration [Pa]: the least of all trials, else 0."""
        reads = [read for stair in self.stairs for read in stair.vented]
        least = min(reads, key=abs, default=0.0)
        alike = all(read * least > 0 for read in reads)
        return least if alike and abs(least) > self.scales.offsets.get("pressure", 0.0) else 0.0

    @cached_property
    def apart(self) -> float:
        """What the displacement tells more than the angle at all rests alike, beyond the calibrations [rad]; else 0."""
        angle, arc = np.array([(rest.angle, rest.arc) for stair in self.stairs for rest in stair.rests]).T
        if not np.isfinite(arc).all() or np.ptp(angle) <= 4 * self.coarse + LIKE * self.noise:
            return 0.0
        slope, zero = np.polyfit(angle, arc - angle, 1).tolist()
        rest = float(np.sqrt(np.mean((arc - angle - zero - slope * angle) ** 2)))
        offsets = self.scales.offsets
        known = np.hypot(offsets.get("angle", 0.0), offsets.get("displacement", 0.0) / self.radius)
        return zero if abs(zero) > max(float(known), LIKE * rest) else 0.0

    @cached_property
    def slip(self) -> tuple[float, bool]:
        """By how much more than the others a trial does not come back to the preload [rad], and whether it is seen."""
        if not self.both or len(self.stairs) < MANY:
            return 0.0, False
        off = float(np.abs(self.gaps[:, 0] - np.median(self.gaps[:, 0])).max())
        return off, off > max(SURE * self.noise, 4 * self.coarse)  # two rests, and two of the others


def loads_of(runs: Sequence[RunData], settings: Mapping[str, Any]) -> tuple[list[Loaded], list[Dropped]]:
    """The loads, rising, and the trials that cannot be used."""
    every, dropped = measured_trials(runs, lambda run, trial: measure(run, trial, settings))
    scales, radius = Scales.of(runs), float(settings.get("radius") or np.nan)
    groups = grouped(every, lambda stair: round(stair.trial.point["tip_mass"] * 1e6))
    found = []
    for _, stairs in sorted(groups.items()):
        on_the_way = [{round(rest.set): rest.set for rest in stair.rests if rest.side < 0} for stair in stairs]
        common = sorted(set.intersection(*(set(one) for one in on_the_way)))
        mass = float(stairs[0].trial.point["tip_mass"])
        if common:
            found.append(Loaded(mass, tuple(stairs), tuple(on_the_way[0][key] for key in common), scales, radius))
        else:
            why = "no pressure is common to all trials with its load"
            dropped += [Dropped(stair.trial.name, stair.trial.point, why) for stair in stairs]
    return found, dropped


def measure(run: RunData, trial: TrialData, settings: Mapping[str, Any]) -> Stair:
    """One trial: what it shows at each pressure; raises `NotUsable`."""
    by_arc, radius = settings.get("angle") == "from-displacement", float(settings.get("radius") or np.nan)
    channel = "displacement" if by_arc else "angle"
    refuse_incomplete(trial, channel, "pressure")
    if "tip_mass" not in trial.point:
        raise NotUsable("its point names no load at the arm's end")
    if by_arc and not radius > 0:
        raise NotUsable("the plan tells no radius for an angle from the displacement")
    P, arc = trial.channels["pressure"], trial.channels.get("displacement", np.full(trial.t.shape, np.nan)) / radius
    angle = arc if by_arc else trial.channels["angle"]
    good = trial.usable & np.isfinite(angle) & np.isfinite(P)
    if float(np.mean(~good)) > UNUSABLE_SHARE:
        raise NotUsable(f"{np.mean(~good):.0%} of the samples are flagged or missing")
    ramps = [c for c in trial.commands if c.output == "pressure" and c.kind == "ramp" and c.data.get("rate", 0.0) > 0]
    rests, step = [], step_of(angle[good])
    for n, ramp in enumerate(ramps):
        side = PHASES.get(ramp.phase)
        if side is None:
            continue
        begin, end = ends(ramp), ramps[n + 1].t if n + 1 < len(ramps) else float(trial.t[-1])
        last, later = (
            np.flatnonzero(good & (trial.t >= end - share * (end - begin)) & (trial.t < end - 1e-9))
            for share in (LAST, LATER)
        )
        if len(last) < FEWEST:
            continue
        middle = len(last) // 2
        rests.append(
            Rest(
                set=float(ramp.value),
                side=side,
                pressure=float(P[last].mean()),
                angle=float(angle[last].mean()),
                drift=2 * float(angle[last[middle:]].mean() - angle[last[:middle]].mean()),
                noise=noise_of(angle[last]) / np.sqrt(max(1, middle)),
                held=Held.of(trial.t[later], angle[later], end - LAST * (end - begin) - float(trial.t[later[0]])),
                moved=0.5 * (ramp.t + begin),
                since=float(trial.t[later[0]]),
                arc=float(arc[last].mean()),
                coarse=_coarse(angle[last], step),
            )
        )
    if sum(rest.side < 0 for rest in rests) < 2:
        raise NotUsable(f"fewer than two rests of {FEWEST} samples on its way up")
    wanted, found = (np.ptp([getattr(rest, name) for rest in rests if rest.side < 0]) for name in ("set", "pressure"))
    if found < FOLLOWS * wanted:
        moved = f"{show(float(found), 'pressure', 3)} of the {show(float(wanted), 'pressure', 3)} that were commanded"
        raise NotUsable(f"over the rests on its way up the measured pressure moves by {moved}: a dead or wrong channel")
    start = float(angle[good & (trial.t <= max(ramps[0].t + SOON, trial.t[good][0]))].mean())
    return Stair(run, trial, tuple(rests), _vented(trial, ramps, good), start)


def _coarse(angle: Array, step: float) -> float:
    """By how much the mean of samples read in steps may be off [rad]: half a step, less what noise averages out.

    Of noise with a standard deviation of s steps exp(-2 pi^2 s^2) is left, the first harmonic of rounding (Widrow).
    """
    if not 0 < step < np.inf:
        return 0.0
    noise = max(0.0, float(np.var(angle)) / step**2 - 1 / 12)
    return 0.5 * step * float(np.exp(-2 * np.pi**2 * noise))


def _vented(trial: TrialData, ramps: Sequence[Command], good: NDArray[np.bool_]) -> tuple[float, ...]:
    """Mean pressure before the first ramp acts and after the last one, where they come from 0 and go there [Pa]."""
    P, parts = trial.channels["pressure"], []
    if ramps and ramps[0].before == 0 and ramps[0].recorded:
        parts.append(good & (trial.t <= ramps[0].t + SOON))
    if ramps and ramps[-1].value == 0 and ramps[-1].recorded:
        parts.append(good & (trial.t >= ends(ramps[-1]) + LATER_ON))
    noise = noise_of(P[good])
    means = [(float(P[part].mean()), LIKE * noise / float(np.sqrt(part.sum()))) for part in parts if part.any()]
    return tuple(float(np.sign(mean)) * max(0.0, abs(mean) - may) for mean, may in means)


LATE = 0.25
"""Share of the gap of both ways above which what is left of a motion is not left to its interval."""
OFF = 3.0
"""Errors of a mean angle by which the form may miss it (root mean square)."""
POWERS = 5
"""Of the load, from 0 on: so many loads can be fitted exactly, and more than that say whether the powers hold."""
LEAST = 0.003
"""Share of the largest angle below which a miss says nothing against the form."""


def _moving(one: Loaded, place: int, side: int) -> tuple[Left, str]:
    found = one.motion(place, side)
    where = f"{show(one.sets[place], 'pressure')}, {one.mass:g} kg"
    text = f"the angle is not at rest: after the hold it may still change by {show(found.most, 'angle', 2)} ({where})"
    return found, f"{text}. Hold longer"


def _slips(one: Loaded, share: float = 1.0) -> Doubt:
    size, seen = one.slip
    text = f"with {one.mass:g} kg one trial comes back to the preload {show(size, 'angle', 2)} off the others"
    reason = f"{text}: a cable or a mount slips. Fasten it, and do the load again"
    return Doubt("slip", "drift", share * size if seen else 0.0, seen, reason)


def zero_off(one: Loaded) -> str:
    """What the pressure shows without pressure, in words. Less than none is no pressure, and more may be some."""
    text = f"with {one.mass:g} kg the pressure reads {show(one.zero, 'pressure', 2)} when it is vented, more than its"
    other = "" if one.zero < 0 else ", or let out what the valve leaves in the muscle"
    return f"{text} calibration allows: zero the gauge{other}"


def _zero(one: Loaded, slope: float) -> Doubt:
    """Of a value that changes by `slope` for each pascal that the pressure reads more."""
    return Doubt("zero of the pressure", "calibration", abs(slope * one.zero), one.zero < 0, zero_off(one))


def _apart(one: Loaded, share: float = 1.0) -> Doubt:
    """Of a value that changes by `share` of what the angle reads more."""
    return Doubt("zero of the angle against the displacement", "calibration", abs(share * one.apart), seen=False)


def _of_sensors(loads: Sequence[Loaded], slope: float, steps: float, share: float) -> list[Doubt]:
    """Of a coefficient: what the zeros of any load may do, and the steps of the angle."""
    worst, farthest = max(loads, key=lambda one: abs(one.zero)), max(loads, key=lambda one: abs(one.apart))
    return [_zero(worst, slope), _apart(farthest, share), _steps(steps)]


def _steps(half: float) -> Doubt:
    return Doubt("steps of the angle", "method", half, seen=False)


def at_rest(one: Loaded, place: int, slope: float) -> list[Doubt]:
    """Of an angle on the way up, which changes by `slope` with the pressure [rad/Pa]."""
    further, reason = _moving(one, place, -1)
    moving = Doubt("motion after the hold", "method", further.most, further.seen, reason)
    return [moving, _slips(one), _zero(one, slope), _apart(one), _steps(one.coarse)]


def of_gap(one: Loaded, place: int, value: float) -> list[Doubt]:
    """Of the gap of both ways: what is left of the motions closes it."""
    found = [_moving(one, place, side) for side in (-1, 1)]
    half, seen = sum(further.most for further, _ in found), any(further.seen for further, _ in found)
    reason = next((text for further, text in found if further.seen), "")
    slip = _slips(one, 1 / len(one.stairs))
    doubts = [Doubt("motion after the hold", "method", half, seen, reason), slip, _steps(2**0.5 * one.coarse)]
    return [one if one.half > LATE * abs(value) else replace(one, reason="") for one in doubts]


def of_flat(one: Loaded, top: int, value: float, flat_from: Callable[[Array, Array], float | None]) -> list[Doubt]:
    """Of the pressure from which on the angle stays: what the largest angle would still change by moves it."""
    further, reason = _moving(one, top, -1)
    P, angles = one.pressure[: top + 1], one.up.mean(axis=0)[: top + 1]

    def by(more: float) -> float:
        moved = [flat_from(P, np.append(angles[:-1], angles[-1] + way * more)) for way in (-1, 1)]
        return max((abs(other - value) for other in moved if other is not None), default=0.0)

    moving = Doubt("motion after the hold", "method", by(further.most), further.seen, reason)
    return [moving, _zero(one, 1.0), _steps(by(2**0.5 * one.coarse))]


def of_fit(estimates: Sequence[Estimate], one: Loaded, start: Sequence[float], *, both: bool) -> list[Estimate]:
    """The coefficients of the form through one load: with the scatter of the trials, or withheld where it misses them.

    `start` are the values of the fit to the mean of the trials; `both`: through the mean of both ways.
    """
    turned = np.where(np.isfinite(one.down), one.down, one.up)
    rows = 0.5 * (one.up + turned) if both else one.up
    P, mean = one.pressure, rows.mean(axis=0)
    fitted = _fit(P, mean, start)
    each = np.array([_fit(P, row, fitted) for row in rows])
    motions = [one.motion(place, -1) for place in range(len(one.sets))]
    further = np.array([motion.most for motion in motions])
    tilts = np.ones(len(mean)), np.linspace(-1.0, 1.0, len(mean))
    moved = np.hypot(*(_fit(P, mean + tilt * further, fitted) - fitted for tilt in tilts))
    seen = any(motion.seen for motion in motions)
    miss = float(np.sqrt(np.sum((_curve(P, fitted) - mean) ** 2) / max(1, len(mean) - len(fitted))))
    error, slip, terms = _error(one, rows), _slips(one), fitted[:, None]
    shifts, steps = per_pascal([one], terms), one.coarse * np.linalg.norm(_solve([one], terms), axis=1)
    slipped = np.abs(_fit(P, mean + slip.half * np.linspace(0.0, 1.0, len(mean)), fitted) - fitted)
    why = ""
    if miss > OFF * error and miss > LEAST * float(np.abs(mean).max()):
        why = f"the angles lie {show(miss, 'angle', 2)} (rms) off this form, {miss / max(error, 1e-12):.0f} of their "
        why += "errors: it is another curve. Take the angles at rest"
    found = []
    for index, e in enumerate(estimates):
        if e.value is None or e.parts.repeats is None:
            found.append(e)
        elif why:
            found.append(withhold(e, why))
        else:
            doubts = [
                Doubt("motion after the hold", "method", float(moved[index]), seen),
                replace(slip, half=float(slipped[index]) + (slip.half if e.coordinate == "a" else 0.0)),
                *_of_sensors([one], float(shifts[index]), float(steps[index]), 1.0 if e.coordinate == "a" else 0.0),
            ]
            wider = replace(e.parts, repeats=max(e.parts.repeats, spread(each[:, index]) or 0.0))
            found.append(weighed(replace(e, parts=wider), doubts))
    return found


def of_loads(estimates: Sequence[Estimate], loads: Sequence[Loaded]) -> list[Estimate]:
    """The powers of the load, `estimates` by coordinate (`a_0` and so on), of the fit to the ways up of these `loads`:
    with the scatter of the trials and what motions and slips could do, or withheld where angles lie off the form.

    To first order: a change of the angles is taken through the linearized least squares.
    """
    known = {e.coordinate: e.value for e in estimates}
    terms = [[known[f"{name}_{n}"] for n in range(POWERS)] for name in "abcd"]
    if any(value is None for row in terms for value in row):
        return list(estimates)
    solve = _solve(loads, np.array(terms, dtype=np.float64))
    parts = np.split(solve, np.cumsum([len(one.sets) for one in loads])[:-1], axis=1)
    off = [one.up.mean(axis=0) - _curve(one.pressure, _at(one, np.array(terms))) for one in loads]
    freedom = sum(map(len, off)) - solve.shape[0]
    miss = float(np.sqrt(sum(float(row @ row) for row in off) / max(1, freedom)))
    error = float(np.sqrt(np.mean([_error(one, one.up) ** 2 for one in loads])))
    if len(loads) > POWERS and miss > max(OFF * error, LEAST * max(float(np.abs(one.mean).max()) for one in loads)):
        text = f"the angles of all loads lie {show(miss, 'angle', 2)} (rms) off the powers of the load"
        reason = f"{text}, {miss / max(error, 1e-12):.0f} of their errors: take the coefficients of each load"
        return [e if e.value is None else withhold(e, reason) for e in estimates]
    several = [(part, one.up) for part, one in zip(parts, loads, strict=True) if len(one.up) > 1]
    scatter = [np.var(part @ up.T, axis=1, ddof=1) / len(up) for part, up in several]
    few = sum(len(one.up) - 1 for one in loads)
    repeats = student.ppf(0.975, few) * np.sqrt(np.sum(scatter, axis=0)) if scatter else np.zeros(len(solve))
    motions = [[one.motion(place, -1) for place in range(len(one.sets))] for one in loads]
    further = [part @ [motion.most for motion in row] for part, row in zip(parts, motions, strict=True)]
    slipped = [_slips(one).half * part.sum(axis=1) for part, one in zip(parts, loads, strict=True)]
    seen = any(motion.seen for row in motions for motion in row)
    found = []
    moved, slip = np.hypot.reduce(further).tolist(), np.hypot.reduce(slipped).tolist()
    shifts = per_pascal(loads, np.array(terms, dtype=np.float64)).tolist()
    steps = np.hypot.reduce([one.coarse * np.linalg.norm(part, axis=1) for part, one in zip(parts, loads, strict=True)])
    rows = zip(estimates, repeats.tolist(), moved, slip, shifts, steps.tolist(), strict=True)
    for e, half, by_motion, by_slip, shift, by_steps in rows:
        wider = replace(e.parts, repeats=max(e.parts.repeats or 0.0, half))
        doubts = [Doubt("motion after the hold", "method", by_motion, seen), Doubt("slip", "drift", by_slip, True)]
        doubts += _of_sensors(loads, shift, by_steps, 1.0 if e.coordinate == "a_0" else 0.0)
        found.append(weighed(replace(e, parts=wider), doubts))
    return found


def per_pascal(loads: Sequence[Loaded], terms: Array) -> Array:
    """Change of all coefficients, shape (4 powers,), where the pressure reads 1 Pa more; `terms` as in `_at`."""
    bends = []
    for one in loads:
        *_, d = _at(one, terms)
        P, _, bent = _bent(one, terms)
        bends.append(bent * d / P)
    return np.asarray(_solve(loads, terms) @ np.concatenate(bends))


def _bent(one: Loaded, terms: Array) -> tuple[Array, Array, Array]:
    """The pressures [Pa], at them (p/c)^d, and b (p/c)^d / (1 + (p/c)^d)^2."""
    _, b, c, d = _at(one, terms)
    P = np.maximum(one.pressure, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):  # a form far from these angles may have infinite powers
        share = (P / abs(c)) ** d
        return P, share, np.nan_to_num(b * share / (1 + share) ** 2)


def _solve(loads: Sequence[Loaded], terms: Array) -> Array:
    """Change of all coefficients with each angle, shape (4 powers, angles), by linearized least squares."""
    slopes = np.vstack([_slopes(one, terms) for one in loads])
    size = np.sqrt(np.sum(slopes**2, axis=0))
    scale = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.pinv(slopes / scale, rcond=1e-12) / scale[:, None])


def _at(one: Loaded, terms: Array) -> Array:
    """a, b, c, d at a load by their powers, shape (4, powers)."""
    return np.asarray(terms @ one.mass ** np.arange(terms.shape[1]))


def _slopes(one: Loaded, terms: Array) -> Array:
    """Derivatives of the angles at a load by all powers, shape (pressures, 4 powers)."""
    _, _, c, d = _at(one, terms)
    P, share, bent = _bent(one, terms)
    each = np.column_stack([np.ones(len(P)), 1 / (1 + share), bent * d / c, -bent * np.log(P / abs(c))])
    return np.asarray((each[:, :, None] * one.mass ** np.arange(terms.shape[1])).reshape(len(P), -1))


def _error(one: Loaded, rows: Array) -> float:
    """Standard error of a mean angle of like rests [rad], without what a trial is off as a whole; shape (trials, n)."""
    within = np.sqrt(np.mean(np.var(rows - rows.mean(axis=1, keepdims=True), axis=0, ddof=min(1, len(rows) - 1))))
    return max(float(within), one.noise) / float(np.sqrt(len(rows)))


def _curve(P: Array, terms: Array) -> Array:
    """Angle [rad] of the form of paper 2."""
    a, b, c, d = terms
    with np.errstate(over="ignore"):  # far from the solution a power may be infinite, and its term is then 0
        return np.asarray(a + b / (1 + (np.maximum(P, 0.0) / abs(c)) ** d))


def _fit(P: Array, angles: Array, start: Sequence[float] | Array) -> Array:
    """Coefficients a, b, c, d by least squares from those near by."""
    begin = np.array(start, dtype=np.float64)

    def miss(share: Array) -> Array:
        return np.asarray(_curve(P, share * begin) - angles)

    solved = least_squares(miss, np.ones(len(begin)), method="lm")
    return np.asarray(solved.x * begin)
