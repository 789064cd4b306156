"""State of a real bench that outlives a process: its lock, its latch, where its guard listens, its compiled bench.

One folder per bench, below `PMABENCH_STATE` or the user's state folder; standard library only, so that `vent` is fast.
A device is locked as well as the bench: two bench files with one device are refused, whatever they are called (S14).
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmabench.base.errors import DeviceError, RecordError
from pmabench.base.system import try_lock

UNCLEAN = "the program or its guard ended without saying that the bench was safe"


def root() -> Path:
    """Folder with the folders of all benches."""
    if given := os.environ.get("PMABENCH_STATE"):
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "pmabench" / "state"
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "pmabench"


def stations() -> Iterator[Station]:
    """All benches that were ever armed on this computer."""
    folder = root()
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.is_dir():
            yield Station(path.name, path)


def folder_name(name: str) -> str:
    """Folder name, unique for each bench name in any script, also where the file system ignores case."""
    plain = re.sub(r"[^a-z0-9._-]+", "-", name.lower())[:60].strip("-.")
    if plain and plain == name:
        return plain
    return f"{plain}~{hashlib.sha256(name.encode('utf-8', 'surrogatepass')).hexdigest()[:16]}"


class Station:
    """Folder of one bench; each JSON file in it is written completely or not at all."""

    def __init__(self, name: str, folder: Path | None = None) -> None:
        self.name = name
        self.folder = folder or root() / folder_name(name)
        self._devices: list[str] = []
        """Addresses and serial numbers of the devices that are locked for this bench."""

    def take(self) -> None:
        """Lock the bench for this process until it ends; raises DeviceError if another process holds the lock."""
        before = root() / (re.sub(r"[^A-Za-z0-9._-]+", "-", self.name).strip("-.") or "bench")
        if before.is_dir() and not self.folder.exists() and Station("", before).read("bench").get("name") == self.name:
            before.rename(self.folder)  # its folder name, with its latch, before version 0.2
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if try_lock(self.folder / "lock") is None:
            owner = self.read("guard")
            who = f"process {owner['pid']} of {owner['user']} since {owner['since']}" if owner else "another program"
            raise DeviceError(
                self.name,
                f"this bench is in use by {who}; one program commands a bench at a time: "
                f"`pmabench watch` shows its run, `pmabench vent {shlex.quote(self.name)}` ends it",
            )

    def take_device(self, where: str) -> None:
        """Lock the device with this address or serial number for this process until it ends.

        Raises DeviceError if another bench uses it now, or if another bench that uses it is latched.
        """
        if where in self._devices:
            raise DeviceError(self.name, f"two of its devices are one, {where}: correct an address of the bench file")
        path = root() / f"{folder_name(where)}.device"
        if try_lock(path) is None:
            owner = path.read_text("utf-8").strip() or "another program"
            raise DeviceError(
                self.name, f"its device at {where} is in use by {owner}; one program commands a device at a time"
            )
        path.write_text(f'the bench "{self.name}", process {os.getpid()}\n', encoding="utf-8")
        self._devices.append(where)
        for other in stations():
            if other.folder != self.folder and where in other.read("state").get("devices", ()) and other.latched():
                name = other.read("bench").get("name", other.name)
                raise DeviceError(
                    self.name,
                    f'its device at {where} belongs to the bench "{name}" too, which is tripped: {other.latched()}. '
                    f'Look at it, then: pmabench vent "{name}" --reset --operator NAME --because TEXT',
                )

    def write(self, file: str, data: Mapping[str, Any]) -> None:
        """Write `data` to `file`.json: complete, synced, readable by this user only. Raises RecordError."""
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
        """Contents of `file`.json; empty if it cannot be read."""
        with suppress(OSError, ValueError):
            data = json.loads((self.folder / f"{file}.json").read_text("utf-8"))
            return data if isinstance(data, dict) else {}
        return {}

    def remove(self, file: str) -> None:
        """Delete `file`.json."""
        (self.folder / f"{file}.json").unlink(missing_ok=True)

    def note(self, what: str, **data: Any) -> None:
        """Add a line to the bench's journal, and make it the current state; a latched bench keeps its first reason."""
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        before = self.read("state")
        line = {"what": what, "at": now, "devices": self._devices or before.get("devices", []), **data}
        first = (
            {"why": before.get("why"), "since": before.get("since")} if before.get("what") == what else {"since": now}
        )
        self.write("state", {**line, **first} if what == "tripped" else line)
        with suppress(OSError), (self.folder / "journal.jsonl").open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")

    def latched(self) -> str:
        """Reason for which an operator must reset the bench before anything may run; empty if there is none."""
        state = self.read("state")
        if state.get("what") == "safe" or not (state or (self.folder / "state.json").exists()):
            return ""
        return f"{state.get('why') or UNCLEAN}, {state.get('since') or state.get('at') or 'at an unknown time'}"
