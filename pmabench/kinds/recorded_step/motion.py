"""A second-order motion under a pressure that is constant between its changes: its answer, exactly, and its fit.

The answer to a change is the unit step response of w^2 / (s^2 + 2 D w s + w^2), so the answer at a time is the sum
over all changes before it. Of each pole p that sum is one decaying number, Z(t) = sum of dP_j exp(p (t - t_j)), which
goes on from sample to sample; it is found for all samples by cumulative sums over stretches short enough for exp(p t).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pmabench.store.records import Array

REACH = 200.0
"""exp(REACH) is far below the largest number, and its inverse far above the smallest."""
EQUAL = 1e-6
"""Damping ratios closer to 1 than this count as 1 + EQUAL: there the two poles are one, and the sum of them is none."""

FREQUENCY = (3.0, 400.0)
DAMPING = (0.01, 20.0)
"""Bounds of natural frequency [rad/s] and damping ratio [1] of the motion; a fit at a bound found nothing."""
FEWEST = 12
"""Samples of a stretch of free swinging."""
LAGS = (0.005, 0.01, 0.02, 0.04)
"""Lags [s] between the pressure that was measured and the one that drives."""
AS_GOOD = 1.02
"""Motions whose misfit is within this factor of the least cannot be distinguished."""
PERIODS = 1.5
"""Of a stretch of free swinging."""
CLEAR = 20.0
"""A swing of more than so many standard deviations of the noise is clear."""
REACHED, SETTLED = 0.02, 1.8
"""Free swinging begins at so many times the time [s from the step] at which the pressure comes within that share."""
SHOWN = 5.0
"""An extreme is one beyond so many standard deviations of the noise."""


@dataclass(frozen=True)
class Motion:
    """x'' + 2 D w x' + w^2 x = w^2 g P, fitted with one assumed lateness of the pressure."""

    late: float
    """[s]."""
    w: float
    """Natural frequency [rad/s]."""
    D: float
    """Damping ratio [1]."""
    g: float
    """Stroke per pressure [m/Pa]."""
    rms: float
    """[m]."""
    model: Array

    @property
    def decay(self) -> float:
        """Rate at which the slowest part of the motion dies [1/s]."""
        return self.w * (self.D - sqrt(max(0.0, self.D**2 - 1))) if self.D > 1 else self.D * self.w


def fit_motion(t: Array, P: Array, x: Array, late: float) -> Motion:
    """Least squares of the driven motion over natural frequency and damping; gain and offset follow linearly.

    The measured pressure jumps in the middle between two samples that differ, which delays neither a channel that
    changes at each sample nor one that is polled, and is moved `late` [s] ahead. The response is the sum of the exact
    step responses of all changes: no resampling.
    """
    changes = np.flatnonzero(np.diff(P)) + 1
    jumps = np.diff(P)[changes - 1]
    at = 0.5 * (t[changes - 1] + t[changes]) - late

    def answer(p: Array) -> tuple[Array, float]:
        driven = respond(t, at, jumps, float(np.exp(p[0])), float(np.exp(p[1])))
        off = driven - driven.mean()
        power = float(np.sum(off * off))
        g = float(np.sum(off * x)) / power if power > 0 else 0.0
        return np.asarray(x.mean() + g * off), g

    def misfit(p: Array) -> Array:
        return np.asarray((answer(p)[0] - x) / scale)

    scale = max(float(np.ptp(x)), 1e-9)
    start = np.log([40.0, 0.3])
    bounds = (np.log([FREQUENCY[0], DAMPING[0]]), np.log([FREQUENCY[1], DAMPING[1]]))
    solved = least_squares(misfit, start, bounds=bounds, max_nfev=60)
    model, g = answer(solved.x)
    rms = float(np.sqrt(np.mean((model - x) ** 2)))
    w, D = (float(value) for value in np.exp(solved.x))
    return Motion(late, w, D, g, rms, model)


def from_rest(P: Array, rest: float) -> Array:
    """A pressure [Pa] whose first sample is that at rest: its noise would be a step of the motion from there on."""
    return np.concatenate([[rest], P[1:]])


def lagged_motions(t: Array, P: Array, x: Array, known: Motion) -> list[Motion]:
    """Motions of a pressure that lags behind the measured one by `LAGS`, those that fit no worse than `known`."""
    found = [fit_motion(t, behind(t, P, lag), x, known.late) for lag in LAGS]
    least = min(motion.rms for motion in [known, *found])
    return [motion for motion in found if motion.rms <= AS_GOOD * least]


def behind(t: Array, y: Array, lag: float) -> Array:
    """What a sensor with a first-order `lag` [s] reads of `y` at times `t` [s], shape (n,); at rest before, and exact
    for straight lines between the samples.
    """
    if lag <= 0:
        return y
    length = np.diff(t) / lag
    keep = np.exp(-length)
    new = 1.0 - (1.0 - keep) / length
    read = np.empty(len(y))
    read[0] = y[0]
    for k, (kept, share) in enumerate(zip(keep, new, strict=True)):
        read[k + 1] = kept * read[k] + (1.0 - kept - share) * y[k] + share * y[k + 1]
    return read


def before_sensor(t: Array, y: Array, lag: float, over: float) -> Array:
    """What a sensor with a first-order `lag` [s] was given where it read `y`, shape (n,), as means `over` a time [s].

    The input is y + lag y', so its mean over a time is that of y and lag times the change of y over that time.
    """
    until, since = np.minimum(t + over / 2, t[-1]), np.maximum(t - over / 2, t[0])
    area = np.concatenate(([0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))))
    change = lag * (np.interp(until, t, y) - np.interp(since, t, y))
    return np.asarray((np.interp(until, t, area) - np.interp(since, t, area) + change) / (until - since))


def extremes(x: Array, end: float, noise: float) -> int:
    """How often a motion that has reached its `end` [m] swings beyond it, to either side in turn, shape (n,)."""
    away = (x - end) * (1.0 if end >= x[0] else -1.0)
    count, side = 0, 1.0
    reached = np.flatnonzero(away >= 0)
    for value in away[reached[0] :] if len(reached) else ():
        if side * value > SHOWN * noise:
            count, side = count + 1, -side
    return count


@dataclass(frozen=True)
class Swing:
    """A stretch of free swinging about the end: natural frequency, damping ratio, swing in its middle [m]."""

    w: float
    D: float
    size: float
    at: float
    """Its middle [s from the step]."""


def free_swings(t: Array, P: Array, x: Array, known: Motion, noise: float) -> list[Swing]:
    """Stretches after the pressure has come to its end, one after another: the time of the pressure is not in them."""
    off = np.abs(P - np.median(P[t > t[-1] - 1.0])) > REACHED * np.ptp(P)
    begin = SETTLED * float(t[np.flatnonzero(off)[-1]]) if off.any() else 0.0
    length = PERIODS * 2 * np.pi / known.w
    found: list[Swing] = []
    while begin + length < t[-1]:
        rows = (t > begin) & (t <= begin + length)
        if np.count_nonzero(rows) < FEWEST or (found and found[-1].size < CLEAR * noise):
            break
        found.append(_free(t[rows], x[rows], known))
        begin += length
    return found


def _free(t: Array, x: Array, known: Motion) -> Swing:
    """Of one stretch: least squares of end + (A cos + B sin) of a decaying swing; end, A and B follow linearly."""
    since = t - t[0]

    def shapes(p: Array) -> Array:
        decay, turn = np.exp(-np.exp(p[0]) * since), np.exp(p[1]) * since
        return np.column_stack([np.ones(len(since)), decay * np.cos(turn), decay * np.sin(turn)])

    def misfit(p: Array) -> Array:
        return np.asarray(shapes(p) @ np.linalg.lstsq(shapes(p), x, rcond=None)[0] - x) / max(float(np.ptp(x)), 1e-9)

    solved = least_squares(misfit, np.log([known.D * known.w, known.w * sqrt(1 - min(known.D, 0.9) ** 2)]), max_nfev=60)
    terms = np.linalg.lstsq(shapes(solved.x), x, rcond=None)[0]
    rate, turn = (float(value) for value in np.exp(solved.x))
    w = float(np.hypot(rate, turn))
    return Swing(w, rate / w, float(np.hypot(*terms[1:]) * np.exp(-rate * since[-1] / 2)), float(t.mean()))


def respond(t: Array, at: Array, jumps: Array, w: float, D: float) -> Array:
    """The answer at times `t` [s] to `jumps` at times `at` [s], both rising; shapes (n,), (m,), result (n,).

    `w` is the natural frequency [rad/s], `D` the damping ratio; the unit of the result is that of the jumps.
    """
    before = np.searchsorted(at, t, side="right")
    held = np.concatenate(([0.0], np.cumsum(jumps)))[before]
    if abs(D - 1.0) < EQUAL:
        D = 1.0 + EQUAL
    if D < 1:
        root = sqrt(1 - D * D)
        left = _decaying(t, at, jumps, before, complex(-D * w, w * root))
        return np.asarray(held - left.real - D / root * left.imag)
    root = sqrt(D * D - 1)
    slow, fast = w * (D - root), w * (D + root)
    parts = [_decaying(t, at, jumps, before, complex(-pole)).real for pole in (slow, fast)]
    return np.asarray(held - (fast * parts[0] - slow * parts[1]) / (fast - slow))


def _decaying(t: Array, at: Array, jumps: Array, before: NDArray[np.intp], pole: complex) -> NDArray[np.complex128]:
    """Z(t) = sum of jumps exp(pole (t - at)) over the `before` changes before each time; Re pole < 0."""
    if not len(at):
        return np.zeros(len(t), dtype=np.complex128)
    stretch = REACH / -pole.real
    number = np.floor((at - at[0]) / stretch).astype(np.intp)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    starts = at[first]
    since = np.exp(-pole * (at - np.repeat(starts, np.diff(first, append=len(at)))))
    sums = np.zeros(len(at), dtype=np.complex128)
    carried, last = 0j, 0.0
    for begin, end, start in zip(first, [*first[1:], len(at)], starts, strict=True):
        carried *= np.exp(pole * (start - last)) if begin else 0.0
        sums[begin:end] = carried + np.cumsum(jumps[begin:end] * since[begin:end])
        carried, last = complex(sums[end - 1]), start
    index = before - 1
    group = np.searchsorted(first, index, side="right") - 1
    result = np.zeros(len(t), dtype=np.complex128)
    seen = index >= 0
    result[seen] = sums[index[seen]] * np.exp(pole * (t[seen] - starts[group[seen]]))
    return result
