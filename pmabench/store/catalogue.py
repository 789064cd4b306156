"""The runs in a folder: where they are, which continue which, and a list whose SQLite cache may be lost at any time.

Standard library only: a folder of thousands of runs is listed in a fraction of a second.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, reading
from pmabench.base.text import unused
from pmabench.store import folder as files
from pmabench.store.since import added, late_files

ANALYSES, ANALYSIS = "analyses", "analysis.json"
"""Name of folders that hold analyses, in which no runs are looked for; file that each analysis folder has."""


@dataclass(frozen=True)
class Task:
    """A run on its own, with those that it continues."""

    path: Path
    """Folder of the last run."""
    place: str
    """Where it lies below the folder that was given, `/` between folders; each once among several."""
    chain: tuple[Path, ...]
    """All its run folders, the first one first, `path` last."""


def runs_below(folder: Path) -> list[Path]:
    """Every run folder below `folder`, in the order of their paths; the folder itself where it is a run.

    A folder with the name of a run counts as one even where its manifest is gone, so that who opens it reports that.
    Links and hidden folders are not followed, and nothing inside a run is looked at. Raises InvalidFile for a folder
    that cannot be read.
    """
    return sorted(_found(folder))


def holds_runs(folder: Path) -> bool:
    """Whether runs lie somewhere below a folder that is no run itself."""
    return folder.is_dir() and next(_found(folder), folder) != folder


def _found(folder: Path) -> Iterator[Path]:
    waiting = [folder]
    while waiting:
        place = waiting.pop()
        with reading(place), os.scandir(place) as entries:
            inside = list(entries)
        if any(entry.name in (files.MANIFEST, files.SEAL) for entry in inside):
            yield place
            continue
        if files.is_run_name(place.name) and not any(Path(entry, ANALYSIS).exists() for entry in inside):
            yield place  # an emptied run folder; analyses of a run are in a folder of the same name
            continue
        waiting += [
            place / entry.name
            for entry in inside
            if not entry.name.startswith(".") and entry.name != ANALYSES and entry.is_dir(follow_symlinks=False)
        ]


def tasks_below(given: Sequence[Path]) -> list[Task]:
    """The runs in `given` (runs, or folders of runs) that no other run there continues, each with those before it.

    A path below which there is no run counts as one that cannot be used.
    """
    places: dict[Path, str] = {}
    for folder in given:
        for run in (folder.is_dir() and runs_below(folder)) or [folder]:
            places.setdefault(run, run.relative_to(folder).as_posix() if run != folder else folder.resolve().name)
    chains = {run: chain_of(run) for run in places}
    continued = {before.resolve() for chain in chains.values() for before in chain[:-1]}
    taken: set[str] = set()
    last = (run for run in chains if not continued or run.resolve() not in continued)
    return [Task(run, unused(places[run], taken), chains[run]) for run in last]


def chain_of(run: Path) -> tuple[Path, ...]:
    """The run and those before it as their manifests name them; who opens it reports what is wrong with a link."""
    chain = [run]
    with suppress(InvalidFile, KeyError, TypeError):
        while b'"continues"' in files.read_file(chain[0], files.MANIFEST):
            link = files.read_manifest(chain[0]).get("continues")
            if link is None:
                break
            before = chain[0].resolve().parent / Path(str(link["run"])).name
            if not (before / files.MANIFEST).is_file():  # its folder may have another name; where there is none it ends
                before = next(files.next_to(chain[0], str(link["run"])), chain[0])
            if before in chain:
                break
            chain.insert(0, before)
    return tuple(chain)


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
        manifest = files.read_manifest(folder)
        seal = files.read_seal(folder)
        status = files.status_of(manifest, seal)
    except InvalidFile:
        manifest, seal, status = {}, {}, "damaged"
    if seal is None:
        found = files.journal_summary(manifest, files.decode_lines(_events(folder)), [])
        size = 0
        with suppress(OSError):
            size = sum(path.stat().st_size for _name, path in files.files_of(folder) if files.is_regular(path))
    else:
        found = seal
        size = sum(int(entry["bytes"]) for entry in seal.get("files", {}).values())
        with suppress(OSError):
            size += (folder / files.SEAL).stat().st_size
    link = manifest.get("continues")
    done = link.get("trials_done") if isinstance(link, Mapping) else None
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
        trials_before=len(set(map(str, done))) if isinstance(done, list) else 0,
        trials_planned=int(found.get("trials_planned") or 0),
        duration=found.get("duration"),
        size=size,
        continues=str(link.get("run") or "") if isinstance(link, Mapping) else "",
        added=tuple(names),
        late=tuple(late_files(folder)) if seal else (),
    )


def _events(folder: Path) -> bytes:
    with suppress(InvalidFile):
        return files.read_file(folder, files.EVENTS) if files.is_regular(folder / files.EVENTS) else b""
    return b""


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
    """A row from the cache, where JSON has lists for tuples."""
    kept |= {name: tuple(value) for name, value in kept.items() if isinstance(value, list)}
    return Row(**kept)


def _store(path: Path, fresh: Mapping[str, tuple[str, Row]], gone: set[str]) -> None:
    """Store rows in the cache; a damaged cache is replaced, and one that cannot be written is left out."""
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
