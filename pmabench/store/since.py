"""Finds additions to a run after it was sealed, and fingerprints runs; changes nothing.

A sealed folder is never written again. Late data (the guard's report of a vent) are in a folder next to it, with the
name of the run folder and `.late`. Files that others put into the folder (a file manager, an editor) are not part of
the run: they are reported, and never read. Standard library only.

The fingerprint of a run covers the bytes of manifest, seal and head of the notes, which contain the hashes of all data
and notes, and size and modification time of every other file, so that a file changed in place is detected too.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, invalid
from pmabench.base.system import registered
from pmabench.store import folder as files
from pmabench.store import notes
from pmabench.store.folder import is_regular, kind_of, open_regular, read_file

LONGEST = 1_000_000
"""Largest size of a guard's report [bytes]; a longer file is ignored."""
NAMED = 3
"""Largest number of names in a sentence."""


@dataclass(frozen=True)
class Added:
    """An entry in the folder of a sealed run that is not in the seal."""

    name: str
    """Path inside the run folder, with `/`."""
    what: str
    """`a file`, `a folder`, `a link`, `a FIFO` ..."""

    @property
    def sentence(self) -> str:
        """Text of `runs verify` after the name."""
        kind = "" if self.what == "a file" else f"; it is {self.what}"
        if self.name.startswith(f"{files.NOTES}/"):
            return f"was added to the note{kind}" if self.name.count("/") > 1 else "was put among the notes; it is none"
        return f"was added after the run was closed{kind}"


@dataclass(frozen=True)
class Since:
    """Everything that changed after the seal."""

    added: tuple[Added, ...] = ()
    late: tuple[str, ...] = ()
    """Names of the files in the folder next to the run."""
    guard: Mapping[str, Any] = field(default_factory=dict)
    """The guard's late report, from either place; empty where there is none."""
    altered: tuple[str, ...] = ()
    """Sentences about changed files without samples (an imported file, calibrations)."""

    @property
    def sentences(self) -> list[str]:
        """Sentences for the user; empty for an unchanged run."""
        found = list(self.altered)
        if self.added:
            names = _listed([entry.name for entry in self.added])
            found.append(f"added to the folder after the run was closed, and not used: {names}")
        if self.late:
            found.append(f"written next to the run after it was closed: {_listed(list(self.late))}")
        if self.guard:
            cause = self.guard.get("cause") or "no cause is given"
            found.append(f"the guard vented once more after the run was closed: {vent_of(self.guard)} ({cause})")
        return found

    def as_data(self) -> dict[str, Any]:
        """Plain data for programs."""
        added = [vars(entry) for entry in self.added]
        return {"added": added, "late": list(self.late), "guard": dict(self.guard), "altered": list(self.altered)}


def vent_of(guard: Mapping[str, Any]) -> str:
    """The result of the vent in a guard's report."""
    vent = guard.get("vent")
    return str((vent.get("result") if isinstance(vent, Mapping) else None) or "no result is given")


def since(folder: Path, manifest: Mapping[str, Any], seal: Mapping[str, Any] | None) -> Since:
    """Additions to a run after its seal, and changes of kept files; raises InvalidFile where one cannot be read."""
    hashes = {name: entry["sha256"] for name, entry in seal["files"].items()} if seal else manifest.get("snapshots", {})
    own = (files.MANIFEST, files.EVENTS, files.PLAN, files.GUARD)  # readers of these refuse changed ones
    kept = sorted(name for name in hashes if name not in own and name.split("/")[0] != files.STREAMS)
    try:
        faults = {name: files.fault_of(folder, name, hashes[name]) for name in kept}
        altered = tuple(f"{name} {fault}" for name, fault in faults.items() if fault)
        if seal is None:
            return Since(altered=altered)
        found = tuple(added(folder, seal))
    except OSError as error:
        raise invalid(error.filename or folder, f"cannot be read: {error.strerror or error}") from error
    inside = any(entry.name == files.GUARD for entry in found)
    guard = late_guard(folder) or (guard_account(folder / files.GUARD) if inside else {})
    return Since(found, tuple(late_files(folder)), guard, altered)


def as_sealed(folder: Path) -> bool:
    """Whether every file of a sealed run and every note is unchanged."""
    sealed = (files.read_seal(folder) or {}).get("files", {})
    same = all(not files.fault_of(folder, name, entry["sha256"], entry["bytes"]) for name, entry in sealed.items())
    return same and next(iter(notes.check_notes(folder)), None) is None


def late_folder(folder: Path) -> Path:
    """The folder next to a run for files written after its seal."""
    whole = folder if folder.name not in {"", ".", ".."} else folder.resolve()
    return whole.with_name(whole.name + files.LATE)


def late_files(folder: Path) -> list[str]:
    """Names of the late files of a run, sorted, without unfinished ones."""
    place = late_folder(folder)
    with suppress(OSError):
        if not place.is_symlink():
            return sorted(path.name for path in place.iterdir() if not path.name.startswith("."))
    return []


def late_guard(folder: Path) -> dict[str, Any]:
    """The guard's report next to a run; empty where there is none that can be read."""
    place = late_folder(folder)
    return {} if place.is_symlink() else guard_account(place / files.GUARD)


def guard_account(path: Path) -> dict[str, Any]:
    """A guard's report that no seal protects; empty where it cannot be read."""
    with suppress(OSError, ValueError, RecursionError), open_regular(path) as file:
        raw = file.read(LONGEST + 1)
        account = json.loads(raw) if len(raw) <= LONGEST else None
        return account if isinstance(account, dict) else {}
    return {}


def adopt(folder: Path) -> None:
    """Move the guard's report into a run that is not sealed yet, so that the seal covers it. Raises OSError."""
    late = late_folder(folder)
    if late.is_symlink() or os.path.lexists(folder / files.GUARD) or not is_regular(late / files.GUARD):
        return
    with open_regular(late / files.GUARD) as file:
        raw = file.read(LONGEST + 1)
    if len(raw) <= LONGEST:
        files.write_whole(folder / files.GUARD, raw)
        with suppress(OSError):  # harmless: it is then in both places
            (late / files.GUARD).unlink()
            late.rmdir()


def added(folder: Path, seal: Mapping[str, Any]) -> Iterator[Added]:
    """Entries in the folder of a sealed run that its seal does not list, sorted; an added folder counts as one.

    Notes are left out, since they may come at any time and have their own hashes; other files among them are included.
    Raises OSError.
    """
    sealed = set(seal["files"])
    folders = {files.STREAMS, *(name.rpartition("/")[0] for name in sealed)}
    folders |= {"/".join(name.split("/")[:depth]) for name in folders for depth in range(1, name.count("/") + 1)}
    yield from _added(folder, "", sealed, folders - {""})


def _added(folder: Path, prefix: str, sealed: set[str], folders: set[str]) -> Iterator[Added]:
    for entry in _inside(folder):
        name = prefix + entry.name
        mode = entry.stat(follow_symlinks=False).st_mode
        if name == files.NOTES and stat.S_ISDIR(mode):
            yield from _among_notes(Path(entry.path))
        elif name in folders and stat.S_ISDIR(mode):
            yield from _added(Path(entry.path), f"{name}/", sealed, folders)
        elif name not in sealed and not (name in _MAY_COME and stat.S_ISREG(mode)):
            yield Added(name, kind_of(mode))


_MAY_COME = {files.SEAL, files.NOTES_HEAD, files.part_of(Path(files.NOTES_HEAD)).name}


def _among_notes(folder: Path) -> Iterator[Added]:
    for entry in _inside(folder):
        if notes.NAME.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
            known = {notes.NOTE, *_attached(Path(entry.path, notes.NOTE))}
            for inner in _inside(Path(entry.path)):
                if inner.name not in known:
                    name = f"{files.NOTES}/{entry.name}/{inner.name}"
                    yield Added(name, kind_of(inner.stat(follow_symlinks=False).st_mode))
        elif not entry.name.startswith(notes.PART):
            yield Added(f"{files.NOTES}/{entry.name}", kind_of(entry.stat(follow_symlinks=False).st_mode))


def _attached(note: Path) -> set[str]:
    """Names of the files of a note; empty if it cannot be read. `check_notes` verifies them."""
    with suppress(OSError, ValueError, RecursionError, TypeError, KeyError), open_regular(note) as file:
        return {str(entry["name"]) for entry in json.loads(file.read(LONGEST))["files"]}
    return set()


def _inside(folder: Path) -> list[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        return sorted(entries, key=lambda entry: entry.name)


def _listed(names: list[str]) -> str:
    more = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {more} more" if more > 0 else "")


READ = (files.MANIFEST, files.SEAL, files.NOTES_HEAD)
PARTS = ("analysis", "base", "bench", "files", "kinds", "model", "plotting", "report", "store")
"""Packages whose code affects results and reports."""
LIBRARIES = ("numpy", "scipy", "pandas", "pyarrow", "jinja2")
GROUPS = ("pmabench.kinds", "pmabench.models", "pmabench.rules")
"""Groups of entry points through which other packages add code that affects results."""


def fingerprint(chain: Iterable[Path], about: str) -> str:
    """Hash of the runs of a chain and of `about` (options); empty if one of them is not closed or cannot be read."""
    digest = hashlib.sha256(about.encode())
    try:
        for run in chain:
            names = _take(digest, run, READ)
            digest.update("\0".join(["late", *late_files(run)]).encode("utf-8", "surrogateescape"))
            if files.SEAL not in names:
                return ""
    except (OSError, InvalidFile):
        return ""
    return digest.hexdigest()


def stamp(folder: Path) -> str:
    """Hash of the names, sizes and modification times of all files of a folder; empty if it cannot be read."""
    digest = hashlib.sha256()
    with suppress(OSError):
        _take(digest, folder)
        return digest.hexdigest()
    return ""


def _take(digest: hashlib._Hash, folder: Path, read: Collection[str] = ()) -> set[str]:
    """Update a hash with name, size and time of each file of a folder, or the bytes of those in `read`.

    Returns the names.
    """
    names = set()
    for name, entry in _walk(folder):
        names.add(name)
        found = entry.stat(follow_symlinks=False)
        digest.update(f"{name}\0{found.st_size}\0".encode())
        digest.update(read_file(folder, name, files.LARGEST) if name in read else f"{found.st_mtime_ns}\0".encode())
    return names


def _walk(folder: Path, prefix: str = "") -> Iterator[tuple[str, os.DirEntry[str]]]:
    """Every file below a folder as (relative name, entry), in the same order on every system."""
    for entry in _inside(folder):
        if entry.is_dir(follow_symlinks=False):
            yield from _walk(Path(entry.path), f"{prefix}{entry.name}/")
        else:
            yield f"{prefix}{entry.name}", entry


@cache
def program() -> str:
    """Hash of the code of pmabench and its extensions that affects results and reports, and of library versions."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[1]
    for place in [*(root / part for part in PARTS), *_extensions()]:
        inside = _walk(place) if place.is_dir() else [("", place)]
        for name, path in inside:
            if "__pycache__/" not in name:  # includes compiled templates, which the first report creates
                digest.update(f"{place.name}/{name}\0".encode())
                digest.update(Path(path).read_bytes())
    for library in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            digest.update(f"{library} {_version(metadata.distribution(library))}\0".encode())
    return digest.hexdigest()


def _version(library: metadata.Distribution) -> str:
    """As `library.version`, for which all of a metadata file is parsed as an e-mail."""
    found = re.search(r"^Version: (.*)$", library.read_text("METADATA") or "", re.MULTILINE)
    return found[1] if found else library.version


def _extensions() -> Iterator[Path]:
    """Packages (folders) and modules (files) that are registered in `GROUPS`."""
    modules = {point.module.partition(".")[0] for group in GROUPS for point in registered(group)}
    for module in sorted(modules - {"pmabench"}):
        with suppress(ImportError, ValueError):
            found = find_spec(module)
            if found is not None and found.origin:
                yield Path(found.origin).parent if found.submodule_search_locations else Path(found.origin)
