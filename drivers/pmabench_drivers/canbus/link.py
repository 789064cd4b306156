"""One CAN adapter of one program: frames out, a thread that hands out what comes in. Loads python-can when opened."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench_drivers.canbus.frames import Frame
from pmabench_drivers.canbus.slcan import PUSH, Slcan

NUMBERED = ("kvaser", "ixxat")
"""Interfaces whose channels have numbers."""
INTERFACES = ("socketcan", "slcan", "pcan", *NUMBERED)
"""`slcan`, and python-can's names of what it is asked for."""
WAIT = 0.05
"""Longest single wait for a frame [s]."""
JOIN = 0.15
"""How long the reading thread is given to end [s]."""

Take = Callable[[Frame, float], None]
"""Takes a frame and when it came [s, bench time]."""


class PythonCan:
    """An adapter that python-can knows."""

    def __init__(self, interface: str, channel: str | int, bitrate: int) -> None:
        import can

        self._can = can
        self.serial = ""
        with self._as_os_error():
            self._bus: Any = can.Bus(interface=interface, channel=channel, bitrate=bitrate)

    def send(self, frame: Frame) -> None:
        """One frame out."""
        message = self._can.Message(
            arbitration_id=frame.identifier, data=frame.data, is_extended_id=frame.extended, check=True
        )
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
        """Let go of it."""
        with contextlib.suppress(Exception):  # whatever a maker's library says at the end
            self._bus.shutdown()

    @contextlib.contextmanager
    def _as_os_error(self) -> Any:
        """Errors of python-can and of makers' libraries as OSError."""
        try:
            yield
        except OSError:
            raise
        except Exception as error:
            raise OSError(str(error) or type(error).__name__) from error


Adapter = Slcan | PythonCan
"""What a link needs: `serial`, `send`, `receive` and `close`, which raise OSError."""


def open_adapter(address: str, bitrate: int, *, ask: bool) -> Adapter:
    """The adapter at INTERFACE:CHANNEL; `ask`: find out its serial number, where it tells it."""
    interface, _, channel = address.partition(":")
    if interface == "slcan":
        return Slcan(channel, bitrate, ask=ask)
    return PythonCan(interface, int(channel) if interface in NUMBERED else channel, bitrate)


class Link:
    """An open adapter; `take` is called in the reading thread. Raises DeviceError."""

    def __init__(self, device: str, address: str, adapter: Callable[[], Adapter], clock: Clock, take: Take) -> None:
        self._device, self._address, self._clock, self._take = device, address, clock, take
        self._lock, self._halt = threading.Lock(), threading.Event()
        self.gone = ""
        """Why the adapter was lost."""
        try:
            self._adapter = adapter()
        except OSError as error:
            raise DeviceError(device, f"cannot open {address}: {error.strerror or error}") from None
        self.serial = self._adapter.serial
        """Serial number of the adapter, where it is known."""
        self._thread = threading.Thread(target=self._read, name=f"can {device}", daemon=True)
        self._thread.start()

    def send(self, identifier: int, data: bytes = b"") -> None:
        """Hand a frame to the adapter, once."""
        if self.gone:
            raise DeviceError(self._device, self.gone)
        try:
            with self._lock:
                self._adapter.send(Frame(identifier, data))
        except OSError as error:
            raise DeviceError(self._device, f"cannot send to {self._address}: {error.strerror or error}") from None

    def close(self) -> None:
        """Let go of the adapter; harmless when repeated."""
        self._halt.set()
        if self._thread is not threading.current_thread():
            self._thread.join(JOIN)
        self._adapter.close()

    def _read(self) -> None:
        while not self._halt.is_set():
            try:
                frame = self._adapter.receive(WAIT)
            except (OSError, ValueError, TypeError) as error:  # ValueError, TypeError: it was closed meanwhile
                if not self._halt.is_set():
                    self.gone = f"lost {self._address}: {getattr(error, 'strerror', None) or error}"
                return
            if frame is None or self._halt.is_set():
                continue
            try:
                self._take(frame, self._clock.now())
            except Exception as error:  # the owner learns it at the next call
                self.gone = f"reading {self._address} broke off: {error}"
                return
