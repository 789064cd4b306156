"""The example controller's lines, and the connection; knows neither units nor pmabench's interface.

A question is `NN WORD ARGUMENT*CC` and a line feed: NN its number (two hexadecimal digits), CC the sum of all bytes
before the star modulo 256. The answer has the same form and the number of its question: so a damaged answer is seen by
its sum, and an old one by its number.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from itertools import count
from time import monotonic

from pmabench.base.errors import DeviceError

LONGEST = 200
"""No line is longer [bytes]."""


def line(number: int, text: str) -> bytes:
    """A whole line."""
    body = f"{number % 256:02X} {text}".encode("ascii")
    return body + b"*%02X\n" % (sum(body) % 256)


def parse(data: bytes) -> tuple[int, str]:
    """Number and text of a line without its line feed; ValueError where it is damaged."""
    body, star, told = data.rpartition(b"*")
    if not star or told != b"%02X" % (sum(body) % 256):
        raise ValueError(f"a damaged line: {data[:40]!r}")
    number, _, text = body.decode("ascii").partition(" ")
    return int(number, 16), text


class Connection:
    """One TCP connection, used by any thread in turn; made anew after any doubt. Raises DeviceError."""

    def __init__(self, device: str, address: str, timeout: float) -> None:
        host, _, port = address.rpartition(":")
        self._device, self._address, self._timeout = device, (host, int(port)), timeout
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._numbers = count(1)

    def ask(self, text: str, deadline: float) -> str:
        """Send a question once and return its answer, before `deadline` [s, monotonic]."""
        if not self._lock.acquire(timeout=max(0.0, deadline - monotonic())):
            raise DeviceError(self._device, "the line was busy until the deadline")
        try:
            deadline = min(deadline, monotonic() + self._timeout)
            number = next(self._numbers) % 256
            connection = self._connected(deadline)
            connection.settimeout(max(0.001, deadline - monotonic()))
            connection.sendall(line(number, text))
            return self._answer(connection, number, deadline)
        except (OSError, ValueError) as error:
            self._drop()  # what was asked may have been done: nothing is sent again, and no late answer can come
            why = str(error) or type(error).__name__
            raise DeviceError(self._device, f'no answer to "{text}" within {self._timeout:g} s: {why}') from None
        finally:
            self._lock.release()

    def close(self) -> None:
        """Let go; harmless when repeated."""
        with self._lock:
            self._drop()

    def _connected(self, deadline: float) -> socket.socket:
        if self._socket is None:
            self._socket = socket.create_connection(self._address, timeout=max(0.001, deadline - monotonic()))
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self._socket

    def _answer(self, connection: socket.socket, number: int, deadline: float) -> str:
        data = b""
        while not data.endswith(b"\n"):
            connection.settimeout(max(0.001, deadline - monotonic()))
            received = connection.recv(LONGEST)
            if not received:
                raise ValueError("the connection was closed")
            data += received
            if len(data) > LONGEST:
                raise ValueError("a line that does not end")
        told, text = parse(data[:-1])
        if told != number:
            raise ValueError(f"the answer to another question, {told:02X} instead of {number:02X}")
        return text

    def _drop(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            with contextlib.suppress(OSError):
                connection.close()
