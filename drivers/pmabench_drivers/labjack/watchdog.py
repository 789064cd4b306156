"""The watchdog of a T7: what it does when the program is silent, armed, read back, fed and disarmed.

Strict: only its key feeds it, so that neither a stream nor another program keeps it quiet. On time-out it sets the DACs
and the valve lines to their safe values. It counts whole seconds. Its settings are kept in flash, also without power.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from time import monotonic
from typing import Protocol

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.labjack import registers as r

CALL = 0.19
"""Longest time that a call takes [s]."""
KEY = 0x504D4142
FROM, WORDS = r.WATCHDOG_ENABLE, 8
"""Enable, advanced, time, start-up delay."""


class Registers(Protocol):
    """Reads and writes registers before a deadline [s, monotonic]."""

    def get(self, address: int, count: int, deadline: float, what: str) -> list[int]:
        """`count` registers from an address on."""

    def put(self, address: int, words: Sequence[int], deadline: float, what: str) -> None:
        """Write once."""


def settings(device: DeviceRecord, seconds: int) -> list[tuple[int, list[int]]]:
    """First address and words of each group of registers, enable left out: all that makes the device safe by itself."""
    dacs = {output.output: float(output.scale.to_raw(output.safe)) for output in device.outputs}
    lines = {r.line_of(valve.output) or 0: valve.safe == valve.energised for valve in device.valves}
    mask = sum(1 << line for line in lines)
    state = sum(1 << line for line, high in lines.items() if high)
    groups = [
        (r.WATCHDOG_ADVANCED, r.u32(0, seconds, 0)),
        (r.WATCHDOG_STRICT, r.u32(1, KEY)),
        (r.WATCHDOG_RESET, r.u32(0)),
        (r.WATCHDOG_DIO_ENABLE, r.u32(int(bool(lines)), state, mask, r.ALL_LINES & ~mask)),
    ]
    for name, enable in zip(r.DACS, r.WATCHDOG_DAC_ENABLE, strict=True):
        groups.append((enable, [*r.u32(int(name in dacs)), *r.f32(dacs.get(name, 0.0))]))
    return groups


class Watchdog:
    """Arms and feeds it over the registers of one device."""

    def __init__(self, device: DeviceRecord, registers: Registers) -> None:
        self._device, self._registers = device, registers

    def arm(self, seconds: float) -> float:
        """Off, set, read back, on; returns the time that the device holds [s]."""
        name, put, get = self._device.name, self._registers.put, self._registers.get
        if not 1.0 <= seconds < math.inf:
            raise DeviceError(name, f"counts whole seconds: a watchdog of {seconds:g} s cannot be set", "watchdog")
        deadline = monotonic() + CALL
        groups = settings(self._device, math.floor(seconds + 1e-6))
        put(r.WATCHDOG_ENABLE, r.u32(0), deadline, "watchdog")
        for address, words in groups:
            if get(address, len(words), deadline, "watchdog") == words:
                continue  # flash wears out, and is slow
            put(address, words, deadline, "watchdog")
            held = get(address, len(words), deadline, "watchdog")
            if held != words:
                raise DeviceError(name, f"register {address} holds {held} after {words} was written", "watchdog")
        put(r.WATCHDOG_CLEAR, r.u32(KEY), deadline, "watchdog")
        put(r.WATCHDOG_ENABLE, r.u32(1), deadline, "watchdog")
        enabled, _advanced, held_time, _startup = r.from_u32(get(FROM, WORDS, deadline, "watchdog"))
        if enabled != 1:
            raise DeviceError(name, "does not say that it is on", "watchdog")
        return float(held_time)

    def feed(self) -> None:
        """Write the key."""
        self._registers.put(r.WATCHDOG_CLEAR, r.u32(KEY), monotonic() + CALL, "watchdog")

    def held(self, deadline: float) -> dict[str, float | str]:
        """What the device reports now: its time [s], 0 where it is off; and what it would do, as one text."""
        get = self._registers.get
        enabled, advanced, seconds, _startup = r.from_u32(get(FROM, WORDS, deadline, "watchdog"))
        groups = [
            (address, get(address, len(words), deadline, "watchdog"))
            for address, words in settings(self._device, int(seconds))[1:]
        ]
        text = " ".join(f"{address}={''.join(f'{word:04x}' for word in words)}" for address, words in groups)
        does = f"61602={advanced:08x} {text}"
        return {"watchdog": float(seconds) if enabled == 1 else 0.0, "registers of the watchdog": does}

    def disarm(self) -> None:
        """Off; outputs stay, and the settings in flash do nothing any more."""
        deadline = monotonic() + CALL
        self._registers.put(r.WATCHDOG_ENABLE, r.u32(0), deadline, "watchdog")
        if r.from_u32(self._registers.get(r.WATCHDOG_ENABLE, 2, deadline, "watchdog")) != [0]:
            raise DeviceError(self._device.name, "is still on", "watchdog")
