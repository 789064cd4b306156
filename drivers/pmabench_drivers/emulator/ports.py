"""Pseudo-terminals under a path of one's own; POSIX only."""

from __future__ import annotations

import contextlib
import os
import select
import tty
from pathlib import Path

from pmabench.base.errors import UsageError


class Terminal:
    """A pseudo-terminal whose far end is reached by the symbolic link `path`."""

    def __init__(self, path: str) -> None:
        self._link = Path(path)
        if self._link.exists() and not self._link.is_symlink():
            raise UsageError(f"{path} is there and is no link of an emulator; give the device another address")
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        try:
            self._link.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(self._far))
        except OSError as error:
            self._hang_up()
            raise UsageError(f"cannot make the link {path}: {error.strerror}") from None

    def read(self, wait: float) -> bytes | None:
        """What came within `wait` [s]; None when it is closed."""
        try:
            if not select.select([self._near], [], [], wait)[0]:
                return b""
            return os.read(self._near, 4096)
        except (OSError, ValueError):
            return None

    def write(self, data: bytes) -> None:
        """Send, as long as anybody takes it: what finds no room is lost, as on a wire without a listener."""
        if self._near >= 0 and select.select([], [self._near], [], 0)[1]:
            os.write(self._near, data)

    def close(self) -> None:
        """Hang up, and take the link away; harmless when repeated."""
        with contextlib.suppress(OSError):
            if self._link.is_symlink():
                self._link.unlink()
        self._hang_up()

    def _hang_up(self) -> None:
        near, far, self._near, self._far = self._near, self._far, -1, -1
        for end in (far, near):
            if end >= 0:
                with contextlib.suppress(OSError):
                    os.close(end)
