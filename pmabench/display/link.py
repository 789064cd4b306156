"""Messages between a run and its display: JSON objects, one a line, over a socket that never blocks either of them."""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from typing import Any

MOST = 1 << 16
"""Bytes that wait to be sent, and the longest message."""


class Link:
    """One end. What cannot be taken is not sent, and `send` says so."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._socket = end
        self._out = bytearray()
        self._in = bytearray()
        self.closed = False
        """Whether the other end is gone."""

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    @property
    def waiting(self) -> bool:
        """Whether something waits to be sent."""
        return bool(self._out)

    def send(self, message: Mapping[str, Any]) -> bool:
        """Send as far as the other end takes it now; the rest goes with later calls. False: dropped."""
        self.flush()
        line = json.dumps(message, default=str).encode() + b"\n"
        if self.closed or len(self._out) + len(line) > MOST:
            return False
        self._out += line
        self.flush()
        return not self.closed

    def flush(self) -> None:
        """Send what waits, as far as it is taken."""
        try:
            while self._out and not self.closed:
                del self._out[: self._socket.send(self._out)]
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self.closed = True

    def receive(self) -> list[dict[str, Any]]:
        """What has come; lines that are no JSON objects are left out."""
        try:
            while len(self._in) < 4 * MOST:
                piece = self._socket.recv(MOST)
                if not piece:
                    self.closed = True
                    break
                self._in += piece
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            self.closed = True
        *lines, rest = bytes(self._in).split(b"\n")
        self._in = bytearray(rest if len(rest) <= MOST else b"")
        return [message for message in map(_parsed, lines) if message is not None]

    def close(self) -> None:
        """Let go; harmless when repeated."""
        self.closed = True
        self._socket.close()


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None
