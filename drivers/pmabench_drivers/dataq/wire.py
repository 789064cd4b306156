"""DATAQ devices: models, options, scans as bytes and their alignment; knows no port. Standard library only.

Source: Data Acquisition Instrument Command Protocol, DATAQ Instruments, 2019. A scan has one word of two bytes for each
entry of the scan list, low byte first, and no mark. So the digital inputs are the last entry of each scan:
their low byte holds D1 and D0 complemented, their high byte D6 to D0, and as long as nothing is switched the word never
changes; where it does, bytes were lost.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.shared.options import Reader

INPUTS = tuple(f"a{number}" for number in range(8))
DIGITAL = 8
"""Entry of the scan list for the digital inputs."""
DIVIDEND = 60_000_000
"""By which `srate` divides [Hz]."""
SLOWEST = 65535
"""Largest `srate`."""
FASTEST = 6000
"""Smallest `srate` that is used here: 10 kHz for each input."""
MOST_DEC = 512
OVERRUN = b"stop 01"
"""What the device sends last when its buffer has run over."""
LATENCY = 0.02
"""A USB packet is filled within this, where the smallest one allows [s]."""
FILTERS = {"last": 0, "average": 1}


@dataclass(frozen=True)
class Model:
    """What one kind of device can do."""

    name: str
    ranges: tuple[str, ...]
    """Ranges (+-) in the order of their codes in the scan list."""
    shift: int = 0
    """Bits at the low end that are no data."""
    decimates: bool = True


MODELS = {
    model.name: model
    for model in (
        Model("DI-2108", ("10 V",)),
        Model("DI-4108", ("10 V", "5 V", "2 V", "1 V", "0.5 V", "0.2 V")),
        Model("DI-1110", ("10 V",), shift=4, decimates=False),
    )
}


def divisors(model: Model, rate: float, dividend: int) -> tuple[int, int]:
    """`srate` and `dec` for the rate nearest to the one that is asked for [Hz]; without `dec` never under 915.5 Hz."""
    wanted = dividend / rate

    def off(dec: int) -> tuple[float, int]:
        return abs(_srate(wanted, dec) * dec - wanted), -dec

    dec = min(range(1, MOST_DEC + 1 if model.decimates else 2), key=off)
    return _srate(wanted, dec), dec


def _srate(wanted: float, dec: int) -> int:
    return min(max(round(wanted / dec), FASTEST), SLOWEST)


def packet(bytes_per_second: float) -> int:
    """The largest `ps` whose packet, 16 << ps bytes, fills within LATENCY; 0 where none does."""
    return max((n for n in range(8) if 16 << n <= LATENCY * bytes_per_second), default=0)


def volts(model: Model, span: float, raw: int) -> float:
    """An analogue word [counts with sign] as volts, at a range of +-`span` [V]."""
    return span * (raw >> model.shift) / (32768 >> model.shift)


def counts(model: Model, span: float, value: float) -> int:
    """Volts as the device sends them."""
    full = 32768 >> model.shift
    return min(max(round(value / span * full), -full), full - 1) << model.shift


def plausible(word: int) -> bool:
    """Whether a word can be that of the digital inputs: D1 and D0 are in it twice, and there is no D7."""
    low, high = word & 0xFF, word >> 8 & 0xFF
    return high < 0x80 and low & 3 == ~high & 3


class Lost(Exception):
    """Bytes are missing or too many: what follows cannot be separated."""


class Scans:
    """Cuts a stream into scans of `inputs` words and the digital inputs; raises Lost at the first scan that is broken.

    What stood whole before is in `whole` also then.
    """

    def __init__(self, inputs: int) -> None:
        self._words = struct.Struct(f"<{inputs}hH")
        self._rest = b""
        self._digital: int | None = None
        self.whole: list[tuple[int, ...]] = []

    def feed(self, data: bytes) -> list[tuple[int, ...]]:
        """The analogue words of the scans that end in `data`."""
        self.whole = []
        self._rest += data
        size, at = self._words.size, 0
        while at + size <= len(self._rest):
            *analog, digital = self._words.unpack_from(self._rest, at)
            at += size
            if self._digital is None and plausible(digital):
                self._digital = digital
            if digital != self._digital:
                self._rest = b""
                raise Lost
            self.whole.append(tuple(analog))
        self._rest = self._rest[at:]
        if self._rest.endswith(OVERRUN):
            raise Lost
        return self.whole


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
