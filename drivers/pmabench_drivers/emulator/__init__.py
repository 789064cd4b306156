"""The plant of the mock behind real wires: Modbus TCP on 127.0.0.1, Modbus RTU and serial text on pseudo-terminals.

`plant`: the muscle in real time, and what is wired to a device; `truth`: what is really wired, and what is wrong with
it; `modbus_server`: Modbus devices; `ports`: where emulated devices listen; `faults`: what goes wrong, and what
happened, written down. Each emulated device is next to its driver. Here: the devices of a bench, each on its own wire,
served from one plant; and a socket for loads, faults and the log.

The socket on 127.0.0.1 takes one JSON object a line:
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
from importlib import import_module
from pathlib import Path
from typing import Any

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.bench.interface import DeviceRecord, Truth
from pmabench_drivers.emulator.faults import EVENTS, CommandLog, Kind
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.emulator.ports import accepted, hang_up, refuse_others
from pmabench_drivers.emulator.truth import Errors, apply, wired
from pmabench_drivers.mock.options import ARM

LONGEST = 10_000
NOTHING_TO_SERVE = (
    "the bench has no device whose driver has an emulator; one of driver mock needs none: run it as it is "
    "(`pmabench list benches` shows benches of real devices)"
)
PLANT = ("burst", "regulator_stuck", "supply_lost", "dump_stuck", "e_stop")
"""What can go wrong with the plant."""


class Control:
    """Listens, and hands each object to `act`."""

    def __init__(self, act: Callable[[Mapping[str, Any]], dict[str, Any]], port: int = 0) -> None:
        self._act = act
        self._listener = socket.create_server(("127.0.0.1", port))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, name="control", daemon=True).start()

    def close(self) -> None:
        """Listen no more."""
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
    """The module that the driver's class names as its `emulator`; empty: it has none.

    Its `serve(device, plant, log)` makes the device that the driver talks to. That writes what it exchanges to
    `log.tap(device.name)`, names its faults as `Faults(LINK, ...)` and listens by `ports.listen`. For each event of
    `faults.EVENTS` among its faults it has that method.
    """
    module, _, name = driver.partition(":")
    try:
        return str(getattr(getattr(import_module(module), name), "emulator", "")) if name else ""
    except (ImportError, AttributeError):
        return ""


class Emulator:
    """The devices whose drivers have an emulator, at the addresses that the bench gives them.

    `truth` says what is really wired to them and by which scales, as `pmabench.bench.truth.read_truth` gives it: only
    addresses are then taken from the bench. Without it everything is derived from the bench, and no scale is `proven`.
    `wrong` lists what differs from either, as "scale:force=0.5" or "swap:pressure=force", values in SI
    (`pmabench_drivers.emulator.truth`).
    """

    def __init__(
        self,
        devices: Iterable[DeviceRecord],
        *,
        truth: Truth | None = None,
        wrong: Iterable[str] = (),
        plant: str | Mapping[str, Any] = "paper0",
        preset: str = "bench",
        seed: int = 1,
        log: Path | None = None,
        control: int = 0,
        expose: bool = False,
    ) -> None:
        self.proven = truth is not None
        rig = [item for item in wired(devices, truth) if server_of(item.record.driver)]
        rig, errors, self.wrong = apply(rig, wrong)
        if not (served := [item.record for item in rig]):
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
        """Each emulated device: its `address` and `faults`, `start`, `close`, and what can happen to it."""
        try:
            for device, error in zip(served, errors, strict=True):
                self.devices[device.name] = self._serve(device, error)
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
        """End everything; what was linked is unlinked."""
        self.plant.close()
        for device in self.devices.values():
            device.close()
        if hasattr(self, "control"):
            self.control.close()
        self.log.close()

    def lines(self) -> Sequence[str]:
        """What is served where, a line each."""
        return [f"{name}: {device.address}" for name, device in self.devices.items()]

    def _serve(self, device: DeviceRecord, errors: Errors) -> Any:
        seen = self.plant.seen(errors, proven=self.proven)
        served = import_module(server_of(device.driver)).serve(device, seen, self.log)
        seen.faults = served.faults
        return served

    def kind(self, device: str, fault: str) -> Kind:
        """What a fault of a device is; ValueError where there is no such device or it has no such fault."""
        if device not in self.devices:
            raise ValueError(f'no device "{device}"{did_you_mean(device, self.devices)}')
        return Kind("ends what went wrong") if fault == "clear" else self.devices[device].faults.known(fault)

    def _happen(self, name: str, event: str, value: float) -> None:
        """Let an event happen to a device; ValueError where it cannot happen now."""
        takes = bool(self.kind(name, event).takes)
        if getattr(self.devices[name], EVENTS[event])(*([value] if takes else [])) is False:
            missing = "has no set-point" if event == "setpoint" else "has no armed watchdog"
            raise ValueError(f'"{event}" cannot happen now: {name} {missing}')

    def act(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out one request of the control socket, in SI; ValueError for what cannot be done."""
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
