"""What was commanded, as JSON lines with monotonic time, for whoever must prove when something was sent."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from time import monotonic
from typing import Any


class CommandLog:
    """Keeps every entry in memory, and in a file where one is named."""

    def __init__(self, path: Path | None = None) -> None:
        self._file = None if path is None else path.open("a", encoding="utf-8", buffering=1)
        self._lock = threading.Lock()
        self.entries: list[dict[str, Any]] = []

    def note(self, kind: str, device: str, **data: Any) -> None:
        """One entry: monotonic time `t` [s], kind, device, and whatever else."""
        entry = {"t": monotonic(), "kind": kind, "device": device, **data}
        with self._lock:
            self.entries.append(entry)
            if self._file is not None:
                self._file.write(json.dumps(entry) + "\n")

    def of(self, kind: str, device: str = "") -> list[dict[str, Any]]:
        """The entries of a kind (and of a device) so far."""
        with self._lock:
            return [e for e in self.entries if e["kind"] == kind and device in {"", e["device"]}]

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._file is not None:
                self._file.close()
                self._file = None
