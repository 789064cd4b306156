"""The list of runs in a folder; its SQLite cache may be lost at any time, the run folders are the truth.

Nothing heavy is imported: a thousand runs are listed in a fraction of a second.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile
from pmabench.store import folder as files
from pmabench.store.folder import files_of, read_file, read_manifest, read_seal, status_of
from pmabench.store.journal import decode, summary
from pmabench.store.regular import is_regular
from pmabench.store.since import added, late_files

CACHE = ".catalogue.sqlite"
_VERSION = 4


@dataclass(frozen=True)
class Row:
    """One run in the list."""

    id: str
    folder: str
    """Name of its folder inside the one that was listed."""
    date: str
    """Start, UTC, ISO 8601."""
    kind: str
    specimen: str
    bench: str
    status: str
    """As in `RunData`; `running` while it is written, `damaged` where manifest or seal cannot be believed."""
    why: str
    """The cause of a status other than `finished`, in a sentence."""
    simulated: bool
    trials_finished: int
    trials_before: int
    """Trials that the runs which this one continues had finished, as its manifest says; not in `trials_finished`."""
    trials_planned: int
    duration: float | None
    """From the first to the last sample or event [s]."""
    size: int
    """Bytes on disk."""
    continues: str
    """Id of the run that it goes on from; empty where it begins."""
    added: tuple[str, ...]
    """Names of what was put into the folder after the run was closed, and is no part of it."""
    late: tuple[str, ...]
    """Names of what was written next to the run after it was closed."""


def catalogue(parent: Path | str) -> list[Row]:
    """Every run directly in `parent`, in the order of their names, which is that of time.

    Rows of closed runs come from the cache as long as their seal is the same file; without a cache that can be used
    every run is read. A folder without a manifest is no run.
    """
    parent = Path(parent)
    cached = _load(parent / CACHE)
    rows: list[Row] = []
    fresh: dict[str, tuple[str, Row]] = {}
    seen = set()
    for name, stamp in _runs(parent):
        seen.add(name)
        kept = cached.get(name)
        if kept is not None and stamp and kept[0] == stamp:
            rows.append(kept[1])
            continue
        row = _read(parent / name)
        rows.append(row)
        if stamp:
            fresh[name] = (stamp, row)
    gone = cached.keys() - seen
    if fresh or gone:
        _store(parent / CACHE, fresh, gone)
    return rows


def folders_in(parent: Path) -> list[Path]:
    """The run folders directly in a folder, in the order of their names; none where it is a run itself."""
    itself = (parent / files.MANIFEST).exists() or (parent / files.SEAL).exists()
    return [] if itself else [parent / name for name, _ in _runs(parent)]


def _runs(parent: Path) -> list[tuple[str, str]]:
    """Names of the run folders, and what changes when their seal or manifest does (empty: not closed)."""
    found = []
    with suppress(OSError), os.scandir(parent) as entries:
        for entry in entries:
            if entry.name.startswith(".") or not entry.is_dir():
                continue
            manifest, seal = (_stamp(Path(entry.path, name)) for name in (files.MANIFEST, files.SEAL))
            if manifest or seal:
                found.append((entry.name, f"{manifest} {seal} {_folders(entry)}" if manifest and seal else ""))
    return sorted(found)


def _folders(entry: os.DirEntry[str]) -> str:
    """What changes when something is put into a run folder or next to it."""
    folders = [entry.path]
    for place in folders:  # which grows meanwhile
        with suppress(OSError), os.scandir(place) as inside:
            folders += [each.path for each in inside if each.is_dir(follow_symlinks=False)]
    return " ".join(_stamp(Path(place)) for place in (*sorted(folders), entry.path + files.LATE))


def _stamp(path: Path) -> str:
    with suppress(OSError):
        info = path.stat()
        return f"{info.st_mtime_ns}:{info.st_ctime_ns}:{info.st_size}:{info.st_ino}"
    return ""


def _read(folder: Path) -> Row:
    try:
        manifest = read_manifest(folder)
        seal = read_seal(folder)
        status = status_of(manifest, seal)
    except InvalidFile:
        manifest, seal, status = {}, {}, "damaged"
    if seal is None:
        found = summary(manifest, decode(_events(folder)), [])
        size = 0
        with suppress(OSError):
            size = sum(path.stat().st_size for _name, path in files_of(folder) if is_regular(path))
    else:
        found = seal
        size = sum(int(entry["bytes"]) for entry in seal.get("files", {}).values())
        with suppress(OSError):
            size += (folder / files.SEAL).stat().st_size
    names: list[str] = []
    with suppress(OSError):
        names = [entry.name for entry in added(folder, seal)] if seal else []
    return Row(
        id=str(manifest.get("id", folder.name)),
        folder=folder.name,
        date=str(manifest.get("started_utc", "")),
        kind=str(manifest.get("kind", "")),
        specimen=_label(manifest.get("specimen")),
        bench=_label(manifest.get("bench")),
        status=status,
        why=str(found.get("why") or ""),
        simulated=bool(manifest.get("simulated")),
        trials_finished=int(found.get("trials_finished") or 0),
        trials_before=_before(manifest.get("continues")),
        trials_planned=int(found.get("trials_planned") or 0),
        duration=found.get("duration"),
        size=size,
        continues=_continued(manifest.get("continues")),
        added=tuple(names),
        late=tuple(late_files(folder)) if seal else (),
    )


def _events(folder: Path) -> bytes:
    with suppress(InvalidFile):
        return read_file(folder, files.EVENTS) if is_regular(folder / files.EVENTS) else b""
    return b""


def _continued(link: Any) -> str:
    return str(link.get("run") or "") if isinstance(link, Mapping) else ""


def _before(link: Any) -> int:
    done = link.get("trials_done") if isinstance(link, Mapping) else None
    return len({str(trial) for trial in done}) if isinstance(done, list) else 0


def _label(value: Any) -> str:
    if isinstance(value, Mapping):
        return " ".join(str(value[key]) for key in ("name", "type", "serial") if value.get(key))
    return "" if value is None else str(value)


def _load(path: Path) -> dict[str, tuple[str, Row]]:
    """What the cache holds; nothing where it is missing, of another version or not a database."""
    if not path.is_file():
        return {}
    with suppress(sqlite3.Error, ValueError, TypeError, OSError), closing(_open(path, "ro")) as base:
        if base.execute("PRAGMA user_version").fetchone()[0] == _VERSION:
            found = base.execute("SELECT folder, stamp, row FROM runs").fetchall()
            return {folder: (stamp, _row(json.loads(row))) for folder, stamp, row in found}
    return {}


def _row(kept: dict[str, Any]) -> Row:
    """JSON has lists where a row has tuples."""
    kept |= {name: tuple(value) for name, value in kept.items() if isinstance(value, list)}
    return Row(**kept)


def _store(path: Path, fresh: Mapping[str, tuple[str, Row]], gone: set[str]) -> None:
    """Keep rows for the next time; a cache that cannot be used is made anew, or left out."""
    for _attempt in range(2):
        try:
            with closing(_open(path, "rwc")) as base, base:
                if base.execute("PRAGMA user_version").fetchone()[0] != _VERSION:
                    base.execute("DROP TABLE IF EXISTS runs")
                    base.execute(f"PRAGMA user_version = {_VERSION}")
                base.execute("CREATE TABLE IF NOT EXISTS runs (folder TEXT PRIMARY KEY, stamp TEXT, row TEXT)")
                base.executemany("DELETE FROM runs WHERE folder = ?", [(name,) for name in gone])
                rows = [(name, stamp, json.dumps(asdict(row))) for name, (stamp, row) in fresh.items()]
                base.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?)", rows)
            return
        except sqlite3.OperationalError:
            return
        except sqlite3.DatabaseError:
            with suppress(OSError):
                path.unlink()


def _open(path: Path, mode: str) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=0.5)
