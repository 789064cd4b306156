"""What comes in over the bus, put together to samples: answers to one SYNC, newest values of DBC signals."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Sequence
from math import isfinite
from time import monotonic

from pmabench_drivers.canbus.dbc import Message, Signal
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.options import Options

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


class Signals:
    """Takes frames and keeps what the channels' `inputs` show, and when it came."""

    def __init__(self, options: Options, inputs: Sequence[str]) -> None:
        self._slowest = options.slowest
        self._values: dict[str, float] = {}
        self._came: dict[str, float] = {}
        self._by_frame: dict[tuple[int, bool], list[tuple[str, Message, Signal]]] = {}
        self._names: list[str] = []
        self._begun = 0.0
        for name in inputs:
            found = options.signal(name)
            if found is not None and name.partition(".")[0] not in options.nodes:
                message, signal = found
                self._names.append(name)
                key = message.identifier, message.extended
                self._by_frame.setdefault(key, []).append((name, message, signal))

    def begin(self) -> None:
        """Sampling begins: from now on signals must come."""
        self._begun = monotonic()

    def take(self, frame: Frame) -> None:
        """A frame of the bus; one of another length than the DBC file says is passed over."""
        for name, message, signal in self._by_frame.get((frame.identifier, frame.extended), ()):
            if len(frame.data) == message.length:
                value = signal.value(frame.data)
                if isfinite(value):
                    self._values[name], self._came[name] = value, monotonic()

    def value(self, name: str) -> float:
        """The newest value, in the unit of the DBC file."""
        return self._values[name]

    def fresh(self) -> bool:
        """Whether no signal is older than it may be."""
        now = monotonic()
        return all(now - self._came.get(name, -1e9) <= self._slowest for name in self._names)

    def stale(self) -> str:
        """A signal that is older than it may be; empty where there is none."""
        now = monotonic()
        waited = (name for name in self._names if now - max(self._came.get(name, 0.0), self._begun) > self._slowest)
        return next(waited, "")
