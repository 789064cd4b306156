"""What can go wrong with an emulated link, called up while it runs; knows no protocol."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace

from pmabench.base.errors import did_you_mean

KINDS = {
    "silence": "nothing is carried out and nothing answered",
    "lost": "everything is carried out and nothing answered",
    "delay": "answers come `value` seconds late",
    "hang-up": "the connection is closed at the next request",
    "reset": "the connection is reset at the next request",
    "exception": "Modbus: answers are the exception `value`",
    "ignore": "Modbus: writes are answered and not carried out",
    "wrong": "Modbus: read registers are `value` too high",
    "stale": "Modbus TCP: answers carry the number of the request before",
    "truncated": "the last `value` bytes of each answer are missing",
    "garbage": "bytes of no meaning stand before each answer",
    "unit": "serial text: the line is in another unit (N as kg, mm as in)",
    "noise": "serial text: the number is off by up to `value`, another way in each line",
    "over": "serial text, Alicat: the range is said to be exceeded",
    "double": "serial text: each line comes twice",
    "held": "Alicat: the status says that the valves are held",
    "sensor": "Alicat: the status says that the pressure sensor has failed",
    "limit": "Alicat: the status says that it is over its pressure limit",
}


@dataclass(frozen=True)
class Fault:
    """A fault of one device for the next `count` requests or lines; -1: until it is cleared."""

    kind: str = ""
    value: float = 0.0
    count: int = -1


class Faults:
    """The fault of one device, used by its threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._fault = Fault()

    def set(self, kind: str, value: float = 0.0, count: int = -1) -> None:
        """Let it happen from the next request on; ValueError for a kind that is not known. `clear` ends it."""
        if kind not in KINDS and kind != "clear":
            raise ValueError(f'no fault "{kind}"{did_you_mean(kind, [*KINDS, "clear"])}')
        with self._lock:
            self._fault = Fault() if kind == "clear" else Fault(kind, value, count)

    def peek(self) -> Fault:
        """The fault of the moment, which is not counted."""
        with self._lock:
            return self._fault

    def next(self) -> Fault:
        """The fault that this request meets."""
        with self._lock:
            fault = self._fault
            if fault.count > 0:
                self._fault = Fault() if fault.count == 1 else replace(fault, count=fault.count - 1)
            return fault
