"""Serial ports: questions while a port is quiet, a reading thread while it streams, lines of text in its bytes.

`SerialStream` is the driver of a device that sends by itself. Knows no protocol. pyserial is loaded when a port is
opened.
"""

from __future__ import annotations

import contextlib
import os
import select
from abc import abstractmethod
from collections.abc import Callable, Iterator
from time import monotonic
from typing import Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, DeviceRecord, Identity
from pmabench_drivers.shared.device import Driver
from pmabench_drivers.shared.link import Listening, Samples, opened, reason

LONGEST_LINE = 120
PIECE = 0.02
"""Longest single wait for bytes [s]."""
PUSH = 0.1
"""Longest time to hand bytes to the port [s]."""
MOST = 20_000
"""More than this is never kept while an answer is waited for [bytes]."""
STREAM_PATIENCE = 0.5
"""So long nothing usable may come before `collect` says so [s]."""


class Wrong(Exception):
    """A line that must never be taken for a measurement: another unit, a fault that the device reports."""


class Unreadable(Exception):
    """A line that is not what is expected: cut off, disturbed, something else."""


class Splitter:
    """Cuts a stream of bytes into lines; what comes before the first terminator is not a whole line and is dropped."""

    def __init__(self, terminator: bytes, *, whole: bool = False) -> None:
        self._terminator, self._whole = terminator, whole
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The whole lines that end in `data`; one that is too long is dropped up to its end."""
        *lines, self._rest = (self._rest + data).split(self._terminator)
        found = []
        for line in lines:
            if self._whole and len(line) <= LONGEST_LINE:
                found.append(line)
            self._whole = True
        if len(self._rest) > LONGEST_LINE + len(self._terminator):
            self._rest, self._whole = self._rest[-len(self._terminator) :], False
        return found


def readable(line: bytes) -> str:
    """The start of a line with only what can be printed, for messages."""
    return "".join(chr(byte) if 32 <= byte < 127 else "." for byte in line[:40])


def text_of(line: bytes) -> str:
    """A line as text; raises `Unreadable` where it is too long, or no ASCII."""
    if len(line) > LONGEST_LINE:
        raise Unreadable("a line longer than any that is expected")
    try:
        return line.decode("ascii")
    except UnicodeDecodeError:
        raise Unreadable(f'"{readable(line)}"') from None


def hand_over(port: Any, data: bytes, seconds: float) -> None:
    """Hand bytes to an open port of pyserial, or a socket, each once; OSError where it takes none for `seconds`.

    Its own `write` says "Write timeout" though every byte went out, where the program stood still for so long.
    """
    deadline = monotonic() + seconds
    while data:
        with contextlib.suppress(BlockingIOError):
            data = data[os.write(port.fileno(), data) :]
        if data and not select.select([], [port.fileno()], [], max(0.0, deadline - monotonic()))[1]:
            raise TimeoutError(f"it takes no bytes for {seconds:g} s")


def open_port(device: str, address: str, **settings: Any) -> Any:
    """A port of pyserial for this program alone; `settings` are those of `serial.Serial`. Raises DeviceError."""
    import serial

    try:
        return serial.Serial(address, exclusive=True, **settings)
    except (OSError, ValueError) as error:
        busy = "temporarily unavailable" in str(error) or "exclusively lock" in str(error)
        why = "another program has it open" if busy else reason(error)
        raise DeviceError(device, f"cannot open {address}: {why}") from None


def received(port: Any) -> bytes:
    """The bytes that arrive within the port's time-out, and all that are waiting then."""
    data = bytes(port.read(1))
    return data + bytes(port.read(min(port.in_waiting, MOST)))


class SerialPort(Listening):
    """An open port of one program alone; every call is bounded. Raises DeviceError."""

    def __init__(self, device: str, address: str, baud: int, clock: Clock, **settings: Any) -> None:
        super().__init__(device, address, clock)
        self._port = open_port(device, address, baudrate=baud, timeout=PIECE, **settings)

    def send(self, data: bytes) -> None:
        """Hand bytes to the port, once."""
        with self._explained("cannot send to"):
            hand_over(self._port, data, PUSH)

    def receive(self, whole: Callable[[bytes], bool], seconds: float) -> bytes:
        """What comes until it is whole, `seconds` have passed, or nothing more is kept."""
        deadline, data = monotonic() + seconds, b""
        with self._explained():
            while not whole(data) and len(data) < MOST and monotonic() < deadline:
                data += received(self._port)
        return data

    def drain(self) -> bytes:
        """What waits."""
        with self._explained():
            return bytes(self._port.read(min(self._port.in_waiting, MOST)))

    @contextlib.contextmanager
    def _explained(self, what: str = "lost") -> Iterator[None]:
        try:
            yield
        except (OSError, TypeError) as error:  # TypeError: it was closed meanwhile
            raise DeviceError(self._device, f"{what} {self._address}: {reason(error)}") from None

    def _receive(self) -> bytes:
        return received(self._port)

    def close(self) -> None:
        """Let go of the port; harmless when repeated."""
        self.hush()
        with contextlib.suppress(OSError):
            self._port.close()


class SerialStream(Driver):
    """One device that has a port to itself; a kind of device says how it is greeted, quieted and read."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._port: SerialPort | None = None
        self._forget()

    @abstractmethod
    def _greet(self) -> Identity:
        """Stop what the device is sending, check that it is the right device, and configure it."""

    @abstractmethod
    def _quiet(self) -> None:
        """End a stream that may be under way."""

    @abstractmethod
    def _take(self, data: bytes, now: float) -> None:
        """Bytes that came at `now` [s, bench time], on the port's thread; what ends the stream goes to `_failure`."""

    @abstractmethod
    def _missing(self) -> str:
        """What is said where nothing usable has come for too long."""

    def _forget(self) -> None:
        """Nothing has come yet."""
        self._samples = Samples([channel.name for channel in self._device.channels])
        self._failure = ""
        self._heard = monotonic()

    def open(self) -> Identity:
        """Quiet it, see that it is the right device, and set what a true record needs; nothing is saved in it."""
        self.close()
        self._port = SerialPort(self._device.name, self._device.address, self._options.baud, self._clock)
        with self._closed_on_error():
            return self._greet()

    def close(self) -> None:
        """Quiet it and let go of the port."""
        if (port := self._port) is not None:
            self.stop()
            self._port = None
            port.close()

    def collect(self) -> Block:
        """What came since the last call; an error where it is silent, or the stream has failed."""
        port = self._opened()
        why = port.gone or self._failure
        if not why and port.listening and monotonic() - self._heard > self._patience:
            why = f"{self._missing()} for {STREAM_PATIENCE:g} s"
        if why:
            raise self._error(why)
        return self._samples.take()

    def stop(self) -> None:
        """End the stream; harmless when repeated."""
        port = self._port
        if port is not None and port.listening:
            port.hush()
            with contextlib.suppress(DeviceError):  # a port that is lost sends nothing either
                self._quiet()

    @property
    def _patience(self) -> float:
        return STREAM_PATIENCE

    def _ready(self, rate: float) -> SerialPort:
        """The port, quiet, for a stream that begins."""
        self._refuse_rate(rate)
        port = self._opened()
        self.stop()
        return port

    def _opened(self) -> SerialPort:
        return opened(self._port, self._device.name)
