"""The rests of an arm's staircase of pressure: one trial up and down under one load; grouped by load.

Creep slower than a hold shows within one hold only as a straight drift. All steps of a staircase together show how the
drift decays, and so its time constant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from pmabench.analysis.shared.calibration import HYSTERESIS, Scales
from pmabench.analysis.shared.samples import (
    Held,
    Left,
    NotUsable,
    ends,
    left,
    noise_of,
    refuse_incomplete,
    step_of,
    sticks,
    unresolved,
)
from pmabench.analysis.shared.student import ppf
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import Array, Command, RunData, TrialData

LAST = 0.2
"""Last share of each hold over which the mean is taken."""
LATER = 0.6
"""Last share of each hold that is tested for motion."""
FEWEST = 5
"""Fewest samples of a mean."""
UNUSABLE_SHARE = 0.5
FOLLOWS = 0.5
"""Share of the commanded change that the measured pressure must show between the rests [1]."""
MANY = 3
"""Fewest trials of which one can be found to differ from the others."""
SIGNIFICANT = 0.995
"""Probability of Student's t above which a drift is significant."""
SURE = 8.0
"""A trial that does not return counts as slipped from this many standard deviations of a rest's noise on."""
SOON, LATER_ON = 0.03, 0.3
"""Time after the first command before pressure rises, and after the last ramp until it is vented [s]."""
LIKE = 3.0
"""Angle and displacement have a zero difference where it exceeds this many times their rms difference."""
NEAR = np.radians(1.0)
"""Distance from the largest angle within which the curve counts as flat [rad]."""
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
    """Change of the angle over the last fifth of the hold [rad]."""
    noise: float
    """Standard deviation of the mean [rad]."""
    held: Held
    """The angle over the later part of the hold."""
    moved: float
    """Middle of the ramp before it [s]."""
    by: float
    """Change of the angle by that ramp [rad]."""
    since: float
    """Start of `held` [s]."""
    arc: float
    """Displacement divided by the radius [rad]; nan where either is unknown."""
    coarse: float
    """Possible error of the mean because the angle is read in steps [rad]."""


@dataclass(frozen=True, eq=False)
class Stair:
    """One trial."""

    trial: TrialData
    rests: tuple[Rest, ...]
    vented: tuple[float, ...]
    """Vented pressure before and after the trial [Pa], each moved towards 0 by its noise."""
    start: float
    """Angle before the first ramp, if that starts at 0 [rad]; else nan."""

    def column(self, sets: Sequence[float], side: int, of: str = "angle") -> Array:
        """Attribute `of` of the rests reached from one side, at the commanded pressures `sets`; nan where there is
        none.
        """
        values = {round(rest.set): float(getattr(rest, of)) for rest in self.rests if rest.side == side}
        return np.array([values.get(round(P), np.nan) for P in sets])


@dataclass(frozen=True, eq=False)
class Loaded:
    """One load and its trials."""

    mass: float
    """At the arm's end [kg]."""
    stairs: tuple[Stair, ...]
    sets: tuple[float, ...]
    """Commanded pressures that every trial has on its way up, ascending [Pa]."""
    scales: Scales
    radius: float
    """Distance from the arm's middle to the line of the displacement [m]; nan where unknown."""
    channel: str
    """Channel that gives the angle."""
    drift: float = 0.0
    """Change of the angle before the trials, from the first to the last of all loads [rad]; 0 where none is seen."""

    @property
    def per_offset(self) -> float:
        """Change of the angle per unit offset of its channel [rad per unit]."""
        return 1.0 / self.radius if self.channel == "displacement" else 1.0

    @cached_property
    def pressure(self) -> Array:
        """Measured pressure, mean of all rests at each commanded one [Pa]; shape (n,)."""
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
        """Mean of both branches and all trials [rad]; the way up alone where there is no other; shape (n,)."""
        there = np.isfinite(self.down)
        return np.asarray(np.where(there, 0.5 * (self.up + np.where(there, self.down, 0.0)), self.up).mean(axis=0))

    @cached_property
    def gaps(self) -> Array:
        """Angle on the way down minus angle on the way up [rad]; shape (trials, n)."""
        return self.down - self.up

    @property
    def widest(self) -> int | None:
        """Index of the largest gap between both branches; None if there is one branch only."""
        return int(np.argmax(np.abs(self.gaps[:, :-1].mean(axis=0)))) if self.both else None

    def motion(self, place: int, side: int) -> Left:
        """Change of the angle still to come at one pressure, reached from one side [rad]."""
        rests = [rest for stair in self.stairs for rest in stair.rests if rest.side == side]
        found = left([rest.held for rest in rests if round(rest.set) == round(self.sets[place])])
        slow = self.creep.get((side, round(self.sets[place])), 0.0)
        return replace(found, most=max(found.most, slow), seen=found.seen or slow > 0)

    @cached_property
    def creep(self) -> dict[tuple[int, int], float]:
        """(side, commanded pressure) -> change still to come by creep slower than a hold [rad]."""
        places = [(rest.side, round(rest.set)) for rest in self.stairs[0].rests]
        return dict(zip(places, still_to_come(self.stairs).tolist(), strict=False))

    @property
    def noise(self) -> float:
        """Largest standard deviation of a rest's mean [rad]."""
        return max(rest.noise for stair in self.stairs for rest in stair.rests)

    @property
    def coarse(self) -> float:
        """Largest error of a rest's mean because the angle is read in steps [rad]."""
        return max(rest.coarse for stair in self.stairs for rest in stair.rests)

    @cached_property
    def hysteresis(self) -> float:
        """How much more the angle sensor may read on the way down than on the way up [rad].

        A share `HYSTERESIS` of twice the uncertainty of its offset; all of that where the reading sticks.
        """
        most = 2 * self.scales.offsets.get(self.channel, 0.0) * abs(self.per_offset)
        readings = (stair.trial.channels[self.channel][stair.trial.usable] for stair in self.stairs)
        return most if most and any(map(sticks, readings)) else HYSTERESIS * most

    @cached_property
    def zero(self) -> float:
        """Smallest reading of the vented gauge [Pa] if all have one sign and it exceeds the calibration; else 0."""
        reads = [read for stair in self.stairs for read in stair.vented]
        least = min(reads, key=abs, default=0.0)
        alike = all(read * least > 0 for read in reads)
        return least if alike and abs(least) > self.scales.offsets.get("pressure", 0.0) else 0.0

    @property
    def zero_off(self) -> str:
        """Message that the vented gauge does not read 0. A reading above 0 may also be air left in the muscle."""
        text = f"with {self.mass:g} kg the pressure reads {show(self.zero, 'pressure', 2)} when it is vented, more than"
        other = "" if self.zero < 0 else ", or let out what the valve leaves in the muscle"
        return f"{text} its calibration allows: zero the gauge{other}"

    @cached_property
    def apart(self) -> float:
        """Zero difference of angle from displacement and measured angle beyond the calibrations [rad]; else 0."""
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
        """Largest difference between the trials in coming back to the preload [rad], and whether it is significant."""
        if not self.both or len(self.stairs) < MANY:
            return 0.0, False
        off = float(np.abs(self.gaps[:, 0] - np.median(self.gaps[:, 0])).max())
        return off, off > max(SURE * self.noise, 4 * self.coarse)  # noise of two rests, and of two of the other trials


def loads_of(runs: Sequence[RunData], settings: Mapping[str, Any]) -> tuple[list[Loaded], list[Dropped]]:
    """The loads, ascending, and the trials that cannot be used."""
    every, dropped = measured_trials(runs, lambda _, trial: measure(trial, settings))
    known = Scales.of(runs), float(settings.get("radius") or np.nan), channel_of(settings)
    groups = grouped(every, lambda stair: round(stair.trial.point["tip_mass"] * 1e6))
    found = []
    for _, stairs in sorted(groups.items()):
        on_the_way = [{round(rest.set): rest.set for rest in stair.rests if rest.side < 0} for stair in stairs]
        common = sorted(set.intersection(*(set(one) for one in on_the_way)))
        mass = float(stairs[0].trial.point["tip_mass"])
        if common:
            found.append(Loaded(mass, tuple(stairs), tuple(on_the_way[0][key] for key in common), *known))
        else:
            why = "no pressure is common to all trials with its load"
            dropped += [Dropped(stair.trial.name, stair.trial.point, why) for stair in stairs]
    drift = from_trial_to_trial([one.stairs for one in found])
    known_to = max((one.scales.offsets.get(one.channel, 0.0) * abs(one.per_offset) for one in found), default=0.0)
    return [replace(one, drift=drift if abs(drift) > known_to else 0.0) for one in found], dropped


def from_trial_to_trial(loads: Sequence[Sequence[Stair]]) -> float:
    """Change of the angle before the trials by a line in time, from the first trial of a run to its last [rad]; 0 where
    it is not significant.

    Trials are compared with those of the same load and run, whose sensor has one zero, and after a like wait: the load
    was changed before both or before neither. The first of each run is left out: the muscle was at rest before.
    """
    each = [(stair, n) for n, stairs in enumerate(loads) for stair in stairs]
    begins: dict[str, list[float]] = {}
    alike: dict[tuple[str, int, bool], list[tuple[float, float]]] = {}
    before = -1
    for stair, load in sorted(each, key=lambda one: (one[0].trial.run, one[0].trial.t[0])):
        run, begin = stair.trial.run, float(stair.trial.t[0])
        if run in begins and np.isfinite(stair.start):
            alike.setdefault((run, load, load != before), []).append((begin, stair.start))
        begins.setdefault(run, []).append(begin)
        before = load
    off, value = np.concatenate([np.zeros((0, 2)), *(np.array(one) - np.mean(one, axis=0) for one in alike.values())]).T
    free = len(off) - len(alike) - 1
    if free < MANY - 1 or not off.any():
        return 0.0
    slope = float(off @ value / (off @ off))
    error = float(np.sqrt(np.sum((value - slope * off) ** 2) / free / (off @ off)))
    whole = max(max(times) - min(times) for times in begins.values())
    return slope * whole if abs(slope) > float(ppf(SIGNIFICANT, free)) * error else 0.0


def channel_of(settings: Mapping[str, Any]) -> str:
    """Name of the channel that gives the angle."""
    return "displacement" if settings.get("angle") == "from-displacement" else "angle"


def measure(trial: TrialData, settings: Mapping[str, Any]) -> Stair:
    """The rests of one trial; raises `NotUsable`."""
    channel, radius = channel_of(settings), float(settings.get("radius") or np.nan)
    refuse_incomplete(trial, channel, "pressure")
    if "tip_mass" not in trial.point:
        raise NotUsable("its point names no load at the arm's end")
    if trial.point["tip_mass"] < 0:
        raise NotUsable("its point names a load below 0 at the arm's end")
    if channel == "displacement" and not radius > 0:
        raise NotUsable("the plan gives no radius for an angle from the displacement")
    P, arc = trial.channels["pressure"], trial.channels.get("displacement", np.full(trial.t.shape, np.nan)) / radius
    angle = arc if channel == "displacement" else trial.channels["angle"]
    good = trial.usable & np.isfinite(angle) & np.isfinite(P)
    if float(np.mean(~good)) > UNUSABLE_SHARE:
        raise NotUsable(f"{np.mean(~good):.0%} of the samples are flagged or missing")
    ramps = [c for c in trial.commands if c.output == "pressure" and c.kind == "ramp" and c.data.get("rate", 0.0) > 0]
    rests, step = list[Rest](), step_of(angle[good])
    start = float(angle[good & (trial.t <= max(ramps[0].t + SOON, trial.t[good][0]))].mean()) if ramps else np.nan
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
        middle, mean, since = len(last) // 2, float(angle[last].mean()), float(trial.t[later[0]])
        rests.append(
            Rest(
                set=float(ramp.value),
                side=side,
                pressure=float(P[last].mean()),
                angle=mean,
                drift=2 * float(angle[last[middle:]].mean() - angle[last[:middle]].mean()),
                noise=noise_of(angle[last]) / np.sqrt(max(1, middle)),
                held=Held.of(trial.t[later], angle[later], end - LAST * (end - begin) - since),
                moved=0.5 * (ramp.t + begin),
                by=mean - (rests[-1].angle if rests else start),
                since=since,
                arc=float(arc[last].mean()),
                coarse=unresolved(angle[last], step),
            )
        )
    if sum(rest.side < 0 for rest in rests) < 2:
        raise NotUsable(f"fewer than two rests of {FEWEST} samples on its way up")
    wanted, found = (np.ptp([getattr(rest, name) for rest in rests if rest.side < 0]) for name in ("set", "pressure"))
    if found < FOLLOWS * wanted:
        moved = f"{show(float(found), 'pressure', 3)} of the {show(float(wanted), 'pressure', 3)} that were commanded"
        raise NotUsable(f"over the rests on its way up the measured pressure moves by {moved}: a dead or wrong channel")
    begins_at_0 = bool(ramps) and ramps[0].before == 0 and ramps[0].recorded
    return Stair(trial, tuple(rests), _vented(trial, ramps, good), start if begins_at_0 else np.nan)


def _vented(trial: TrialData, ramps: Sequence[Command], good: NDArray[np.bool_]) -> tuple[float, ...]:
    """Mean pressure before the first ramp acts and after the last, if they start or end at 0 [Pa], moved towards 0 by
    noise.
    """
    P, parts = trial.channels["pressure"], []
    if ramps and ramps[0].before == 0 and ramps[0].recorded:
        parts.append(good & (trial.t <= ramps[0].t + SOON))
    if ramps and ramps[-1].value == 0 and ramps[-1].recorded:
        parts.append(good & (trial.t >= ends(ramps[-1]) + LATER_ON))
    noise = noise_of(P[good])
    means = [(float(P[part].mean()), LIKE * noise / float(np.sqrt(part.sum()))) for part in parts if part.any()]
    return tuple(float(np.sign(mean)) * max(0.0, abs(mean) - may) for mean, may in means)


TIMES = np.geomspace(0.3, 120.0, 19)
"""Time constants of creep that are tried, in units of the evaluated part of a hold."""
LONGEST = 1e3
"""Longest time constant of creep that is even over the logarithm of time [s]."""
SLOW = 4.0
"""Longer time constants, in the same units, do not show within one hold (`samples.TIMES`)."""
MORE = 1.3
"""Factor on the change still to come: creep is not exponential and lasts longer than the fit says."""


def still_to_come(stairs: Sequence[Stair]) -> Array:
    """Change still to come by slow creep at each rest [rad], mean of equal staircases; 0 where none is significant.

    Fitted: a share of each step creeps with one time constant, or with all time constants equally over log time up to
    `LONGEST`; creep left from before the first step decays in the same way.
    """
    each = [rest for stair in stairs for rest in stair.rests]
    rests = len(each) // len(stairs)
    if rests < 4 or any(len(stair.rests) != rests for stair in stairs):
        return np.zeros(rests)
    length = float(np.mean([rest.held.t[-1] for rest in each]))
    drifts = np.array([_drift(rest.held.y) for rest in each])

    def fitted(times: Array) -> tuple[float, float, float, float, Array]:
        """Residual sum of squares, largest time constant [s], share of each step and its standard error, change to
        come.
        """
        pairs = [_dying_away(stair.rests[: n + 1], times) for stair in stairs for n in range(rests)]
        columns, to_come = (np.array(column) for column in zip(*pairs, strict=True))
        found, *_ = np.linalg.lstsq(columns, drifts, rcond=None)
        cost = float(np.sum((drifts - columns @ found) ** 2))
        error = float(np.sqrt(cost / (len(drifts) - 2) * np.linalg.pinv(columns.T @ columns)[0, 0]))
        return cost, float(times[-1]), float(found[0]), error, to_come @ found

    tried = [*(length * TIMES[:, None]), np.geomspace(TIMES[0] * length, LONGEST, len(TIMES))]
    cost, time, share, error, far = min(map(fitted, tried), key=lambda one: one[0])
    if time < SLOW * length or share < SURE * error or cost <= 0:
        return np.zeros(rests)
    return np.asarray(MORE * np.abs(far.reshape(-1, rests).mean(axis=0)))


def _dying_away(rests: Sequence[Rest], times: Array) -> tuple[list[float], Array]:
    """Regressors of creep of all steps together, and of creep left from before: drift in the last of `rests` [rad],
    shape (2,), and the change to come after it, shape (2,).
    """
    at, by = (np.array([getattr(rest, name) for rest in rests]) for name in ("moved", "by"))
    held = rests[-1].held
    open_ = np.exp(-(rests[-1].since + held.t[:, None] - at) / times[:, None, None]).mean(axis=0)
    still = np.column_stack([open_ @ by, open_[:, 0]])
    return [-_drift(column) for column in still.T], still[held.late > 0].mean(axis=0)


def _drift(y: Array) -> float:
    """Mean of the later half minus mean of the earlier half."""
    half = len(y) // 2
    return float(y[half:].mean() - y[:half].mean())


def flat_from(P: Array, angle: Array) -> float | None:
    """Highest pressure [Pa] at which `angle` [rad] is `NEAR` below its last and largest value; None if it never is, or
    where the measured pressure does not rise. By monotone cubics.
    """
    low = np.flatnonzero(angle < angle[-1] - NEAR)
    if not len(low) or not (np.diff(P) > 0).all():
        return None
    above = PchipInterpolator(P, angle - (angle[-1] - NEAR))
    return float(brentq(lambda at: float(above(at)), P[low[-1]], P[low[-1] + 1]))
