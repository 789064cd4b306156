"""Messages between the guard and those who talk to it: a length, a JSON object, and bytes that are not looked at."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Iterator, Mapping
from typing import Any

_HEAD = struct.Struct("!II")
LONGEST = 64 * 1024 * 1024
"""Longest message that is believed [bytes]."""

Message = tuple[dict[str, Any], bytes]


def encode(message: Mapping[str, Any], payload: bytes = b"") -> bytes:
    """One message as bytes."""
    text = json.dumps(message, separators=(",", ":")).encode()
    return _HEAD.pack(len(text), len(payload)) + text + payload


class Messages:
    """Whole messages out of a stream of bytes; raises ValueError for what is none."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, piece: bytes) -> Iterator[Message]:
        """Every message that is complete with `piece`."""
        self._bytes += piece
        while len(self._bytes) >= _HEAD.size:
            text, payload = _HEAD.unpack_from(self._bytes)
            end = _HEAD.size + text + payload
            if end > LONGEST:
                raise ValueError("a message is longer than any that is sent")
            if len(self._bytes) < end:
                return
            message = json.loads(bytes(self._bytes[_HEAD.size : _HEAD.size + text]))
            body = bytes(self._bytes[_HEAD.size + text : end])
            del self._bytes[:end]
            if not isinstance(message, dict):
                raise ValueError("a message is no JSON object")
            yield message, body


def exchange(link: socket.socket, message: Mapping[str, Any], within: float) -> Message:
    """Send a message and wait for one answer; raises OSError (a time-out is one) or ValueError."""
    link.settimeout(within)
    link.sendall(encode(message))
    messages = Messages()
    while True:
        piece = link.recv(1 << 20)
        if not piece:
            raise ConnectionResetError("the other side has gone")
        for answer in messages.feed(piece):
            return answer
