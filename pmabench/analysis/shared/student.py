"""Student's t, as a rule without scipy, whose import takes longer than most reductions; means with half widths."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import cos, exp, isnan, lgamma, pi, sqrt, tan
from statistics import NormalDist

import numpy as np

from pmabench.store.records import Array

SHARES, FREEDOMS = (0.5, 0.99), (1.0, 300.0)
"""Where the quadrature is as exact as scipy, to 1e-11; over more degrees a series is, and elsewhere scipy is used."""
OF_WHOLE = 0.999
"""The highest share where the degrees of freedom are a whole number."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)
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
    """With t = sqrt(freedom) tan(a), the probability between 0 and t is the integral of c cos(a)^(freedom - 1).

    The integral is concave in a: Newton's method from a = 0 comes to the value from below, until only rounding is left.
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
    """The quantile next to the normal one, z, by powers of 1 / freedom (Abramowitz and Stegun 1964, 26.7.5)."""
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / freedom**power for power, term in enumerate(terms, 1))


def half_width(se: float | None, freedom: int) -> float | None:
    """95 % half width by Student's t; None where there is no degree of freedom."""
    return None if se is None or freedom < 1 else float(ppf(0.975, freedom)) * se


def mean_with_half(values: Sequence[float] | Array) -> tuple[float, float | None]:
    """Mean and its 95 % half width."""
    array = np.array(values)
    se = float(array.std(ddof=1)) / sqrt(len(array)) if len(array) > 1 else None
    return float(array.mean()), half_width(se, len(array) - 1)


def half_of_trials(values: Sequence[float] | Array, halves: Sequence[float]) -> float | None:
    """95 % half width of the mean of trials: by that of each, NaN where it is unknown, or by their scatter if wider."""
    within = sqrt(float(np.mean(np.square(halves))) / len(values))
    known = [half for half in (within, mean_with_half(values)[1]) if half is not None and not isnan(half)]
    return max(known, default=None)


def mean_over(values: Sequence[float], conditions: Sequence[float]) -> tuple[float, float | None, tuple[float, float]]:
    """Mean over unlike conditions, each counting alike; its 95 % half width; least and largest mean of a condition.

    Conditions are no repeats of each other: the half width comes from the scatter of repeats of one condition, pooled
    over all of them, and is None where each was tested once.
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
