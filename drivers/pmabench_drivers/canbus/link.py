"""CAN adapters: sending frames, a thread that distributes received ones, and assembling samples from them.

Loads python-can or pyserial when an adapter is opened. Adapters of the slcan kind (LAWICEL) transfer frames as lines of
text, over a serial port or TCP. python-can supports them too, but it reads single bytes, and does not recover from a
byte that is not ASCII.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from math import isfinite
from time import monotonic
from typing import TYPE_CHECKING, Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.shared.link import Listening, reason
from pmabench_drivers.shared.serial_port import hand_over

if TYPE_CHECKING:
    from pmabench_drivers.canbus.options import Message, Options, Signal

BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
RATES = {rate: f"S{number}" for number, rate in enumerate(BIT_RATES)}
"""Bit rate -> command of the adapter."""
TCP = "socket://"
CONNECT = 1.0
"""Longest time to reach an adapter behind TCP [s]."""
PUSH = 0.1
"""Time limit for sending bytes [s]."""
RESTART = 0.3
"""Delay after a serial adapter was opened, as it may restart [s]."""
ASKED = 0.2
"""Longest wait for an adapter's serial number [s]."""
LONGEST = 64
"""Longest unfinished line that is kept [bytes]."""
NUMBERED = ("kvaser", "ixxat")
"""Interfaces with numbered channels."""
INTERFACES = ("socketcan", "slcan", "pcan", *NUMBERED)
"""`slcan`, and python-can's names of interfaces."""
WAIT = 0.05
"""Longest single wait for a frame [s]."""
Take = Callable[[Frame, float], None]
"""Called with a frame and its arrival time [s, bench time]."""
PATIENCE = 2
"""Periods for which an answer is waited for; no SYNC is sent meanwhile, so that it cannot belong to a later one."""


def line_of(frame: Frame) -> bytes:
    """A data frame as a line of text."""
    head = f"T{frame.identifier:08X}" if frame.extended else f"t{frame.identifier:03X}"
    return f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode()


def read_line(line: bytes) -> Frame | None:
    """The data frame in a line without its end; None for anything else."""
    width = {b"t": 3, b"T": 8}.get(line[:1])
    try:
        text = line.decode("ascii")
        if width is None or not text.isalnum():
            return None
        identifier, length = int(text[1 : 1 + width], 16), int(text[1 + width : 2 + width])
        data = bytes.fromhex(text[2 + width : 2 + width + 2 * length])
    except ValueError:
        return None
    if length > 8 or len(data) != length or identifier >= (1 << 29 if width == 8 else 1 << 11):
        return None
    if len(text) - 2 - width - 2 * length not in {0, 4}:  # an adapter may append a timestamp of 4 digits
        return None
    return Frame(identifier, data, width == 8)


class Slcan:
    """An open slcan adapter. Its methods raise OSError."""

    def __init__(self, channel: str, bitrate: int, *, ask: bool = False) -> None:
        self._end: Any  # a socket or a serial port, with the same methods for reading and writing
        if channel.startswith(TCP):
            host, _, port = channel.removeprefix(TCP).rpartition(":")
            self._end = socket.create_connection((host, int(port)), CONNECT)
            self._end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._end.setblocking(False)
        else:
            import serial

            self._end = serial.Serial(channel, 115200, exclusive=True)
            time.sleep(RESTART)
        self._rest, self._frames = b"", deque[Frame]()
        self.serial = ""
        """Serial number, if it was requested by `ask` and the adapter has one."""
        self._write(f"\rC\r{RATES[bitrate]}\rO\r".encode())
        if ask:
            self._write(b"N\r")
            until = monotonic() + ASKED
            while not self.serial and monotonic() < until:
                self._receive(0.02)

    def send(self, frame: Frame) -> None:
        """Send one frame."""
        self._write(line_of(frame))

    def receive(self, wait: float) -> Frame | None:
        """The next frame, waited for at most `wait` [s]."""
        if not self._frames:
            self._receive(wait)
        return self._frames.popleft() if self._frames else None

    def close(self) -> None:
        """Close the channel and the connection."""
        with contextlib.suppress(OSError):
            self._write(b"C\r")
        self._end.close()

    def _write(self, data: bytes) -> None:
        hand_over(self._end, data, PUSH)

    def _read(self, wait: float) -> bytes:
        if not select.select([self._end], [], [], wait)[0]:
            return b""
        if not (data := os.read(self._end.fileno(), 4096)):
            raise ConnectionResetError("the adapter hung up")
        return data

    def _receive(self, wait: float) -> None:
        *lines, rest = (self._rest + self._read(wait)).replace(b"\x07", b"\r").split(b"\r")
        self._rest = rest[-LONGEST:]
        for line in lines:
            if (frame := read_line(line)) is not None:
                self._frames.append(frame)
            elif line[:1] == b"N" and len(line) < 20:
                self.serial = line[1:].decode("ascii", "replace")


class PythonCan:
    """An adapter supported by python-can."""

    def __init__(self, interface: str, channel: str | int, bitrate: int) -> None:
        import can

        self._can = can
        self.serial = ""
        with self._as_os_error():
            self._bus: Any = can.Bus(interface=interface, channel=channel, bitrate=bitrate)

    def send(self, frame: Frame) -> None:
        """Send one frame."""
        kind = {"is_extended_id": frame.extended, "check": True}
        message = self._can.Message(arbitration_id=frame.identifier, data=frame.data, **kind)
        with self._as_os_error():
            self._bus.send(message, timeout=PUSH)

    def receive(self, wait: float) -> Frame | None:
        """The next data frame, waited for at most `wait` [s]."""
        with self._as_os_error():
            message = self._bus.recv(wait)
        if message is None or message.is_error_frame or message.is_remote_frame or message.is_fd:
            return None
        return Frame(message.arbitration_id, bytes(message.data), bool(message.is_extended_id))

    def close(self) -> None:
        """Close it."""
        with contextlib.suppress(Exception):  # a maker's library may raise anything on closing
            self._bus.shutdown()

    @contextlib.contextmanager
    def _as_os_error(self) -> Any:
        """Raise errors of python-can and of makers' libraries as OSError."""
        try:
            yield
        except OSError:
            raise
        except Exception as error:
            raise OSError(str(error) or type(error).__name__) from error


Adapter = Slcan | PythonCan
"""Interface of an adapter: `serial`, `send`, `receive` and `close`, which raise OSError."""


def open_adapter(address: str, bitrate: int, *, ask: bool) -> Adapter:
    """Open the adapter at INTERFACE:CHANNEL; `ask`: read its serial number, if it has one."""
    interface, _, channel = address.partition(":")
    if interface == "slcan":
        return Slcan(channel, bitrate, ask=ask)
    return PythonCan(interface, int(channel) if interface in NUMBERED else channel, bitrate)


class Link(Listening):
    """An open adapter; the reading thread calls `take` with a frame and its arrival time. Raises DeviceError."""

    def __init__(self, device: str, address: str, adapter: Callable[[], Adapter], clock: Clock, take: Take) -> None:
        super().__init__(device, address, clock)
        self._lock = threading.Lock()
        try:
            self._adapter = adapter()
        except OSError as error:
            raise DeviceError(device, f"cannot open {address}: {reason(error)}") from None
        self.serial = self._adapter.serial
        """Serial number of the adapter; empty if unknown."""
        self.listen(take)

    def send(self, identifier: int, data: bytes = b"") -> None:
        """Send a frame once."""
        if self.gone:
            raise DeviceError(self._device, self.gone)
        try:
            with self._lock:
                self._adapter.send(Frame(identifier, data))
        except OSError as error:
            raise DeviceError(self._device, f"cannot send to {self._address}: {reason(error)}") from None

    def close(self) -> None:
        """Close the adapter; may be called again."""
        self.hush()
        self._adapter.close()

    def _receive(self) -> Frame | None:
        return self._adapter.receive(WAIT)


class Rows:
    """Waits after each SYNC for all PDOs in `wanted`, then calls `done(time, host)` [ns].

    All nodes sample at the SYNC: between sending it and the first answer (`host`); `time` is the middle.
    If the first answer took longer than `slowest` [ns], the sampling time is not known well enough: a gap.
    """

    def __init__(self, wanted: Collection[int], done: Callable[[int, int], None], slowest: int) -> None:
        self._wanted, self._done, self._slowest = frozenset(wanted), done, slowest
        self._lock = threading.Lock()
        self._open: set[int] = set()
        self._sent = self._first = self._waited = 0
        self.lost = 0
        """SYNCs without all answers; each is a gap."""
        self.in_a_row = 0
        """Number of consecutive ones."""

    def may_sync(self) -> bool:
        """Whether the last SYNC was answered, or waited for long enough."""
        with self._lock:
            if not self._open:
                return True
            self._waited += 1
            if self._waited <= PATIENCE:
                return False
            self.lost += 1
            self.in_a_row += 1
            self._open.clear()
            return True

    def missing(self) -> frozenset[int]:
        """PDOs that are still missing after the last SYNC."""
        with self._lock:
            return frozenset(self._open)

    def begin(self, time: int) -> None:
        """Record that a SYNC is about to be sent, at `time` [ns, bench time]."""
        with self._lock:
            self._open, self._sent, self._first, self._waited = set(self._wanted), time, 0, 0
        if not self._wanted:
            self._done(time, time)

    def arrived(self, identifier: int, host: int) -> None:
        """Record the arrival of a PDO at `host` [ns, bench time]; one that answers no SYNC is ignored."""
        with self._lock:
            if identifier not in self._open:
                return
            self._open.discard(identifier)
            self._first = self._first or host
            if self._open:
                return
            time, first, self.in_a_row = (self._sent + self._first) // 2, self._first, 0
            if first - self._sent > self._slowest:
                self.lost += 1
                return
        self._done(time, first)


class Signals:
    """Newest values of the channels' `inputs` from received frames, and their arrival times."""

    def __init__(self, options: Options, inputs: Sequence[str]) -> None:
        self._slowest = options.slowest
        self._values: dict[str, float] = {}
        self._came: dict[str, float] = {}
        self._by_frame: dict[tuple[int, bool], list[tuple[str, Message, Signal]]] = {}
        self._names: list[str] = []
        self._begun = 0.0
        for name in inputs:
            found = options.signal(name)
            if found is not None and name.partition(".")[0] not in options.nodes:
                message, signal = found
                self._names.append(name)
                key = message.identifier, message.extended
                self._by_frame.setdefault(key, []).append((name, message, signal))

    def begin(self) -> None:
        """Note that sampling begins: signals must arrive from now on."""
        self._begun = monotonic()

    def take(self, frame: Frame) -> None:
        """Decode a frame; one whose length differs from the DBC file is ignored."""
        for name, message, signal in self._by_frame.get((frame.identifier, frame.extended), ()):
            if len(frame.data) == message.length:
                value = signal.value(frame.data)
                if isfinite(value):
                    self._values[name], self._came[name] = value, monotonic()

    def value(self, name: str) -> float:
        """Newest value, in the unit of the DBC file."""
        return self._values[name]

    def fresh(self) -> bool:
        """Whether no signal is too old."""
        now = monotonic()
        return all(now - self._came.get(name, -1e9) <= self._slowest for name in self._names)

    def stale(self) -> str:
        """Name of a signal that is too old; empty if there is none."""
        now = monotonic()
        waited = (name for name in self._names if now - max(self._came.get(name, 0.0), self._begun) > self._slowest)
        return next(waited, "")
