"""The newest value of every DBC signal that a channel uses."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from time import monotonic

from pmabench_drivers.canbus.dbc import Message, Signal
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.options import Options


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
