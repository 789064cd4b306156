"""What is wired to the terminals of one emulated device, and what a command at a terminal does; knows no wire."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant


class Wiring:
    """Channels, outputs, valves and contacts by the names of their terminals."""

    def __init__(self, device: DeviceRecord, plant: RealPlant, log: CommandLog) -> None:
        self._name, self._plant, self._log = device.name, plant, log
        self.channels = {channel.input: channel for channel in device.channels}
        self.outputs = {output.output: output for output in device.outputs}
        self.valves = {valve.output: valve for valve in device.valves}
        self.locks = {lock.input: lock for lock in device.interlocks}

    def raw(self, terminal: str, quantities: Mapping[str, float], *, calibrated: bool = False) -> float:
        """What a terminal gives at the quantities of the plant [raw]; 0 where nothing is wired."""
        channel = self.channels.get(terminal)
        if channel is None:
            return 0.0
        scale = channel.calibrated if calibrated else channel.scale
        return float(scale.to_raw(quantities.get(channel.name, 0.0)))

    def level(self, terminal: str) -> bool:
        """Whether the contact at a terminal holds it high; low where nothing is wired."""
        lock = self.locks.get(terminal)
        if lock is None:
            return False
        closed = self._plant.e_stop_high() if "stop" in lock.name else True
        return closed == (lock.safe == "high")

    def set(self, terminal: str, raw: float, *, reached: float | None = None, **more: Any) -> None:
        """A command came: it is noted, and done, to what the terminal has `reached` where that is not `raw`."""
        output = self.outputs.get(terminal)
        if output is not None:
            si = float(output.scale.to_si(raw))
            self._log.note("set", self._name, output=output.name, raw=raw, si=si, **more)
            if not more.get("held"):
                self.give(terminal, raw if reached is None else reached)

    def give(self, terminal: str, raw: float) -> None:
        """A terminal gives this from now on [raw], whoever wants it."""
        output = self.outputs.get(terminal)
        if output is not None and output.quantity == "pressure":
            self._plant.command(float(output.scale.to_si(raw)))

    def switch(self, terminal: str, *, on: bool, **more: Any) -> None:
        """A command for a valve came: it is noted, and done."""
        valve = self.valves.get(terminal)
        if valve is not None:
            self._log.note("switch", self._name, valve=valve.name, on=on, **more)
            if not more.get("held"):
                self.drive(terminal, on=on)

    def drive(self, terminal: str, *, on: bool) -> None:
        """A terminal energises its valve or not, whoever wants it."""
        valve = self.valves.get(terminal)
        if valve is not None:
            self._plant.switch(on=on == (valve.energised == "closed"))
