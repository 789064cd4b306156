"""What answers to one SYNC, put together to one sample of all channels. Standard library only."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection

PATIENCE = 2
"""So many periods an answer is waited for; no SYNC is sent in that time, so that it cannot belong to a later one."""


class Rows:
    """Waits for the PDOs `wanted` after each SYNC, and calls `done(time, host)` [ns] when the last one has come.

    All nodes sample at the SYNC: after it was sent and before the first answer (`host`); `time` is the middle.
    Where the first answer took longer than `slowest` [ns], when they sampled is not known well enough: a gap.
    """

    def __init__(self, wanted: Collection[int], done: Callable[[int, int], None], slowest: int) -> None:
        self._wanted, self._done, self._slowest = frozenset(wanted), done, slowest
        self._lock = threading.Lock()
        self._open: set[int] = set()
        self._sent = self._first = self._waited = 0
        self.lost = 0
        """SYNCs that were not answered wholly; each is a gap."""
        self.in_a_row = 0
        """How many of them follow each other."""

    def may_sync(self) -> bool:
        """Whether the last SYNC was answered, or has been waited for long enough."""
        with self._lock:
            if not self._open:
                return True
            self._waited += 1
            if self._waited <= PATIENCE:
                return False
            self.lost += 1
            self.in_a_row += 1
            self._open.clear()
            return True

    def missing(self) -> frozenset[int]:
        """What has not answered to the last SYNC yet."""
        with self._lock:
            return frozenset(self._open)

    def begin(self, time: int) -> None:
        """A SYNC is about to be sent, at `time` [ns, bench time]."""
        with self._lock:
            self._open, self._sent, self._first, self._waited = set(self._wanted), time, 0, 0
        if not self._wanted:
            self._done(time, time)

    def arrived(self, identifier: int, host: int) -> None:
        """A PDO of `wanted` has come at `host` [ns, bench time]; one that answers to no SYNC is passed over."""
        with self._lock:
            if identifier not in self._open:
                return
            self._open.discard(identifier)
            self._first = self._first or host
            if self._open:
                return
            time, first, self.in_a_row = (self._sent + self._first) // 2, self._first, 0
            if first - self._sent > self._slowest:
                self.lost += 1
                return
        self._done(time, first)
