"""Lines of the serial-line DAQ as bytes, times of its numbered samples, and its options; knows no port.

Standard library only.
"""

from __future__ import annotations

import re
from binascii import crc_hqx
from dataclasses import dataclass

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.shared.options import BAUDS, Reader

END = b"\n"
PROTOCOL = "line-daq"
VERSION = "1"
MOST = {"a": 6, "d": 6, "o": 4, "v": 4}
"""How many inputs, levels, outputs and valves a board has at most, by the letter of their names (`a0`, `d0` ...)."""
NAMES = {"a": "count input", "d": "digital input", "o": "output", "v": "valve"}
ARMED, VENTED, LEVELS = 1, 2, 2
"""Bits of the state: watchdog armed, vented by the watchdog; the levels follow from bit 2 on."""
REASONS = {
    "unknown": "does not know the command",
    "range": "says that the value is out of its range",
    "unarmed": "refuses, because its watchdog is not armed",
    "vented": "has vented by itself, because its watchdog heard nothing; it takes nothing until it is armed again",
}
"""The words with which a board refuses."""
_WHOLE = re.compile(rb"([ -)+-~]{1,114})\*([0-9A-F]{4})")
_COUNT = re.compile(r"-?\d{1,10}")
WRAP = 1 << 32
LONGEST = 10_000_000
"""A jump over more than this is no loss but nonsense [us]."""
DRIFT = 2e-3
"""How far number and clock may drift apart over a gap [1]."""
KNOWN_BAUDS = tuple(sorted({*BAUDS, 250_000, 500_000, 1_000_000, 2_000_000}))
BAUD = 500_000
WATCHDOG = (0.05, 1.0)
"""Shortest and longest time of the board's watchdog [s]."""


class NoLine(ValueError):
    """Bytes that are no line of the protocol: cut, disturbed, something else."""


@dataclass(frozen=True)
class Sample:
    """One numbered row of counts."""

    number: int
    """Counts the periods since sampling began, those too in which nothing was sent [1], modulo 2^32."""
    micros: int
    """When it was taken by the board's clock [us], modulo 2^32."""
    state: int
    counts: tuple[int, ...]


def encode(*fields: object) -> bytes:
    """Fields as a line with checksum and end: the CRC-16/IBM-3740 (0x1021 from 0xFFFF) of all before the star."""
    text = ",".join(map(str, fields)).encode("ascii")
    return b"%s*%04X" % (text, crc_hqx(text, 0xFFFF)) + END


def decode(line: bytes) -> list[str]:
    """The fields of a line without its end; raises NoLine."""
    found = _WHOLE.fullmatch(line)
    if found is None:
        raise NoLine("a line that is none of the protocol")
    if crc_hqx(found[1], 0xFFFF) != int(found[2], 16):
        raise NoLine("a line whose checksum is wrong")
    return found[1].decode("ascii").split(",")


def read_sample(fields: list[str], inputs: int) -> Sample:
    """The fields of an `S` line; raises NoLine."""
    if len(fields) != 4 + inputs or not all(_COUNT.fullmatch(text) for text in fields[1:]):
        raise NoLine(f"a sample that has not {inputs} counts")
    number, micros, state, *counts = map(int, fields[1:])
    if not (0 <= number < 1 << 32 and 0 <= micros < 1 << 32 and 0 <= state < 256):
        raise NoLine("a sample with a number out of its range")
    if not all(-(1 << 31) <= count < 1 << 31 for count in counts):
        raise NoLine("a sample with a count of more than 32 bits")
    return Sample(number, micros, state, tuple(counts))


def index_of(name: str, letter: str) -> int | None:
    """The number in a name like `a0`; None where it is no such name."""
    found = re.fullmatch(rf"{letter}(\d)", name)
    return int(found[1]) if found and int(found[1]) < MOST[letter] else None


class Timeline:
    """Gives the time of each sample; counts what was lost by the numbers.

    Number and clock say the same twice: a sample whose two do not fit is not believed.
    """

    def __init__(self, period: int, before: Timeline | None = None) -> None:
        self._period = period
        self._last: Sample | None = None
        self._time = 0
        self.ahead: float | None = before.ahead if before is not None else None
        """What the board's clock is ahead of bench time by, wraps counted [us]; times go on where `before` ended."""
        self.lost = 0
        """Samples whose numbers never came."""
        self.misfits = 0
        """Samples in a row that were not believed."""

    def place(self, sample: Sample, host: float) -> int | None:
        """Time of a sample that came at `host` [s, bench time] by the board's clock [us]; None: it is not believed."""
        last = self._last
        if last is None:
            if self.ahead is None:
                self.ahead = sample.micros - host * 1e6
            self._time = sample.micros + WRAP * round((host * 1e6 + self.ahead - sample.micros) / WRAP)
        else:
            ahead, passed = (sample.number - last.number) % WRAP, (sample.micros - last.micros) % WRAP
            expected = ahead * self._period
            if not 0 < expected <= LONGEST or abs(passed - expected) >= self._period + DRIFT * expected:
                self.misfits += 1
                return None
            self.lost += ahead - 1
            self._time += passed
        self._last, self.misfits = sample, 0
        return self._time


def read_options(device: DeviceRecord, reader: Reader) -> int:
    """The baud rate; `reader` gets a fault for everything in the device's record that the board cannot do."""
    given = reader.keys(device.options, ("options",), ("baud",))
    reader.port(device, "/dev/ttyACM0")
    baud = reader.one_of(given, "baud", ("options",), KNOWN_BAUDS, BAUD)
    for channel in device.channels:
        _named(reader, ("channels", channel.name, "input"), channel.input, "a")
    for interlock in device.interlocks:
        _named(reader, ("interlocks", interlock.name, "input"), interlock.input, "d")
    for output in device.outputs:
        place = "outputs", output.name
        _named(reader, (*place, "output"), output.output, "o")
        if output.resolution < 1 or output.resolution != round(output.resolution):
            reader.fault(place, 'the board takes whole counts: "resolution: 1 count" is expected')
        if abs(float(output.scale.to_raw(output.safe))) > 1e-6:
            reader.fault(place, "the board vents to 0 counts: the scale must have the safe value there")
    for valve in device.valves:
        _named(reader, ("outputs", valve.name, "output"), valve.output, "v")
        if valve.energised == valve.safe:
            message = f'the board vents with its valves off: "{valve.name}" must be {valve.safe} without power'
            reader.fault(("outputs", valve.name, "energised"), message)
    shortest, longest = WATCHDOG
    if (device.outputs or device.valves) and not device.watchdog:
        reader.fault(
            (), f'outputs work only under the watchdog of the board: add "watchdog: 500 ms" (at most {longest:g} s)'
        )
    elif device.watchdog and not shortest <= device.watchdog <= longest:
        reader.fault(("watchdog",), f"the board's watchdog takes {shortest * 1e3:g} ms to {longest:g} s")
    return baud


def _named(reader: Reader, place: tuple[str, ...], name: str, letter: str) -> None:
    if index_of(name, letter) is None:
        last = MOST[letter] - 1
        reader.fault(place, f'a {NAMES[letter]} of the board is expected, {letter}0 to {letter}{last}, not "{name}"')
