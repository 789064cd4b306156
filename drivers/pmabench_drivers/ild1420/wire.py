"""What an ILD1420 sends: distances with their numbers as bytes, and its options; knows no port. Standard library only.

Instruction manual optoNCDT 1420, measurement value output over RS422: three bytes a value, marked by their two highest
bits: low byte `00`, middle byte `01`, high byte `10` for the first value of a measurement (the distance) and `11` for
each further one (here the counter); six bits each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.shared.options import Reader

BITS = 60
"""On the wire for a distance and its counter, start and stop bits counted."""
WRAP = 1 << 18
"""The counter begins again after so many measurements."""
FULL = 65520
"""Largest code that is a distance."""
SPANS = (10, 25, 50, 100, 200, 500)
"""Measuring ranges that the sensor is made in [mm]."""
SCENE = {
    262076: "sees no peak",
    262077: "sees a peak before its measuring range",
    262078: "sees a peak behind its measuring range",
    262080: "cannot compute the value",
    262081: "sees a peak that is too large",
}
"""Codes about what is in front of the laser: no number, as often as it happens."""
SETTING = {262075: "sends more than its baud rate can carry", 262082: "has its laser switched off"}
"""Codes for something that is set wrong."""
BAUDS = (115200, 230400, 256000, 460800, 691200, 921600, 1000000)
INPUT = "distance"


class Decoder:
    """Cuts a stream of bytes into measurements.

    Behind a byte out of place everything is left out up to the end of the second counter: what is up to the first
    one may be put together from old bytes and disturbed ones.
    """

    def __init__(self) -> None:
        self._value: list[int] = []
        self._code = -1
        self._skip = 0
        self.invalid = 0
        """How often a byte was out of its place."""

    def feed(self, data: bytes) -> list[tuple[int, int]]:
        """The measurements that end in `data`: code of the distance and counter, 18 bits each."""
        found = []
        for byte in data:
            mark = byte >> 6
            if self._skip:
                self._skip -= mark == 3
                continue
            if len(self._value) < 2:
                if mark != len(self._value):
                    self._restart()
                    continue
                self._value.append(byte & 0x3F)
                continue
            if mark != (2 if self._code < 0 else 3):
                self._restart()
                continue
            value = (byte & 0x3F) << 12 | self._value[1] << 6 | self._value[0]
            self._value = []
            if mark == 2:
                self._code = value
            else:
                found.append((self._code, value))
                self._code = -1
        return found

    def _restart(self) -> None:
        self.invalid += 1
        self._value, self._code = [], -1
        self._skip = 2


def encode(code: int, counter: int) -> bytes:
    """A distance and its counter as the sensor sends them."""
    return bytes(
        mark << 6 | value >> shift & 0x3F
        for value, last in ((code, 2), (counter, 3))
        for mark, shift in ((0, 0), (1, 6), (last, 12))
    )


def distance(code: int, span: int) -> float:
    """Distance from the begin of the measuring range [mm] at a range of `span` [mm]; no number where it is none."""
    if not 0 <= code <= FULL:
        return math.nan
    return 0.01 * (102.0 / FULL * code - 1.0) * span


def code_of(value: float, span: int) -> int:
    """The code that the sensor sends for a distance [mm]; peaks outside have other codes."""
    code = round((value / (0.01 * span) + 1.0) * FULL / 102.0)
    return 262077 if code < 0 else 262078 if code > FULL else code


def misset(code: int) -> str:
    """What is set wrong where the sensor sends this code; empty where nothing is."""
    if code <= FULL or code in SCENE:
        return ""
    known = SETTING.get(code)
    return known or f"sends {code}, which is no distance: a master value may be set in it"


class CounterBroken(Exception):
    """The counter goes on from elsewhere: which measurement this is, is not known."""


class Numbering:
    """Numbers measurements from 0 on.

    A measurement is believed when its counter follows that of the last one believed, or of the one right before it. So
    the first one behind a gap is left out: its bytes may belong to two. A disturbed counter makes no false gap.
    """

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._last: int | None = None
        self._before: int | None = None
        self._number = 0
        self.lost = 0
        """Measurements that never came, or were left out."""

    def place(self, counter: int) -> int | None:
        """The number of a measurement; None: it is not believed. Raises CounterBroken."""
        follows = [(before + 1) % WRAP for before in (self._last, self._before) if before is not None]
        self._before = counter
        if counter not in follows:
            return None
        ahead = 0 if self._last is None else (counter - self._last) % WRAP
        if ahead > self._longest:
            raise CounterBroken
        self._number += ahead
        self.lost += max(0, ahead - 1)
        self._last = counter
        return self._number


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
