"""Student's t, usually without scipy, whose import takes longer than most reductions; means with half widths."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import cos, exp, isnan, lgamma, pi, sqrt, tan
from statistics import NormalDist

import numpy as np

from pmabench.store.records import Array

SHARES, FREEDOMS = (0.5, 0.99), (1.0, 300.0)
"""Range in which the quadrature agrees with scipy to 1e-11; above it a series is used, elsewhere scipy."""
OF_WHOLE = 0.999
"""Highest share for whole degrees of freedom."""
_OFF = np.arange(1, 60) / np.sqrt(4.0 * np.arange(1, 60) ** 2 - 1)
NODES, _ways = np.linalg.eigh(np.diag(_OFF, -1))
WEIGHTS = 2 * _ways[0] ** 2
"""Gauss-Legendre quadrature, from the Jacobi matrix (Golub, Welsch: Math. Comp. 23 (1969), 221-230): importing numpy's
takes longer."""
STEPS = 100


def ppf(share: float, freedom: float | Array) -> Array:
    """Value below which t of `freedom` degrees [1] stays with probability `share` [1]; NaN without a degree.

    As `scipy.stats.t.ppf`; same shape as `freedom`.

    >>> round(float(ppf(0.975, 4)), 3)
    2.776
    """
    values = np.asarray(freedom, dtype=np.float64)
    return np.array([_quantile(share, one) for one in values.ravel().tolist()], dtype=np.float64).reshape(values.shape)


@lru_cache(maxsize=4096)
def _quantile(share: float, freedom: float) -> float:
    """Quantile by Newton's method in the angle a, with t = sqrt(freedom) tan(a).

    The probability between 0 and t is the integral of c cos(a)^(freedom - 1), which is concave in a, so the iteration
    from a = 0 converges from below.
    """
    if freedom > FREEDOMS[1] and SHARES[0] <= share <= OF_WHOLE:
        return _of_many(NormalDist().inv_cdf(share), freedom)
    highest = OF_WHOLE if freedom == int(min(freedom, FREEDOMS[1])) else SHARES[1]
    if not (SHARES[0] <= share <= highest and FREEDOMS[0] <= freedom <= FREEDOMS[1]):
        from scipy.special import stdtrit

        return float(stdtrit(freedom, share))
    c = exp(lgamma((freedom + 1) / 2) - lgamma(freedom / 2)) / sqrt(pi)
    angle = 0.0
    for _ in range(STEPS):
        inside = angle / 2 * float(WEIGHTS @ np.cos(angle / 2 * (1 + NODES)) ** (freedom - 1))
        step = ((share - 0.5) / c - inside) / cos(angle) ** (freedom - 1)
        angle += step
        if step <= 1e-16 * angle:
            break
    return sqrt(freedom) * tan(angle)


def _of_many(z: float, freedom: float) -> float:
    """Quantile from the normal one, z, by powers of 1 / freedom (Abramowitz and Stegun 1964, 26.7.5)."""
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / freedom**power for power, term in enumerate(terms, 1))


def half_width(se: float | None, freedom: int) -> float | None:
    """95 % half width by Student's t; None without a standard error or a degree of freedom."""
    return None if se is None or freedom < 1 else float(ppf(0.975, freedom)) * se


def mean_with_half(values: Sequence[float] | Array) -> tuple[float, float | None]:
    """Mean and its 95 % half width, which is None for a single value."""
    array = np.array(values)
    se = float(array.std(ddof=1)) / sqrt(len(array)) if len(array) > 1 else None
    return float(array.mean()), half_width(se, len(array) - 1)


def half_of_trials(values: Sequence[float] | Array, halves: Sequence[float]) -> float | None:
    """95 % half width of the mean of trials: from `halves` of each (NaN: unknown) or their scatter, the larger."""
    within = sqrt(float(np.mean(np.square(halves))) / len(values))
    known = [half for half in (within, mean_with_half(values)[1]) if half is not None and not isnan(half)]
    return max(known, default=None)


def mean_over(values: Sequence[float], conditions: Sequence[float]) -> tuple[float, float | None, tuple[float, float]]:
    """Mean over conditions with equal weights, its 95 % half width, and the least and largest mean of a condition.

    The half width is from the scatter of repeats within conditions, pooled, and None where each was tested once.
    """
    array = np.array(values)
    _, group, count = np.unique(np.array(conditions), return_inverse=True, return_counts=True)
    means = np.bincount(group, array) / count
    freedom = len(array) - len(count)
    se = None
    if freedom > 0:
        variance = float(np.sum((array - means[group]) ** 2)) / freedom
        se = sqrt(variance * float(np.sum(1 / count))) / len(count)
    return float(means.mean()), half_width(se, freedom), (float(means.min()), float(means.max()))
