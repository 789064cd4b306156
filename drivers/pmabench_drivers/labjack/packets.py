"""The stream of a T7 as bytes: packets, lost packets, and what the device had to skip; knows no connection.

A packet (all numbers with the high byte first; LabJack, T-series datasheet, low-level streaming): transaction number
(0 at the start, one more with each packet), protocol 0, length of what follows, unit 1, function 76, type 16, a byte
without meaning, bytes that wait in the device, status, additional information, then two bytes a sample in the order of
the scan list. When the device's buffer was full it skips scans, then puts a whole scan of 0xFFFF in their place, with
the status 2941 and the number of skipped scans.

Every scan keeps its number, counted from 1 at the start: what is missing is left out, and never closed up. Where the
number of what is missing cannot be known, that is an error.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Iterator
from dataclasses import dataclass

HEADER = struct.Struct(">HHHBBBBHHH")
PROTOCOL, UNIT, FUNCTION, TYPE = 0, 1, 76, 16
AFTER_LENGTH = 10
"""Bytes of the header behind its length."""
RECOVERING, RECOVERED, OVERLAP, UNCOUNTED, COMPLETE, FULL = 2940, 2941, 2942, 2943, 2944, 2945
MARKER = 0xFFFF
ENDS = {
    OVERLAP: "scans overlap: the rate is too high for this number of channels, resolution index or settling time",
    UNCOUNTED: "its buffer was full for so long that it did not count what it left out",
    COMPLETE: "the stream ended by itself, as if a number of scans had been asked for",
    FULL: "its buffer was full and the stream ended",
}
"""Status that ends a stream -> why."""


class StreamBroken(Exception):
    """What came is no stream, or one whose samples cannot be numbered any more."""


@dataclass(frozen=True)
class Scans:
    """Consecutive scans: `raw` counts, channel by channel in the order of the scan list, from number `first` on."""

    first: int
    raw: array[int]


class Packets:
    """Takes the bytes of a stream, and gives the scans in them with their numbers."""

    def __init__(self, channels: int, scans: int) -> None:
        self._channels, self._scans = channels, scans
        self._size = 2 * channels * scans
        self._data = bytearray()
        self._expected = 0
        self._recovering = False
        self._marker = array("H", [MARKER] * channels)
        self.next = 1
        """Number of the scan that comes next."""
        self.lost = 0
        """Scans in packets that never came."""
        self.skipped = 0
        """Scans that the device left out because its buffer was full."""
        self.backlog = 0
        """Bytes that waited in the device when it sent the last packet."""

    def feed(self, data: bytes) -> Iterator[Scans]:
        """The scans that are whole with `data`; `StreamBroken` after them where the rest cannot be the stream."""
        self._data += data
        while len(self._data) >= HEADER.size:
            transaction, protocol, length, unit, function, kind, _, backlog, status, info = HEADER.unpack_from(
                self._data
            )
            if (protocol, unit, function, kind) != (PROTOCOL, UNIT, FUNCTION, TYPE):
                raise StreamBroken(f"bytes that are no stream packet: {bytes(self._data[: HEADER.size]).hex(' ')}")
            if length != AFTER_LENGTH + self._size and status not in ENDS:
                raise StreamBroken(f"a packet of {length} bytes instead of {AFTER_LENGTH + self._size}")
            if status in ENDS:
                raise StreamBroken(f"status {status}: {ENDS[status]}")
            whole = HEADER.size + self._size
            if len(self._data) < whole:
                break
            raw = array("H", bytes(self._data[HEADER.size : whole]))
            del self._data[:whole]
            if sys.byteorder == "little":
                raw.byteswap()
            self._number(transaction)
            self.backlog = backlog
            yield from self._placed(raw, status, info)

    def _number(self, transaction: int) -> None:
        """Leave room for packets that never came."""
        missing = (transaction - self._expected) % 65536
        self._expected = (transaction + 1) % 65536
        if missing and self._recovering:
            raise StreamBroken(f"{missing} packets are lost while the device was leaving out scans")
        self.next += missing * self._scans
        self.lost += missing * self._scans

    def _placed(self, raw: array[int], status: int, info: int) -> list[Scans]:
        """The scans of a packet with their numbers."""
        if status not in {0, RECOVERING, RECOVERED}:
            raise StreamBroken(f"status {status}, which is not known")
        self._recovering = status == RECOVERING
        if status != RECOVERED:
            return [self._run(raw)]
        at = next((i for i in range(0, len(raw), self._channels) if raw[i : i + self._channels] == self._marker), -1)
        if at < 0:
            raise StreamBroken(f"{info} scans were left out, and nothing tells where")
        runs = [self._run(raw[:at])]
        self.next += info
        self.skipped += info
        runs.append(self._run(raw[at + self._channels :]))
        return [run for run in runs if run.raw]

    def _run(self, raw: array[int]) -> Scans:
        first = self.next
        self.next += len(raw) // self._channels
        return Scans(first, raw)
