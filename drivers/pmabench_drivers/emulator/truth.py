"""What is really wired to each emulated device, and by which scales; not the bench file under test, where it can be.

A truth file (`pmabench.bench.truth`) says it from data sheets, so that a wrong slope, sign or calibration in the bench
file shows. Without one it is derived from the bench's own records: then no scale is proven.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale, ValveRecord

PLACES = ("server", "stream_port")
"""Options that say where to listen; they come from the bench file, as the address does."""
ENDLESS = 1e9


@dataclass(frozen=True)
class Plug:
    """What is plugged into one terminal: a sensor or an actuator with its signal, and how the terminal shows that."""

    sensor: Scale
    """Signal to SI."""
    digits: Scale = field(default_factory=Scale)
    """What the device gives or takes to the signal."""
    unit: str = ""
    """Of the signal: only plugs with the same one fit into each other's terminals."""
    low: float = 0.0
    """Where the range of the sensor begins [SI]."""

    @property
    def scale(self) -> Scale:
        """What the device gives or takes to SI."""
        return Scale(self.sensor.slope * self.digits.slope, self.sensor.slope * self.digits.offset + self.sensor.offset)


@dataclass(frozen=True)
class Wired:
    """One device as it is really wired: a record for its emulator, and the plugs by terminal."""

    record: DeviceRecord
    inputs: Mapping[str, Plug]
    outputs: Mapping[str, Plug]


def derived(device: DeviceRecord) -> Wired:
    """The wiring that the bench's own record says, which proves nothing about it."""
    inputs = {
        item.input: Plug(item.scale, unit=item.raw_unit, low=float(item.scale.to_si(0.0))) for item in device.channels
    }
    outputs = {item.output: Plug(item.scale, unit=item.quantity) for item in device.outputs}
    return Wired(device, inputs, outputs)


def wired(devices: Iterable[DeviceRecord], truth: Mapping[str, Any] | None) -> list[Wired]:
    """The devices of a bench as `truth` says, which is what `pmabench.bench.truth` reads; None: as the bench says.

    Of the bench's records only names, addresses and the time of the watchdog are used where there is a truth.
    """
    if truth is None:
        return [derived(device) for device in devices]
    known = truth["devices"]
    found = []
    for device in devices:
        if device.name not in known:
            hint = did_you_mean(device.name, known)
            raise UsageError(f'{truth["path"]}: says nothing of the device "{device.name}"{hint}')
        found.append(_of_truth(device, known[device.name]))
    return found


def _of_truth(device: DeviceRecord, said: Mapping[str, Any]) -> Wired:
    """The record of one device of a truth file, at the address of the bench."""
    inputs = {terminal: _plug(item) for terminal, item in said["inputs"].items()}
    outputs = {terminal: _plug(item) for terminal, item in said["outputs"].items()}
    places = {name: device.options[name] for name in PLACES if name in device.options}
    record = DeviceRecord(
        device.name,
        said["driver"],
        device.address,
        {**said["options"], **places},
        tuple(
            ChannelRecord(
                item["is"],
                item["quantity"],
                device.name,
                terminal,
                "int32" if item["raw_unit"] == "count" else "float64",
                item["raw_unit"],
                inputs[terminal].scale,
                -ENDLESS,
                ENDLESS,
            )
            for terminal, item in said["inputs"].items()
        ),
        tuple(
            OutputRecord(
                item["is"],
                item["quantity"],
                device.name,
                terminal,
                outputs[terminal].scale,
                item["step"],
                0.0,
                item["range"][0],
                item["range"][1],
                rate=ENDLESS,
            )
            for terminal, item in said["outputs"].items()
        ),
        tuple(ValveRecord(v["is"], device.name, terminal, v["energised"]) for terminal, v in said["valves"].items()),
        tuple(InterlockRecord(c["is"], device.name, at, c["released"]) for at, c in said["contacts"].items()),
        watchdog=device.watchdog,
    )
    return Wired(record, inputs, outputs)


def _plug(said: Mapping[str, Any]) -> Plug:
    return Plug(Scale(*said["sensor"]), Scale(*said["device"]), said["unit"], said["low"])


def moved(item: Wired, *, inputs: Mapping[str, str] | None = None, outputs: Mapping[str, str] | None = None) -> Wired:
    """The same device with plugs in other terminals: where each of them was -> where it is now."""
    inputs, outputs = inputs or {}, outputs or {}
    record = item.record
    channels = tuple(
        replace(c, input=inputs[c.input], scale=_in(item.inputs, c.input, inputs[c.input]).scale)
        if c.input in inputs
        else c
        for c in record.channels
    )
    driven = tuple(
        replace(o, output=outputs[o.output], scale=_in(item.outputs, o.output, outputs[o.output]).scale)
        if o.output in outputs
        else o
        for o in record.outputs
    )
    valves = tuple(replace(v, output=outputs.get(v.output, v.output)) for v in record.valves)
    return Wired(
        replace(record, channels=channels, outputs=driven, valves=valves),
        {inputs.get(at, at): _in(item.inputs, at, inputs.get(at, at)) for at in item.inputs},
        {outputs.get(at, at): _in(item.outputs, at, outputs.get(at, at)) for at in item.outputs},
    )


def _in(plugs: Mapping[str, Plug], was: str, now: str) -> Plug:
    """A plug in another terminal: its sensor, and the digits of that terminal."""
    return replace(plugs[was], digits=plugs.get(now, plugs[was]).digits)
