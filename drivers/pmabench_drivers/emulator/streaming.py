"""What emulated serial devices that send by themselves have in common: lines of commands in, a stream out, faults."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import LINK, SKEW, STUCK, Fault, Faults, Kind, Outgoing
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.ports import Terminal

TICK = 0.004
"""What falls due within this is sent together [s]."""
IDLE = 0.05
"""Longest wait for a command [s]."""
LONGEST = 200
"""More of an unfinished line is forgotten [bytes]."""


class Streaming(ABC):
    """One device on a pseudo-terminal. A kind of device says what a `command` does and what is `due`."""

    def __init__(self, device: DeviceRecord, log: CommandLog, *kinds: dict[str, Kind], garbage: bytes) -> None:
        self.address, self.faults = device.address, Faults(LINK, STUCK, SKEW, *kinds)
        self.terminal = Terminal(device.address, log.tap(device.name))
        self._outgoing = Outgoing(garbage)
        self.streaming = False
        self.due = 0.0
        """When the next measurement is due [s, monotonic]."""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"emulated {device.name}", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        self.terminal.close()

    @abstractmethod
    def command(self, line: str) -> None:
        """A line that came; raises ConnectionAbortedError to hang up."""

    @abstractmethod
    def send_what_is_due(self) -> None:
        """While `streaming`: every measurement that is due; raises ConnectionAbortedError to hang up."""

    def next_fault(self) -> Fault:
        """The fault of the moment; one that drops the line hangs up."""
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            raise ConnectionAbortedError
        return fault

    def seconds(self, shown: float) -> float:
        """How long this machine's clock says that so much time of the device's own clock lasts [s]."""
        fault = self.faults.peek()
        return shown / (1.0 + fault.value) if fault.kind == "skew" else shown

    def outgoing(self, data: bytes, fault: Fault) -> bytes:
        """One answer or measurement as the line delivers it."""
        return self._outgoing.of(data, fault)

    def _serve(self) -> None:
        asked = b""
        while not self._ended.is_set():
            wait = min(max(TICK, self.due - monotonic()), IDLE) if self.streaming else IDLE
            received = self.terminal.read(wait)
            if received is None:
                return
            *lines, asked = (asked + received).replace(b"\r", b"\n").split(b"\n")
            asked = asked[-LONGEST:]
            try:
                for line in lines:
                    if line.strip():
                        self.command(line.decode("ascii", "replace").strip())
                if self.streaming:
                    self.send_what_is_due()
            except ConnectionAbortedError:
                self.terminal.close()
                return
            except OSError:
                return
