"""LabJack T4, T7 and T8: their registers, numbers as words, and the options of a bench file; uses no connection.

Addresses and types: the maker's public register table (LabJack/ljm_constants, version 2025.12.18). 32-bit values take
two registers, the high word first. Standard library only.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.modbus.registers import Mapped, Register, RegisterMap
from pmabench_drivers.shared.options import Reader, option

TEST, TEST_VALUE = 55100, 0x00112233
PRODUCT_ID, FIRMWARE_VERSION, SERIAL_NUMBER = 60000, 60004, 60028
EMULATED, UNPROVEN = 0, 1
"""Serial numbers of emulated devices: with a truth file of wiring and scales, and without."""
LAST_ERR_DETAIL = 55000
RESET_CAUSE, RTC_TIME = 60014, 61500
"""Cause of the last restart, as bits; clock [s], from power-on or of the day."""
TIME_OF_DAY = 1_000_000_000
"""A clock beyond this counts from 1970: no device has been on for 30 years."""

DAC = 1000
"""DAC0 [V]; DAC1 is two registers on."""
DACS = ("DAC0", "DAC1")

DIO = 2000
"""FIO0, one register per line: writing makes it an output, reading an input."""
DIO_STATE, DIO_DIRECTION = 2800, 2850
"""Present state of all lines as bits; reading changes nothing."""
LINES = {
    **{f"FIO{i}": i for i in range(8)},
    **{f"EIO{i}": 8 + i for i in range(8)},
    **{f"CIO{i}": 16 + i for i in range(4)},
    **{f"MIO{i}": 20 + i for i in range(3)},
}
"""Name of a digital line -> its number."""
LINES_BY_NAME = LINES | {f"DIO{i}": i for i in range(len(LINES))}
"""The same by both of its names."""
ALL_LINES = (1 << 23) - 1

AINS = {f"AIN{i}": i for i in range(14)}
AIN_RANGE, AIN_NEGATIVE = 40000, 41000
SINGLE_ENDED = 199
CAPTURE = 650
"""T8: AIN0 when any input was last read [V]; the next input is two registers on."""
RANGES = {"10 V": (0, 10.0), "1 V": (1, 1.0), "0.1 V": (2, 0.1), "0.01 V": (3, 0.01)}
"""T7: name of the range -> index of its gain, and the range [V]."""
T8_SPANS = (11, 9.6, 4.8, 2.4, 1.2, 0.6, 0.3, 0.15, 0.075, 0.036, 0.018)
STREAM_SCANRATE = 4002
STREAM_CONFIGURATION = ("scan rate", "addresses", "samples a packet", "settling", "resolution", "buffer", "clock")
"""Values from `STREAM_SCANRATE` on, two registers each; the clock source is left at 0, the device's own."""
STREAM_AUTO_TARGET, TO_ETHERNET = 4016, 1
"""Then the data type, which must be 0, and the number of scans (0: no end)."""
STREAM_SCANLIST = 4100
STREAM_ENABLE = 4990
STREAM_PORT = 702
STREAM_BUFFER = 32768
"""Largest buffer of a T7 [bytes]: two bytes per sample."""
MOST_SAMPLES = 512
"""Largest number of samples in a packet."""
FASTEST = 100_000.0
"""Samples a second, over all channels, at resolution index 0 or 1 and the range of 10 V."""
WATCHDOG_ENABLE, WATCHDOG_ADVANCED, WATCHDOG_TIMEOUT = 61600, 61602, 61604
WATCHDOG_STRICT, WATCHDOG_KEY, WATCHDOG_CLEAR = 61610, 61612, 61614
WATCHDOG_RESET = 61620
WATCHDOG_DIO_ENABLE, WATCHDOG_DIO_STATE, WATCHDOG_DIO_DIRECTION, WATCHDOG_DIO_INHIBIT = 61630, 61632, 61634, 61636
WATCHDOG_DAC_ENABLE, WATCHDOG_DAC = (61640, 61650), (61642, 61652)
FLASH_POINTER, FLASH_READ = 61810, 61812
ERRORS = {
    2370: "this range of an analogue input does not exist",
    2373: "this negative channel does not exist",
    2375: "this resolution index does not exist",
    2605: "not while a stream runs",
    2608: "the scan rate is out of range",
    2620: "no stream runs",
    2621: "the settling time is wrong",
    2625: "a channel cannot be streamed",
    2670: "the watchdog's time is too short",
    2671: "the watchdog is on; it must be off while it is set",
    2672: "the watchdog's digital lines are set wrong",
    2673: "the watchdog's DAC0 is set wrong",
    2674: "the watchdog's DAC1 is set wrong",
}
"""LabJack's own error code -> meaning, for those that what is written here may meet."""
HERE = ("options",)
TIMEOUT = 0.15
"""Longest wait for an answer [s]."""
KNOWN_LINES = "FIO0 to FIO7, EIO0 to EIO7, CIO0 to CIO3, MIO0 to MIO2"
OF_STREAMS = ("stream_port", "differential", "settling", "resolution_index")
"""Options that only a model with a stream has; the others have `rate`."""


@dataclass(frozen=True)
class Model:
    """Differences between the models."""

    product: float
    """Value of `PRODUCT_ID`."""
    dac_full: float
    """Highest voltage of the DACs [V]."""
    dac_bits: int
    inputs: Mapping[str, int]
    ranges: Mapping[str, tuple[int, float]] = field(default_factory=dict)
    """Ranges of the inputs, the widest first; empty if they cannot be set here."""
    restart_cause_from: float = 0.0
    """Lowest firmware version that reports the cause of its last restart."""
    streams: bool = False
    """Whether it is read by its stream, or for each sample."""
    captures: bool = False
    """Whether reading one input captures all of them at that moment."""

    @property
    def dac_step(self) -> float:
        """Smallest step of the DACs [V]."""
        return self.dac_full / (1 << self.dac_bits)


MODELS = {
    "T4": Model(4.0, 5.0, 10, {f"AIN{i}": i for i in range(12)}, restart_cause_from=1.0023),
    "T7": Model(7.0, 5.0, 12, AINS, RANGES, restart_cause_from=1.0281, streams=True),
    "T8": Model(
        8.0, 10.0, 16, {f"AIN{i}": i for i in range(8)}, {f"{v:g} V": (0, float(v)) for v in T8_SPANS}, captures=True
    ),
}


def u32(*values: int) -> list[int]:
    """Words of integers."""
    return [word for value in values for word in (value >> 16 & 0xFFFF, value & 0xFFFF)]


def f32(*values: float) -> list[int]:
    """Words of numbers in single precision."""
    return list(struct.unpack(f">{2 * len(values)}H", struct.pack(f">{len(values)}f", *values)))


def from_u32(words: Sequence[int]) -> list[int]:
    """Integers in pairs of words."""
    return [words[i] << 16 | words[i + 1] for i in range(0, len(words) - 1, 2)]


def from_f32(words: Iterable[int]) -> list[float]:
    """Single-precision numbers in pairs of words."""
    data = b"".join(word.to_bytes(2, "big") for word in words)
    return list(struct.unpack(f">{len(data) // 4}f", data))


def line_of(name: str) -> int | None:
    """The number of a digital line by its name (`FIO0`, `EIO3`, `CIO1`, `MIO2`, or `DIO11`), or None."""
    return LINES_BY_NAME.get(name)


@dataclass(frozen=True)
class Input:
    """One channel of the scan list: analogue input, its negative input, and its range."""

    number: int
    negative: int = SINGLE_ENDED
    gain: int = 0
    span: float = 10.0


@dataclass(frozen=True)
class Options(Mapped):
    """Options of one device; its map has outputs, lines and inputs that are read: no stream, no watchdog."""

    model: str = option(Reader.choice, MODELS, "T7")
    host: str = ""
    port: int = 502
    rate: float = option(Reader.quantity, "frequency", 100.0, 0.1, 500.0)
    differential: tuple[str, ...] = option(Reader.texts)
    stream_port: int = option(Reader.whole, 1, 65535, STREAM_PORT)
    inputs: Mapping[str, Input] = field(default_factory=dict)
    """Channel of the bench -> its input, in the order of the scan list."""
    settling: float = option(Reader.quantity, "time", 0.0, 1e-6, 4e-3)
    """Time between two channels [s]; 0: the device's own choice."""
    resolution_index: int = option(Reader.whole, 0, 8, 0)
    """Resolution index of the stream."""

    @property
    def kind(self) -> Model:
        """Properties of the model."""
        return MODELS[self.model]


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """Options of a device; also checks the names that its channels, outputs, valves and interlocks use."""
    options, given = reader.options(Options, device.options, HERE, ("ranges",))
    name, model = options.model, options.kind
    for key in given:
        if key in OF_STREAMS and not model.streams:
            reader.fault((*HERE, key), f"a {name} is asked for its samples here, and has no {key}")
        elif key == "rate" and model.streams:
            reader.fault((*HERE, key), f"a {name} samples by itself, at the rate of the protocol")
    host, port = reader.host(device, "192.168.0.20", usual=502)
    if given.get("ranges") and not model.ranges:
        reader.fault((*HERE, "ranges"), f"the ranges of a {name} are not set here")
    ranges = reader.choices(given, "ranges", HERE, model.ranges) if model.ranges else {}
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
        negative = number + 1 if channel.input in options.differential else SINGLE_ENDED
        inputs[channel.name] = Input(number, negative, gain, span)
    _used_inputs(device, reader, ranges, options.differential)
    _outputs(device, name, reader)
    if device.watchdog and device.watchdog < 1.0:
        reader.fault(("watchdog",), "its watchdog counts whole seconds: 1 s or more, and 2 s leave room")
    return replace(options, map=_map(device, model, inputs), host=host, port=port, inputs=inputs)


def _map(device: DeviceRecord, model: Model, inputs: Mapping[str, Input]) -> RegisterMap:
    """Registers that the Modbus driver handles, as its map.

    Of captured inputs the first is read by its own register, and before the others.
    """
    asked = [] if model.streams else [item.number for item in inputs.values()]
    taken = {number: CAPTURE if model.captures and number != asked[0] else 0 for number in asked}
    reads = [Register(f"AIN{n}", "holding", at + 2 * n, "float32") for n, at in taken.items()]
    reads += [_line(lock.input) for lock in device.interlocks]
    dacs = [name for name in DACS if name in {output.output for output in device.outputs}]
    writes = [Register(name, "holding", DAC + 2 * DACS.index(name), "float32") for name in dacs]
    writes += [_line(valve.output) for valve in device.valves]
    return RegisterMap(
        timeout=TIMEOUT,
        write_single=False,
        identity={"maker": "LabJack"},
        inputs={register.name: register for register in reads},
        outputs={register.name: register for register in writes},
    )


def _line(name: str) -> Register:
    return Register(name, "holding", DIO + (line_of(name) or 0))


def _used_inputs(
    device: DeviceRecord, reader: Reader, ranges: Mapping[str, str], differential: tuple[str, ...]
) -> None:
    """Check that each input is used once, and that options are given only for inputs in use."""
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
    reader.lines(device, LINES_BY_NAME, f"; known: {KNOWN_LINES}")
