"""Finds the runs in a folder, the chains of runs that continue one another, and lists runs by manifest and seal.

Standard library only: a thousand runs are listed in half a second.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, reading
from pmabench.base.text import unused
from pmabench.store import folder as files
from pmabench.store.since import added, late_files

ANALYSES, ANALYSIS = "analyses", "analysis.json"
"""Name of folders with analyses, which are not searched for runs; and of the file in each analysis folder."""


@dataclass(frozen=True)
class Task:
    """A run with those that it continues, as one unit of work."""

    path: Path
    """Folder of the last run."""
    place: str
    """Path relative to the given folder, with `/`; unique among several tasks."""
    chain: tuple[Path, ...]
    """All its run folders in order of time; `path` is the last."""


def holds_runs(folder: Path) -> bool:
    """Whether `folder` is not a run itself and there are runs below it."""
    return folder.is_dir() and next(_found(folder), folder) != folder


def _found(folder: Path) -> Iterator[Path]:
    """Every run folder below `folder`; the folder itself if it is a run.

    A folder with the name of a run counts as one even without a manifest, so that opening it reports the damage. Links,
    hidden folders and the inside of runs are not searched. Raises InvalidFile for a folder that cannot be read.
    """
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
        named = (entry for entry in inside if not entry.name.startswith(".") and entry.name != ANALYSES)
        waiting += [place / entry.name for entry in named if entry.is_dir(follow_symlinks=False)]


def tasks_below(given: Sequence[Path]) -> list[Task]:
    """The last runs of all chains in `given` (runs, or folders of runs), each with the runs that it continues.

    A path without any run below it is returned as a task too; opening it reports the problem.
    """
    places: dict[Path, str] = {}
    for folder in given:
        for run in (folder.is_dir() and sorted(_found(folder))) or [folder]:
            places.setdefault(run, run.relative_to(folder).as_posix() if run != folder else folder.resolve().name)
    chains = {run: chain_of(run) for run in places}
    continued = {before.resolve() for chain in chains.values() for before in chain[:-1]}
    taken: set[str] = set()
    last = (run for run in chains if not continued or run.resolve() not in continued)
    return [Task(run, unused(places[run], taken), chains[run]) for run in last]


def chain_of(run: Path) -> tuple[Path, ...]:
    """The run and those before it, as their manifests name them; invalid links are ignored here."""
    chain = [run]
    with suppress(InvalidFile, KeyError, TypeError):
        while b'"continues"' in files.read_file(chain[0], files.MANIFEST):
            link = files.read_manifest(chain[0]).get("continues")
            if link is None:
                break
            before = chain[0].resolve().parent / Path(str(link["run"])).name
            if not (before / files.MANIFEST).is_file():  # its folder may have been renamed; without one the chain ends
                before = next(files.next_to(chain[0], str(link["run"])), chain[0])
            if before in chain:
                break
            chain.insert(0, before)
    return tuple(chain)


@dataclass(frozen=True)
class Row:
    """One run in the list."""

    id: str
    folder: str
    """Name of its folder in the listed folder."""
    date: str
    """Start, UTC, ISO 8601."""
    kind: str
    specimen: str
    bench: str
    status: str
    """As in `RunData`; `running` while it is written, `damaged` if manifest or seal is invalid."""
    why: str
    """The cause of a status other than `finished`."""
    simulated: bool
    trials_finished: int
    trials_before: int
    """Trials finished by the runs that this one continues, from its manifest; not counted in `trials_finished`."""
    trials_planned: int
    duration: float | None
    """From the first to the last sample or event [s]."""
    size: int
    """Bytes on disk."""
    continues: str
    """Id of the run that it continues; empty for none."""
    added: tuple[str, ...]
    """Names of files put into the folder after the run was closed; they are not part of it."""
    late: tuple[str, ...]
    """Names of files written next to the run folder after it was closed."""


def catalogue(parent: Path | str) -> list[Row]:
    """Every run directly in `parent`, sorted by name, which is by time."""
    return [_read(folder) for folder in _runs(Path(parent))]


def folders_in(parent: Path) -> list[Path]:
    """The run folders directly in a folder, sorted by name; none if it is a run itself."""
    return [] if _is_run(parent) else _runs(parent)


def _is_run(folder: Path) -> bool:
    """Whether a folder has a manifest or a seal; without both, or where it may not be read, it is no run."""
    return any(os.path.exists(folder / name) for name in (files.MANIFEST, files.SEAL))  # noqa: PTH110  (never raises)


def _runs(parent: Path) -> list[Path]:
    """The run folders directly in a folder; none where it cannot be read."""
    with suppress(OSError):
        return sorted(each for each in parent.iterdir() if not each.name.startswith(".") and _is_run(each))
    return []


def _read(folder: Path) -> Row:
    try:
        manifest = files.read_manifest(folder)
        seal = files.read_seal(folder)
        status = files.status_of(manifest, seal)
    except InvalidFile:
        manifest, seal, status = {}, {}, "damaged"
    if seal is None:
        events, size = b"", 0
        with suppress(InvalidFile):
            events = files.read_file(folder, files.EVENTS) if files.is_regular(folder / files.EVENTS) else b""
        found = files.journal_summary(manifest, files.decode_lines(events), [])
        with suppress(OSError):
            size = sum(path.stat().st_size for _name, path in files.files_of(folder) if files.is_regular(path))
    else:
        found = seal
        size = sum(int(entry["bytes"]) for entry in seal.get("files", {}).values())
        with suppress(OSError):
            size += (folder / files.SEAL).stat().st_size
    link = manifest.get("continues")
    link = link if isinstance(link, Mapping) else {}
    done = link.get("trials_done")
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
        continues=str(link.get("run") or ""),
        added=tuple(names),
        late=tuple(late_files(folder)) if seal else (),
    )


def _label(value: Any) -> str:
    if isinstance(value, Mapping):
        return " ".join(str(value[key]) for key in ("name", "type", "serial") if value.get(key))
    return "" if value is None else str(value)
