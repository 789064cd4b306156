"""How the plant's own process and those who talk to it speak: framing, one question at a time; standard library only.

A message is one line of JSON, ended by a line feed, and after it as many raw bytes as its key `bytes` says (none
without it). The client asks `{"n": 7, "by": 1234.5, "do": "write", "output": "pressure", "value": 3276.0}`: `n`
counts its questions, `by` is the moment on CLOCK_MONOTONIC [s] after which it no longer waits, so that the server must
not carry it out any more. The server answers `{"n": 7, ...}`, or `{"n": 7, "error": "sentence", "channel": ""}`.
Answers to older questions are passed over. What can be asked is in `pmabench_drivers.mock.server`.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

from pmabench.base.errors import DeviceError

LONGEST_LINE = 1 << 20
LONGEST_BYTES = 1 << 26
Message = tuple[dict[str, Any], bytes]


def encode(message: Mapping[str, Any], payload: bytes = b"") -> bytes:
    """One message as bytes."""
    head = {**message, "bytes": len(payload)} if payload else message
    return json.dumps(head, separators=(",", ":")).encode() + b"\n" + payload


class Inbox:
    """Whole messages out of a stream of bytes."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._head: dict[str, Any] | None = None

    def feed(self, piece: bytes) -> Iterator[Message]:
        """Every message that is complete with `piece`; ValueError for what is none."""
        self._bytes += piece
        while True:
            if self._head is None:
                end = self._bytes.find(b"\n")
                if end < 0:
                    if len(self._bytes) > LONGEST_LINE:
                        raise ValueError("a line is longer than any that is sent")
                    return
                self._head = self._read(bytes(self._bytes[:end]))
                del self._bytes[: end + 1]
            size = self._head.get("bytes", 0)
            if not isinstance(size, int) or not 0 <= size <= LONGEST_BYTES:
                raise ValueError(f"a message of {size} bytes")
            if len(self._bytes) < size:
                return
            head, payload = self._head, bytes(self._bytes[:size])
            del self._bytes[:size]
            self._head = None
            yield head, payload

    @staticmethod
    def _read(line: bytes) -> dict[str, Any]:
        message = json.loads(line)
        if not isinstance(message, dict):
            raise ValueError("a message is no JSON object")
        return message


def parse_address(device: str, address: str) -> tuple[str, int]:
    """`127.0.0.1:PORT` as host and port; only this machine is served."""
    host, _, port = address.rpartition(":")
    if host not in {"127.0.0.1", "localhost"} or not port.isdigit() or not 0 < int(port) < 65536:
        raise DeviceError(device, f'address "{address}": 127.0.0.1:PORT is expected, with a port from 1 to 65535')
    return "127.0.0.1", int(port)


class Link:
    """One connection to the server at `address`; OSError where nobody listens within `timeout` [s]."""

    def __init__(self, device: str, address: tuple[str, int], timeout: float) -> None:
        self._device = device
        self._socket = socket.create_connection(address, timeout)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._inbox = Inbox()
        self._number = 0

    def ask(self, do: str, by: float, **fields: Any) -> Message:
        """The answer to one question, until the moment `by` [s, CLOCK_MONOTONIC].

        Raises
        ------
        DeviceError
            For a question that was refused; the connection can be used on.
        OSError, ValueError
            Where no answer came in time (TimeoutError) or the other side has gone; the connection must be closed.
        """
        self._number += 1
        self._socket.settimeout(max(by - time.monotonic(), 1e-3))
        self._socket.sendall(encode({"n": self._number, "by": by, "do": do, **fields}))
        while True:
            piece = self._socket.recv(1 << 18)
            if not piece:
                raise ConnectionResetError("the other side has closed the connection")
            for answer, payload in self._inbox.feed(piece):
                if answer.get("n") == self._number:
                    if "error" in answer:
                        raise DeviceError(self._device, str(answer["error"]), str(answer.get("channel", "")))
                    return answer, payload
            left = by - time.monotonic()
            if left <= 0:
                raise TimeoutError
            self._socket.settimeout(left)

    def close(self) -> None:
        """Hang up; harmless when repeated, also from another thread."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
