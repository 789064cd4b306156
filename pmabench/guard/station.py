"""What outlives a process of a real bench: its lock, its latch, where its guard listens, and its compiled bench.

One folder per bench, below `PMABENCH_STATE` or the user's state folder; standard library only, so that `vent` is fast.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from pmabench.base.errors import DeviceError, RecordError
from pmabench.base.system import try_lock

UNCLEAN = "the program ended without saying that the bench was safe"


def root() -> Path:
    """Where the folders of all benches are."""
    if given := os.environ.get("PMABENCH_STATE"):
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "pmabench" / "state"
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "pmabench"


def stations() -> Iterator[Station]:
    """Every bench that was ever armed here."""
    folder = root()
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.is_dir():
            yield Station(path.name)


class Station:
    """The folder of one bench; the file of each method's name is written whole or not at all."""

    def __init__(self, name: str) -> None:
        self.folder = root() / (re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "bench")
        self._lock: int | None = None

    def log(self) -> IO[bytes]:
        """Where the guard writes what goes wrong in itself; makes the folder. Raises DeviceError where it cannot."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            return (self.folder / "guard.log").open("ab")
        except OSError as error:
            raise DeviceError(
                self.folder.name, f"its state cannot be kept in {self.folder}: {error.strerror}; set PMABENCH_STATE"
            ) from error

    def take(self) -> None:
        """Be the only one who commands this bench until this process ends; raises DeviceError where another one is."""
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._lock = try_lock(self.folder / "lock")
        if self._lock is None:
            owner = self.read("guard")
            who = f"process {owner['pid']} of {owner['user']} since {owner['since']}" if owner else "another program"
            raise DeviceError(
                self.folder.name, f"this bench is in use by {who}; one program commands a bench at a time"
            )

    def write(self, file: str, data: Mapping[str, Any]) -> None:
        """Keep `data` in `file`.json: whole, synced, readable by this user only. Raises RecordError."""
        path = self.folder / f"{file}.json"
        part = path.with_suffix(f".{os.getpid()}.part")  # guard and `vent` may write at the same time
        try:
            handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                json.dump(data, stream)
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(path)
        except OSError as error:
            raise RecordError(f"cannot write {path}: {error.strerror}; the state of the bench is not kept") from error

    def read(self, file: str) -> dict[str, Any]:
        """What `file`.json holds; empty where there is none that can be read."""
        with suppress(OSError, ValueError):
            data = json.loads((self.folder / f"{file}.json").read_text("utf-8"))
            return data if isinstance(data, dict) else {}
        return {}

    def remove(self, file: str) -> None:
        """Take `file`.json away."""
        (self.folder / f"{file}.json").unlink(missing_ok=True)

    def note(self, what: str, **data: Any) -> None:
        """Add a line to the bench's journal, and make it the state of the bench; a latch keeps its first reason."""
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        before = self.read("state")
        line = {"what": what, "at": now, **data}
        first = (
            {"why": before.get("why"), "since": before.get("since")} if before.get("what") == what else {"since": now}
        )
        self.write("state", {**line, **first} if what == "tripped" else line)
        with suppress(OSError), (self.folder / "journal.jsonl").open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")

    def latched(self) -> str:
        """Why nothing may run on this bench before an operator has reset it; empty where it may."""
        state = self.read("state")
        if state.get("what") == "safe" or not (state or (self.folder / "state.json").exists()):
            return ""
        return f"{state.get('why') or UNCLEAN}, {state.get('since') or state.get('at') or 'at an unknown time'}"
