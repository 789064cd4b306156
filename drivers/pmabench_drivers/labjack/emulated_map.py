"""Registers of an emulated T7, T8 or T4, which of them form one value, and the stream.

Source of addresses, types, access and defaults: LabJack's public register table (LabJack/ljm_constants, 2025.12.18).
Every value is read and written as a whole.

The stream has scans at absolute times, a buffer of limited size, and packets on a separate connection. It is written
from the packet's description and separately from the driver's parser, so that each checks the other.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import monotonic, sleep

from pmabench_drivers.emulator.faults import CommandLog, DeviceClock, Faults, Kind
from pmabench_drivers.emulator.ports import accepted, hang_up, listen
from pmabench_drivers.labjack import registers as r

U16, U32, F32 = "H", "I", "f"
WORDS = {U16: 1, U32: 2, F32: 2}


@dataclass(frozen=True)
class Value:
    """One value of the register table."""

    type: str
    access: str = "RW"
    default: float = 0.0

    @property
    def words(self) -> list[int]:
        """Its registers after power-on."""
        data = struct.pack(f">{self.type}", self.default if self.type == F32 else int(self.default))
        return list(struct.unpack(f">{WORDS[self.type]}H", data))


ROWS: tuple[tuple[int, int, Value], ...] = (
    (r.DAC, 2, Value(F32)),
    (r.DIO, len(r.LINES), Value(U16)),
    (r.DIO_STATE, 1, Value(U32, "R")),
    (r.DIO_DIRECTION, 1, Value(U32, "R")),
    (r.STREAM_SCANRATE, 14, Value(U32)),
    (r.STREAM_SCANLIST, 128, Value(U32)),
    (r.STREAM_ENABLE, 1, Value(U32)),
    (r.LAST_ERR_DETAIL, 1, Value(U16, "R")),
    (r.TEST, 1, Value(U32, "R", r.TEST_VALUE)),
    (r.PRODUCT_ID, 1, Value(F32, "R")),
    (r.FIRMWARE_VERSION, 1, Value(F32, "R")),
    (r.RESET_CAUSE, 1, Value(U32, "R")),
    (r.SERIAL_NUMBER, 1, Value(U32, "R")),
    (r.RTC_TIME, 1, Value(U32, "R")),
    (r.WATCHDOG_ENABLE, 4, Value(U32)),
    (r.WATCHDOG_STRICT, 2, Value(U32)),
    (r.WATCHDOG_CLEAR, 1, Value(U32, "W")),
    (r.WATCHDOG_RESET, 1, Value(U32)),
    (r.WATCHDOG_DIO_ENABLE, 4, Value(U32)),
    *((first, 2, Value(U32)) for first in r.WATCHDOG_DAC_ENABLE),
    (r.FLASH_POINTER, 1, Value(U32)),
    (r.FLASH_READ, 13, Value(U32, "R")),
)
"""First address, number of consecutive values, and their description."""


def values_of(model: r.Model) -> dict[int, Value]:
    """First address -> value, for one model."""
    count = len(model.inputs)
    inputs = [
        (0, count, Value(F32, "R")),
        (r.AIN_RANGE, count, Value(F32)),
        (r.AIN_NEGATIVE, count, Value(U16, default=r.SINGLE_ENDED)),
        *([(r.CAPTURE, count, Value(F32, "R"))] if model.captures else []),
    ]
    return {
        first + index * WORDS[value.type]: value for first, many, value in (*inputs, *ROWS) for index in range(many)
    }


class Unknown(Exception):
    """There is no such register, or it does not allow this access."""


class Cut(Exception):
    """The request covers only a part of a value."""


def whole(values: dict[int, Value], address: int, count: int, access: str) -> Iterator[tuple[int, Value]]:
    """The values in the registers from an address on; raises `Unknown`, or `Cut` for a part of a value."""
    at, end = address, address + count
    while at < end:
        if (value := values.get(at)) is None:
            before = values.get(at - 1)
            raise Cut if before is not None and WORDS[before.type] > 1 else Unknown
        if access not in value.access:
            raise Unknown
        if at + WORDS[value.type] > end:
            raise Cut
        yield at, value
        at += WORDS[value.type]


SHORTEST, LONGEST = 0.001, 0.01
"""Sleep between two checks for due scans [s]."""
FAULTS = {
    "stream-lost": Kind("so many packets of the stream are lost on the way", "number", 1.0),
    "stream-skip": Kind("the device leaves out so many scans, as with a full buffer", "number", 1.0),
    "stream-status": Kind("the next packet of the stream has this status", "number", 2940.0),
    "stream-silence": Kind("the stream sends nothing for so long, and the buffer fills", "time", 1.0),
    "stream-garbage": Kind("so many bytes without meaning are sent on the stream", "number", 3.0),
}

Sample = Callable[[int], list[int]]
"""Returns the raw counts of scan `number` (from 1), for each channel of the scan list."""


class Streamer:
    """Listens for one client at a time; writing STREAM_ENABLE calls `begin` and `end`."""

    def __init__(self, device: str, host: str, port: int, log: CommandLog) -> None:
        self._listener = listen(device, host, port)
        self._tap, self.faults = log.tap(device, connection="stream"), Faults()
        self.port = int(self._listener.getsockname()[1])
        self._client: socket.socket | None = None
        self._running = threading.Event()
        self.moment = 0.0
        """When the present scan was due [s, monotonic]."""
        self._faults: deque[tuple[str, float]] = deque()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Accept connections."""
        threading.Thread(target=self._accept, name="emulated T7 stream", daemon=True).start()

    def close(self) -> None:
        """Stop scanning and close the connections."""
        self.end()
        hang_up(self._listener, self._client)

    @property
    def running(self) -> bool:
        """Whether a stream runs."""
        return self._running.is_set()

    def fault(self, kind: str, value: float) -> None:
        """Let one of `FAULTS` happen."""
        self._faults.append((kind, value))

    def begin(self, rate: float, channels: int, per_packet: int, capacity: int, sample: Sample) -> None:
        """Start scanning: `rate` [Hz], samples in a packet, samples in the buffer."""
        self.end()
        self._running = threading.Event()
        self._running.set()
        arguments = (self._running, rate, channels, per_packet, capacity, sample)
        self._thread = threading.Thread(target=self._scan, args=arguments, name="emulated T7 scans", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop scanning."""
        self._running.clear()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(1.0)

    def _accept(self) -> None:
        for client in accepted(self._listener):
            before, self._client = self._client, client
            if before is not None:
                before.close()

    def _scan(
        self, running: threading.Event, rate: float, channels: int, per_packet: int, capacity: int, sample: Sample
    ) -> None:
        number, transaction, leave_out, silent_until = 0, 0, 0, 0.0
        clock = DeviceClock(self.faults)
        buffer: deque[tuple[int, list[int]]] = deque()  # each scan with the number skipped before it, -1 for none
        recovering = skipped = lose = status_next = 0
        scans, outgoing = per_packet // channels, b""
        while running.is_set():
            now = monotonic()
            while self._faults:
                kind, value = self._faults.popleft()
                lose += int(value) if kind == "stream-lost" else 0
                leave_out += int(value) if kind == "stream-skip" else 0
                status_next = int(value) if kind == "stream-status" else status_next
                silent_until = now + value if kind == "stream-silence" else silent_until
                outgoing += b"\xa5" * int(value) if kind == "stream-garbage" else b""
            shown = clock.now()
            while number < int(shown * rate):
                number += 1
                self.moment = now - (shown - number / rate)
                if recovering or leave_out or (len(buffer) + 1) * channels > capacity:
                    leave_out = max(0, leave_out - 1)
                    recovering, skipped = 1, skipped + 1
                    if leave_out == 0 and len(buffer) < scans:
                        buffer.append((skipped, [0xFFFF] * channels))
                        recovering = skipped = 0
                else:
                    buffer.append((-1, sample(number)))
            client = self._client
            while len(buffer) >= scans and len(outgoing) < 4096 and now >= silent_until:
                taken = [buffer.popleft() for _ in range(scans)]
                left_out = max(count for count, _ in taken)
                status = 2940 if recovering else 0
                if left_out >= 0:
                    status = 2941 if left_out < 65536 else 2943
                if status_next:
                    status, status_next = status_next, 0
                data = struct.pack(f">{per_packet}H", *(raw for _, scan in taken for raw in scan))
                backlog = min(2 * channels * len(buffer), 65535)
                head = struct.pack(
                    ">HHHBBBBHHH",
                    transaction, 0, 10 + len(data), 1, 76, 16, 0, backlog, status, max(left_out, 0) & 0xFFFF,
                )  # fmt: skip
                transaction = (transaction + 1) & 0xFFFF
                if lose:
                    lose -= 1
                else:
                    outgoing += head + data
            if client is not None and outgoing:
                with contextlib.suppress(OSError, ValueError):
                    if select.select([], [client], [], 0)[1]:
                        client.setblocking(False)
                        sent = client.send(outgoing)
                        self._tap("sent", outgoing[:sent])
                        outgoing = outgoing[sent:]
            sleep(min(max((number + 1) / rate - clock.now(), SHORTEST), LONGEST))
