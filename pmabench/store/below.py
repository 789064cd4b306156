"""Which runs lie below a folder, and which of them continue which; reads manifests only where it must.

Standard library only: a folder of thousands of runs is looked through in a fraction of a second.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pmabench.base.errors import InvalidFile, invalid
from pmabench.store import folder as files
from pmabench.store.folder import read_file, read_manifest
from pmabench.store.naming import is_run_name

ANALYSES, ANALYSIS = "analyses", "analysis.json"
"""What lies in folders of the first name was made of runs and is none; the second is in each analysis folder."""


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
        try:
            with os.scandir(place) as entries:
                inside = list(entries)
        except OSError as error:
            raise invalid(place, f"cannot be read: {error.strerror or error}") from error
        if any(entry.name in (files.MANIFEST, files.SEAL) for entry in inside):
            yield place
            continue
        if is_run_name(place.name) and not any(Path(entry, ANALYSIS).exists() for entry in inside):
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
    tasks = []
    for run, chain in chains.items():
        if len(continued) and run.resolve() in continued:
            continue
        place, count = places[run], 1
        while place.casefold() in taken:
            count += 1
            place = f"{places[run]}-{count}"
        taken.add(place.casefold())
        tasks.append(Task(run, place, chain))
    return tasks


def chain_of(run: Path) -> tuple[Path, ...]:
    """The run and those before it as their manifests name them; who opens it reports what is wrong with a link."""
    chain = [run]
    with suppress(InvalidFile, KeyError, TypeError):
        while b'"continues"' in read_file(chain[0], files.MANIFEST):
            link = read_manifest(chain[0]).get("continues")
            if link is None:
                break
            before = chain[0].resolve().parent / Path(str(link["run"])).name
            before = before if (before / files.MANIFEST).is_file() else _renamed(chain[0], str(link["run"]))
            if before in chain:
                break
            chain.insert(0, before)
    return tuple(chain)


def _renamed(run: Path, name: str) -> Path:
    """The folder next to `run` that holds the run `name` under another name."""
    for folder in sorted(run.resolve().parent.iterdir()):
        with suppress(InvalidFile):
            if (folder / files.MANIFEST).is_file() and read_manifest(folder).get("id") == name:
                return folder
    raise invalid(run, f"continues {name}, which is not next to it")
