"""The options of an ILD1420, read strictly; knows no port. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.ild1420.wire import BITS, SPANS
from pmabench_drivers.shared.options import Reader

BAUDS = (115200, 230400, 256000, 460800, 691200, 921600, 1000000)
INPUT = "distance"


@dataclass(frozen=True)
class Options:
    """Options of a sensor."""

    span: int = 100
    """Measuring range [mm]."""
    rate: float = 1000.0
    """Measuring rate that the sensor is set to [Hz]."""
    baud: int = 921600


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """The options of a device, and the inputs that its channels use."""
    place, base = ("options",), Options()
    given = reader.keys(device.options, place, ("range", "rate", "baud"), ("range", "rate"))
    reader.port(device, "/dev/ttyUSB0")
    spans = [f"{span} mm" for span in SPANS]
    span = reader.choice(given, "range", place, spans, "100 mm") if "range" in given else "100 mm"
    baud = reader.one_of(given, "baud", place, BAUDS, base.baud)
    rate = reader.quantity(given, "rate", place, "frequency", base.rate, 100.0, 4000.0)
    if rate * BITS > baud:
        reader.fault((*place, "rate"), f"{rate:g} distances a second with their counter need {rate * BITS:g} baud")
    if device.guarded:
        reader.fault((), "a laser only measures; it has no outputs, valves, interlocks or watchdog")
    for channel in device.channels:
        at = ("channels", channel.name)
        reader.known((*at, "input"), "the sensor has no input", channel.input, [INPUT])
        if channel.raw_unit != "mm":
            reader.fault(at, f'the sensor gives mm, and the channel has "{channel.raw_unit}"')
    return Options(int(span.removesuffix(" mm")), rate, baud)
