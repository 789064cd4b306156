"""What an ILD1420 sends: three bytes a value, marked by their two highest bits; knows no port. Standard library only.

Instruction manual optoNCDT 1420, measurement value output over RS422: low byte `00`, middle byte `01`, high byte `10`
for the first value of a measurement (the distance) and `11` for each further one (here the counter); six bits each.
"""

from __future__ import annotations

import math

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
"""Codes that tell of what is before the laser: no number, as often as it happens."""
SETTING = {262075: "sends more than its baud rate can carry", 262082: "has its laser switched off"}
"""Codes that tell that something is set wrong."""


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
        """Places where a byte did not stand where it belongs."""

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
    """The code that the sensor sends for a distance [mm]; peaks outside have codes of their own."""
    code = round((value / (0.01 * span) + 1.0) * FULL / 102.0)
    return 262077 if code < 0 else 262078 if code > FULL else code


def misset(code: int) -> str:
    """What is set wrong where the sensor sends this code; empty where nothing is."""
    if code <= FULL or code in SCENE:
        return ""
    known = SETTING.get(code)
    return known or f"sends {code}, which is no distance: a master value may be set in it"
