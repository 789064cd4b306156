"""One trial of isometric torques: its rests, its turns, and what its record shows against them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.joint import AXES, CUT, MUSCLES, Kept, flank, why_no_turns
from pmabench.analysis.shared.ramp_loop import Turns, on_grid, turns_of
from pmabench.analysis.shared.samples import (
    Held,
    NotUsable,
    ends,
    noise_of,
    on_time,
    refuse_unusable,
    settings_of,
    step_of,
)
from pmabench.base.quantities import show
from pmabench.store.records import Array, Command, RunData, TrialData

POINTS = 81
"""Points of the gap for the decay after a turn."""
FEWEST_ANGLES = 7
"""Angles that a stiffness needs: its slope is that of a polynomial of order 5."""
ORDERS = 5, 3
"""Order of the polynomial of torque over angle, and of another one that shows the effect of this choice."""
UNEVEN = 0.25
"""Largest change of the gap over the angles, relative to its median, if both muscles are taut at all of them."""
LEAST_SAMPLES = 10
DITHERED = 0.5
"""Noise, in steps of a channel, above which the steps average out."""
ELSEWHERE, ASIDE = 0.25, 0.02
"""Deviation of the joint from its place, as a share of the distance between angles: largest, and from which on it is
reported.
"""
SKIPPED = 0.25
"""First share of a rest in which regulators and muscles settle; after it the torque should be constant."""


@dataclass(frozen=True, eq=False)
class Rests:
    """Means over the later half of each rest; arrays of shape (cycles, 2, n), rising first."""

    angles: Array
    """[rad]."""
    torques: Array
    """[N m]."""
    pressures: Array
    """[Pa], shape (2, cycles, 2, n)."""
    holds: tuple[list[Held], list[Held]]
    """Torque along each rest, rising and falling [N m]."""
    noise: float
    """Standard deviation of a mean torque [N m]."""
    step: float
    """Step of the torque channel if noise does not average it out [N m]; else 0."""


@dataclass(frozen=True)
class AfterTurns:
    """The gap after a turn, over the way since then [N m]: open - size exp(-way/w)."""

    size: float
    """[N m]."""
    w: float
    """[rad]."""
    play: float
    """Way without change of the torque [rad]; negative if it changes abruptly at the turn."""


@dataclass(frozen=True, eq=False)
class Staircase:
    """One usable trial; angles [rad] of shape (n,), torques [N m] of shape (cycles, n)."""

    run: RunData
    trial: TrialData
    nominal: Array
    """Commanded angles."""
    rests: Rests
    turns: Turns | None
    open: NDArray[np.bool_]
    """True where both turns are far enough away."""
    after: AfterTurns | None
    """None without turns."""
    flank: float
    """Step of the torque at its change of sign, because of backlash [N m]; 0 if not significant."""

    @cached_property
    def angles(self) -> Array:
        """Measured angles: means of all cycles."""
        return np.asarray(self.rests.angles.mean(axis=(0, 1)))

    @cached_property
    def gap(self) -> Array:
        """Torque while falling minus torque while rising [N m], shape (cycles, n)."""
        return np.asarray(self.rests.torques[:, 1] - self.rests.torques[:, 0])

    @cached_property
    def left(self) -> Array:
        """Remainder of the turns in the mean of both sides [N m], shape (n,)."""
        return np.zeros_like(self.angles) if self.turns is None else self.turns.of_mean(self.angles)

    @property
    def apart(self) -> Array:
        """Angle when it was reached from above minus that from below [rad], shape (n,)."""
        return np.asarray(np.diff(self.rests.angles.mean(axis=0), axis=0)[0])

    @cached_property
    def kept(self) -> Kept:
        """Deviation of pressures and angles of the rests from their commands; of each pressure the largest."""
        scale, zero = np.polyfit(self.nominal, self.angles - self.nominal, 1)
        off = self.rests.pressures.reshape(2, -1) - [[self.trial.point[name]] for name in MUSCLES]
        return Kept(off[[0, 1], np.argmax(np.abs(off), axis=1)], float(zero), float(scale))

    @cached_property
    def mean(self) -> Array:
        """Torque without hysteresis [N m], shape (cycles, n)."""
        return np.asarray(self.rests.torques.mean(axis=1) - self.left)

    @cached_property
    def why_no_stiffness(self) -> str:
        """Reason why there is no slope of torque over angle; else empty."""
        if self.open.sum() < FEWEST_ANGLES:
            return f"{self.open.sum()} angles are far enough from the turns, and a slope needs {FEWEST_ANGLES}"
        return self.slack

    @cached_property
    def slack(self) -> str:
        """Sign of a slack muscle in the gap; empty if there is none.

        A muscle that pulls in one direction only makes a smaller gap, and the mean then contains hysteresis.
        """
        gap = self.gap.mean(axis=0)[self.open]
        if np.ptp(gap) > UNEVEN * np.median(gap) + 4 * self.rests.noise:
            ends = " to ".join(show(float(end), "torque", 3) for end in (gap.min(), gap.max()))
            return f"the gap between both sides is {ends}: a muscle is slack at some of the angles"
        return ""

    def _by_torque(self, order: int = ORDERS[0]) -> Array:
        """Minus the slope of a polynomial at open angles per torque at each angle [1/rad]; (torques, angles)."""
        x = self.angles[self.open]
        terms = np.polyfit(x - x.mean(), np.eye(len(x)), order)
        powers = np.arange(order, 0, -1)
        return np.asarray([-np.polyval(column[:-1] * powers, x - x.mean()) for column in terms.T])

    def stiffness(self, order: int = ORDERS[0]) -> Array:
        """Minus the slope of a polynomial of torque over angle [N m/rad], at open angles; shape (cycles, open)."""
        return np.asarray(self.mean[:, self.open] @ self._by_torque(order))

    @cached_property
    def rounded(self) -> Array:
        """Error of the stiffness at open angles because torques are read in steps [N m/rad], shape (open,)."""
        return np.asarray(ROUNDED * self.rests.step * np.linalg.norm(self._by_torque(), axis=0))

    @cached_property
    def held_back(self) -> Array:
        """Error of that stiffness because of backlash at the turns [N m/rad], shape (open,)."""
        if self.after is None or self.turns is None or self.after.play <= 0:
            return np.zeros(int(self.open.sum()))
        x, w = self.angles[self.open], self.after.w
        falling, rising = (np.exp(-way / w) for way in (self.turns.upper - x, x - self.turns.lower))
        off = 0.5 * self.after.size * (rising - falling) - self.left[self.open]
        return np.asarray(np.abs(off @ self._by_torque()))

    @cached_property
    def flatter(self) -> float:
        """Largest error of that stiffness by the step of the torque at its change of sign [N m/rad]."""
        return float(np.max(np.abs(self.flank * np.sign(self.mean.mean(axis=0)[self.open]) @ self._by_torque())))


ROUNDED = 2 / sqrt(24)
"""Half width of the mean of two torques that were rounded, in steps."""


def staircase_of(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Staircase:
    """Evaluation of one trial; raises `NotUsable` with the reason, for angles near the turns with the sufficient
    overrun.
    """
    refuse_unusable(trial, "angle", "torque", *MUSCLES)
    nominal = np.array(settings_of(run, options)["angles"], dtype=np.float64)
    angle, torque = on_time(run, trial, "angle"), on_time(run, trial, "torque")
    rests = _rests(trial, nominal, angle, torque)
    elsewhere = _elsewhere(rests.angles, nominal)
    lowest, highest = trial.point["lowest_angle"], trial.point["highest_angle"]
    # turns in the encoder's reading, which may differ from the drive's
    low, high = np.polyval(np.polyfit(nominal, rests.angles.mean(axis=(0, 1)), 1), [lowest, highest])
    grid, up, down = _moving(trial, angle, torque, low, high)
    known = np.isfinite(up + down)
    turns = turns_of(grid[known], (down - up)[known], low, high) if known.sum() > LEAST_SAMPLES else None
    after = _after_turns(trial, angle, torque, turns.w) if turns is not None else None
    way = CUT * turns.w * (1 - 1e-9) if turns is not None else -np.inf
    far = np.asarray((nominal - lowest >= way) & (highest - nominal >= way))
    step = flank(grid, up, down, (low, high), turns)
    found = Staircase(run, trial, nominal, rests, turns, far, after, step)
    if why := why_no_turns(turns, 0.5 * (highest - lowest), float(np.median(found.gap)), rests.noise):
        raise NotUsable(f"{elsewhere}; {why}" if elsewhere else why)
    if turns is not None and not found.open.any():
        least = show(CUT * turns.w, "angle", 3)
        raise NotUsable(
            f"a turn fades on {show(turns.w, 'angle', 3)}, and no angle is 3 times that away from both turns: the "
            f"torque there is that of the turns; give an overrun of at least {least}"
        )
    return found


def _rests(trial: TrialData, nominal: Array, angle: Array, torque: Array) -> Rests:
    """Mean angles, torques and pressures of the later half of each rest, and their noise."""
    channels = [angle, torque, *(trial.channels[name] for name in MUSCLES)]
    means: dict[tuple[int, int], list[list[float]]] = {}
    holds: tuple[list[Held], list[Held]] = ([], [])
    noise, rough = 0.0, 0.0
    for ramp, after in pairwise(ramps_of(trial)):
        at = np.flatnonzero(np.abs(nominal - ramp.value) < 1e-9)
        if not len(at):
            continue
        begin = ends(ramp)
        late = 0.5 * (begin + after.t)
        rows = (trial.t >= late) & (trial.t < after.t) & trial.usable
        if rows.sum() < LEAST_SAMPLES:
            raise NotUsable(f"fewer than {LEAST_SAMPLES} samples in the later half of a rest")
        side = 0 if ramp.phase == "rise" else 1
        means.setdefault((side, int(at[0])), []).append([float(values[rows].mean()) for values in channels])
        whole = (trial.t >= begin + SKIPPED * (after.t - begin)) & (trial.t < after.t) & trial.usable
        holds[side].append(Held.of(trial.t[whole], torque[whole], late))
        noise = max(noise, noise_of(torque[rows]) / float(np.sqrt(rows.sum())))
        rough = max(rough, float(torque[rows].std()))
    each = [[means.get((side, n), []) for n in range(len(nominal))] for side in (0, 1)]
    cycles = int(trial.point["cycles"])
    if any(len(one) != cycles for branch in each for one in branch) or not np.isfinite(each).all():
        raise NotUsable("not every angle was reached from both sides in every cycle")
    angles, torques, *pressures = np.transpose(each, (3, 2, 0, 1))
    step = step_of(torque[trial.usable])
    coarse = step if rough < DITHERED * step < np.inf else 0.0
    return Rests(angles, torques, np.array(pressures), holds, noise, coarse)


def _elsewhere(places: Array, nominal: Array) -> str:
    """Message where the joint is off its place, empty for a small deviation; raises `NotUsable` for a large one."""
    off = np.abs(places - nominal).max(axis=(0, 1))
    worst = int(np.argmax(off))
    share = off[worst] / float(np.diff(nominal).min())
    said = (
        f"the joint was {show(float(off[worst]), 'angle', 3)} off where it was to be at "
        f"{show(float(nominal[worst]), 'angle', 3)}: look at the encoder's zero and sign, and at the drive"
    )
    if share > ELSEWHERE:
        raise NotUsable(said)
    return said if share > ASIDE else ""


def ramps_of(trial: TrialData) -> list[Command]:
    """The ramps from angle to angle, in both directions."""
    return [c for c in trial.commands if c.output == "angle" and c.kind == "ramp" and c.phase in ("rise", "fall")]


def _moving(trial: TrialData, angle: Array, torque: Array, low: float, high: float) -> tuple[Array, Array, Array]:
    """Angles, and torques while they rise and while they fall; NaN where the motion does not cover an angle."""
    moving = {phase: np.zeros(trial.t.shape, bool) for phase in (AXES.rises, AXES.falls)}
    for ramp in ramps_of(trial):
        moving[ramp.phase] |= (trial.t >= ramp.t) & (trial.t < ends(ramp)) & trial.usable
    grid = np.linspace(low, high, POINTS)[1:-1]
    up, down = (on_grid(grid, angle[rows], torque[rows]) for rows in moving.values())
    return grid, up, down


SETTLED = 0.4
"""Start of the evaluation after a turn, in w: before it the drive itself turns and backlash is taken up."""


def _after_turns(trial: TrialData, angle: Array, torque: Array, w: float) -> AfterTurns | None:
    """Growth of the gap after the turns, which decay over about `w` [rad]; None if there is none.

    From the turn on it is 1 - exp(-way/w); backlash, or a late torque, shifts it.
    """
    from scipy.optimize import minimize_scalar  # takes long to import

    ways, gaps = [], []
    for one, two in pairwise(ramps_of(trial)):
        if one.phase == two.phase:
            continue
        before = (trial.t >= one.t) & (trial.t < ends(one)) & trial.usable
        after = (trial.t >= two.t) & (trial.t < ends(two)) & trial.usable
        sign = np.sign(one.value - one.before)
        turn = float(np.max(sign * angle[before | after]))
        along, way = (turn - sign * angle[rows] for rows in (before, after))
        order = np.argsort(along)
        gap = sign * (torque[after] - np.interp(way, along[order], torque[before][order]))
        inside = (way > SETTLED * w) & (way < along.max())
        ways.append(way[inside])
        gaps.append(gap[inside])
    way, gap = np.concatenate(ways), np.concatenate(gaps)
    if len(way) < LEAST_SAMPLES:
        return None

    def fitted(fades: float) -> tuple[float, Array]:
        design = np.column_stack([np.ones_like(way), -np.exp(-way / np.exp(fades))])
        terms, *_ = np.linalg.lstsq(design, gap, rcond=None)
        return float(np.sum((gap - design @ terms) ** 2)), np.asarray(terms)

    best = minimize_scalar(lambda way: fitted(way)[0], bounds=(log(0.3 * w), log(3 * w)), method="bounded").x
    opened, size = (float(one) for one in fitted(float(best))[1])
    found = float(np.exp(best))
    return AfterTurns(size, found, found * log(size / opened)) if min(size, opened) > 0 else None
