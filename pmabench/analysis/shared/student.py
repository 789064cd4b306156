"""Student's t, without `scipy.stats`, whose import takes longer than most reductions; means with half widths."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from scipy.special import stdtrit

from pmabench.store.records import Array


def ppf(share: float, freedom: float | Array) -> Array:
    """Value below which t of `freedom` degrees [1] stays with probability `share` [1]; NaN without a degree.

    As `scipy.stats.t.ppf`; same shape as `freedom`.

    >>> round(float(ppf(0.975, 4)), 3)
    2.776
    """
    return np.asarray(stdtrit(freedom, share), dtype=np.float64)


def half_width(se: float | None, freedom: int) -> float | None:
    """95 % half width by Student's t; None where there is no degree of freedom."""
    return None if se is None or freedom < 1 else float(ppf(0.975, freedom)) * se


def mean_with_half(values: Sequence[float]) -> tuple[float, float | None]:
    """Mean and its 95 % half width."""
    array = np.array(values)
    se = float(array.std(ddof=1)) / sqrt(len(array)) if len(array) > 1 else None
    return float(array.mean()), half_width(se, len(array) - 1)


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
