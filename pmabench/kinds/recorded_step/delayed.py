"""A second-order motion fitted with its delay behind the measured pressure, where K and B change along the step.

Knows samples and a first motion; no trial.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.optimize import least_squares

from pmabench.kinds.recorded_step.motion import DAMPING, FREQUENCY, Motion, respond
from pmabench.store.records import Array

FREE = 0.04
"""The pressure may be so much earlier or later [s] than its stamps where that is fitted, too."""
BOUND = 0.99
"""A time found beyond this share of `FREE` is at its bound."""
HEAVIEST = 200.0
"""Greatest damping ratio where the delay is fitted, too: that of a mass that does not show."""
FASTEST = 8e-3
"""A mass whose pole M/B is faster than this [s] may hide behind a delay."""
WIDE = 3.0
"""Standard deviations of the interval: the noise of the pressure drives the model and hides in what is fitted."""
REMAINS = 0.3
"""Share of what the second column changes that is added to the half widths."""


@dataclass(frozen=True)
class Delayed:
    """A driven motion whose delay behind the measured pressure was fitted with it; half widths of 95 % intervals."""

    tau: float
    """Time constant B/K at the pressure that the step ends at, 2 D/w [s]."""
    half_tau: float
    delay: float
    """Time of the motion behind the measured pressure [s]; below 0 where the pressure is stamped late."""
    half_delay: float
    rms: float
    """[m]."""
    place: Array
    """Where the fit ended: the delay over `FREE`, logarithms of damping ratio and natural frequency."""

    @property
    def bounded(self) -> bool:
        """Whether the delay was found within its bounds."""
        return abs(self.delay) + self.half_delay < BOUND * FREE


def fit_delayed(t: Array, P: Array, x: Array, start: Motion, w: float | None = None) -> Delayed:
    """Least squares of the driven motion over natural frequency, damping ratio and delay behind the pressure.

    t [s], P [Pa], x [m], shapes (n,). `w` is the natural frequency sqrt(K/M) [rad/s], where stiffness and moving mass
    are known. K and B change with the pressure along the step; a second column, driven by the square of its change,
    takes that up to first order, and what it changes widens the intervals. They hold the covariance with the serial
    correlation of what is left, and half the sample period: what a sample shows has come since the one before it.
    """
    period = float(np.median(np.diff(t)))
    first = np.array([-start.late / FREE, np.log(start.D * (1.0 if w is None else w / start.w)), np.log(start.w)])
    one = _delayed(t, P, x, first, w, columns=1)
    two = min((_delayed(t, P, x, begin, w, columns=2) for begin in (first, one.place)), key=lambda found: found.rms)
    return replace(
        two,
        half_tau=float(np.hypot(two.half_tau, REMAINS * (two.tau - one.tau))),
        half_delay=float(np.linalg.norm([two.half_delay, REMAINS * (two.delay - one.delay), 0.5 * period])),
    )


def _delayed(t: Array, P: Array, x: Array, first: Array, w: float | None, columns: int) -> Delayed:
    changes = np.flatnonzero(np.diff(P)) + 1
    came = 0.5 * (t[changes] + t[changes - 1])
    change = (P - P[0]) / max(float(np.ptp(P)), 1e-9)
    jumps = [np.diff(values)[changes - 1] for values in (change, change * np.abs(change))[:columns]]
    scale = max(float(np.ptp(x)), 1e-9)

    def misfit(p: Array) -> Array:
        frequency, damping = w if w is not None else float(np.exp(p[2])), float(np.exp(p[1]))
        driven = [respond(t, came + FREE * p[0], one, frequency, damping) for one in jumps]
        design = np.column_stack([np.ones(len(t)), *driven])
        return np.asarray(x - design @ np.linalg.lstsq(design, x, rcond=None)[0]) / scale

    low, high = [-1.0, np.log(DAMPING[0]), np.log(FREQUENCY[0])], [1.0, np.log(HEAVIEST), np.log(FREQUENCY[1])]
    free = 3 if w is None else 2
    begin = np.clip(first[:free], np.array(low[:free]) + 1e-3, np.array(high[:free]) - 1e-3)
    solved = least_squares(misfit, begin, bounds=(low[:free], high[:free]), x_scale=0.1, max_nfev=100)
    frequency = w if w is not None else float(np.exp(solved.x[2]))
    fast = 1 / (2 * float(np.exp(solved.x[1])) * frequency)
    if w is None and fast < 0.5 * float(np.median(np.diff(t))):
        massless = FREQUENCY[1]
        heavy = solved.x[1] + np.log(massless / frequency)
        found = _delayed(t, P, x, np.array([solved.x[0], heavy, np.log(massless)]), massless, columns)
        halves = (float(np.hypot(half, FASTEST)) for half in (found.half_tau, found.half_delay))
        return replace(found, half_tau=next(halves), half_delay=next(halves))
    rest = solved.fun
    power = float(rest @ rest)
    variance = power / (len(rest) - free - 1 - columns) * _together(rest)
    slopes = np.asarray(solved.jac, dtype=np.float64)
    covariance = np.linalg.pinv(slopes.T @ slopes) * variance
    ratio = np.array([0.0, 1.0, -1.0][:free])
    tau = 2 * float(np.exp(solved.x[1])) / frequency
    half_tau = WIDE * tau * sqrt(max(0.0, float(ratio @ covariance @ ratio)))
    half_delay = WIDE * FREE * sqrt(max(0.0, float(covariance[0, 0])))
    place = np.array([*solved.x[:2], np.log(frequency)])
    return Delayed(tau, half_tau, FREE * float(solved.x[0]), half_delay, sqrt(power / len(rest)) * scale, place)


def _together(rest: Array) -> float:
    """By how much the variance of means of `rest`, shape (n,), exceeds that of independent samples.

    The noise of a measured pressure drives the model, too, and so what is left is correlated for as long as B/K.
    """
    off = rest - rest.mean()
    size = 2 * len(off)
    spectrum = np.abs(np.fft.rfft(off, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: len(off) // 2]
    correlation = correlation / max(float(correlation[0]), 1e-30)
    below = np.flatnonzero(correlation < 0)
    return max(1.0, float(1 + 2 * correlation[1 : below[0] if len(below) else None].sum()))
