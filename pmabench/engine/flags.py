"""What is flagged of samples while they are taken: missing or late ones, by their times alone; overrange and slack."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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
"""So many periods beyond what the steps should be make a lost sample, and not a late one [1]."""
WAITING = 12
"""No more samples wait for the next one: polls that are made up come a few at once, or not at all."""


class Spacing:
    """Whether samples are missing before a sample (GAP), or it only came late (LATE), from block to block.

    Polls at absolute deadlines that are late by x periods make one step of 1 + x and, with those that are made up, the
    next ones shorter by x in all; where a sample is missing they stay longer. So where x is near 1 or more the samples
    after decide, and until they are there the last ones are `open`.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1e9 / rate
        self._last: int | None = None
        self._late = 0.0
        self._open: list[float] = []
        """How late the samples that are open would be, if none were missing [periods]."""

    @property
    def open(self) -> int:
        """Of how many of the newest samples the next one decides the flag."""
        return len(self._open)

    def look(self, time_ns: Sequence[int] | NDArray[np.int64]) -> tuple[list[int], list[int]]:
        """The flags of the samples that were open, oldest first, and those of the samples at `time_ns`.

        0 where a sample is open now.
        """
        were = self.open
        flags = [0] * were
        if isinstance(time_ns, np.ndarray) and self._even(time_ns):
            return flags, [0] * len(time_ns)
        for time in time_ns:
            step = 1.0 if self._last is None else (time - self._last) / self._period
            self._last = time
            if self._open and step < MISSING <= self._open[-1] + step - 1.0 and self.open < WAITING:
                self._open.append(self._open[-1] + step - 1.0)
                flags.append(0)
                continue
            decided = self._decide(step)
            flags[len(flags) - len(decided) :] = decided
            step += self._late
            flags.append(int(Flag.LATE) if APART < step <= LATE_ONLY else 0)
            if step > LATE_ONLY:
                self._open, self._late = [step - 1.0], 0.0
            else:
                self._late = step - 1.0 if step - 1.0 > CARRIED else 0.0
        return flags[:were], flags[were:]

    def _even(self, time_ns: NDArray[np.int64]) -> bool:
        """Whether no sample is late or missing, nor waits, so that nothing is carried over; they then count as seen."""
        if self._open or self._late or not len(time_ns):
            return False
        first = 0 if self._last is None else int(time_ns[0]) - self._last
        if (time_ns[1:] - time_ns[:-1]).max(initial=first) / self._period - 1.0 > CARRIED:
            return False
        self._last = int(time_ns[-1])
        return True

    def settle(self) -> list[int]:
        """The flags of the samples that are open, where no other one follows."""
        return self._decide(1.0)

    def _decide(self, step: float) -> list[int]:
        """The flags of the samples that are open, by the `step` [periods] to the one after them."""
        late, self._open = self._open, []
        if not late:
            return []
        beyond = late[-1] + step - 1.0
        lost = floor(beyond + 1.0 - MISSING) if beyond >= MISSING else 0
        self._late = late[-1] - lost if not lost or late[-1] - lost > CARRIED else 0.0
        found = [int(Flag.LATE) if x - lost > APART - 1.0 else 0 for x in late]
        if lost:
            found[0] = int(Flag.GAP)
        return found


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
