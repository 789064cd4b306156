"""Which measurement a value is, by its counter, and how many are missing; knows no port. Standard library only."""

from __future__ import annotations

from pmabench_drivers.ild1420.wire import WRAP


class CounterBroken(Exception):
    """The counter goes on from elsewhere: which measurement this is, is not known."""


class Numbering:
    """Numbers measurements from 0 on.

    A measurement is believed when its counter follows that of the last one believed, or of the one right before it. So
    the first one behind a gap is left out: its bytes may belong to two. A disturbed counter makes no false gap.
    """

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._last: int | None = None
        self._before: int | None = None
        self._number = 0
        self.lost = 0
        """Measurements that never came, or were left out."""

    def place(self, counter: int) -> int | None:
        """The number of a measurement; None: it is not believed. Raises CounterBroken."""
        follows = [(before + 1) % WRAP for before in (self._last, self._before) if before is not None]
        self._before = counter
        if counter not in follows:
            return None
        ahead = 0 if self._last is None else (counter - self._last) % WRAP
        if ahead > self._longest:
            raise CounterBroken
        self._number += ahead
        self.lost += max(0, ahead - 1)
        self._last = counter
        return self._number
