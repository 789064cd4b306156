"""What links to devices share: turns on one line, answers that did not come, links that are not open; knows no wire."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any, TypeVar

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench_drivers.shared.polling import JOIN

T = TypeVar("T")
Still = Callable[[], bool]
"""Whether what is about to be sent is still wanted."""
BUSY = "the line was busy with another call until the deadline"


class Unanswered(DeviceError):
    """No answer came to a question that was sent: whether it was carried out is not known."""


def always() -> bool:
    """Whether it is still wanted: yes."""
    return True


def opened(link: T | None, device: str) -> T:
    """The link, or an error where there is none."""
    if link is None:
        raise DeviceError(device, "is not open")
    return link


@contextmanager
def turn(lock: threading.Lock, deadline: float, device: str, what: str = "", busy: str = BUSY) -> Iterator[None]:
    """Hold the lock of a line; DeviceError if it is not free by `deadline` [s, monotonic]."""
    if not lock.acquire(timeout=max(0.0, deadline - monotonic())):
        raise DeviceError(device, busy, what)
    try:
        yield
    finally:
        lock.release()


def reason(error: Exception) -> str:
    """Why a port or a connection failed, in the words of the operating system where it has any."""
    return getattr(error, "strerror", None) or str(error)


class Listening(ABC):
    """A link with a thread that passes on every piece that arrives, with its time [s, bench time]."""

    def __init__(self, device: str, address: str, clock: Clock) -> None:
        self._device, self._address, self._clock = device, address, clock
        self._halt = threading.Event()
        self._thread: threading.Thread | None = None
        self.gone = ""
        """Why the link was lost while it was listened to."""

    @abstractmethod
    def _receive(self) -> Any:
        """What came within a short time, nothing in vain; OSError where the link is lost."""

    def listen(self, take: Callable[[Any, float], None]) -> None:
        """From now on a thread hands each piece to `take`."""
        self.hush()
        self.gone, self._halt = "", threading.Event()
        self._thread = threading.Thread(
            target=self._hand_on, args=(take, self._halt), name=f"reads {self._device}", daemon=True
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

    def _hand_on(self, take: Callable[[Any, float], None], halt: threading.Event) -> None:
        while not halt.is_set():
            try:
                piece = self._receive()
            except (OSError, ValueError, TypeError) as error:  # ValueError, TypeError: it was closed meanwhile
                if not halt.is_set():
                    self.gone = f"lost {self._address}: {reason(error)}"
                return
            if not piece or halt.is_set():
                continue
            try:
                take(piece, self._clock.now())
            except Exception as error:  # the owner learns it at the next call
                self.gone = f"reading {self._address} broke off: {error}"
                return
