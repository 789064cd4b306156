"""How a loop's branches turn into each other at its ends: fitted to the gap alone, taken off the mean of the branches.

After a turn the force goes over to the other branch as exp(-way/w), whatever the speed. In a loop that repeats itself,
between ends `lower` and `upper` with E = exp(-(upper - lower)/w), and d1, d2 the ways from the two ends:

    gap  = 2 h - 2 h/(1 + E) (exp(-d1/w) + exp(-d2/w))
    mean = what it is without hysteresis + h/(1 + E) (exp(-d1/w) - exp(-d2/w))

What the muscle does without hysteresis is not in the gap, so h and w are found whatever it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from pmabench.store.records import Array

BETTER = 0.5
"""Share of the gap's rms about a constant that the turns must bring it below to be believed."""
WIDEST = 0.4
"""Largest w, as a share of the stroke."""


@dataclass(frozen=True)
class Turns:
    """h: half the gap of the open loop [N]; w: way on which a turn fades to 1/e [m]; ends of the stroke [m]."""

    h: float
    w: float
    lower: float
    upper: float
    rms: float
    """Of the gap about the fit [N]."""

    def of_mean(self, x: Array) -> Array:
        """What the turns leave in the mean of the branches [N] at `x` [m]."""
        first, second = _fading(x, self.lower, self.upper, self.w)
        return np.asarray(0.5 * self.h * (first - second))


def _fading(x: Array, lower: float, upper: float, w: float) -> tuple[Array, Array]:
    """2/(1 + E) exp(-d1/w) and 2/(1 + E) exp(-d2/w)."""
    size = 2.0 / (1.0 + np.exp(-(upper - lower) / w))
    return size * np.exp(-(x - lower) / w), size * np.exp(-(upper - x) / w)


def turns_of(x: Array, gap: Array, lower: float, upper: float) -> Turns | None:
    """The turns in a gap [N] at `x` [m], both of shape (n,); None where none show.

    The gap of the open loop is a constant, or where that does not do a parabola over the stroke: pressure that depends
    on the motion makes one.
    """
    return _found(x, gap, lower, upper, 0) or _found(x, gap, lower, upper, 2)


def _found(x: Array, gap: Array, lower: float, upper: float, order: int) -> Turns | None:
    """The turns beside a gap of a power of `order` over the stroke."""
    z = (2 * x - lower - upper) / (upper - lower)
    powers = [z**k for k in range(order + 1)]

    def left(columns: list[Array]) -> tuple[float, float]:
        """The first coefficient, and the rms of what is left [N]."""
        design = np.column_stack(columns)
        terms, *_ = np.linalg.lstsq(design, gap, rcond=None)
        return float(terms[0]), float(np.sqrt(np.mean((gap - design @ terms) ** 2)))

    flat = left(powers)[1] if len(x) >= 8 else 0.0
    if flat <= 1e-9 * float(np.max(np.abs(gap))):
        return None

    def solve(w: float) -> tuple[float, float]:
        first, second = _fading(x, lower, upper, w)
        return left([2.0 - first - second, *powers[1:]])

    stroke = upper - lower
    bounds = np.log(0.5 * float(x[1] - x[0])), np.log(WIDEST * stroke)
    starts = np.linspace(*bounds, 40)
    best = starts[int(np.argmin([solve(float(np.exp(s)))[1] for s in starts]))]
    step = starts[1] - starts[0]
    found = minimize_scalar(
        lambda s: solve(float(np.exp(s)))[1],
        bounds=(best - step, best + step),
        method="bounded",
        options={"xatol": 1e-6},
    )
    w = float(np.exp(found.x))
    h, rms = solve(w)
    if rms > BETTER * flat or w >= WIDEST * stroke or h <= 0:
        return None
    return Turns(h, w, lower, upper, rms)
