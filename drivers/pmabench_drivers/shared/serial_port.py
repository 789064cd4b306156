"""A serial port that sends bytes by itself: questions while it is quiet, a reading thread while it streams.

Knows no protocol. pyserial is loaded when a port is opened.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
from collections.abc import Callable, Iterator
from time import monotonic
from typing import Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench_drivers.shared.link import reason

PIECE = 0.02
"""Longest single wait for bytes [s]."""
PUSH = 0.1
"""Longest time to hand bytes to the port [s]."""
JOIN = 0.15
"""How long the reading thread is given to end [s]."""
MOST = 20_000
"""More than this is never kept while an answer is waited for [bytes]."""


def hand_over(port: Any, data: bytes, seconds: float) -> None:
    """Hand bytes to an open port of pyserial, each once; raises OSError where it takes none for `seconds`.

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
    """What comes within the port's time-out, and all that waits then."""
    data = bytes(port.read(1))
    return data + bytes(port.read(min(port.in_waiting, MOST)))


class SerialPort:
    """An open port of one program alone; every call is bounded. Raises DeviceError."""

    def __init__(self, device: str, address: str, baud: int, clock: Clock, **settings: Any) -> None:
        self._device, self._address, self._clock = device, address, clock
        self._port = open_port(device, address, baudrate=baud, timeout=PIECE, **settings)
        self._halt = threading.Event()
        self._thread: threading.Thread | None = None
        self.gone = ""
        """Why the port was lost while it was listened to."""

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

    def listen(self, take: Callable[[bytes, float], None]) -> None:
        """From now on a thread hands each piece to `take`, with the time it came [s, bench time]."""
        self.hush()
        self.gone, self._halt = "", threading.Event()
        self._thread = threading.Thread(
            target=self._read, args=(take, self._halt), name=f"serial {self._device}", daemon=True
        )
        self._thread.start()

    @property
    def listening(self) -> bool:
        """Whether somebody listens."""
        return self._thread is not None

    def hush(self) -> None:
        """Listen no more; harmless when repeated."""
        self._halt.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(JOIN)

    def close(self) -> None:
        """Let go of the port; harmless when repeated."""
        self.hush()
        with contextlib.suppress(OSError):
            self._port.close()

    def _read(self, take: Callable[[bytes, float], None], halt: threading.Event) -> None:
        while not halt.is_set():
            try:
                data = received(self._port)
            except (OSError, TypeError) as error:
                if not halt.is_set():
                    self.gone = f"lost {self._address}: {reason(error)}"
                return
            if not data or halt.is_set():
                continue
            try:
                take(data, self._clock.now())
            except Exception as error:  # the owner learns it at the next collect
                self.gone = f"reading {self._address} broke off: {error}"
                return
