"""The watch on measured limits: looks at every sample of every block; knows limits, not steps or devices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.interface import TripRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trip:
    """A limit that was crossed: at which sample of the block, when [s], with which value [SI]."""

    limit: TripRecord
    index: int
    t: float
    value: float

    def __str__(self) -> str:
        """The sentence for operator and record."""
        quantity = CHANNEL_QUANTITY[self.limit.channel]
        if not np.isfinite(self.value):
            return f"{self.limit.channel} reads {self.value} at {self.t:.3f} s: no valid value ({self.limit.source})"
        bound = self.limit.high if self.limit.high is not None and self.value >= self.limit.high else self.limit.low
        side = "above" if bound is self.limit.high else "below"
        limit = show(bound if bound is not None else 0.0, quantity)
        return (
            f"{self.limit.channel} {show(self.value, quantity)} at {self.t:.3f} s is {side} its limit "
            f"{limit} ({self.limit.source})"
        )


class Watch:
    """Holds each limit's state from block to block."""

    def __init__(self, limits: Sequence[TripRecord]) -> None:
        self._limits = tuple(limits)
        self._since: list[float | None] = [None] * len(self._limits)

    def look(self, t: Array, values: Mapping[str, Array]) -> Trip | None:
        """The first limit that is crossed for longer than its delay in this block, if any.

        `t` [s] has shape (n,), each of `values` [SI] too. A value that is no number counts as a crossing.
        """
        found: Trip | None = None
        for number, limit in enumerate(self._limits):
            samples = values.get(limit.channel)
            if samples is None or len(samples) == 0:
                continue
            trip = self._one(number, limit, t, samples)
            if trip is not None and (found is None or trip.index < found.index):
                found = trip
        return found

    def look_once(self, t: float, values: Mapping[str, float]) -> Trip | None:
        """As `look`, for a single sample in plain numbers: loops that are closed at every sample."""
        for number, limit in enumerate(self._limits):
            value = values.get(limit.channel)
            if value is None:
                continue
            # Written so that NaN, which compares false with everything, counts as outside.
            if (limit.high is None or value < limit.high) and (limit.low is None or value > limit.low):
                self._since[number] = None
                continue
            since = self._since[number]
            if since is None:
                self._since[number] = since = t
            if t - since >= limit.delay:
                return Trip(limit, 0, t, value)
        return None

    def _one(self, number: int, limit: TripRecord, t: Array, samples: Array) -> Trip | None:
        low, high = samples.min(), samples.max()
        inside = (limit.high is None or high < limit.high) and (limit.low is None or low > limit.low)
        if inside and np.isfinite(low) and np.isfinite(high):
            self._since[number] = None
            return None
        outside = ~np.isfinite(samples)
        if limit.high is not None:
            outside |= samples >= limit.high
        if limit.low is not None:
            outside |= samples <= limit.low
        since = self._since[number]
        for index in np.flatnonzero(outside | np.concatenate(([True], outside[:-1]))):
            if not outside[index]:
                since = None
                continue
            since = t[index] if since is None else since
            if t[index] - since >= limit.delay:
                return Trip(limit, int(index), float(t[index]), float(samples[index]))
        self._since[number] = float(since) if since is not None and outside[-1] else None
        return None
