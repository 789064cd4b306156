"""Closes a run folder: streams into Parquet, a summary, the hash of every file; also for a run whose writer died."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, RecordError
from pmabench.store import folder as files
from pmabench.store.archive import archive, span_of
from pmabench.store.folder import cannot_write, plain, read_file, read_manifest, read_seal, reason_of, sealed_json
from pmabench.store.journal import decode, summary
from pmabench.store.regular import is_regular, sha256_of
from pmabench.store.room import free_for_events, write_into_room
from pmabench.store.since import adopt

STRAY = re.compile(r"(?:.*/)?(?:\..*|.*~|Thumbs\.db|ehthumbs\.db|desktop\.ini)(?:/.*)?", re.IGNORECASE | re.DOTALL)
"""Names that only file managers and editors make: they may change at any time, and are no part of a run."""


@dataclass
class _Streams:
    """What became of the streams."""

    described: dict[str, dict[str, Any]] = field(default_factory=dict)
    spans: list[tuple[float, float]] = field(default_factory=list)
    failure: OSError | None = None


def seal(folder: Path, status: str, why: str, end: Mapping[str, Any]) -> None:
    """Turn the streams into Parquet, write `seal.json` and make every file read-only.

    Raises OSError where something could not be written; streams that could not be turned stay as they are, and the
    status is then `error`.
    """
    streams = _turn(folder / files.STREAMS)
    if streams.failure is not None:
        text = str(cannot_write(folder, streams.failure))
        known = status == "error" and reason_of(streams.failure) in why  # a full disk is named once
        status, why = "error", why if known else f"{text}; before that: {status} {why}".rstrip()
    _tidy(folder)
    manifest = read_manifest(folder)
    journal = decode(read_file(folder, files.EVENTS) if os.path.lexists(folder / files.EVENTS) else b"")
    content = {
        "schema": files.SEAL_SCHEMA,
        "id": manifest["id"],
        "status": status,
        "why": why,
        "end": plain(end),
        "closed_utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
        **summary(manifest, journal, streams.spans),
        "events": len(journal.lines),
        "events_fault": journal.fault,
        "streams": streams.described,
        "files": {
            name: {"sha256": sha256_of(path), "bytes": path.stat().st_size} for name, path in _part_of_the_run(folder)
        },
    }
    write_into_room(folder / files.SEAL, sealed_json(content))
    for path in (folder / name for name in (files.SEAL, *content["files"])):
        with suppress(OSError):
            path.chmod(0o444)
    if streams.failure is not None:
        raise streams.failure


def _part_of_the_run(folder: Path) -> Iterator[tuple[str, Path]]:
    """The files that are sealed: not the notes, which may come at any time, and nothing that is no file of a run."""
    for name, path in files.files_of(folder):
        note = name == files.NOTES_HEAD or name.startswith(f"{files.NOTES}/")
        if not note and is_regular(path) and not STRAY.fullmatch(name):
            yield name, path


def _tidy(folder: Path) -> None:
    """Delete what was begun and never became whole; the room for the seal stays. Raises OSError."""
    free_for_events(folder)
    room = files.part_of(folder / files.SEAL)
    for place in (folder, folder / files.STREAMS):
        for path in place.glob(".*.part"):
            if path != room and is_regular(path) and path.name != f".{files.NOTES_HEAD}.part":
                path.unlink()


def _turn(folder: Path) -> _Streams:
    streams = _Streams()
    for live in _found(folder, "*.arrows"):
        try:
            kept = archive(live, live.with_suffix(".parquet"))
        except (OSError, ValueError) as error:
            streams.failure = error if isinstance(error, OSError) else streams.failure
            streams.described[live.stem] = {"rows": None, "fault": str(error), "file": live.name}
            continue
        streams.described[live.stem] = {"rows": kept.rows, "fault": kept.fault, "file": f"{live.stem}.parquet"}
        if not kept.torn:
            live.unlink()
    for path in _found(folder, "*.parquet"):
        rows, low, high = span_of(path)
        streams.described.setdefault(path.stem, {"rows": rows, "fault": "", "file": path.name})
        if rows:
            streams.spans.append((low / 1e9, high / 1e9))
    return streams


def _found(folder: Path, pattern: str) -> list[Path]:
    return [] if folder.is_symlink() else [path for path in sorted(folder.glob(pattern)) if is_regular(path)]


def close_interrupted(folder: Path) -> Path:
    """Seal a run whose writer died, with all whole batches and the status `interrupted`; a sealed run stays as it is.

    Raises RecordError where its writer still lives or it cannot be written, InvalidFile where it is no run.
    """
    manifest = read_manifest(folder)
    if read_seal(folder) is not None:
        return folder
    if files.status_of(manifest, None) == "running":
        raise RecordError(f"{folder} is still being written by process {manifest['writer']['pid']}")
    try:
        adopt(folder)
        seal(folder, "interrupted", "the program that wrote it ended without closing it", {})
    except (OSError, ValueError, InvalidFile) as error:
        raise cannot_write(folder, error) from error
    return folder
