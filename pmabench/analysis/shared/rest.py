"""Whether a signal has come to rest at the end of a hold, and how much further it would go; knows no test kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.store.records import Array

BLOCKS = 20
"""Means that a stretch is divided into."""
FEWEST = 5
TIMES = np.geomspace(0.15, 4.0, 10)
"""Time constants that are tried, over the length of the stretch; what takes longer cannot be told from a drift."""
ALIKE = 4.0
"""By so many variances may the sum of squares of a time constant exceed the least (95 %)."""
MORE = 1.2
"""What is left counts by so much more than it is found, for a motion need not be one exponential."""
SURE = 5.0
"""Standard deviations from which on a motion is seen."""


@dataclass(frozen=True)
class Left:
    """What a signal would still change by [as the signal] after the mean of its end, by an exponential."""

    size: float
    """The likeliest."""
    most: float
    """The largest that the samples allow (95 %), without a sign."""
    seen: bool
    """Whether it moves at all, as far as noise lets one say."""


@dataclass(frozen=True, eq=False)
class Held:
    """Means of a signal along the later part of a hold."""

    t: Array
    """From its begin on [s]."""
    y: Array
    late: Array
    """1 where it is of the end whose mean counts, else 0."""

    @classmethod
    def of(cls, t: Array, y: Array, since: float) -> Held:
        """Of samples `y` (n,) at `t` (n,) [s]; the mean counts from the time `since` on."""
        parts = np.array_split(np.arange(len(t)), max(1, min(BLOCKS, len(t) // 3)))
        at, mean = (np.array([float(values[part].mean()) for part in parts]) for values in (t - t[0], y))
        return cls(at, mean, np.where(at >= min(since - t[0], at[-1]), 1.0, 0.0))


def left(holds: Sequence[Held]) -> Left:
    """What the mean of the ends of like holds would still change by.

    An exponential with each of `TIMES` is fitted to the means of all; those that fit nearly as well as the best
    bound the result, and with few samples the range of the means does.
    """
    count = min(len(one.t) for one in holds)
    at, mean, late = np.mean([[one.t[:count], one.y[:count], one.late[:count]] for one in holds], axis=0)
    mean -= mean.mean()
    if count < FEWEST or not late.any():
        return Left(0.0, float(np.ptp(mean)), seen=False)
    shapes = np.exp(-at / (float(at[-1]) * TIMES[:, None]))
    off = shapes - shapes.mean(axis=1, keepdims=True)
    power = np.sum(off**2, axis=1)
    size = off @ mean / power
    cost = np.sum((mean - size[:, None] * off) ** 2, axis=1)
    best, beyond = int(np.argmin(cost)), shapes @ late / late.sum()
    variance = float(cost[best]) / (count - 3)
    fits = cost <= cost[best] + ALIKE * variance
    most = MORE * beyond * (np.abs(size) + 2 * np.sqrt(variance / power))
    seen = abs(float(size[best])) * sqrt(float(power[best])) > SURE * sqrt(variance)
    return Left(-float(size[best] * beyond[best]), float(most[fits].max()), seen)
