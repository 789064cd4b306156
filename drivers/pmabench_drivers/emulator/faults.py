"""Faults of an emulated device or its link, set while it runs; and the log of what happened.

All faults are defined in `KINDS`. A device declares those that it has; `Outgoing` applies the faults of a link to
complete answers. The log has JSON lines with monotonic time: every exchange, and every command. Its kinds: `received`
and `sent` (bytes as hex, seen from the emulated device), `connect`, `disconnect`, `lost`; `set`, `switch`, `watchdog`
and others of the devices; `load`, `plant`, `fault` for requests to the control socket. Independent of the protocol.
"""

from __future__ import annotations

import json
import random
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Any

from pmabench.base.errors import did_you_mean

Tap = Callable[[str, bytes], None]
"""Called with the word `received` or `sent`, and the bytes."""
EVENTS = {
    "watchdog": "expire_watchdog",
    "watchdog-off": "switch_off_watchdog",
    "restart": "restart",
    "setpoint": "change_set_point",
}
"""Single events, and the method of an emulated device that causes them: it takes the value if there is one, and
returns False if the event is not possible in the present state.
"""
GARBAGE = b"\x00\xff\x13"


class CommandLog:
    """Keeps all entries except exchanges in memory, and all entries in a file if one is given.

    `problem`: why the file is incomplete; else empty.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path, self._file = path, None if path is None else path.open("a", encoding="utf-8", buffering=1)
        self._lock = threading.Lock()
        self.entries: list[dict[str, Any]] = []
        self.problem = ""

    def note(self, kind: str, device: str, **data: Any) -> None:
        """Add an entry: monotonic time `t` [s], kind, device, and `data`."""
        entry = {"t": monotonic(), "kind": kind, "device": device, **data}
        with self._lock:
            self.entries.append(entry)
            self._write(entry)

    def tap(self, device: str, **more: Any) -> Tap:
        """Function that writes the exchanges of a device to the log."""

        def note(kind: str, data: bytes) -> None:
            if self._file is not None and data:
                with self._lock:
                    self._write({"t": monotonic(), "kind": kind, "device": device, "data": data.hex(), **more})

        return note

    def _write(self, entry: dict[str, Any]) -> None:
        if self._file is None:
            return
        try:
            self._file.write(json.dumps(entry) + "\n")
        except OSError as error:
            self.problem = f"{self._path}: the log ends early: {error.strerror or error}"
            self._file = None

    def of(self, kind: str, device: str = "") -> list[dict[str, Any]]:
        """Entries of a kind (and of a device) so far, without exchanges."""
        with self._lock:
            return [e for e in self.entries if e["kind"] == kind and device in {"", e["device"]}]

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None


@dataclass(frozen=True)
class Kind:
    """Effect of a fault, and its value: a `time` [s], a `ratio`, a whole `number`, a `level`, or nothing."""

    means: str
    takes: str = ""
    usual: float = 0.0


LINK = {
    "silence": Kind("nothing is carried out and nothing is answered"),
    "lost": Kind("answers and samples are lost on the way: all, or this share of them", "ratio", 1.0),
    "delay": Kind("answers come so much later", "time", 0.1),
    "late": Kind("an answer comes only when the next one is due, just before it"),
    "stale": Kind("the answer before comes once more, in place of the new one"),
    "truncated": Kind("so many bytes at the end of an answer are missing", "number", 1.0),
    "corrupted": Kind("the bits of this byte of an answer, counted from 0, are inverted", "number"),
    "garbage": Kind("bytes of no meaning come before an answer"),
    "double": Kind("an answer comes twice"),
    "hang-up": Kind("the connection is closed at the next request"),
    "reset": Kind("the connection is reset at the next request; a board starts again"),
}
"""Faults of every wire. For a device that sends by itself, samples are its answers."""
STUCK = {"stuck": Kind("measured values stay as they were when it began")}
SKEW = {"skew": Kind("the device's clock runs so much too fast (below 0: too slow)", "ratio", 1e-3)}
EXPIRY = {"watchdog": Kind("the armed watchdog expires now, once")}
WATCHDOG_OFF = {"watchdog-off": Kind("the watchdog is switched off from outside, once")}
RESTART = {"restart": Kind("the device restarts, once: outputs as after power-on, uptime from 0; its link stays")}
SETPOINT = {"setpoint": Kind("the set-point is changed from outside, once, to this in the device's unit", "level")}
EXCEPTION = {"exception": Kind("the answer is this exception, or error, code", "number", 4.0)}
IGNORE = {"ignore": Kind("what is written is acknowledged and not carried out")}
MODBUS = EXCEPTION | IGNORE | {"wrong": Kind("registers that are read are so much too high", "number", 1.0)}
NOISE = {"noise": Kind("the number is off by up to so much in the device's unit, another way each time", "level", 1.0)}
OVER = {"over": Kind("the range is said to be exceeded")}
UNIT = {"unit": Kind("the line is in another unit (N as kg, mm as in)")}
STATUS = {
    "held": Kind("the status says that the valves are held"),
    "sensor": Kind("the status says that the pressure sensor has failed"),
    "limit": Kind("the status says that it is over its pressure limit"),
}
KINDS = LINK | STUCK | SKEW | EXPIRY | WATCHDOG_OFF | RESTART | SETPOINT | MODBUS | NOISE | OVER | UNIT | STATUS


@dataclass(frozen=True)
class Fault:
    """A fault of one device for the next `count` requests or samples; -1: until it is cleared."""

    kind: str = ""
    value: float = 0.0
    count: int = -1


class Faults:
    """The present fault of one device, used by its threads; `kinds` are its possible ones."""

    def __init__(self, *kinds: dict[str, Kind]) -> None:
        self.kinds = {name: kind for group in kinds or (KINDS,) for name, kind in group.items()}
        self._lock = threading.Lock()
        self._fault = Fault()
        self._chance = random.Random(1)

    def known(self, kind: str) -> Kind:
        """Description of a kind; ValueError if the device does not have it."""
        if kind not in self.kinds:
            raise ValueError(f'no fault "{kind}"{did_you_mean(kind, [*self.kinds, "clear"])}')
        return self.kinds[kind]

    def set(self, kind: str, value: float | None = None, count: int = -1) -> None:
        """Set the fault for the next requests; ValueError for an unknown kind. `clear` ends it."""
        fault = Fault()
        if kind != "clear":
            usual = self.known(kind).usual
            fault = Fault(kind, usual if value is None else value, count)
        with self._lock:
            self._fault = fault

    def peek(self) -> Fault:
        """The present fault, without counting a request."""
        with self._lock:
            return self._fault

    def next(self) -> Fault:
        """The present fault; counts one request."""
        with self._lock:
            fault = self._fault
            if fault.kind == "lost" and self._chance.random() >= fault.value:
                return Fault()
            if fault.count > 0:
                self._fault = Fault() if fault.count == 1 else replace(fault, count=fault.count - 1)
            return fault


class Outgoing:
    """The sending end of one connection: applies a fault to each answer."""

    def __init__(self, garbage: bytes = GARBAGE) -> None:
        self._garbage = garbage
        self._before = self._kept = b""

    def of(self, data: bytes, fault: Fault) -> bytes:
        """Bytes sent instead of `data`, possibly none; waits if the answer is delayed."""
        before, self._before = self._before, data
        kept, self._kept = self._kept, b""
        if fault.kind in {"silence", "lost"}:
            return kept
        if fault.kind == "late":
            self._kept = data
            return kept
        if fault.kind == "delay":
            time.sleep(fault.value)
        return kept + damaged(before if fault.kind == "stale" else data, fault, self._garbage)


def damaged(data: bytes, fault: Fault, garbage: bytes = GARBAGE) -> bytes:
    """One answer as delivered by a faulty wire."""
    if fault.kind == "truncated":
        return data[: max(0, len(data) - int(fault.value))]
    if fault.kind == "corrupted" and data:
        place = min(int(fault.value), len(data) - 1)
        return data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :]
    if fault.kind == "garbage":
        return garbage + data
    return data * 2 if fault.kind == "double" else data


class DeviceClock:
    """The clock of a device that timestamps its samples; the fault `skew` makes it run fast or slow."""

    def __init__(self, faults: Faults) -> None:
        self._faults, self._at, self._shown = faults, monotonic(), 0.0

    def now(self) -> float:
        """Time since it was created [s]."""
        fault, at = self._faults.peek(), monotonic()
        self._shown += (at - self._at) * (1.0 + (fault.value if fault.kind == "skew" else 0.0))
        self._at = at
        return self._shown
