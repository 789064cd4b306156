"""Options of the driver `labjack` for a device, read strictly; knows no connection. Standard library only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.labjack.registers import AINS, DACS, LINES, MODELS, SINGLE_ENDED, STREAM_PORT, Model, line_of
from pmabench_drivers.shared.options import Reader

HERE = ("options",)
KNOWN_LINES = "FIO0 to FIO7, EIO0 to EIO7, CIO0 to CIO3, MIO0 to MIO2"
OF_STREAMS = ("stream_port", "differential", "settling", "resolution_index")
"""Options that only a model with a stream has; the others have `rate`."""


@dataclass(frozen=True)
class Input:
    """One channel of the scan list: analogue input, the one that is taken off it, and its range."""

    number: int
    negative: int = SINGLE_ENDED
    gain: int = 0
    span: float = 10.0


@dataclass(frozen=True)
class Options:
    """Everything about one device."""

    host: str = ""
    port: int = 502
    stream_port: int = STREAM_PORT
    inputs: Mapping[str, Input] = field(default_factory=dict)
    """Channel of the bench -> what is sampled for it, in the order of the scan list."""
    settling: float = 0.0
    """Time between two channels [s]; 0: the device's own choice."""
    resolution: int = 0
    """Resolution index of the stream."""
    name: str = "T7"
    rate: float = 100.0
    """Highest rate at which a model without a stream is asked [Hz]."""

    @property
    def model(self) -> Model:
        """Which device it is."""
        return MODELS[self.name]


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """The options of a device and the names that its channels, outputs, valves and interlocks use."""
    given = reader.keys(device.options, HERE, ("model", "ranges", "rate", *OF_STREAMS))
    name = reader.choice(given, "model", HERE, MODELS, "T7")
    model = MODELS[name]
    for key in given:
        if key in OF_STREAMS and not model.streams:
            reader.fault((*HERE, key), f"a {name} is asked for its samples here, and has no {key}")
        elif key == "rate" and model.streams:
            reader.fault((*HERE, key), f"a {name} samples by itself, at the rate of the protocol")
    host, port = reader.host(device, "192.168.0.20", usual=502)
    ranges = _ranges(given, name, reader)
    differential = reader.texts(given, "differential", HERE)
    inputs: dict[str, Input] = {}
    for channel in device.channels:
        place, last = ("channels", channel.name, "input"), list(model.inputs)[-1]
        if not reader.known(place, f"a {name} has no input", channel.input, model.inputs, f"; known: AIN0 to {last}"):
            continue
        number = model.inputs[channel.input]
        if channel.raw_type == "int32":
            reader.fault(place, "gives volts, not counts: calibrate it in V")
        widest = next(iter(model.ranges), "")
        gain, span = model.ranges.get(ranges.get(channel.input, widest), (0, 0.0))
        negative = number + 1 if channel.input in differential else SINGLE_ENDED
        inputs[channel.name] = Input(number, negative, gain, span)
    _used_inputs(device, reader, ranges, differential)
    _outputs(device, name, reader)
    if device.watchdog and device.watchdog < 1.0:
        reader.fault(("watchdog",), "its watchdog counts whole seconds: 1 s or more, and 2 s leave room")
    return Options(
        host,
        port,
        reader.whole(given, "stream_port", HERE, 1, 65535, STREAM_PORT),
        inputs,
        reader.quantity(given, "settling", HERE, "time", 0.0, 1e-6, 4e-3),
        reader.whole(given, "resolution_index", HERE, 0, 8, 0),
        name,
        reader.quantity(given, "rate", HERE, "frequency", 100.0, 0.1, 500.0),
    )


def _ranges(given: Mapping[str, Any], model: str, reader: Reader) -> dict[str, str]:
    place, known = (*HERE, "ranges"), MODELS[model].ranges
    items = reader.named(given.get("ranges", {}), place)
    if items and not known:
        reader.fault(place, f"the ranges of a {model} are not set here")
        return {}
    return {name: reader.choice(items, name, place, known, next(iter(known))) for name in items}


def _used_inputs(
    device: DeviceRecord, reader: Reader, ranges: Mapping[str, str], differential: tuple[str, ...]
) -> None:
    """Every input once, and options only for inputs that are used."""
    used = [channel.input for channel in device.channels]
    for channel in device.channels:
        if used.count(channel.input) > 1:
            reader.fault(("channels", channel.name, "input"), f"{channel.input} is the input of two channels")
    for name in ranges:
        reader.known((*HERE, "ranges", name), "no channel uses", name, used)
    for name in differential:
        number = AINS.get(name)
        if reader.known((*HERE, "differential"), "no channel uses", name, used) and (
            number is not None and (number % 2 or f"AIN{number + 1}" in used)
        ):
            message = f"{name} is measured against AIN{number + 1}: an even input is needed, with the next one free"
            reader.fault((*HERE, "differential"), message)


def _outputs(device: DeviceRecord, name: str, reader: Reader) -> None:
    model = MODELS[name]
    for output in device.outputs:
        place = ("outputs", output.name, "output")
        reader.known(place, "no analogue output", output.output, DACS, "; known: DAC0, DAC1")
        volts = [float(output.scale.to_raw(value)) for value in (output.low, output.high, output.safe)]
        if not all(-1e-9 <= value <= model.dac_full for value in volts):
            needed = f"would need {min(volts):g} V to {max(volts):g} V"
            message = f"{needed}, and the DACs of a {name} give 0 V to {model.dac_full:g} V"
            reader.fault(("outputs", output.name, "scale"), message)
        if output.resolution < 0.99 * model.dac_step:
            step = f'"{1e3 * model.dac_step:.3g} mV"'
            message = f"is at least the step of {model.dac_bits} bits: {step}, or the same in the unit of the scale"
            reader.fault(("outputs", output.name, "resolution"), message)
    places = [(("outputs", valve.name, "output"), valve.output) for valve in device.valves]
    places += [(("interlocks", lock.name, "input"), lock.input) for lock in device.interlocks]
    seen: dict[int, str] = {}
    for place, name in places:
        line = line_of(name)
        if line is None:
            reader.known(place, "no digital line", name, LINES, f"; known: {KNOWN_LINES}")
        elif line in seen:
            reader.fault(place, f"{name} is in use by {seen[line]}")
        else:
            seen[line] = str(place[1])
