"""What happened on the emulated wires, as JSON lines with monotonic time: every exchange, and what was commanded.

Kinds: `received` and `sent` (bytes as hex, seen from the emulated device), `connect`, `disconnect`, `lost`; `set`,
`switch`, `watchdog` and others that devices name; `load`, `plant`, `fault` for what was done to them.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from time import monotonic
from typing import Any

Tap = Callable[[str, bytes], None]
"""Told of what one device `received` and `sent`."""


class CommandLog:
    """Keeps every entry but exchanges in memory, and everything in a file where one is named.

    `problem` says why the file ends early, where it does.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path, self._file = path, None if path is None else path.open("a", encoding="utf-8", buffering=1)
        self._lock = threading.Lock()
        self.entries: list[dict[str, Any]] = []
        self.problem = ""

    def note(self, kind: str, device: str, **data: Any) -> None:
        """One entry: monotonic time `t` [s], kind, device, and whatever else."""
        entry = {"t": monotonic(), "kind": kind, "device": device, **data}
        with self._lock:
            self.entries.append(entry)
            self._write(entry)

    def tap(self, device: str, **more: Any) -> Tap:
        """What writes down the exchanges of a device."""

        def note(kind: str, data: bytes) -> None:
            if self._file is not None and data:
                with self._lock:
                    self._write({"t": monotonic(), "kind": kind, "device": device, "data": data.hex(), **more})

        return note

    def _write(self, entry: dict[str, Any]) -> None:
        if self._file is None:
            return
        try:
            self._file.write(json.dumps(entry) + "\n")
        except OSError as error:
            self.problem = f"{self._path}: the log ends early: {error.strerror or error}"
            self._file = None

    def of(self, kind: str, device: str = "") -> list[dict[str, Any]]:
        """The entries of a kind (and of a device) so far, exchanges left out."""
        with self._lock:
            return [e for e in self.entries if e["kind"] == kind and device in {"", e["device"]}]

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None
