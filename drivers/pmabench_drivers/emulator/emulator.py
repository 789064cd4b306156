"""Serves the devices of a bench, each on its own wire, from one plant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.emulator.control import Control
from pmabench_drivers.emulator.faults import Faults as LinkFaults
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.mock.options import Faults

SERVERS = {
    "pmabench_drivers.festo_cpx_e:FestoCpxE": "pmabench_drivers.festo_cpx_e.emulated",
    "pmabench_drivers.alicat:AlicatController": "pmabench_drivers.alicat.emulator",
    "pmabench_drivers.dataq:Dataq": "pmabench_drivers.dataq.emulator",
    "pmabench_drivers.ild1420:Ild1420": "pmabench_drivers.ild1420.emulator",
    "pmabench_drivers.labjack:LabJack": "pmabench_drivers.labjack.emulated",
    "pmabench_drivers.modbus:ModbusDevice": "pmabench_drivers.emulator.modbus_server",
    "pmabench_drivers.serial_ascii:SerialIndicator": "pmabench_drivers.emulator.indicator",
    "pmabench_drivers.serial_line_daq:SerialLineDaq": "pmabench_drivers.serial_line_daq.emulator",
}
"""Driver -> the module whose `serve(device, plant, log)` makes the device that it talks to."""


class Served(Protocol):
    """One emulated device at its address."""

    address: str
    faults: LinkFaults

    def start(self) -> None:
        """Begin to serve."""

    def close(self) -> None:
        """Hang up."""


class Emulator:
    """The devices whose drivers have an emulator, at the addresses that the bench gives them."""

    def __init__(
        self,
        devices: Iterable[DeviceRecord],
        *,
        plant: str = "paper0",
        preset: str = "bench",
        seed: int = 1,
        log: Path | None = None,
        control: int = 0,
    ) -> None:
        served = [device for device in devices if device.driver in SERVERS]
        if not served:
            raise UsageError("the bench has no device whose driver has an emulator, as modbus and serial-ascii have")
        driven = any(output.quantity == "length" for device in served for output in device.outputs)
        valve = any(device.valves for device in served)
        self.plant = RealPlant(plant, preset, dump_valve=valve, driven=driven, seed=seed)
        self.log = CommandLog(log)
        self.devices: dict[str, Served] = {}
        try:
            for device in served:
                self.devices[device.name] = self._serve(device)
            self.control = Control(self._act, control)
        except (OSError, UsageError) as error:
            self.close()
            if isinstance(error, UsageError):
                raise
            raise UsageError(f"cannot serve: {error.strerror or error}") from None
        for item in self.devices.values():
            item.start()

    def close(self) -> None:
        """End everything; what was linked is unlinked."""
        for device in self.devices.values():
            device.close()
        if hasattr(self, "control"):
            self.control.close()
        self.log.close()

    def lines(self) -> Sequence[str]:
        """What is served where, a line each."""
        return [f"{name}: {device.address}" for name, device in self.devices.items()]

    def _serve(self, device: DeviceRecord) -> Served:
        return cast(Served, import_module(SERVERS[device.driver]).serve(device, self.plant, self.log))

    def _act(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """What the control socket asks for."""
        if "load" in wanted:
            force, mass = float(wanted["load"]["force"]), float(wanted["load"]["mass"])
            self.plant.load(force, mass)
        elif "plant" in wanted:
            fault, known = f"{wanted['plant']}_at", [item.name for item in fields(Faults)]
            if fault not in known:
                hint = did_you_mean(str(wanted["plant"]), [name.removesuffix("_at") for name in known])
                raise ValueError(f'no fault "{wanted["plant"]}"{hint}')
            self.plant.fail(fault, over=bool(wanted.get("over", False)))
        elif "fault" in wanted:
            name = str(wanted.get("device"))
            if name not in self.devices:
                raise ValueError(f'no device "{name}"{did_you_mean(name, self.devices)}')
            value, number = float(wanted.get("value", 0.0)), int(wanted.get("count", -1))
            self.devices[name].faults.set(str(wanted["fault"]), value, number)
        elif "log" in wanted:
            return {"entries": self.log.of(str(wanted["log"]))}
        else:
            raise ValueError('one of "load", "plant", "fault", "log" is expected')
        return {}
