"""What emulated serial devices that send by themselves have in common: lines of commands in, a stream out, faults."""

from __future__ import annotations

from abc import abstractmethod
from time import monotonic

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import LINK, SKEW, STUCK, Faults, Kind
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.on_terminal import IDLE, OnTerminal

TICK = 0.004
"""What falls due within this is sent together [s]."""
LONGEST = 200
"""More of an unfinished line is forgotten [bytes]."""


class Streaming(OnTerminal):
    """One device on a pseudo-terminal. A kind of device says what a `command` does and what is `due`."""

    def __init__(self, device: DeviceRecord, log: CommandLog, *kinds: dict[str, Kind], garbage: bytes) -> None:
        super().__init__(device, log, Faults(LINK, STUCK, SKEW, *kinds), garbage)
        self.streaming = False
        self.due = 0.0
        """When the next measurement is due [s, monotonic]."""
        self._asked = b""

    @abstractmethod
    def command(self, line: str) -> None:
        """A line that came; raises ConnectionAbortedError to hang up."""

    @abstractmethod
    def send_what_is_due(self) -> None:
        """While `streaming`: every measurement that is due; raises ConnectionAbortedError to hang up."""

    def seconds(self, shown: float) -> float:
        """How long this machine's clock says that so much time of the device's own clock lasts [s]."""
        fault = self.faults.peek()
        return shown / (1.0 + fault.value) if fault.kind == "skew" else shown

    def wait(self) -> float:
        """Until a measurement falls due."""
        return min(max(TICK, self.due - monotonic()), IDLE) if self.streaming else IDLE

    def take(self, data: bytes) -> None:
        """Obey each whole line, and send what is due."""
        *lines, rest = (self._asked + data).replace(b"\r", b"\n").split(b"\n")
        self._asked = rest[-LONGEST:]
        for line in lines:
            if line.strip():
                self.command(line.decode("ascii", "replace").strip())
        if self.streaming:
            self.send_what_is_due()
