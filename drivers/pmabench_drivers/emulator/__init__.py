"""The plant of the mock behind real wires: Modbus TCP on 127.0.0.1, Modbus RTU and serial text on pseudo-terminals.

`plant`: the muscle in real time, and the wiring of a device; `modbus_server`: Modbus devices; `ports`: addresses of
emulated devices; `faults`: faults, and the log. Each emulated device is next to its driver. Here: the devices of a
bench, each on its own wire, served from one plant; and a control socket for loads, faults and the log.

The socket on 127.0.0.1 takes one JSON object per line:
`{"load": {"force": 58.86, "mass": 6}}`, `{"device": "regulator", "fault": "delay", "value": 0.3, "count": 5}`,
`{"plant": "burst"}` (a fault of the mock; `"over": true` ends it), `{"log": "set"}`. Each is answered by one line,
`{"ok": true, ...}` or `{"ok": false, "why": "..."}`.
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.bench.interface import DeviceRecord, Truth
from pmabench_drivers.emulator.faults import EVENTS, CommandLog, Kind
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import accepted, hang_up, refuse_others
from pmabench_drivers.mock.options import ARM

LONGEST = 10_000
NOTHING_TO_SERVE = (
    "the bench has no device whose driver has an emulator; one of driver mock needs none: run it as it is "
    "(`pmabench list benches` shows benches of real devices)"
)
PLANT = ("burst", "regulator_stuck", "supply_lost", "dump_stuck", "e_stop")
"""Possible faults of the plant."""
PLACES = ("server", "stream_port")
"""Options with addresses for listening; they come from the bench file, as the address does."""


def wired(devices: Iterable[DeviceRecord], truth: Truth | None) -> list[DeviceRecord]:
    """The devices of a bench as described by `truth`; without it, by the bench, which proves nothing about it.

    With a truth, only names, addresses and watchdog times are taken from the bench's records.
    """
    if truth is None:
        return list(devices)
    found = []
    for device in devices:
        if device.name not in truth.devices:
            hint = did_you_mean(device.name, truth.devices)
            raise UsageError(f'{truth.path}: says nothing of the device "{device.name}" of the bench{hint}')
        real = truth.devices[device.name]
        options = {**real.options, **{name: device.options[name] for name in PLACES if name in device.options}}
        found.append(replace(real, address=device.address, options=options, watchdog=device.watchdog))
    return found


class Control:
    """Listens for requests, and calls `act` with each object."""

    def __init__(self, act: Callable[[Mapping[str, Any]], dict[str, Any]], port: int = 0) -> None:
        self._act = act
        self._listener = socket.create_server(("127.0.0.1", port))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, name="control", daemon=True).start()

    def close(self) -> None:
        """Stop listening."""
        hang_up(self._listener)

    def _accept(self) -> None:
        for connection in accepted(self._listener):
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError), connection.makefile("rwb") as stream:
            while line := stream.readline(LONGEST):
                try:
                    wanted = json.loads(line)
                    if not isinstance(wanted, dict):
                        raise ValueError("an object is expected")
                    reply = {"ok": True, **self._act(wanted)}
                except (ValueError, TypeError, KeyError, RecursionError) as error:
                    reply = {"ok": False, "why": str(error)}
                stream.write(json.dumps(reply).encode() + b"\n")
                stream.flush()


def server_of(driver: str) -> str:
    """The module in the `emulator` attribute of the driver's class; empty without one.

    Its `serve(device, plant, log)` makes the device that the driver talks to. That device writes what it exchanges to
    `log.tap(device.name)`, declares its faults as `Faults(LINK, ...)` and listens by `ports.listen`. For each event of
    `faults.EVENTS` among its faults it has the method named there.
    """
    module, _, name = driver.partition(":")
    try:
        return str(getattr(getattr(import_module(module), name), "emulator", "")) if name else ""
    except (ImportError, AttributeError):
        return ""


class Emulator:
    """The devices whose drivers have an emulator, at their addresses in the bench.

    `truth` is the actual wiring and scales, from `pmabench.bench.truth.read_truth`; the bench then only gives the
    addresses. Without it everything is derived from the bench, and no scale is `proven`.
    """

    def __init__(
        self,
        devices: Iterable[DeviceRecord],
        *,
        truth: Truth | None = None,
        plant: str | Mapping[str, Any] = "paper0",
        preset: str = "bench",
        seed: int = 1,
        log: Path | None = None,
        control: int = 0,
        expose: bool = False,
    ) -> None:
        self.proven = truth is not None
        if not (served := [device for device in wired(devices, truth) if server_of(device.driver)]):
            raise UsageError(NOTHING_TO_SERVE)
        if not expose:
            for device in served:
                refuse_others(device.name, device.address)
        if plant != ARM and any(channel.quantity == "angle" for device in served for channel in device.channels):
            raise UsageError(f'the bench measures an angle, and only the plant "{ARM}" has one: give --plant {ARM}')
        driven = any(output.quantity == "length" for device in served for output in device.outputs)
        valve = any(device.valves for device in served)
        self.plant_faults = PLANT
        self.plant = RealPlant(plant, preset, dump_valve=valve, driven=driven, seed=seed)
        self.log = CommandLog(log)
        self.devices: dict[str, Any] = {}
        """Each emulated device, with `address`, `faults`, `start`, `close`, and methods for its events."""
        try:
            for device in served:
                self.devices[device.name] = self._serve(device)
            self.control = Control(self.act, control)
        except (OSError, UsageError) as error:
            self.close()
            if isinstance(error, UsageError):
                raise
            raise UsageError(f"cannot serve: {error.strerror or error}") from None
        for item in self.devices.values():
            item.start()
        self.plant.keep_up()

    def close(self) -> None:
        """Stop everything; removes symbolic links."""
        self.plant.close()
        for device in self.devices.values():
            device.close()
        if hasattr(self, "control"):
            self.control.close()
        self.log.close()

    def lines(self) -> Sequence[str]:
        """One line for each served device, with its address."""
        return [f"{name}: {device.address}" for name, device in self.devices.items()]

    def _serve(self, device: DeviceRecord) -> Any:
        seen = self.plant.seen(proven=self.proven)
        served = import_module(server_of(device.driver)).serve(device, seen, self.log)
        seen.faults = served.faults
        return served

    def kind(self, device: str, fault: str) -> Kind:
        """Description of a fault of a device; ValueError if there is no such device or fault."""
        if device not in self.devices:
            raise ValueError(f'no device "{device}"{did_you_mean(device, self.devices)}')
        return Kind("ends what went wrong") if fault == "clear" else self.devices[device].faults.known(fault)

    def _happen(self, name: str, event: str, value: float) -> None:
        """Cause an event in a device; ValueError if it is not possible now."""
        takes = bool(self.kind(name, event).takes)
        if getattr(self.devices[name], EVENTS[event])(*([value] if takes else [])) is False:
            missing = "has no set-point" if event == "setpoint" else "has no armed watchdog"
            raise ValueError(f'"{event}" cannot happen now: {name} {missing}')

    def act(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out one request of the control socket, in SI; ValueError if that is not possible."""
        if "load" in wanted:
            force, mass = float(wanted["load"]["force"]), float(wanted["load"]["mass"])
            self.plant.load(force, mass)
            self.log.note("load", "", force=force, mass=mass)
        elif "plant" in wanted:
            fault, over = str(wanted["plant"]), bool(wanted.get("over", False))
            if fault not in PLANT:
                raise ValueError(f'no fault of the plant "{fault}"{did_you_mean(fault, PLANT)}')
            self.plant.fail(f"{fault}_at", over=over)
            self.log.note("plant", "", fault=fault, over=over)
        elif "fault" in wanted:
            name, fault = str(wanted.get("device")), str(wanted["fault"])
            value, count = wanted.get("value"), int(wanted.get("count", -1))
            value = self.kind(name, fault).usual if value is None else float(value)
            if hasattr(self.devices[name], EVENTS.get(fault, " ")):
                self._happen(name, fault, value)
            else:
                self.devices[name].faults.set(fault, value, count)
            self.log.note("fault", name, fault=fault, value=value, count=count)
        elif "log" in wanted:
            return {"entries": self.log.of(str(wanted["log"]))}
        else:
            raise ValueError('one of "load", "plant", "fault", "log" is expected')
        return {}
