"""What links to devices share: turns on one line, answers that did not come, links that are not open; knows no wire."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import TypeVar

from pmabench.base.errors import DeviceError

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
    """The lock of a line, which is not waited for beyond `deadline` [s, monotonic]."""
    if not lock.acquire(timeout=max(0.0, deadline - monotonic())):
        raise DeviceError(device, busy, what)
    try:
        yield
    finally:
        lock.release()


def reason(error: Exception) -> str:
    """Why a port or a connection failed, in the words of the operating system where it has any."""
    return getattr(error, "strerror", None) or str(error)
