"""Writes one run: the folder before anything moves, samples and events during the run, the seal at its end.

Samples wait in memory for about 0.05 s of wall-clock time; one thread passes them to the operating system, and another
one syncs them, so that a slow disk does not block the run. The writer must not know plans, the meaning of trials, or SI
values. The README.txt explains how to read a run without pmabench, in lines that the tests execute.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import platform
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import InvalidFile, RecordError
from pmabench.store import folder as files
from pmabench.store.livestream import LiveStream, describe
from pmabench.store.seal import free_for_events, keep_room, seal

FLUSH_EVERY = 0.05
"""Interval at which samples are passed to the operating system [s of wall clock]."""
SYNC_EVERY = 1.0
"""Interval at which samples and events are synced [s of wall clock]."""
STALLED = 5.0
"""In real time, a disk that has accepted nothing for this long [s of wall clock] has failed."""
PATIENT = 120.0
"""The same where samples can wait: in virtual time, and for imports."""
AT_ONCE = 100_000
"""Number of rows written together if all are available at once."""
_SAMPLES_FIRST = ("trial-end", "vent", "end")
"""Kinds of events before which all waiting samples are written."""


class RunWriter:
    """The only writer of a run's folder. Every method raises RecordError where the record cannot be written.

    `append` and `event` may be called from several threads, not from a signal handler.
    """

    def __init__(self, folder: Path, events: files.AppendFile) -> None:
        """Use `RunWriter.create`."""
        self.folder = folder
        self.waits = False
        """Whether samples can wait for the disk, as in virtual time."""
        self._events = events
        self._lines: list[bytes] = []
        self._seq = 0
        self._crc = 0
        self._last_t = 0.0
        self._streams: dict[str, LiveStream] = {}
        self._lock = threading.Lock()
        self._failure: RecordError | None = None
        self._reported = False
        self._closed = False
        self._stop = threading.Event()
        self._syncing: float | None = None
        self._threads = [
            threading.Thread(target=task, name=f"pmabench-{name}", daemon=True)
            for name, task in (("record", self._pump), ("sync", self._sync))
        ]
        for thread in self._threads:
            thread.start()
        atexit.register(self._halt)

    @classmethod
    def create(
        cls, parent: Path, name: str, manifest: Mapping[str, Any], snapshots: Mapping[str, bytes | files.Copy]
    ) -> RunWriter:
        """Make the folder `parent`/`name` (`name-2` ... if it exists) with snapshots and manifest, complete and synced.

        `snapshots` maps names inside the folder to the contents of the run's source files. Id, schema, versions and
        hashes are added to the manifest, and the start if missing. Leaves nothing behind if it fails.
        """
        contents = {files.check_name(key): value for key, value in snapshots.items()}
        contents[files.README] = Path(__file__).with_name("readme.txt").read_bytes()
        made_parent = not parent.exists()
        folder = parent / files.check_name(name)
        made = False
        try:
            parent.mkdir(parents=True, exist_ok=True)
            folder = _make_folder(parent, name)
            made = True
            (folder / files.STREAMS).mkdir()
            for key, content in contents.items():
                (folder / key).parent.mkdir(parents=True, exist_ok=True)
                if isinstance(content, files.Copy):
                    files.copy_whole(folder / key, content)
                else:
                    files.write_whole(folder / key, content)
            keep_room(folder)
            full = _full_manifest(folder.name, manifest, contents)
            events = files.AppendFile(folder / files.EVENTS).open()
            files.write_whole(folder / files.MANIFEST, files.sealed_json(full))
            files.sync_folder(parent)
        except (OSError, InvalidFile) as error:
            if made:
                shutil.rmtree(folder, ignore_errors=True)
            if made_parent:
                with suppress(OSError):
                    parent.rmdir()
            if isinstance(error, InvalidFile):
                raise
            raise files.cannot_write(folder, error) from error
        return cls(folder, events)

    def open_stream(self, name: str, columns: Sequence[Mapping[str, Any]], rate: float) -> None:
        """Begin a stream of one device with its columns as `asdict(ChannelRecord)` and its rate [Hz, 0: irregular]."""
        self._check()
        if name in self._streams:
            raise RecordError(f"stream {name} is open already")
        path = self.folder / files.STREAMS / f"{files.check_name(name)}.arrows"
        about = describe(name, columns, rate)
        try:
            stream = LiveStream(path, about)
            files.write_whole(path.with_suffix(".json"), json.dumps(about, indent=1).encode())
        except OSError as error:
            raise files.cannot_write(path, error) from error
        with self._lock:
            self._streams = {**self._streams, name: stream}

    def append(
        self,
        stream: str,
        time_ns: NDArray[np.int64],
        columns: Mapping[str, Any],
        flags: NDArray[np.uint16],
        host_ns: int | None = None,
    ) -> None:
        """Take samples of a stream: device clock [ns], raw values by column and flags, all of shape (n,).

        `host_ns` is their arrival on the host's monotonic clock [ns since the start of the run]; without it the clocks
        are taken as equal, or related by a `clock` event. The samples are copied; they are written after about
        `FLUSH_EVERY` and synced after about `SYNC_EVERY`. If it raises because of an earlier failed write, they are
        still kept, and `close` tries to write them again.
        """
        if stream not in self._streams or self._closed:
            raise RecordError(f"stream {stream} is not open")
        live = self._streams[stream]
        live.put(time_ns, columns, flags, host_ns)
        syncing = self._syncing
        most = PATIENT if self.waits else STALLED
        hung = live.waiting() > most or (syncing is not None and time.monotonic() - syncing > most)
        if self._failure is None and hung:
            self._failure = files.cannot_write(live.file.path, TimeoutError(f"the disk took nothing for {most:g} s"))
        self._check()

    def append_now(
        self, stream: str, time_ns: NDArray[np.int64], columns: Mapping[str, Any], flags: NDArray[np.uint16]
    ) -> None:
        """As `append`, but returns after they are written, for more rows than memory can hold."""
        for begin in range(0, len(time_ns), AT_ONCE):
            part = slice(begin, begin + AT_ONCE)
            self.append(stream, time_ns[part], {name: values[part] for name, values in columns.items()}, flags[part])
            live = self._streams[stream]
            if not self._try(live.file.path, live.drain):
                self._check()

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Add an event at `t` [s from the start]; it has been passed to the operating system when this returns.

        Before the end of a trial, a vent or the end of the run all waiting samples are written.
        """
        if self._closed:
            raise RecordError(f"the run {self.folder.name} is closed")
        self._event(kind, t, data)
        self._check()

    def _event(self, kind: str, t: float, data: Mapping[str, Any]) -> None:
        with self._lock:
            line, self._crc = files.encode_line(self._seq, t, kind, data, self._crc)
            self._seq += 1
            self._last_t = max(self._last_t, float(t))
            self._lines.append(line)
            for stream in self._streams.values() if kind in _SAMPLES_FIRST else ():
                self._try(stream.file.path, stream.drain)
            if self._try(self._events.path, lambda: self._events.write(b"".join(self._lines))):
                self._lines.clear()

    def _try(self, path: Path, act: Callable[[], None], failures: type[Exception] = OSError) -> bool:
        """Run `act`, which writes `path`; returns whether it succeeded. The first failure is stored for `_check`.

        The threads catch every kind of error: the run is then no longer recorded, and the engine must be informed.
        """
        try:
            act()
        except failures as error:
            self._failure = self._failure or files.cannot_write(path, error)
            return False
        return True

    def _check(self) -> None:
        if self._failure is not None:
            self._reported = True
            raise self._failure

    def _pump(self) -> None:
        """Thread body: passes samples to the operating system without waiting for the disk."""
        while not self._stop.wait(FLUSH_EVERY):
            if not all(self._try(s.file.path, s.drain, Exception) for s in list(self._streams.values())):
                return

    def _sync(self) -> None:
        """Thread body: syncs the written data, so that they survive a power cut."""
        while not self._stop.wait(SYNC_EVERY):
            self._syncing = time.monotonic()
            streams = [stream.file for stream in list(self._streams.values())]
            if not all(self._try(file.path, file.sync, Exception) for file in (*streams, self._events)):
                return
            self._syncing = None

    def _halt(self) -> None:
        """End the threads and write waiting samples; at the interpreter's exit at the latest."""
        self._stop.set()
        for thread in self._threads:
            thread.join()
        atexit.unregister(self._halt)
        for stream in self._streams.values():
            with suppress(OSError):
                stream.drain()

    def close(self, status: str, why: str = "", **end: Any) -> Path:
        """Write the end mark with `end`, convert streams to Parquet, and seal the folder; returns its path.

        `status` is one of `finished`, `failed`, `aborted`, `tripped`, `error`. If rows or events could not be written
        the status becomes `error`, everything available is sealed, and then RecordError is raised.
        """
        if self._closed:
            raise RecordError(f"the run {self.folder.name} is closed")
        if status not in files.STATUSES:
            raise ValueError(f"status {status!r} is not one of {', '.join(files.STATUSES)}")
        self._halt()
        failure = self._finish_streams() or (None if self._reported else self._failure)
        if failure is not None:
            status, why = "error", _with(failure, status, why)
        last = max([self._last_t, *(s.last_ns / 1e9 for s in self._streams.values() if s.last_ns is not None)])
        self._event("end", last, {"status": status, "why": why, **files.plain(end)})
        self._closed = True
        try:
            try:
                if self._lines:  # retry events that could not be written
                    free_for_events(self.folder)
                self._events.write(b"".join(self._lines))
                self._events.sync()
            except OSError as error:
                failure = failure or files.cannot_write(self._events.path, error)
                status, why = "error", _with(failure, status, why)
            self._events.close()
            seal(self.folder, status, why, end)
        except (OSError, ValueError, InvalidFile) as error:
            raise failure or files.cannot_write(self.folder, error) from error
        if failure is not None:
            raise failure
        return self.folder

    def _finish_streams(self) -> RecordError | None:
        failure = None
        for stream in self._streams.values():
            try:
                stream.finish()
            except OSError as error:
                failure = failure or files.cannot_write(stream.file.path, error)
                stream.file.close()
        return failure


def _with(failure: RecordError, status: str, why: str) -> str:
    """Sentence with the failure of the record, and the status and cause of the run before it, without repetition."""
    return why if why.startswith(str(failure)) else f"{failure}; before that: {status} {why}".rstrip()


def _make_folder(parent: Path, name: str) -> Path:
    for count in range(1, 1000):
        folder = parent / (name if count == 1 else f"{name}-{count}")
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise FileExistsError(17, "a thousand runs of this name exist")


def _full_manifest(name: str, given: Mapping[str, Any], contents: Mapping[str, bytes | files.Copy]) -> dict[str, Any]:
    versions = {"python": platform.python_version()}
    for library in ("pmabench", "numpy", "scipy", "pandas", "pyarrow"):
        with suppress(metadata.PackageNotFoundError):
            versions[library] = metadata.version(library)
    usual = {
        "kind": "",
        "simulated": False,
        "started_utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "trials_planned": _planned(plan if isinstance(plan := contents.get(files.PLAN), bytes) else b""),
    }
    known = {
        "schema": files.RUN_SCHEMA,
        "id": name,
        "versions": versions,
        "platform": platform.platform(),
        "snapshots": {
            key: content.sha256 if isinstance(content, files.Copy) else hashlib.sha256(content).hexdigest()
            for key, content in contents.items()
        },
        "writer": files.this_process(),
    }
    return {**usual, **given, **known}


def _planned(plan: bytes) -> int:
    with suppress(ValueError, KeyError, TypeError):
        return len(json.loads(plan)["trials"])
    return 0
