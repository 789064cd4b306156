"""The connection that a T7 streams over, in a thread of its own: bytes to samples in volts, on the stream's own clock.

The device's clock is the number of the scan over the rate; it begins at the bench time of the start, so that a stream
that is started again goes on.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from array import array
from collections.abc import Sequence
from dataclasses import dataclass

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block
from pmabench_drivers.labjack.packets import Packets, Scans, StreamBroken

PATIENCE = 0.25
"""So long [s] after a packet is due `collect` says that none comes."""
AHEAD, DRIFT = 0.5, 1e-3
"""So far [s], and in proportion to time [1], a scan's time may be ahead of the moment when it arrived."""
PIECE = 65536


@dataclass(frozen=True)
class Plan:
    """How the stream runs."""

    rate: float
    """Scans a second, as the device says [Hz]."""
    scans: int
    """Scans in a packet."""
    tables: Sequence[array[float]]
    """Volts of every count, for each channel of the scan list, shape (65536,)."""


class StreamLink:
    """Receives one stream from its start to its end."""

    def __init__(self, device: str, names: Sequence[str], address: tuple[str, int], wait: float, clock: Clock) -> None:
        self._device, self._names, self._clock = device, tuple(names), clock
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._ended = False
        self._failure: str = ""
        self._time, self._columns, self._host = array("q"), [array("d") for _ in names], -1
        self._last = 0.0
        where = f"{address[0]}:{address[1]}"
        try:
            self._socket = socket.create_connection(address, timeout=max(wait, 0.001))
        except OSError as error:
            why = (error.strerror or str(error)).lower()
            raise DeviceError(device, f"no connection to {where}, where the stream comes from: {why}") from None

    def begin(self, plan: Plan) -> None:
        """Receive from now on; the device is started after this."""
        self._plan = plan
        self._packets = Packets(len(self._names), plan.scans)
        self._start = self._last = self._clock.now()
        self._socket.settimeout(None)
        self._thread = threading.Thread(target=self._receive, name=f"labjack {self._device}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Receive no more; harmless when repeated."""
        self._ended = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    @property
    def lost(self) -> int:
        """Scans that are missing so far: in lost packets, or left out by the device."""
        return self._packets.lost + self._packets.skipped

    @property
    def backlog(self) -> int:
        """Bytes that waited in the device's buffer when it sent the last packet."""
        return self._packets.backlog

    def collect(self) -> Block:
        """What came since the last call; once all of it is handed out, an error where the stream has failed."""
        with self._lock:
            time, columns, host = self._time, self._columns, self._host
            self._time, self._columns, self._host = array("q"), [array("d") for _ in columns], -1
            failure, silent = self._failure, self._clock.now() - self._last
        if not time:
            if failure:
                raise DeviceError(self._device, f"the stream broke off: {failure}")
            if silent > PATIENCE + 2 * self._plan.scans / self._plan.rate:
                raise DeviceError(self._device, f"its stream has been silent for {silent:.2f} s")
        return Block(time, dict(zip(self._names, columns, strict=True)), host)

    def _receive(self) -> None:
        try:
            while data := self._socket.recv(PIECE):
                arrived = self._clock.now()
                for scans in self._packets.feed(data):
                    self._keep(scans, arrived)
                self._last = arrived
            failure = "the device closed the connection"
        except StreamBroken as error:
            failure = str(error)
        except OSError as error:
            failure = f"the connection was lost ({(error.strerror or str(error)).lower()})"
        if not self._ended:
            with self._lock:
                self._failure = failure

    def _keep(self, scans: Scans, arrived: float) -> None:
        width, rate = len(self._names), self._plan.rate
        end = scans.first + len(scans.raw) // width
        elapsed = arrived - self._start
        if (end - 1) / rate > elapsed * (1 + DRIFT) + AHEAD:
            raise StreamBroken(f"scan {end - 1} cannot have been taken {elapsed:.3f} s after the start")
        origin = round(self._start * 1e9)
        times = array("q", [origin + round(number * 1e9 / rate) for number in range(scans.first, end)])
        columns = [
            array("d", map(table.__getitem__, scans.raw[index::width])) for index, table in enumerate(self._plan.tables)
        ]
        with self._lock:
            self._time += times
            self._host = round(arrived * 1e9)
            for kept, new in zip(self._columns, columns, strict=True):
                kept += new
