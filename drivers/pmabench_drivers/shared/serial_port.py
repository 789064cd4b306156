"""Serial ports: requests to a quiet port, a reading thread for a streaming one, text lines in its bytes.

`SerialStream` is the driver of a device that sends by itself. Uses no protocol. pyserial is imported when a port is
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
from pmabench_drivers.shared.link import Listening, Samples, reason

LONGEST_LINE = 120
PIECE = 0.02
"""Longest single wait for bytes [s]."""
PUSH = 0.1
"""Longest time to pass bytes to the port [s]."""
MOST = 20_000
"""Largest number of bytes kept during the wait for an answer."""
STREAM_PATIENCE = 0.5
"""Time without usable data after which `collect` raises an error [s]."""


class Wrong(Exception):
    """A line that must never be taken for a measurement: another unit, a fault that the device reports."""


class Unreadable(Exception):
    """A line in another format than expected: cut off, disturbed, something else."""


class Splitter:
    """Cuts a stream of bytes into lines; the part before the first terminator is not a whole line and is dropped."""

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
    """Printable start of a line, for messages."""
    return "".join(chr(byte) if 32 <= byte < 127 else "." for byte in line[:40])


def text_of(line: bytes) -> str:
    """A line as text; raises `Unreadable` if it is too long, or not ASCII."""
    if len(line) > LONGEST_LINE:
        raise Unreadable("a line longer than any that is expected")
    try:
        return line.decode("ascii")
    except UnicodeDecodeError:
        raise Unreadable(f'"{readable(line)}"') from None


def hand_over(port: Any, data: bytes, seconds: float) -> None:
    """Pass bytes to an open port of pyserial, or a socket, each once; raises OSError if it takes none for `seconds`.

    pyserial's `write` raises "Write timeout" although every byte was sent, if the program was stopped for that time.
    """
    deadline = monotonic() + seconds
    while data:
        with contextlib.suppress(BlockingIOError):
            data = data[os.write(port.fileno(), data) :]
        if data and not select.select([], [port.fileno()], [], max(0.0, deadline - monotonic()))[1]:
            raise TimeoutError(f"it takes no bytes for {seconds:g} s")


def open_port(device: str, address: str, **settings: Any) -> Any:
    """A port of pyserial, opened exclusively; `settings` are those of `serial.Serial`. Raises DeviceError."""
    import serial

    try:
        return serial.Serial(address, exclusive=True, **settings)
    except (OSError, ValueError) as error:
        busy = "temporarily unavailable" in str(error) or "exclusively lock" in str(error)
        why = "another program has it open" if busy else reason(error)
        raise DeviceError(device, f"cannot open {address}: {why}") from None


def received(port: Any) -> bytes:
    """The bytes that arrive within the port's time-out, and all that are then waiting."""
    data = bytes(port.read(1))
    return data + bytes(port.read(min(port.in_waiting, MOST)))


class SerialPort(Listening):
    """A port opened exclusively; every call is bounded. Raises DeviceError."""

    def __init__(self, device: str, address: str, baud: int, clock: Clock, **settings: Any) -> None:
        super().__init__(device, address, clock)
        self._port = open_port(device, address, baudrate=baud, timeout=PIECE, **settings)

    def send(self, data: bytes) -> None:
        """Pass bytes to the port, once."""
        with self._explained("cannot send to"):
            hand_over(self._port, data, PUSH)

    def receive(self, whole: Callable[[bytes], bool], seconds: float) -> bytes:
        """Bytes received until they are `whole`, `seconds` have passed, or no more are kept."""
        deadline, data = monotonic() + seconds, b""
        with self._explained():
            while not whole(data) and len(data) < MOST and monotonic() < deadline:
                data += received(self._port)
        return data

    def drain(self) -> bytes:
        """The waiting bytes."""
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
        """Close the port; may be called again."""
        self.hush()
        with contextlib.suppress(OSError):
            self._port.close()


class SerialStream(Driver[SerialPort]):
    """One device with its own port; a kind of device defines how it is set up, stopped and read."""

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._forget()

    @abstractmethod
    def _greet(self) -> Identity:
        """Stop what the device is sending, check that it is the right device, and configure it."""

    @abstractmethod
    def _quiet(self) -> None:
        """End a stream that may be in progress."""

    @abstractmethod
    def _take(self, data: bytes, now: float) -> None:
        """Take bytes that arrived at `now` [s, bench time], on the port's thread; sets `_failure` to end the stream."""

    @abstractmethod
    def _missing(self) -> str:
        """Error message if nothing usable has arrived for too long."""

    def _forget(self) -> None:
        """Reset to the state before any data."""
        self._samples = Samples([channel.name for channel in self._device.channels])
        self._failure = ""
        self._heard = monotonic()

    def open(self) -> Identity:
        """Stop its stream, check the model, and write the settings that a complete record needs; they are not saved."""
        self.close()
        self._link = SerialPort(self._device.name, self._device.address, self._options.baud, self._clock)
        with self._closed_on_error():
            return self._greet()

    def close(self) -> None:
        """Stop its stream and close the port."""
        self.stop()
        self._hang_up()

    def collect(self) -> Block:
        """Samples since the last call; raises DeviceError if it is silent, or the stream has failed."""
        port = self._opened()
        why = port.gone or self._failure
        if not why and port.listening and monotonic() - self._heard > self._patience:
            why = f"{self._missing()} for {STREAM_PATIENCE:g} s"
        if why:
            raise self._error(why)
        return self._samples.take()

    def stop(self) -> None:
        """End the stream; may be called again."""
        port = self._link
        if port is not None and port.listening:
            port.hush()
            with contextlib.suppress(DeviceError):  # a lost port sends nothing either
                self._quiet()

    @property
    def _patience(self) -> float:
        return STREAM_PATIENCE

    def _ready(self, rate: float) -> SerialPort:
        """The port, quiet, for a new stream."""
        self._refuse_rate(rate)
        port = self._opened()
        self.stop()
        return port
