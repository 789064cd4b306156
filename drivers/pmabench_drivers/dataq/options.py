"""The options of a DATAQ device, read strictly; knows no port. Standard library only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.dataq.wire import INPUTS, MODELS, Model
from pmabench_drivers.shared.options import Reader

FILTERS = {"last": 0, "average": 1}


@dataclass(frozen=True)
class Options:
    """Options of a device."""

    model: Model = MODELS["DI-2108"]
    ranges: Mapping[str, int] = field(default_factory=dict)
    """Code of each input's range, where it is not the widest."""
    baud: int = 115200
    """Of no meaning on USB."""
    filter: int = 0
    """What becomes of the points between two samples: 0 the last one counts, 1 they are averaged."""

    def span(self, source: str) -> float:
        """Range of an input, to both sides [V]."""
        return float(self.model.ranges[self.ranges.get(source, 0)].removesuffix(" V"))


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """The options of a device, and the inputs that its channels use."""
    place = ("options",)
    given = reader.keys(device.options, place, ("model", "ranges", "filter"), ("model",))
    reader.port(device, "/dev/ttyACM0")
    model = MODELS[reader.choice(given, "model", place, MODELS, "DI-2108")] if "model" in given else MODELS["DI-2108"]
    ranges = reader.keys(given.get("ranges", {}), (*place, "ranges"), INPUTS)
    codes = {
        source: model.ranges.index(reader.choice(ranges, source, (*place, "ranges"), model.ranges, model.ranges[0]))
        for source in ranges
        if source in INPUTS
    }
    chosen = FILTERS[reader.choice(given, "filter", place, FILTERS, "last")]
    if chosen and not model.decimates:
        reader.fault((*place, "filter"), f"a {model.name} has nothing to average: it samples no faster than it sends")
    if device.guarded:
        reader.fault((), "only what this device measures is used; it has no outputs, valves, interlocks or watchdog")
    for channel in device.channels:
        at = ("channels", channel.name)
        reader.known((*at, "input"), "the device has no input", channel.input, INPUTS)
        if channel.raw_unit != "V":
            reader.fault(at, f'the device gives V, and the channel has "{channel.raw_unit}"')
    return Options(model, codes, filter=chosen)


def scan_inputs(device: DeviceRecord) -> list[str]:
    """The inputs that are scanned, each once, in the order of the scan list."""
    used = {channel.input for channel in device.channels}
    return [source for source in INPUTS if source in used]
