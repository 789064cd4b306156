"""Options of the driver `ni-daqmx` for a device, read strictly; uses no connection. Standard library only."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.shared.options import Place, Reader, option

HERE = ("options",)
TERMINALS = ("RSE", "NRSE", "DIFF")
"""Reference of an input: the device's ground, AI SENSE, the input eight higher."""
RANGES = {"10 V": 10.0, "5 V": 5.0, "1 V": 1.0, "0.2 V": 0.2}
"""Range to both sides [V]."""
PAIR = 8
"""Offset of the second input of a differential pair (NI-DAQmx, physical channels of M Series)."""
AI = tuple(f"ai{number}" for number in range(32))
AO = ("ao0", "ao1")
LINES = {f"port{port}/line{line}": 8 * port + line for port in range(2) for line in range(8)}
PORT = 31763
"""Default port of NI's gRPC server."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")
_SERVER = re.compile(r"([A-Za-z0-9][A-Za-z0-9.-]{0,251})(?::(\d{1,5}))?")


@dataclass(frozen=True)
class Input:
    """One analogue input of the scan."""

    name: str
    terminal: str = "RSE"
    span: float = 10.0
    """Range to both sides [V]."""


@dataclass(frozen=True)
class Output:
    """One analogue output."""

    low: float
    high: float
    """Lowest and highest commanded voltage [V]."""
    step: float
    """Resolution in the bench file [V]."""


def _server(reader: Reader, given: Mapping[str, Any], key: str, place: Place) -> str:
    """`host:port`, with the default port if none is given."""
    text = reader.text(given, key, place)
    match = _SERVER.fullmatch(text)
    if text and (match is None or int(match[2] or PORT) > 65535):
        reader.fault((*place, key), f'HOST or HOST:PORT is expected, for instance "192.168.0.30:{PORT}"')
        return ""
    return f"{match[1]}:{match[2] or PORT}" if match else ""


@dataclass(frozen=True)
class Options:
    """Options of one device."""

    device: str = ""
    """Its name in NI-DAQmx."""
    server: str = option(_server)
    """`host:port` of NI's gRPC server; empty if NI-DAQmx is on this computer."""
    inputs: Mapping[str, Input] = field(default_factory=dict)
    """Channel of the bench -> its input."""
    outputs: Mapping[str, Output] = field(default_factory=dict)
    valves: tuple[str, ...] = ()
    """Lines of the valves."""
    levels: tuple[str, ...] = ()
    """Lines of the interlocks."""


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device; also checks the names that its channels, outputs, valves and interlocks use."""
    options, given = reader.options(Options, device.options, HERE, ("terminals", "ranges"))
    if not _NAME.fullmatch(device.address):
        reader.fault(("address",), f'the name in NI-DAQmx is expected, for instance "Dev1", not "{device.address}"')
    terminals = reader.choices(given, "terminals", HERE, TERMINALS)
    ranges = reader.choices(given, "ranges", HERE, RANGES)
    inputs: dict[str, Input] = {}
    for channel in device.channels:
        place = ("channels", channel.name, "input")
        if not reader.known(place, "no input", channel.input, AI, "; known: ai0 to ai31"):
            continue
        if channel.raw_unit != "V":
            reader.fault(place, f'gives V, and the channel has "{channel.raw_unit}": calibrate it in V')
        span = RANGES[ranges.get(channel.input, "10 V")]
        inputs[channel.name] = Input(channel.input, terminals.get(channel.input, "RSE"), span)
    _each_once(device, inputs, reader)
    for key, chosen in (("terminals", terminals), ("ranges", ranges)):
        used = [item.name for item in inputs.values()]
        for name in chosen:
            reader.known((*HERE, key, name), "no channel uses", name, used)
    if device.watchdog:
        what = "NI-DAQmx has none for the outputs of such a device, which hold their last value when the computer dies"
        remedy = 'give "no_watchdog" with who accepts it, and a normally-open dump valve that needs a live signal'
        reader.fault(("watchdog",), f"{what}: {remedy}")
    reader.lines(device, LINES, "; known: port0/line0 to port1/line7")
    return replace(
        options,
        device=device.address,
        inputs=inputs,
        outputs=_outputs(device, reader),
        valves=tuple(valve.output for valve in device.valves),
        levels=tuple(lock.input for lock in device.interlocks),
    )


def _each_once(device: DeviceRecord, inputs: Mapping[str, Input], reader: Reader) -> None:
    """Check that no two channels use a terminal, and that differential inputs have a second input."""
    taken: dict[str, str] = {}
    for channel, item in inputs.items():
        place: Place = ("channels", channel, "input")
        ends = [item.name]
        if item.terminal == "DIFF":
            number = AI.index(item.name)
            if number % (2 * PAIR) >= PAIR:
                message = f"{item.name} cannot be measured differentially: ai0 to ai7 (and ai16 to ai23) can, each "
                reader.fault(place, f"{message}against the input eight higher")
                continue
            ends.append(AI[number + PAIR])
        for end in ends:
            if end in taken:
                reader.fault(place, f"{end} is in use by {taken[end]}")
            taken.setdefault(end, channel)


def _outputs(device: DeviceRecord, reader: Reader) -> dict[str, Output]:
    found: dict[str, Output] = {}
    for output in device.outputs:
        place = ("outputs", output.name, "output")
        if not reader.known(place, "no analogue output", output.output, AO, "; known: ao0, ao1"):
            continue
        volts = [float(output.scale.to_raw(value)) for value in (output.low, output.high, output.safe)]
        found[output.output] = Output(min(volts), max(volts), output.resolution)
        if not all(-10.0 - 1e-9 <= value <= 10.0 + 1e-9 for value in volts):
            message = f"would need {min(volts):g} V to {max(volts):g} V, and the outputs give -10 V to 10 V"
            reader.fault(("outputs", output.name, "scale"), message)
        if not output.resolution:
            message = 'the step of the output is missing: "0.000306 V" for 16 bits over -10 V to 10 V'
            reader.fault(("outputs", output.name, "resolution"), message)
    return found
