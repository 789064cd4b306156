"""What emulated devices on pseudo-terminals have in common: a thread that serves the line until it is closed."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import GARBAGE, Fault, Faults, Outgoing
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.ports import Terminal

IDLE = 0.05
"""Longest wait for bytes [s]."""


class OnTerminal(ABC):
    """One device at the end of a pseudo-terminal. A kind of device says what bytes do."""

    def __init__(self, device: DeviceRecord, log: CommandLog, faults: Faults, garbage: bytes = GARBAGE) -> None:
        self.address, self.faults = device.address, faults
        self.terminal, self._outgoing = Terminal(device.address, log.tap(device.name)), Outgoing(garbage)
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
    def take(self, data: bytes) -> None:
        """Bytes that came, or none within `wait`; raises ConnectionAbortedError to hang up."""

    def wait(self) -> float:
        """How long bytes are waited for [s]."""
        return IDLE

    def next_fault(self) -> Fault:
        """The fault of the moment; one that drops the line hangs up."""
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            raise ConnectionAbortedError
        return fault

    def outgoing(self, data: bytes, fault: Fault) -> bytes:
        """One answer or measurement as the line delivers it."""
        return self._outgoing.of(data, fault)

    def _serve(self) -> None:
        while not self._ended.is_set():
            data = self.terminal.read(self.wait())
            if data is None:
                return
            try:
                self.take(data)
            except ConnectionAbortedError:
                self.terminal.close()
                return
            except OSError:
                return
