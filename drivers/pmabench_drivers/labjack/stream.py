"""The stream of a T7: its packets, volts from counts, and the thread that receives them on its own clock.

A packet (all numbers with the high byte first; LabJack, T-series datasheet, low-level streaming): transaction number
(0 at the start, one more with each packet), protocol 0, length of the rest, unit 1, function 76, type 16, an unused
byte, bytes waiting in the device, status, additional information, then two bytes a sample in the order of the scan
list. If the device's buffer was full it skips scans, then puts a whole scan of 0xFFFF in their place, with the status
2941 and the number of skipped scans.

Every scan keeps its number, counted from 1 at the start: a missing scan leaves a gap, which is never closed up. If the
number of missing scans is unknown, that is an error. The device's clock is the number of the scan over the rate; it
starts at the bench time of the start, so that a restarted stream continues the time.

Counts are converted to volts by the constants in the device's flash, 41 single-precision numbers: for the high-speed
converter (which streams) four gains of positive slope, negative slope, centre and offset; the same for the
high-resolution converter; then DACs, temperature, current sources and bias, which are not used here.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import sys
import threading
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block
from pmabench_drivers.shared.link import Pace, Samples, reason

FLASH = 0x3C4000
"""Address of the constants in the device's flash."""
COUNT = 41
"""Number of constants."""
NOMINAL_SLOPE, NOMINAL_CENTER = 3.158058e-4, 33523.0
"""For the range of 10 V [V], [1]; each next gain has a tenth of the slope."""
CODES = 65536
HEADER = struct.Struct(">HHHBBBBHHH")
PROTOCOL, UNIT, FUNCTION, TYPE = 0, 1, 76, 16
AFTER_LENGTH = 10
"""Bytes of the header after its length field."""
RECOVERING, RECOVERED, OVERLAP, UNCOUNTED, COMPLETE, FULL = 2940, 2941, 2942, 2943, 2944, 2945
MARKER = 0xFFFF
ENDS = {
    OVERLAP: "scans overlap: the rate is too high for this number of channels, resolution index or settling time",
    UNCOUNTED: "its buffer was full for so long that it did not count what it left out",
    COMPLETE: "the stream ended by itself, as if a number of scans had been asked for",
    FULL: "its buffer was full and the stream ended",
}
"""Status that ends a stream -> reason."""
PATIENCE = 0.25
"""Time after a packet is due until `collect` reports that none arrived [s]."""
AHEAD, DRIFT = 0.5, 1e-3
"""Largest lead of a scan's time over its arrival: constant [s], and proportional to time [1]."""
SLIP = 0.1
"""Largest increase of the delay of all scans of a second [s]."""
PIECE = 65536


@dataclass(frozen=True)
class Gain:
    """Constants of one range: volts per count above and below the centre, and the count at 0 V."""

    positive: float
    negative: float
    center: float

    def volts(self, raw: int) -> float:
        """The voltage of a count [V]."""
        return (self.center - raw) * self.negative if raw < self.center else (raw - self.center) * self.positive

    def table(self) -> array[float]:
        """The voltage of every count [V], shape (65536,)."""
        return array("d", [self.volts(raw) for raw in range(CODES)])


def gains(constants: Sequence[float]) -> tuple[Gain, ...]:
    """The high-speed converter's gains for 10, 1, 0.1 and 0.01 V; raises ValueError if one is impossible for a T7."""
    if len(constants) != COUNT:
        raise ValueError(f"{len(constants)} calibration constants instead of {COUNT}")
    found = []
    for index in range(4):
        positive, negative, center, _offset = constants[4 * index : 4 * index + 4]
        slope = NOMINAL_SLOPE / 10**index
        near = all(math.isfinite(value) for value in (positive, negative, center)) and (
            abs(positive / slope - 1) < 0.1 and abs(negative / slope + 1) < 0.1 and abs(center - NOMINAL_CENTER) < 3000
        )
        if not near:
            given = f"slopes {positive:g} and {negative:g} V, centre {center:g}"
            raise ValueError(f"calibration constants of gain {index} that no T7 has: {given}")
        found.append(Gain(positive, negative, center))
    return tuple(found)


class StreamBroken(Exception):
    """The bytes are no stream, or its samples can no longer be numbered."""


@dataclass(frozen=True)
class Scans:
    """Consecutive scans: `raw` counts, channel by channel in the order of the scan list, from number `first` on."""

    first: int
    raw: array[int]


class Packets:
    """Parses the bytes of a stream into numbered scans."""

    def __init__(self, channels: int, scans: int) -> None:
        self._channels, self._scans = channels, scans
        self._size = 2 * channels * scans
        self._data = bytearray()
        self._expected = 0
        self._recovering = False
        self._marker = array("H", [MARKER] * channels)
        self.next = 1
        """Number of the next scan."""
        self.lost = 0
        """Scans in packets that did not arrive."""
        self.skipped = 0
        """Scans that the device left out because its buffer was full."""

    def feed(self, data: bytes) -> Iterator[Scans]:
        """Scans that `data` completes; then raises `StreamBroken` if the rest cannot be the stream."""
        self._data += data
        while len(self._data) >= HEADER.size:
            transaction, protocol, length, unit, function, kind, _, _, status, info = HEADER.unpack_from(self._data)
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
            yield from self._placed(raw, status, info)

    def _number(self, transaction: int) -> None:
        """Leave a gap for packets that did not arrive."""
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
            raise StreamBroken(f"{info} scans were left out, and nothing shows where")
        runs = [self._run(raw[:at])]
        self.next += info
        self.skipped += info
        runs.append(self._run(raw[at + self._channels :]))
        return [run for run in runs if run.raw]

    def _run(self, raw: array[int]) -> Scans:
        first = self.next
        self.next += len(raw) // self._channels
        return Scans(first, raw)


class StreamLink:
    """Receives one stream from start to end."""

    def __init__(self, device: str, names: Sequence[str], address: tuple[str, int], wait: float, clock: Clock) -> None:
        self._device, self._clock = device, clock
        self._samples = Samples(names)
        self._failure: str = ""
        self._last = 0.0
        where = f"{address[0]}:{address[1]}"
        try:
            self._socket = socket.create_connection(address, timeout=max(wait, 0.001))
        except OSError as error:
            why = reason(error).lower()
            raise DeviceError(device, f"no connection to {where}, where the stream comes from: {why}") from None

    def begin(self, rate: float, scans: int, tables: Sequence[array[float]]) -> None:
        """Start receiving; the device is started after this.

        `rate` as the device reports it [Hz]; `scans` per packet; `tables`: volts of every count, shape (65536,).
        """
        self._rate, self._scans, self._tables = rate, scans, tables
        self._packets = Packets(len(tables), scans)
        self._start = self._last = self._clock.now()
        self._pace = Pace(SLIP)
        self._socket.settimeout(None)
        threading.Thread(target=self._receive, name=f"labjack {self._device}", daemon=True).start()

    def close(self) -> None:
        """Stop receiving; may be called again."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    @property
    def lost(self) -> int:
        """Missing scans so far: in lost packets, or left out by the device."""
        return self._packets.lost + self._packets.skipped

    def collect(self) -> Block:
        """Samples since the last call; once all are returned, raises DeviceError if the stream has failed."""
        # read before the samples: those received before a failure are returned before it is raised
        failure, silent = self._failure, self._clock.now() - self._last
        block = self._samples.take()
        if not block.time:
            if failure:
                raise DeviceError(self._device, f"the stream broke off: {failure}")
            if silent > PATIENCE + 2 * self._scans / self._rate:
                raise DeviceError(self._device, f"its stream has been silent for {silent:.2f} s")
        return block

    def _receive(self) -> None:
        try:
            while data := self._socket.recv(PIECE):
                arrived = self._clock.now()
                for scans in self._packets.feed(data):
                    self._keep(scans, arrived)
                self._last = arrived
            self._failure = "the device closed the connection"
        except StreamBroken as error:
            self._failure = str(error)
        except OSError as error:
            self._failure = f"the connection was lost ({reason(error).lower()})"

    def _keep(self, scans: Scans, arrived: float) -> None:
        width, rate = len(self._tables), self._rate
        end = scans.first + len(scans.raw) // width
        elapsed = arrived - self._start
        if (end - 1) / rate > elapsed * (1 + DRIFT) + AHEAD:
            raise StreamBroken(f"scan {end - 1} cannot have been taken {elapsed:.3f} s after the start")
        if (behind := self._pace.behind(self._start + (end - 1) / rate, arrived)) > 0:
            why = "they wait in its buffer or on the way, or it is slower than it says"
            raise StreamBroken(f"scans come {behind:.2f} s later than they did: {why}")
        columns = [
            array("d", map(table.__getitem__, scans.raw[index::width])) for index, table in enumerate(self._tables)
        ]
        self._samples.extend(scans.first, columns, self._start, rate, arrived)
