"""One trial of isometric torques: what the joint held at each angle, reached from below and from above."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.ramp_loop import AXES, CUT, MUSCLES, Turns, on_grid, refuse_turns, turns_of
from pmabench.analysis.shared.samples import (
    Held,
    NotUsable,
    ends,
    noise_of,
    on_time,
    refuse_flagged,
    refuse_incomplete,
    settings_of,
)
from pmabench.base.quantities import show
from pmabench.store.records import Array, Command, RunData, TrialData

POINTS = 81
"""Points of the gap that show how a turn fades."""
FEWEST = 7
"""Angles that a stiffness needs: its slope is that of a polynomial of order 5."""
ORDERS = 5, 3
"""Of the polynomial of torque over angle, and of the one that shows what the choice of an order changes."""
UNEVEN = 0.25
"""A gap that changes by a larger share over the angles is not that of two taut muscles at all of them."""
LEAST_SAMPLES = 10
ELSEWHERE, ASIDE = 0.25, 0.02
"""Shares of the way between angles by which the joint may be off its place, and from which on that is said."""
SKIPPED = 0.25
"""Share of a rest after which the torque is to be still: before it regulators and muscles come to rest."""


@dataclass(frozen=True, eq=False)
class Rests:
    """The later half of each rest; arrays of shape (cycles, 2, n), rising first."""

    angles: Array
    """[rad]."""
    torques: Array
    """[N m]."""
    pressures: Array
    """[Pa], shape (2, cycles, 2, n)."""
    holds: tuple[list[Held], list[Held]]
    """Torque along each rest, rising and falling [N m]."""
    noise: float
    """Of a torque [N m]."""


@dataclass(frozen=True, eq=False)
class Staircase:
    """One usable trial; angles [rad] of shape (n,), torques [N m] of shape (cycles, n)."""

    run: RunData
    trial: TrialData
    angles: Array
    """Where the joint was, as measured: means of all cycles."""
    nominal: Array
    """Where it was to be."""
    rising: Array
    falling: Array
    turns: Turns | None
    open: NDArray[np.bool_]
    """True where both turns are far enough away."""
    pressures: Array
    """Mean pressures of both muscles as measured [Pa], shape (2,)."""
    noise: float
    """Of the torque [N m]."""
    rests: Rests

    @cached_property
    def gap(self) -> Array:
        """Torque while falling minus torque while rising [N m], shape (cycles, n)."""
        return np.asarray(self.falling - self.rising)

    @cached_property
    def left(self) -> Array:
        """What the turns leave in the mean of both sides [N m], shape (n,)."""
        return np.zeros_like(self.angles) if self.turns is None else self.turns.of_mean(self.angles)

    @property
    def apart(self) -> Array:
        """Angle when it was reached from above minus that from below [rad], shape (n,)."""
        return np.asarray(np.diff(self.rests.angles.mean(axis=0), axis=0)[0])

    @property
    def scale(self) -> float:
        """Angle measured over angle commanded, less 1."""
        off = self.nominal - self.nominal.mean()
        return float(off @ (self.angles - self.nominal) / (off @ off))

    @cached_property
    def mean(self) -> Array:
        """Torque without hysteresis [N m], shape (cycles, n)."""
        return np.asarray(0.5 * (self.falling + self.rising) - self.left)

    @cached_property
    def why_no_stiffness(self) -> str:
        """Why there is no slope of torque over angle; empty where there is one."""
        if self.open.sum() < FEWEST:
            return f"{self.open.sum()} angles are far enough from the turns, and a slope needs {FEWEST}"
        return self.slack

    @cached_property
    def slack(self) -> str:
        """What the gap says of a slack muscle; empty where it says nothing.

        A muscle that pulls on one of the two ways only makes a smaller gap, and the mean is not free of hysteresis.
        """
        gap = self.gap.mean(axis=0)[self.open]
        if np.ptp(gap) > UNEVEN * np.median(gap) + 4 * self.noise:
            ends = " to ".join(show(float(end), "torque", 3) for end in (gap.min(), gap.max()))
            return f"the gap between both sides is {ends}: a muscle is slack at some of the angles"
        return ""

    def stiffness(self, order: int = ORDERS[0]) -> Array:
        """Minus the slope of a polynomial of torque over angle [N m/rad], at open angles; shape (cycles, open)."""
        x = self.angles[self.open]
        terms = np.polyfit(x - x.mean(), self.mean[:, self.open].T, order)
        powers = np.arange(order, 0, -1)
        return np.asarray([-np.polyval(column[:-1] * powers, x - x.mean()) for column in terms.T])


def staircase_of(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Staircase:
    """One trial measured; raises `NotUsable` with the reason, for angles near the turns with what would be enough."""
    refuse_incomplete(trial, "angle", "torque", *MUSCLES)
    refuse_flagged(trial.usable)
    nominal = np.array(settings_of(run, options)["angles"], dtype=np.float64)
    angle, torque = on_time(run, trial, "angle"), on_time(run, trial, "torque")
    rests = _rests(trial, nominal, angle, torque)
    elsewhere = _elsewhere(rests.angles, nominal)
    lowest, highest = trial.point["lowest_angle"], trial.point["highest_angle"]
    turns = _turns(trial, angle, torque, lowest, highest)
    way = CUT * turns.w * (1 - 1e-9) if turns is not None else -np.inf
    far = np.asarray((nominal - lowest >= way) & (highest - nominal >= way))
    pressures = np.array([float(np.mean(trial.channels[name][trial.usable])) for name in MUSCLES])
    mean, (rising, falling) = rests.angles.mean(axis=(0, 1)), rests.torques.swapaxes(0, 1)
    found = Staircase(run, trial, mean, nominal, rising, falling, turns, far, pressures, rests.noise, rests)
    try:
        refuse_turns(turns, 0.5 * (highest - lowest), float(np.median(found.gap)), rests.noise)
    except NotUsable as reason:
        raise NotUsable(f"{elsewhere}; {reason}" if elsewhere else str(reason)) from None
    if turns is not None and not found.open.any():
        least = show(CUT * turns.w, "angle", 3)
        raise NotUsable(
            f"a turn fades on {show(turns.w, 'angle', 3)}, and no angle is 3 times that away from both turns: the "
            f"torque there is that of the turns; give an overrun of at least {least}"
        )
    return found


def _rests(trial: TrialData, nominal: Array, angle: Array, torque: Array) -> Rests:
    """Mean angles, torques and pressures of the later half of each rest, and what else the rests say."""
    ramps = _ramps(trial)
    cycles = int(trial.point["cycles"])
    channels = [angle, torque, *(trial.channels[name] for name in MUSCLES)]
    means = np.full((len(channels), cycles, 2, len(nominal)), np.nan)
    holds: tuple[list[Held], list[Held]] = ([], [])
    counts = {"rise": [0] * len(nominal), "fall": [0] * len(nominal)}
    noise = 0.0
    for ramp, after in pairwise(ramps):
        at = np.flatnonzero(np.abs(nominal - ramp.value) < 1e-9)
        if not len(at):
            continue
        begin = ends(ramp)
        late = 0.5 * (begin + after.t)
        rows = (trial.t >= late) & (trial.t < after.t) & trial.usable
        if rows.sum() < LEAST_SAMPLES:
            raise NotUsable(f"fewer than {LEAST_SAMPLES} samples in the later half of a rest")
        cycle, n = counts[ramp.phase][at[0]], int(at[0])
        counts[ramp.phase][n] += 1
        side = 0 if ramp.phase == "rise" else 1
        means[:, cycle, side, n] = [values[rows].mean() for values in channels]
        whole = (trial.t >= begin + SKIPPED * (after.t - begin)) & (trial.t < after.t) & trial.usable
        holds[side].append(Held.of(trial.t[whole], torque[whole], late))
        noise = max(noise, noise_of(torque[rows]) / float(np.sqrt(rows.sum())))
    if not np.isfinite(means).all():
        raise NotUsable("not every angle was reached from both sides in every cycle")
    return Rests(means[0], means[1], means[2:], holds, noise)


def _elsewhere(places: Array, nominal: Array) -> str:
    """Where the joint was not where it was sent, empty where it nearly was; raises `NotUsable` where it was far off."""
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


def _ramps(trial: TrialData) -> list[Command]:
    return [c for c in trial.commands if c.output == "angle" and c.kind == "ramp" and c.phase in ("rise", "fall")]


def _turns(trial: TrialData, angle: Array, torque: Array, lowest: float, highest: float) -> Turns | None:
    """How a turn fades, from the torque while the joint moves; None where no turns show."""
    moving = {phase: np.zeros(trial.t.shape, bool) for phase in (AXES.rises, AXES.falls)}
    for ramp in _ramps(trial):
        moving[ramp.phase] |= (trial.t >= ramp.t) & (trial.t < ends(ramp)) & trial.usable
    grid = np.linspace(lowest, highest, POINTS)[1:-1]
    up, down = (on_grid(grid, angle[rows], torque[rows]) for rows in moving.values())
    known = np.isfinite(up + down)
    return turns_of(grid[known], (down - up)[known], lowest, highest) if known.sum() > LEAST_SAMPLES else None
