"""The options of an ILD1420, read strictly; knows no port. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass

from pmabench.base.errors import did_you_mean
from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.ild1420.wire import BITS, SPANS
from pmabench_drivers.options import Reader

BAUDS = (115200, 230400, 256000, 460800, 691200, 921600, 1000000)
INPUT = "distance"


@dataclass(frozen=True)
class Options:
    """What the driver is told about a sensor."""

    span: int = 100
    """Measuring range [mm]."""
    rate: float = 1000.0
    """Measuring rate that the sensor is set to [Hz]."""
    baud: int = 921600


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """The options of a device, and the inputs that its channels use."""
    place, base = ("options",), Options()
    given = reader.keys(device.options, place, ("range", "rate", "baud"), ("range", "rate"))
    if not device.address:
        reader.fault(("address",), 'the path of a serial port is expected, for instance "/dev/ttyUSB0"')
    spans = [f"{span} mm" for span in SPANS]
    span = reader.choice(given, "range", place, spans, "100 mm") if "range" in given else "100 mm"
    baud = reader.whole(given, "baud", place, BAUDS[0], BAUDS[-1], base.baud)
    if baud not in BAUDS:
        reader.fault((*place, "baud"), f"{baud} is none of the sensor's; known: {', '.join(map(str, BAUDS))}")
    rate = reader.quantity(given, "rate", place, "frequency", base.rate, 100.0, 4000.0)
    if rate * BITS > baud:
        reader.fault((*place, "rate"), f"{rate:g} distances a second with their counter need {rate * BITS:g} baud")
    if device.guarded:
        reader.fault((), "a laser only measures; it has no outputs, valves, interlocks or watchdog")
    for channel in device.channels:
        if channel.input != INPUT:
            hint = did_you_mean(channel.input, [INPUT])
            reader.fault(("channels", channel.name, "input"), f'the sensor has no input "{channel.input}"{hint}')
        if channel.raw_unit != "mm":
            reader.fault(("channels", channel.name), f'the sensor gives mm, and the channel has "{channel.raw_unit}"')
    return Options(int(span.removesuffix(" mm")), rate, baud)
