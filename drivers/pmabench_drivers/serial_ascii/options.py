"""The options of a serial indicator, read strictly; knows no port. Standard library only."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.serial_ascii.pattern import inputs_of, pattern_problem
from pmabench_drivers.shared.options import BAUDS, PARITIES, Reader

KEYS = (
    *("baud", "data_bits", "parity", "stop_bits", "poll", "pattern", "terminator", "timeout", "slowest", "rate"),
    *("unit", "good_status", "over_range", "errors", "ask_identity", "emulate"),
)
_EMULATED = re.compile(r"[^%]*%[+\- 0]*\d{0,2}(?:\.\d{1,2})?f[^%]*")


@dataclass(frozen=True)
class Options:
    """Options of the driver `serial-ascii` for a indicator; times in s, rates in Hz."""

    pattern: re.Pattern[str] = re.compile("(?P<value>.*)")
    baud: int = 9600
    data_bits: int = 8
    parity: str = "N"
    stop_bits: int = 1
    poll: bytes = b""
    """What is sent to get one line; empty where the indicator sends by itself."""
    terminator: bytes = b"\r"
    timeout: float = 0.15
    slowest: float = 0.5
    """Longest time after which a line may still come that was asked for [s]."""
    rate: float = 10.0
    """Lines a second: the most that it is polled, or those that it sends by itself."""
    unit: str = ""
    """How the indicator writes its unit; empty: as the bench does."""
    good_status: tuple[str, ...] = ()
    over_range: tuple[str, ...] = ("OL", "------")
    errors: Mapping[str, str] = field(default_factory=dict)
    """Lines that mean a fault, and what they mean."""
    ask_identity: bytes = b""
    emulate: str = "%.3f\r"
    """For the emulator: a line as printf writes it."""


def read_options(device: DeviceRecord, reader: Reader) -> Options:
    """The options of a device, and the inputs that its channels use."""
    place, base = ("options",), Options()
    given = reader.keys(device.options, place, KEYS, ("pattern", "rate"))
    reader.port(device, "/dev/ttyUSB0")
    text = reader.text(given, "pattern", place, longest=1000)
    problem = pattern_problem(text) if text else ""
    if problem:
        reader.fault((*place, "pattern"), problem)
    pattern = re.compile(text) if text and not problem else base.pattern
    errors = given.get("errors", {})
    if not isinstance(errors, Mapping) or not all(isinstance(v, str) for v in errors.values()):
        reader.fault((*place, "errors"), "texts and what they mean are expected")
        errors = {}
    terminator = _bytes(given, "terminator", reader, "\r")
    if not terminator:
        reader.fault((*place, "terminator"), "what ends a line is expected")
    line = reader.text(given, "emulate", place, base.emulate)
    if not _EMULATED.fullmatch(line):
        reader.fault((*place, "emulate"), 'a line with one number as printf writes it is expected, as "%+8.2f N\\r"')
        line = base.emulate
    options = Options(
        pattern=pattern,
        baud=reader.one_of(given, "baud", place, BAUDS, base.baud),
        data_bits=reader.whole(given, "data_bits", place, 7, 8, base.data_bits),
        parity=PARITIES[reader.choice(given, "parity", place, PARITIES, "none")],
        stop_bits=reader.whole(given, "stop_bits", place, 1, 2, base.stop_bits),
        poll=_bytes(given, "poll", reader, ""),
        terminator=terminator or b"\r",
        timeout=reader.quantity(given, "timeout", place, "time", base.timeout, 0.005, 0.18),
        slowest=reader.quantity(given, "slowest", place, "time", base.slowest, 0.0, 10.0),
        rate=reader.quantity(given, "rate", place, "frequency", base.rate, 0.1, 2000.0),
        unit=reader.text(given, "unit", place, longest=20),
        good_status=reader.texts(given, "good_status", place),
        over_range=reader.texts(given, "over_range", place) if "over_range" in given else base.over_range,
        errors=dict(errors),
        ask_identity=_bytes(given, "ask_identity", reader, ""),
        emulate=line,
    )
    if options.good_status and "status" not in pattern.groupindex:
        reader.fault((*place, "good_status"), 'the pattern has no group "status"')
    _channels(device, options, reader, known=bool(text) and not problem)
    return options


def _bytes(given: Mapping[str, object], key: str, reader: Reader, default: str) -> bytes:
    text = reader.text(given, key, ("options",), default, longest=40)
    try:
        return text.encode("ascii")
    except UnicodeEncodeError:
        reader.fault(("options", key), "only ASCII characters go over the wire")
        return b""


def _channels(device: DeviceRecord, options: Options, reader: Reader, *, known: bool) -> None:
    if device.guarded:
        reader.fault((), "an indicator only measures; it has no outputs, valves, interlocks or watchdog")
    inputs = inputs_of(options.pattern)
    for channel in device.channels:
        if known:
            reader.known(("channels", channel.name, "input"), "the pattern has no group", channel.input, inputs)
    units = {channel.raw_unit for channel in device.channels}
    if "unit" in options.pattern.groupindex and not options.unit and len(units) > 1:
        reader.fault(("options", "pattern"), f"a line has one unit, and the channels have {', '.join(sorted(units))}")
