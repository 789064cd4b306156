"""A gauge that is behind the displacement in a relay's oscillation, which shows in the harmonics of both."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi

import numpy as np

from pmabench.model.loop import ComplexArray
from pmabench.store.records import Array

BETTER = 0.5
"""Another form is used if its residual is below this share of that of the simpler one; of the regulator its square:
lags that differ between filling and venting do not reduce it that much.
"""
SEEN = 0.003
"""Least residual without a filter or a delay, relative to the first harmonic: noise makes up to 0.002."""
EARLY, TRIED = 0.2, 41
"""Longest delay of a gauge that is tried, over the period, and number of delays."""


def gauge_of(s: ComplexArray, X: ComplexArray, Q: ComplexArray) -> tuple[float, float]:
    """Time constant and delay [s] of the gauge, of which one at least is 0, by a displacement that moves before it.

    The motion is the answer of two lags to the pressure before the gauge: a filter adds one column to their least
    squares, and delays are tried.
    """

    def left(Q: ComplexArray, *more: ComplexArray) -> tuple[float, float]:
        fits = (positive_sizes([*(X * s**power for power in range(most)), *more], Q) for most in (2, 3))
        return min((residual, float(sizes[-1])) for sizes, residual in fits)

    plain, (filtered, size) = left(Q)[0], left(Q, -s * Q)
    delays = np.linspace(0.0, EARLY * 2 * pi / float(s[0].imag), TRIED)
    delayed, delay = min((left(Q * np.exp(delay * s))[0], float(delay)) for delay in delays)
    if plain < SEEN or min(filtered, delayed) > BETTER * plain:
        return 0.0, 0.0
    return (size, 0.0) if filtered < delayed else (0.0, delay)


def positive_sizes(columns: Sequence[ComplexArray], Q: ComplexArray) -> tuple[Array, float]:
    """Sizes of `columns` in `Q` by least squares; and the residual, relative to its first harmonic.

    The residual is inf where a size is not positive: lags below 0 fit nothing.
    """
    made = np.column_stack(columns)
    size = np.linalg.norm(made, axis=0)
    design, wanted = (np.concatenate([one.real, one.imag]) for one in (made / size, Q))
    found = np.linalg.lstsq(design, wanted, rcond=None)[0]
    left = float(np.linalg.norm(design @ found - wanted) / abs(Q[0]))
    return found / size, left if np.all(found > 0) else inf
