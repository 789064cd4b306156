"""A socket on 127.0.0.1 that takes one JSON object a line: loads, faults, the log; knows no wire.

`{"load": {"force": 58.86, "mass": 6}}`, `{"device": "regulator", "fault": "delay", "value": 0.3, "count": 5}`,
`{"plant": "burst"}` (a fault of the mock; `"over": true` ends it), `{"log": "set"}`. Each is answered by one line,
`{"ok": true, ...}` or `{"ok": false, "why": "..."}`.
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Callable, Mapping
from typing import Any

LONGEST = 10_000


class Control:
    """Listens, and hands each object to `act`."""

    def __init__(self, act: Callable[[Mapping[str, Any]], dict[str, Any]], port: int = 0) -> None:
        self._act = act
        self._listener = socket.create_server(("127.0.0.1", port))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, name="control", daemon=True).start()

    def close(self) -> None:
        """Listen no more."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, _peer = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError), connection.makefile("rwb") as stream:
            while line := stream.readline(LONGEST):
                try:
                    wanted = json.loads(line)
                    if not isinstance(wanted, dict):
                        raise ValueError("an object is expected")
                    reply = {"ok": True, **self._act(wanted)}
                except (ValueError, TypeError, KeyError, RecursionError) as error:
                    reply = {"ok": False, "why": str(error)}
                stream.write(json.dumps(reply).encode() + b"\n")
                stream.flush()
