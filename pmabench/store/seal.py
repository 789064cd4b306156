"""Closes a run folder: streams into Parquet, a summary, the hash of every file; also for a run whose writer died."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, RecordError
from pmabench.store import folder as files
from pmabench.store.archive import archive, span_of
from pmabench.store.folder import cannot_write, plain, read_manifest, read_seal, sealed_json, sealed_part, sha256_of
from pmabench.store.journal import decode, summary


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
        status, why = "error", f"{cannot_write(folder, streams.failure)}; before that: {status} {why}".rstrip()
    for _name, path in sealed_part(folder):
        if path.name.startswith(".") and path.name.endswith(".part"):
            path.unlink()
    manifest = read_manifest(folder)
    journal = decode((folder / files.EVENTS).read_bytes() if (folder / files.EVENTS).exists() else b"")
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
            name: {"sha256": sha256_of(path), "bytes": path.stat().st_size}
            for name, path in sealed_part(folder)
            if name != files.SEAL
        },
    }
    files.write_whole(folder / files.SEAL, sealed_json(content))
    for _name, path in sealed_part(folder):
        with suppress(OSError):
            path.chmod(0o444)
    if streams.failure is not None:
        raise streams.failure


def _turn(folder: Path) -> _Streams:
    streams = _Streams()
    for live in sorted(folder.glob("*.arrows")):
        try:
            kept = archive(live, live.with_suffix(".parquet"))
        except (OSError, ValueError) as error:
            streams.failure = error if isinstance(error, OSError) else streams.failure
            streams.described[live.stem] = {"rows": None, "fault": str(error), "file": live.name}
            continue
        streams.described[live.stem] = {"rows": kept.rows, "fault": kept.fault, "file": f"{live.stem}.parquet"}
        if not kept.torn:
            live.unlink()
    for path in sorted(folder.glob("*.parquet")):
        rows, low, high = span_of(path)
        streams.described.setdefault(path.stem, {"rows": rows, "fault": "", "file": path.name})
        if rows:
            streams.spans.append((low / 1e9, high / 1e9))
    return streams


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
        seal(folder, "interrupted", "the program that wrote it ended without closing it", {})
    except (OSError, ValueError, InvalidFile) as error:
        raise cannot_write(folder, error) from error
    return folder
