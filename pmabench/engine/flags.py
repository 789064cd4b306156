"""What is flagged of samples while they are taken: missing or late ones, by their times alone; overrange and slack."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import floor

import numpy as np
from numpy.typing import NDArray

from pmabench.bench.interface import ChannelRecord
from pmabench.store.records import Flag

Array = NDArray[np.float64]
Flags = NDArray[np.uint16]

APART = 1.5
"""A sample is apart from the one before when it is so many periods later [1] ..."""
LATE_ONLY = 1.75
"""... and up to here only late: it would have to be early if another one were missing."""
CARRIED = 0.25
"""Lateness from which on a sample makes the step to the next one shorter [periods]; less is the clock's own."""
MISSING = 0.75
"""So many periods beyond two make of two steps a lost sample, and not a late one [1]."""


class Spacing:
    """Whether samples are missing before a sample (GAP), or it only came late (LATE), from block to block.

    A poll at absolute deadlines that is late by x periods makes one step of 1 + x and the next of 1 - x; where a sample
    is missing two steps are three periods. So where x is near 1 the sample after tells, and until it is there the last
    one is `open`.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1e9 / rate
        self._last: int | None = None
        self._late = 0.0
        self._apart: float | None = None
        """The step of the sample that is open, from its predecessor's deadline [periods]."""

    @property
    def open(self) -> bool:
        """Whether the flag of the newest sample is told by the next one."""
        return self._apart is not None

    def look(self, time_ns: Iterable[int]) -> tuple[int, list[int]]:
        """The flag of the sample that was open, and those of the samples at `time_ns`; 0 where one is open now."""
        before = 0
        flags: list[int] = []
        for time in time_ns:
            step = 1.0 if self._last is None else (time - self._last) / self._period
            self._last = time
            decided = self._decide(step)
            if flags:
                flags[-1] |= decided
            else:
                before = decided
            step += self._late
            if step > LATE_ONLY:
                self._apart, self._late = step, 0.0
            else:
                self._late = step - 1.0 if step - 1.0 > CARRIED else 0.0
            flags.append(int(Flag.LATE) if APART < step <= LATE_ONLY else 0)
        return before, flags

    def settle(self) -> int:
        """The flag of the sample that is open, where no other one will tell."""
        return self._decide(1.0)

    def _decide(self, step: float) -> int:
        if self._apart is None:
            return 0
        apart, self._apart = self._apart, None
        beyond = apart + step - 2.0
        if beyond < MISSING:
            self._late = apart - 1.0
            return int(Flag.LATE)
        late = apart - 1.0 - floor(beyond + 1.0 - MISSING)
        self._late = late if late > CARRIED else 0.0
        return int(Flag.GAP)


class Ranges:
    """Overrange and slack, and how far each channel has gone: `extremes` [SI], lowest and highest."""

    def __init__(self, slack_below: float) -> None:
        self._slack_below = slack_below
        self.extremes: dict[str, tuple[float, float]] = {}

    def block(self, channels: Mapping[str, ChannelRecord], values: Mapping[str, Array], count: int) -> Flags:
        """Flags of `count` samples, of shape (n,); `values` [SI] have that shape too."""
        flags = np.zeros(count, dtype=np.uint16)
        for name, value in values.items():
            channel = channels[name]
            low, high = float(value.min()), float(value.max())
            if low == low and high == high:
                seen = self.extremes.get(name, (low, high))
                self.extremes[name] = (min(seen[0], low), max(seen[1], high))
            if not (low > channel.low and high < channel.high):  # also where one is no number
                inside = (value > channel.low) & (value < channel.high)
                if channel.raw_type != "int32":
                    inside = (value >= channel.low) & (value <= channel.high)
                flags[~inside] |= np.uint16(Flag.OVERRANGE)
        force = values.get("force")
        if self._slack_below > 0 and force is not None:
            flags[force < self._slack_below] |= np.uint16(Flag.SLACK)
        return flags

    def one(self, channels: Iterable[ChannelRecord], values: Mapping[str, float]) -> int:
        """As `block` for a single sample, in plain numbers: a loop closed at 500 Hz has 2 ms for everything."""
        flags = 0
        for channel in channels:
            value = values[channel.name]
            low, high = self.extremes.get(channel.name, (value, value))
            if value < low or value > high:
                self.extremes[channel.name] = (min(low, value), max(high, value))
            if not channel.low < value < channel.high and (
                channel.raw_type == "int32" or not channel.low <= value <= channel.high
            ):
                flags |= int(Flag.OVERRANGE)
        if self._slack_below > 0 and values.get("force", self._slack_below) < self._slack_below:
            flags |= int(Flag.SLACK)
        return flags
