"""Messages between the guard and its clients: a key, two lengths, a JSON object, and a binary payload.

Each bench in use has two keys of 16 bytes that only its user can read (`guard.json` in the state folder): one starts
every request, the other every answer. A client without the key is refused before anything is parsed (S15).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from typing import Any

_HEAD = struct.Struct("!16sII")
LONGEST = 64 * 1024 * 1024
"""Longest message that is accepted [bytes]."""

Message = tuple[dict[str, Any], bytes]


def keys(token: str) -> tuple[bytes, bytes]:
    """Keys of requests and of answers, from the token in `guard.json`; raises ValueError if it is not hexadecimal."""
    return bytes.fromhex(token)[:16], bytes.fromhex(token)[16:]


def encode(message: Mapping[str, Any], key: bytes, payload: bytes = b"") -> bytes:
    """One message as bytes."""
    text = json.dumps(message, separators=(",", ":")).encode()
    return _HEAD.pack(key, len(text), len(payload)) + text + payload


class Messages:
    """Splits a stream of bytes into messages; raises ValueError for anything else, or for a wrong key."""

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._bytes = bytearray()

    def feed(self, piece: bytes) -> Iterator[Message]:
        """Yield every message that is complete once `piece` has arrived."""
        self._bytes += piece
        while len(self._bytes) >= _HEAD.size:
            key, text, payload = _HEAD.unpack_from(self._bytes)
            if key != self._key:
                raise ValueError("a stranger")
            end = _HEAD.size + text + payload
            if end > LONGEST:
                raise ValueError("a message is longer than any that is sent")
            if len(self._bytes) < end:
                return
            message = json.loads(bytes(self._bytes[_HEAD.size : _HEAD.size + text]))
            body = bytes(self._bytes[_HEAD.size + text : end])
            del self._bytes[:end]
            if not isinstance(message, dict):
                raise ValueError("a message must be a JSON object")
            yield message, body
