"""What is really wired to each emulated device, and by which scales; not the bench file under test, where it can be.

A truth file (`pmabench.bench.truth`) says it from data sheets, so that a wrong slope, sign or calibration in the bench
file shows. Without one it is derived from the bench's own records: then no scale is proven.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.bench.interface import DeviceRecord
from pmabench.bench.records import Plug, Truth, Wired

PLACES = ("server", "stream_port")
"""Options that say where to listen; they come from the bench file, as the address does."""


def wired(devices: Iterable[DeviceRecord], truth: Truth | None) -> list[Wired]:
    """The devices of a bench as `truth` says; None: as the bench says.

    Of the bench's records only names, addresses and the time of the watchdog are used where there is a truth.
    """
    if truth is None:
        return [_derived(device) for device in devices]
    found = []
    for device in devices:
        if device.name not in truth.devices:
            hint = did_you_mean(device.name, truth.devices)
            raise UsageError(f'{truth.path}: says nothing of the device "{device.name}" of the bench{hint}')
        item = truth.devices[device.name]
        places = {name: device.options[name] for name in PLACES if name in device.options}
        options = {**item.record.options, **places}
        here = replace(item.record, address=device.address, options=options, watchdog=device.watchdog)
        found.append(replace(item, record=here))
    return found


def _derived(device: DeviceRecord) -> Wired:
    """The wiring that the bench's own record says, which proves nothing about it."""
    inputs = {
        item.input: Plug(item.scale, unit=item.raw_unit, low=float(item.scale.to_si(0.0))) for item in device.channels
    }
    outputs = {item.output: Plug(item.scale, unit=item.quantity) for item in device.outputs}
    return Wired(device, inputs, outputs)


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
