"""Reads a run folder incrementally, and keeps its newest samples.

Reads files without interpreting the run; writes nothing. Missing, torn or half-written data are read at a later call,
or never, without an error.
"""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.errors import InvalidFile
from pmabench.store import folder as files
from pmabench.store.folder import decode_lines, open_json, open_regular, read_manifest, read_seal, status_of
from pmabench.store.livestream import FLAGS, TIME, LiveReader, numbers, pa
from pmabench.store.reader import channel_info
from pmabench.store.records import Array, ChannelInfo, ClockInfo, Event, Flags
from pmabench.store.seal import read_archive
from pmabench.store.timebase import fit_clock, onto

MOST_BYTES = 4 << 20
"""Bytes read from one file per call, so that the first screen of a long run appears quickly."""
MOST_ROWS = 200_000
"""The same for a stream of a closed run, in rows."""


@dataclass(frozen=True, eq=False)
class Block:
    """Samples of one stream in SI: `t` [s], each of `values` and `flags` have shape (n,)."""

    t: Array
    values: Mapping[str, Array]
    flags: Flags


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; empty if it cannot be read."""
    with suppress(OSError, ValueError, RecursionError):
        with open_regular(path) as file:
            data = json.loads(file.read())
        if isinstance(data, dict):
            return data
    return {}


class JournalTail:
    """The complete lines of `events.jsonl`, each returned once."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / files.EVENTS
        self._offset = self._lines = self._crc = 0
        self.fault = ""
        """Why the rest of the file is not used; empty without a fault."""
        self.written = 0.0
        """When the file last changed [s, wall clock]."""

    def read(self) -> list[Event]:
        """New lines since the last call."""
        if self.fault:
            return []
        try:
            with open_regular(self._path) as file:
                self.written = os.fstat(file.fileno()).st_mtime
                file.seek(self._offset)
                raw = file.read()
        except OSError:
            return []
        whole = raw[: raw.rfind(b"\n") + 1]
        journal = decode_lines(whole, self._lines, self._crc)
        self.fault = journal.fault
        self._offset += len(whole)
        self._lines += len(journal.lines)
        if journal.lines:
            self._crc = int(whole[-11:-3], 16) if not self.fault else 0
        return [
            Event(
                line["seq"], float(line["t"]), str(line["kind"]), line["data"] if isinstance(line["data"], dict) else {}
            )
            for line in journal.lines
        ]


class StreamTail:
    """One stream, live or closed, in SI; its rows are returned once, in order."""

    def __init__(self, folder: Path, name: str) -> None:
        self.name = name
        self._live = folder / files.STREAMS / f"{name}.arrows"
        self._closed = folder / files.STREAMS / f"{name}.parquet"
        self._head = b""
        self._offset = self._batches = 0
        self._most = MOST_BYTES
        self._table: Any = None
        """Table of a closed run while it is being read."""
        self._whole = False
        """Whether a closed run was read to its end."""
        self.rows = 0
        self.rate = 0.0
        self.infos: dict[str, ChannelInfo] = {}
        self.clock: ClockInfo | None = None
        """Clock of a `clock` event; without one it is fitted to the arrival times of the samples."""
        self._arrivals: list[tuple[int, int]] = []
        self._fitted = 0
        self._by_arrivals = ClockInfo()
        self.behind = False
        """Whether more data are available than one call reads."""
        self.fault = ""
        """Why an incomplete batch could not be read; empty without a fault."""
        self.written = 0.0
        """When the file last changed [s, wall clock]."""

    def read(self) -> list[Block]:
        """New rows since the last call."""
        self.behind = False
        if self._whole:
            return []
        if self._table is None:
            try:
                with open_regular(self._live) as file:
                    self.written = os.fstat(file.fileno()).st_mtime
                    return self._read_live(file)
            except OSError:
                if not self._open_closed():
                    return []
        return self._read_closed()

    def _read_live(self, file: Any) -> list[Block]:
        file.seek(self._offset)
        raw = file.read(self._most)
        if not raw:
            return []
        try:
            reader = LiveReader(pa.py_buffer(self._head + raw), self._batches, self.rows)
        except ValueError:
            return []
        if not self._head:
            self._describe(reader.about)
            self._head = raw[: reader.head]
        batches = [batch for batch in reader if batch.num_rows]
        self._arrivals += reader.arrivals
        blocks = [self._block({name: numbers(b.column(name)) for name in b.schema.names}) for b in batches]
        start = reader.head if self._offset else 0
        self._offset += reader.position - start
        self.behind = len(raw) == self._most
        if self.behind and reader.batches == self._batches:
            self._most *= 2  # a batch is larger than one call reads
        self.fault = reader.fault if reader.torn and not self.behind else ""
        self._batches, self.rows = reader.batches, reader.rows
        return blocks

    def _open_closed(self) -> bool:
        try:
            with open_regular(self._closed) as file:
                self._table, about, self._arrivals = read_archive(pa.PythonFile(file))
        except (OSError, ValueError):
            return False
        self.written = self._closed.stat().st_mtime
        self._describe(about)
        return True

    def _read_closed(self) -> list[Block]:
        part = self._table.slice(self.rows, MOST_ROWS)
        if not part.num_rows:
            return []
        self.rows += part.num_rows
        self.behind = self.rows < self._table.num_rows
        if not self.behind:
            self._table, self._whole = None, True  # 50 MB for half an hour at 500 Hz
        return [self._block({name: _values(part.column(name).combine_chunks()) for name in part.column_names})]

    def _describe(self, about: Mapping[str, Any]) -> None:
        self.rate = float(about.get("rate") or 0.0)
        self.infos |= {column["name"]: channel_info(column, self.name, self.rate) for column in about["columns"]}

    def _block(self, columns: dict[str, Any]) -> Block:
        time_ns, flags = columns.pop(TIME), columns.pop(FLAGS)
        clock = self.clock or self._fit()
        with np.errstate(all="ignore"):
            values = {name: raw * self.infos[name].slope + self.infos[name].offset for name, raw in columns.items()}
        return Block(clock.time(time_ns), values, np.asarray(flags, dtype=np.uint16))

    def _fit(self) -> ClockInfo:
        """Clock fitted to the arrivals so far; fitted again when their number has doubled."""
        if self._arrivals and len(self._arrivals) >= 2 * self._fitted:
            self._fitted = len(self._arrivals)
            self._by_arrivals = fit_clock(*zip(*self._arrivals, strict=True))
        return self._by_arrivals


def _values(column: Any) -> Array:
    """A column of a closed stream, shape (n,); Arrow's own conversion imports pandas, so only if a value is missing."""
    return np.asarray(column.to_numpy() if column.null_count else numbers(column))


class Follower:
    """A run folder that may not exist yet, is being written, has ended, or whose writer died."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest: dict[str, Any] = {}
        self.plan: dict[str, Any] = {}
        self.bench: dict[str, Any] = {}
        self.seal: dict[str, Any] | None = None
        self.streams: dict[str, StreamTail] = {}
        self.journal = JournalTail(folder)
        self.problem = ""
        """Why the folder cannot be read as a run; empty without a fault."""
        self._notes = 0

    @property
    def there(self) -> bool:
        """Whether the run's manifest exists."""
        return bool(self.manifest)

    def events(self) -> list[Event]:
        """New events; also reads the files that are written only once."""
        if not self.manifest:
            self._begin()
        if not self.manifest:
            return []
        if self.seal is None:
            with suppress(InvalidFile):
                self.seal = read_seal(self.folder)
        events = self.journal.read()
        for event in events:
            stream = self.streams.get(str(event.data.get("stream"))) if event.kind == "clock" else None
            if stream is not None:
                at, drift = (float(event.data.get(key) or 0.0) for key in ("offset", "drift"))
                stream.clock = ClockInfo(0, at, drift)
        return events

    def samples(self) -> list[tuple[StreamTail, list[Block]]]:
        """New samples by stream. Call `events` first: samples are written before the end of their trial."""
        if self.manifest:
            sealed = self.seal["files"] if self.seal is not None else None
            for path in sorted((self.folder / files.STREAMS).glob("*")):
                known = sealed is None or f"{files.STREAMS}/{path.name}" in sealed
                if known and path.suffix in (".arrows", ".parquet") and path.stem not in self.streams:
                    self.streams[path.stem] = StreamTail(self.folder, path.stem)
        return [(stream, stream.read()) for stream in self.streams.values()]

    def notes(self) -> list[str]:
        """Notes that were added to the run since the last call."""
        found = sorted((self.folder / "notes").glob("[0-9]*/note.json"))
        fresh, self._notes = found[self._notes :], len(found)
        texts = []
        for path in fresh:
            with suppress(OSError, InvalidFile):
                with open_regular(path) as file:
                    note = open_json(file.read(), path)
                text = str(note.get("text", ""))
                if isinstance(note.get("exclude"), int):
                    text = f"trial {note['exclude'] + 1} excluded: {note.get('because')} {text}"
                texts.append(text.strip())
        return texts

    @property
    def behind(self) -> bool:
        """Whether more data can be read at once."""
        return any(stream.behind for stream in self.streams.values())

    @property
    def status(self) -> str:
        """`running` while the writer lives, else how the run ended; `waiting` if there is no run yet."""
        if not self.manifest:
            return "waiting"
        if self.seal is None and not self.manifest.get("writer"):
            return "running"  # this system cannot report whether the writer lives
        return status_of(self.manifest, self.seal)

    def _begin(self) -> None:
        try:
            self.manifest = read_manifest(self.folder)
        except InvalidFile as error:
            self.problem = str(error) if (self.folder / files.MANIFEST).exists() else ""
            return
        self.plan = read_json(self.folder / files.PLAN)
        self.bench = read_json(self.folder / "bench.json")


class Kept:
    """Blocks of samples in order of arrival."""

    def __init__(self) -> None:
        self._blocks: dict[str, deque[Block]] = {}

    def add(self, stream: str, block: Block) -> None:
        """Keep a non-empty block."""
        self._blocks.setdefault(stream, deque()).append(block)

    def forget(self, before: float) -> None:
        """Drop blocks that end before a time [s], except the last of each stream."""
        for blocks in self._blocks.values():
            while len(blocks) > 1 and blocks[0].t[-1] < before:
                blocks.popleft()

    @property
    def newest(self) -> float:
        """Time of the newest sample [s]; 0 without samples."""
        return max((float(blocks[-1].t[-1]) for blocks in self._blocks.values()), default=0.0)

    @property
    def reached(self) -> float:
        """Time up to which every stream was read [s]; -inf without samples."""
        return min((float(blocks[-1].t[-1]) for blocks in self._blocks.values()), default=-np.inf)

    def trace(self, channel: str) -> tuple[Array, Array]:
        """Time [s] and value [SI] of a channel, both of shape (n,)."""
        for blocks in self._blocks.values():
            if channel in blocks[-1].values:
                return np.concatenate([b.t for b in blocks]), np.concatenate([b.values[channel] for b in blocks])
        return np.empty(0), np.empty(0)

    def between(
        self, begin: float, end: float, rates: Mapping[str, float]
    ) -> tuple[Array, dict[str, Array], Flags, float]:
        """Times [s], channels [SI], flags and rate [Hz], from about `begin` to `end` [s].

        On the times of the stream with the displacement, else the pressure, as in `open_run`.
        """
        parts: dict[str, tuple[Array, dict[str, Array], Flags]] = {}
        for name, blocks in self._blocks.items():
            near = [b for b in blocks if b.t[-1] >= begin - 1.0 and b.t[0] <= end + 1.0]
            if near:
                columns = {c: np.concatenate([b.values[c] for b in near]) for c in near[0].values}
                parts[name] = np.concatenate([b.t for b in near]), columns, np.concatenate([b.flags for b in near])
        if not parts:
            return np.empty(0), {}, np.empty(0, np.uint16), 0.0
        named = (n for channel in ("displacement", "pressure") for n in parts if channel in parts[n][1])
        main = next(named, next(iter(parts)))
        t, channels, flags = parts[main]
        for name, (other, columns, other_flags) in parts.items():
            missing = {c: values for c, values in columns.items() if c not in channels}
            if name != main and missing:
                moved, flags, _ = onto(t, flags, other, other_flags, missing, rates.get(name, 0.0))
                channels |= moved
        return t, channels, flags, rates.get(main, 0.0)
