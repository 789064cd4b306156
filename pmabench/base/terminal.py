"""Keyboard input from a terminal, key by key, and restoring its settings; the only module that uses termios.

Ctrl-C keeps its function. Ctrl-Z and Ctrl-S have none meanwhile, so that no bench is suspended by accident.
"""

from __future__ import annotations

import codecs
import os
import re
import select
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from pmabench.base.errors import UsageError

try:
    import termios
except ImportError:  # a system without them, for instance Windows
    termios = None  # type: ignore[assignment]

ESCAPE, ENTER, BACKSPACE = "\x1b", "\n", "\x7f"
_SEQUENCE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|O.|[^\x1b\[O])")
"""Escape sequences of arrow and function keys, pasting and mice."""

Attributes = list[Any]


def in_front(fd: int) -> bool:
    """Whether `fd` is a terminal with this process in the foreground, so that it may be read and changed."""
    with suppress(OSError, AttributeError):
        return os.isatty(fd) and os.tcgetpgrp(fd) == os.getpgrp()
    return False


def attributes(fd: int) -> Attributes | None:
    """Present settings of the terminal, for `restore`; None if it is no terminal."""
    if termios is not None:
        with suppress(termios.error, OSError):
            return termios.tcgetattr(fd)
    return None


def restore(fd: int, before: Attributes | None) -> None:
    """Restore the settings of the terminal; at once, also from the background, without an error if it is gone."""
    if termios is None or before is None:
        return
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTOU})
    try:
        with suppress(termios.error, OSError):
            termios.tcsetattr(fd, termios.TCSANOW, before)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)


def _taken_back(fd: int) -> bool:
    """Whether another program, such as a shell, has taken control of the terminal and changed its settings."""
    with suppress(OSError, AttributeError):
        return os.tcgetpgrp(fd) not in (0, os.getpgrp())
    return False


class Keyboard:
    """Keys of a terminal in `key_by_key` mode."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._decoder = codecs.getincrementaldecoder("utf-8")("ignore")

    def read(self, timeout: float = 0.0) -> list[str]:
        """Keys pressed, waiting at most `timeout` [s] for the first; special keys are `ENTER`, `BACKSPACE`, `ESCAPE`.

        Keys that send sequences (arrows, function keys) are left out. Raises EOFError if the terminal is gone.
        """
        if not in_front(self.fd) or not select.select([self.fd], [], [], timeout)[0]:
            return []
        try:
            raw = os.read(self.fd, 1024)
        except BlockingIOError:
            return []
        except OSError as error:
            raise EOFError("the terminal is gone") from error
        if not raw:
            raise EOFError("the terminal is gone")
        text = _SEQUENCE.sub("", self._decoder.decode(raw)).replace("\r", ENTER).replace("\b", BACKSPACE)
        return list(text)


@contextmanager
def key_by_key(fd: int) -> Iterator[Keyboard]:
    """Read keys as they are pressed, without echo; restores the terminal afterwards, unless a shell took it back.

    Raises UsageError if the system has no termios, or `fd` is not a terminal in the foreground.
    """
    if termios is None:
        raise UsageError("keys cannot be read: this system has no termios; use --plain")
    before = attributes(fd)
    if before is None or not in_front(fd):
        raise UsageError("keys cannot be read: the input is not a terminal in the foreground; use --plain")
    changed: Attributes = [list(part) if isinstance(part, list) else part for part in before]
    changed[0] &= ~(termios.IXON | termios.ICRNL)
    changed[3] &= ~(termios.ICANON | termios.ECHO)
    changed[6][termios.VSUSP] = b"\x00"
    changed[6][termios.VMIN], changed[6][termios.VTIME] = 1, 0
    try:
        termios.tcsetattr(fd, termios.TCSANOW, changed)
        yield Keyboard(fd)
    finally:
        if not _taken_back(fd):
            restore(fd, before)
