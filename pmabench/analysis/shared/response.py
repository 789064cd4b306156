"""Response to one set-point: rise, overshoot, settling, steady-state error, limit cycle.

Rise time, overshoot and settling time refer to the step, from the position at rest to the set-point; IAE is the
integral of |set-point - x|.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import hypot, pi, sqrt

import numpy as np

from pmabench.analysis.shared.samples import Held, left, noise_of
from pmabench.analysis.shared.signals import SEEN, SMOOTHED, SURE, smooth
from pmabench.store.records import Array

SMALLEST = 1e-4
"""Share of the set-point above which a cycle counts, if it also exceeds the noise and two counts."""
SUSTAINED = 0.5
"""Size of the last cycle over that of the first above which an oscillation is sustained [1]."""
OVERDUE = 1.5
"""Number of periods without a further cycle after which an oscillation has died out [1]."""
FEWEST = 2
"""Fewest whole cycles of a limit cycle."""
STILL = 0.01
"""Motion within a fortieth of a cycle, over its size, below which it is at rest; a sine is so for 8 % of the time."""
PART = 0.02
"""Relative error of size and period of a cycle from smoothing."""
LONGEST, FADES = 1e3, 0.5
"""A motion in the window is extrapolated over the logarithm of time until the first [s], where its slope over that is
more than the second share of the slope before: muscles creep so."""
STICKS = 0.3
"""Share of the time at rest from which on a cycle is stick-slip."""


@dataclass(frozen=True)
class Cycle:
    """A sustained oscillation around the set-point."""

    size: float
    """Mean peak to peak [m]."""
    period: float
    """[s]."""
    count: int
    """Whole cycles seen."""
    at_rest: float
    """Share of the time at rest [1]."""

    @property
    def sticks(self) -> bool:
        """Whether it is a stick-slip cycle."""
        return self.at_rest >= STICKS


@dataclass(frozen=True)
class Response:
    """Response to a step of the set-point from rest; times are counted from the step."""

    rise: float | None
    """Time from 10 % to 90 % of the step [s]; None where 90 % is not reached by more than the noise."""
    overshoot: float
    """Largest excess over the set-point, over the step [1]; 0 for none."""
    settling: float | None
    """Time after which it stays in the band around the set-point [s]; None where it leaves the band less the noise."""
    error: float
    """Mean of set-point minus x in the window [m]."""
    IAE: float
    """Integral of |set-point - x| over the whole hold [m.s]."""
    cycle: Cycle | None
    wander: float
    """Peak to peak in the window [m]; above `smallest` without a cycle it is a drift, or slower than the window."""
    smallest: float
    """Smallest cycle that can be detected, peak to peak [m]."""
    unsure: Unsure


@dataclass(frozen=True)
class Unsure:
    """Half widths from sampling, noise and motion in the window, for values of `Response` and `Cycle`."""

    rise: float
    overshoot: float
    settling: float
    """Difference between the settling times of a band that is narrower and one that is wider by the noise."""
    IAE: float
    size: float
    period: float
    error: float
    """Possible difference of the mean in the window from that at rest, or over whole cycles [m]."""
    moves: bool
    """Whether a motion in the window is significant."""
    creep: float
    """Possible further motion over the logarithm of time until `LONGEST` [m]; 0 where it decays faster."""


def respond(
    t: Array,
    x: Array,
    setpoint: float,
    window: tuple[float, float],
    band: float,
    *,
    origin: float = 0.0,
    resolution: float = 0.0,
    lag: float = 0.0,
) -> Response:
    """Measures of the samples `x` [m] at `t` [s from the step], shape (n,), from the step to the end of the hold.

    `window` [s] is for error and cycle; `band` is over the step [1]; `origin`: position at rest before [m];
    `resolution`: one count of the channel [m]; `lag`: time constant of its sensor, which is corrected [s]. Raises
    ValueError with fewer than 8 samples in the window, or where `origin` is not below the set-point.
    """
    period = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    inside = (t >= window[0]) & (t <= window[1])
    if inside.sum() < 8 or period <= 0:
        raise ValueError(f"fewer than 8 samples from {window[0]:g} s to {window[1]:g} s")
    step = setpoint - origin
    if step <= 0:
        raise ValueError("it rested beyond the set-point already")
    noise, place = noise_of(x[inside]), smooth(t, x, lag)
    at, rest = place.y, SURE * noise * place.gain + 0.5 * resolution

    def settled(limit: float) -> float | None:
        outside = np.flatnonzero(np.abs(at - setpoint) > limit)
        return 0.0 if not len(outside) else float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None

    smallest = max(SEEN * noise * max(1.0, place.gain), 2 * resolution, SMALLEST * setpoint)
    cycle, wander = cycle_of(t[inside], x[inside], smallest, lag), float(np.ptp(at[inside]))
    rise, open_ = _rise(t, at - origin, step, rest)
    near, wide = settled(band * step - rest), settled(band * step + rest)
    # noise of standard deviation s about rest makes |x| larger by 0.8 s, and by nothing far from it
    rectified = sqrt(2 / pi) * noise * place.gain * period * float(np.sum(np.abs(at - setpoint) < rest))
    further = left([Held.of(t[inside], x[inside], float(window[0]))])
    if cycle is not None:
        error = 0.5 * cycle.size * min(1.0, cycle.period / (window[1] - window[0]))
    else:
        error = max(further.most, wander if wander > smallest else 0.0)
    unsure = Unsure(
        rise=hypot(period + SMOOTHED / 2, *open_),
        overshoot=rest / step,
        settling=period + (near - wide if near is not None and wide is not None else 0.0),
        IAE=rectified,
        size=2 * rest + 2 * PART * (0.0 if cycle is None else cycle.size),
        period=0.0 if cycle is None else period + PART * cycle.period / cycle.count,
        error=max(error, 0.5 * resolution),
        moves=cycle is not None or further.seen or wander > smallest,
        creep=_creep(t, x, window) if further.seen and cycle is None else 0.0,
    )
    overshoot = max(0.0, place.against(setpoint).peak(noise) / step)
    settling = settled(band * step) if near is not None else None
    IAE = float(np.trapezoid(np.abs(setpoint - at), t)) - 0.5 * rectified
    off = setpoint - float(x[inside].mean())
    return Response(rise, overshoot, settling, off, IAE, cycle, wander, smallest, unsure)


def _creep(t: Array, x: Array, window: tuple[float, float]) -> float:
    """Possible further motion over the logarithm of time [m]; 0 where the motion decays faster."""

    def by_log(low: float, high: float) -> float:
        rows = (t >= low) & (t <= high) & (t > 0)
        return abs(float(np.polyfit(np.log(t[rows]), x[rows], 1)[0])) if rows.sum() > FEWEST else 0.0

    inside = by_log(*window)
    if inside < FADES * by_log(0.5 * window[0], window[0]):
        return 0.0
    return inside * max(0.0, float(np.log(LONGEST / np.mean(window))))


def _rise(t: Array, x: Array, step: float, rest: float) -> tuple[float | None, list[float]]:
    """Rise time from 10 to 90 % of the step [s] and the uncertainty of both times [s]; None where 90 % is not certain.

    The uncertainty is the time between passing one standard deviation (a third of `rest`) below and above a level.
    """

    def reached(level: float) -> float | None:
        rows = np.flatnonzero(x >= level)
        return float(t[rows[0]]) if len(rows) else None

    low, high = reached(0.1 * step), reached(0.9 * step)
    if low is None or high is None or reached(0.9 * step + rest) is None:
        return None, []
    ends = [[reached(share * step + more / SURE) or 0.0 for more in (-rest, rest)] for share in (0.1, 0.9)]
    return high - low, [late - early for early, late in ends]


def cycle_of(t: Array, x: Array, smallest: float, lag: float = 0.0) -> Cycle | None:
    """The sustained oscillation of `x` [m] at `t` [s], shape (n,); None without one larger than `smallest` [m].

    `lag`: time constant of the sensor, which is corrected [s]. Cycles are from one upward crossing of the middle to the
    next, with a hysteresis of a tenth of the size, so that corners of a stick-slip cycle do not matter.
    """
    period = float(np.median(np.diff(t)))
    at = smooth(t, x, lag).y
    low, high = float(at.min()), float(at.max())
    if high - low <= smallest:
        return None
    ups = _upward(at, 0.5 * (low + high), 0.1 * (high - low))
    if len(ups) < FEWEST + 1:
        return None
    parts = [at[a : b + 1] for a, b in pairwise(ups)]
    sizes = np.array([float(np.ptp(part)) for part in parts])
    if sizes[-1] < SUSTAINED * sizes[0] or sizes.mean() <= smallest:
        return None
    length = float(t[ups[-1]] - t[ups[0]]) / len(parts)
    if t[-1] - t[ups[-1]] > OVERDUE * length:
        return None
    whole = x[ups[0] : ups[-1] + 1]
    step = max(1, round(length / 40 / period))
    means = whole[: len(whole) // step * step].reshape(-1, step).mean(axis=1)
    still = np.abs(np.diff(means)) < STILL * sizes.mean()
    return Cycle(float(sizes.mean()), length, len(parts), float(still.mean()) if len(still) else 0.0)


def _upward(x: Array, middle: float, hysteresis: float) -> list[int]:
    """Indices at which `x` crosses `middle` upwards, between values `hysteresis` below and `hysteresis` above it."""
    far = np.flatnonzero(np.abs(x - middle) > hysteresis)
    above = x[far] > middle
    reached, below = far[1:][above[1:] & ~above[:-1]], np.flatnonzero(x < middle)
    return [int(place) + 1 for place in below[np.searchsorted(below, reached) - 1]]
