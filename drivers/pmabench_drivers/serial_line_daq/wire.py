"""Lines of the serial-line DAQ as bytes: fields, checksum, bounds; knows no port. Standard library only."""

from __future__ import annotations

import re
from binascii import crc_hqx
from dataclasses import dataclass

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
