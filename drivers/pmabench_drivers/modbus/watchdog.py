"""The watchdog inside a Modbus device: set, read back, fed; and whether the program still feeds it."""

from __future__ import annotations

import math
from collections.abc import Callable
from time import monotonic
from typing import Protocol

from pmabench.base.errors import DeviceError
from pmabench_drivers.modbus.registers import Register, RegisterMap, WatchdogRegisters

CALL = 0.19
"""Longest time that a call takes [s]."""

SHARE, LEAST = 0.25, 0.1
"""The polling thread waits for a sign of life of the program for this share of the watchdog's time, at least 0.1 s."""

Get = Callable[[Register, float], float]
"""Reads a register before a deadline [s, monotonic]."""


class Put(Protocol):
    """Writes a register before a deadline."""

    def __call__(self, register: Register, value: float, deadline: float, *, checked: bool = True) -> None:
        """Write; then read back, where it is `checked`."""


class DeviceWatchdog:
    """Arms and feeds the watchdog of a map, by `get` and `put` of a register."""

    def __init__(self, device: str, map_: RegisterMap, get: Get, put: Put) -> None:
        self._device, self._map, self._get, self._put = device, map_, get, put
        self._armed = 0.0
        self._fed = 0.0
        self._beat = 0

    def forget(self) -> None:
        """Nothing is armed from here any more; the device keeps what it has."""
        self._armed = 0.0

    def hungry(self) -> bool:
        """Whether it is armed and nobody has fed it for a quarter of its time.

        Most devices count any communication as a sign of life, so the thread that polls must fall silent then: the
        device vents a quarter of its time (or 0.1 s) late at most, whatever hangs in the program.
        """
        return self._armed > 0 and monotonic() - self._fed > max(SHARE * self._armed, LEAST)

    def arm(self, seconds: float) -> float:
        """Set the time, start it, and return the time that the device holds [s]."""
        registers = self._registers()
        if not 0 < seconds < math.inf:
            raise DeviceError(self._device, f"a watchdog of {seconds} s cannot be set", "watchdog")
        counts, deadline = max(1, math.floor(seconds / registers.resolution + 1e-6)), monotonic() + CALL
        if registers.trigger is not None:
            self._put(registers.trigger, registers.off, deadline, checked=False)
        self._put(registers.timeout, counts, deadline, checked=False)
        held = self._get(registers.timeout, deadline) if registers.timeout.read_back else counts
        if registers.trigger is not None:
            self._put(registers.trigger, registers.on, deadline)
        if held <= 0:
            raise DeviceError(self._device, "holds a watchdog time of 0, which is none", "watchdog")
        self._armed, self._fed = held * registers.resolution, monotonic()
        return self._armed

    def feed(self) -> None:
        """A sign of life."""
        registers, deadline = self._registers(), monotonic() + CALL
        if registers.heartbeat is not None:
            self._beat = self._beat % 1000 + 1
            self._put(registers.heartbeat, self._beat, deadline)
        else:
            self._get(registers.timeout, deadline)
        self._fed = monotonic()

    def held(self, deadline: float) -> dict[str, float]:
        """What the device reports of it now: `watchdog`, the time [s], 0 where it is off; without the time that cannot
        be read, `watchdog trigger`; nothing where neither can be read.
        """
        registers = self._registers()
        trigger = registers.trigger if registers.trigger is not None and registers.trigger.read_back else None
        found = {} if trigger is None else {"watchdog trigger": self._get(trigger, deadline)}
        if registers.timeout.read_back:
            seconds = self._get(registers.timeout, deadline) * registers.resolution
            found["watchdog"] = seconds if found.get("watchdog trigger", registers.on) == registers.on else 0.0
        return found

    def disarm(self) -> None:
        """Stop it; outputs stay."""
        registers, deadline = self._registers(), monotonic() + CALL
        self._armed = 0.0
        if registers.trigger is not None:
            self._put(registers.trigger, registers.off, deadline)
        else:
            self._put(registers.timeout, 0, deadline)

    def _registers(self) -> WatchdogRegisters:
        if self._map.watchdog is None:
            raise DeviceError(self._device, 'has no watchdog: the map has no "watchdog"', "watchdog")
        return self._map.watchdog
