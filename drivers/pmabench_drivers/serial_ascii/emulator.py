"""An emulated serial indicator: sends text lines about the plant, when polled or by itself, with faults on demand."""

from __future__ import annotations

import random

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.faults import LINK, NOISE, OVER, SKEW, STUCK, UNIT, CommandLog, DeviceClock, Faults
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import IDLE, OnTerminal
from pmabench_drivers.serial_ascii import read_options
from pmabench_drivers.shared.options import options_of

OTHER_UNITS = {"N": "kg", "kN": "kg", "kg": "lb", "mm": "in", "cm": "in", "um": "mil", "kPa": "bar", "bar": "psi"}
GARBAGE = b"\x00\x7f@#"
KINDS = (LINK, STUCK, NOISE, OVER, UNIT)


class Indicator(OnTerminal):
    """One indicator on a pseudo-terminal; the line is the option `emulate`, with the number of the first channel."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self._device, self._options, self._plant = device, options_of(device, read_options), plant
        faults = Faults(*KINDS, *(() if self._options.poll else (SKEW,)))
        super().__init__(device, log, faults, GARBAGE)
        self._clock, self._due, self._asked = DeviceClock(faults), 0.0, b""

    def wait(self) -> float:
        """Time until the next line is due, if it sends by itself."""
        return IDLE if self._options.poll else min(max(0.0, self._due - self._clock.now()), IDLE)

    def take(self, data: bytes) -> None:
        """Answer each request; if it sends by itself, send the due lines."""
        poll, identity = self._options.poll, self._options.ask_identity
        if not poll:
            if self._clock.now() >= self._due:
                self._due += 1.0 / self._options.rate
                self._send()
            return
        asked = (self._asked + data)[-100:]
        if identity and identity in asked:
            asked = asked.split(identity, 1)[1]
            self.terminal.write(self._plant.model(self._device.name).encode() + self._options.terminator)
        while poll in asked:
            asked = asked.split(poll, 1)[1]
            self._send()
        self._asked = asked

    def _send(self) -> None:
        """Send one line, with the present fault."""
        fault = self.next_fault()
        line = self._line(fault.kind, fault.value)
        self.terminal.write(self.outgoing(line.encode("ascii", "replace"), fault))

    def _line(self, fault: str, size: float) -> str:
        end = self._options.terminator.decode("ascii")
        if fault == "over":
            return (self._options.over_range or ("OL",))[0] + end
        quantities = self._plant.quantities()
        channel = self._device.channels[0]
        raw = float(channel.scale.to_raw(quantities.get(channel.name, 0.0)))
        line = self._options.emulate % (raw + random.uniform(-size, size) if fault == "noise" else raw)
        if fault == "unit":
            unit = self._options.unit or channel.raw_unit
            line = line.replace(unit, OTHER_UNITS.get(unit, "XX"))
        return line


serve = Indicator
"""Emulated indicator for a device of the driver `serial-ascii`."""
