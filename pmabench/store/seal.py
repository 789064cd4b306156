"""Closes a run folder: streams to Parquet, a summary, the hash of every file; also for a run whose writer died.

If the disk is full at the end of a run, it would get no seal, and the cause and the result of the vent would be lost.
Two hidden files reserve space from the start: `.seal.json.part` is overwritten in place and becomes the seal;
`.events.jsonl.part` is deleted when the last events do not fit otherwise.
"""

from __future__ import annotations

import json
import mmap
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from io import BufferedWriter
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, RecordError
from pmabench.store import folder as files
from pmabench.store.livestream import DAMAGED, LiveReader, about_stream, pa, pq, raw_bytes
from pmabench.store.since import adopt

GROUP = 500_000
"""Rows of a row group."""
ARRIVALS = "arrivals"
"""Metadata key of the file: two lists, times of device and host [ns] for the last samples of batches."""


def archive(live: Path, target: Path) -> tuple[int, str, bool]:
    """Write the complete batches of `live` to the Parquet file `target`, synced, re-read and compared byte for byte.

    Returns the number of rows, the reason why reading stopped before the end mark (empty: it did not), and whether
    bytes remain that belong to no complete batch. Raises OSError where it cannot be written, ValueError where `live`
    has no complete schema or the re-read data differ; `target` then does not exist.
    """
    with files.whole(target) as part:
        with live.open("rb") as file:
            source = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # closed with the last batch on it
        reader = LiveReader(pa.py_buffer(source))
        _write(part, reader, source)
        arrivals = reader.arrivals
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        with pq.ParquetFile(part) as written:
            same = _arrivals_of(written) == arrivals
        if not same or not _is_copy(part, reader, source):
            raise ValueError("what was read back is not what was written")
    return reader.rows, reader.fault, reader.torn


def _write(part: Path, reader: LiveReader, source: mmap.mmap) -> None:
    """Write the batches as row groups."""
    schema = reader.schema
    integers = [field.name for field in schema if pa.types.is_signed_integer(field.type)]
    others = [field.name for field in schema if pa.types.is_unsigned_integer(field.type)]  # flags: few different values
    with pq.ParquetWriter(
        part,
        schema,
        compression="zstd",
        use_dictionary=others,
        column_encoding=dict.fromkeys(integers, "DELTA_BINARY_PACKED"),
        write_page_checksum=True,
    ) as writer:
        for table in _tables(reader, schema):
            writer.write_table(table, row_group_size=GROUP)
            _release(source)
        if reader.arrivals:
            writer.add_key_value_metadata({ARRIVALS: json.dumps(list(zip(*reader.arrivals, strict=True)))})


def _release(source: mmap.mmap) -> None:
    """Release the pages of a file from memory; they are read anew when they are needed again."""
    if hasattr(source, "madvise"):
        source.madvise(mmap.MADV_DONTNEED)


def _is_copy(part: Path, reader: LiveReader, source: mmap.mmap) -> bool:
    """Whether a Parquet file has the same bytes as the complete batches that `reader` found in `source`."""
    batches = islice(pa.ipc.open_stream(pa.py_buffer(source)), reader.batches)
    for table, again in zip_longest(_tables(batches, reader.schema), _row_groups(part)):
        if table is None or again is None or _bytes_of(table) != _bytes_of(again):
            return False
        _release(source)
    return True


def _bytes_of(table: Any) -> list[Any]:
    """The bytes of each column, as buffers, which are equal where all bytes are."""
    return [pa.py_buffer(raw_bytes(column.combine_chunks())) for column in table.columns]


def _arrivals_of(file: Any) -> list[tuple[int, int]]:
    device, host = json.loads((file.metadata.metadata or {}).get(ARRIVALS.encode(), b"[[], []]"))
    return [(int(a), int(b)) for a, b in zip(device, host, strict=True)]


def _tables(batches: Iterable[Any], schema: Any) -> Iterator[Any]:
    """The batches as tables of GROUP rows, the last one shorter; each column in one piece."""
    waiting: list[Any] = []
    rows = 0
    for batch in batches:
        waiting.append(batch)
        rows += batch.num_rows
        if rows >= GROUP:
            table, waiting = pa.Table.from_batches(waiting, schema).combine_chunks(), []
            whole = rows - rows % GROUP
            yield from (table.slice(start, GROUP) for start in range(0, whole, GROUP))
            waiting, rows = table.slice(whole).to_batches(), rows - whole
    if rows:
        yield pa.Table.from_batches(waiting, schema).combine_chunks()


def _row_groups(path: Path) -> Iterator[Any]:
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        for index in range(file.num_row_groups):
            yield file.read_row_group(index)


def read_archive(source: Any) -> tuple[Any, dict[str, Any], list[tuple[int, int]]]:
    """The table of a Parquet stream (a buffer), its description, and its arrivals; ValueError where it is damaged.

    Arrivals: times of device and host [ns] for the last sample of each batch with `host_ns`.
    """
    with _readable(source) as file:
        return file.read(use_threads=False), about_stream(file.schema_arrow), _arrivals_of(file)


ROWS = 65_536
"""Rows that are decoded at once: few enough to stay in the fast memory of the processor."""


def archived(source: Any) -> tuple[Iterator[Any], int, dict[str, Any], list[tuple[int, int]]]:
    """As `read_archive`, but batches and the number of their rows: each is decoded when it is asked for."""

    def batches() -> Iterator[Any]:
        with _readable(source) as file:
            yield from file.iter_batches(ROWS, use_threads=False)

    with _readable(source) as file:
        return batches(), file.metadata.num_rows, about_stream(file.schema_arrow), _arrivals_of(file)


@contextmanager
def _readable(source: Any) -> Iterator[Any]:
    """A Parquet stream, opened; ValueError where it is damaged."""
    try:
        with pq.ParquetFile(source, page_checksum_verification=True) as file:
            yield file
    except DAMAGED as error:
        raise ValueError(f"cannot be read as Parquet ({str(error).splitlines()[0]})") from error


def span_of(path: Path) -> tuple[int, int, int]:
    """Rows, and the lowest and highest time [ns], of a Parquet stream; ValueError where it is damaged."""
    try:
        with pq.ParquetFile(path) as file:
            groups = [file.metadata.row_group(index).column(0).statistics for index in range(file.num_row_groups)]
            low, high = min((g.min for g in groups), default=0), max((g.max for g in groups), default=0)
            return file.metadata.num_rows, low, high
    except (pa.ArrowException, OSError, AttributeError) as error:
        raise ValueError(f"cannot be read as Parquet ({error})") from error


FOR_SEAL = 64 * 1024
"""Space for the seal [bytes]; with one hash per file, cause, counts and vent actions it needs about a tenth of this."""
FOR_EVENTS = 64 * 1024
"""Space for some hundred events [bytes]."""


def keep_room(folder: Path) -> None:
    """Reserve the space for the end of a run in its folder. Raises OSError if the disk has too little."""
    _reserve(files.part_of(folder / files.SEAL), FOR_SEAL)
    _reserve(files.part_of(folder / files.EVENTS), FOR_EVENTS)


def free_for_events(folder: Path) -> None:
    """Release the space reserved for the last events; may be called again."""
    with suppress(OSError):
        files.part_of(folder / files.EVENTS).unlink()


def write_into_room(path: Path, content: bytes) -> None:
    """As `write_whole`, but in the disk space reserved for `path`, if there is any. Raises OSError."""
    part = files.part_of(path)
    if not files.is_regular(part):
        files.write_whole(path, content)
        return
    flags = os.O_WRONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
    with os.fdopen(os.open(part, flags), "wb") as file:  # opened without truncation
        _write_all(file, content)
    part.replace(path)
    files.sync_folder(path.parent)


def _reserve(path: Path, size: int) -> None:
    """Make a file of `size` random bytes: a compressing file system would not allocate space for zeros."""
    with path.open("xb") as file:
        _write_all(file, os.urandom(size))


def _write_all(file: BufferedWriter, content: bytes) -> None:
    """Write and sync `content` as the whole content of a file."""
    file.write(content)
    file.truncate()
    file.flush()
    os.fsync(file.fileno())


STRAY = re.compile(r"(?:.*/)?(?:\..*|.*~|Thumbs\.db|ehthumbs\.db|desktop\.ini)(?:/.*)?", re.IGNORECASE | re.DOTALL)
"""Names of files that file managers and editors create; they may change at any time and are not part of a run."""


@dataclass
class _Streams:
    """Result of the conversion of the streams."""

    described: dict[str, dict[str, Any]] = field(default_factory=dict)
    spans: list[tuple[float, float]] = field(default_factory=list)
    failure: OSError | None = None


def seal(folder: Path, status: str, why: str, end: Mapping[str, Any]) -> None:
    """Convert the streams to Parquet, write `seal.json` and make every file read-only.

    Raises OSError where something could not be written; streams that could not be converted stay as they are, and the
    status is then `error`.
    """
    streams = _turn(folder / files.STREAMS)
    if streams.failure is not None:
        text = str(files.cannot_write(folder, streams.failure))
        known = status == "error" and files.reason_of(streams.failure) in why  # not reported twice
        status, why = "error", why if known else f"{text}; before that: {status} {why}".rstrip()
    _tidy(folder)
    manifest = files.read_manifest(folder)
    events = files.read_file(folder, files.EVENTS) if os.path.lexists(folder / files.EVENTS) else b""
    journal = files.decode_lines(events)
    content = {
        "schema": files.SEAL_SCHEMA,
        "id": manifest["id"],
        "status": status,
        "why": why,
        "end": files.plain(end),
        "closed_utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
        **files.journal_summary(manifest, journal, streams.spans),
        "events": len(journal.lines),
        "events_fault": journal.fault,
        "streams": streams.described,
        "files": {
            name: {"sha256": files.sha256_of(path), "bytes": path.stat().st_size}
            for name, path in _part_of_the_run(folder)
        },
    }
    write_into_room(folder / files.SEAL, files.sealed_json(content))
    for path in (folder / name for name in (files.SEAL, *content["files"])):
        with suppress(OSError):
            path.chmod(0o444)
    if streams.failure is not None:
        raise streams.failure


def _part_of_the_run(folder: Path) -> Iterator[tuple[str, Path]]:
    """The files to seal: regular files without notes, which may come at any time, and without stray files."""
    for name, path in files.files_of(folder):
        note = name == files.NOTES_HEAD or name.startswith(f"{files.NOTES}/")
        if not note and files.is_regular(path) and not STRAY.fullmatch(name):
            yield name, path


def _tidy(folder: Path) -> None:
    """Delete incomplete files, except the space reserved for the seal. Raises OSError."""
    free_for_events(folder)
    room = files.part_of(folder / files.SEAL)
    for place in (folder, folder / files.STREAMS):
        for path in place.glob(".*.part"):
            if path != room and files.is_regular(path) and path.name != f".{files.NOTES_HEAD}.part":
                path.unlink()


def _turn(folder: Path) -> _Streams:
    streams = _Streams()
    for live in _found(folder, "*.arrows"):
        try:
            rows, fault, torn = archive(live, live.with_suffix(".parquet"))
        except (OSError, ValueError) as error:
            streams.failure = error if isinstance(error, OSError) else streams.failure
            streams.described[live.stem] = {"rows": None, "fault": str(error), "file": live.name}
            continue
        streams.described[live.stem] = {"rows": rows, "fault": fault, "file": f"{live.stem}.parquet"}
        if not torn:
            live.unlink()
    for path in _found(folder, "*.parquet"):
        rows, low, high = span_of(path)
        streams.described.setdefault(path.stem, {"rows": rows, "fault": "", "file": path.name})
        if rows:
            streams.spans.append((low / 1e9, high / 1e9))
    return streams


def _found(folder: Path, pattern: str) -> list[Path]:
    return [] if folder.is_symlink() else [path for path in sorted(folder.glob(pattern)) if files.is_regular(path)]


def close_interrupted(folder: Path) -> Path:
    """Seal a run whose writer died, with all complete batches and the status `interrupted`; a sealed run is unchanged.

    Raises RecordError where its writer still runs or it cannot be written, InvalidFile where it is not a run.
    """
    manifest = files.read_manifest(folder)
    if files.read_seal(folder) is not None:
        return folder
    if files.status_of(manifest, None) == "running":
        raise RecordError(f"{folder} is still being written by process {manifest['writer']['pid']}")
    try:
        adopt(folder)
        seal(folder, "interrupted", "the program that wrote it ended without closing it", {})
    except (OSError, ValueError, InvalidFile) as error:
        raise files.cannot_write(folder, error) from error
    return folder
