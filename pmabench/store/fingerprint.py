"""Shows whether a run, what was said of it and the program are still the same, without reading any samples.

The bytes of manifest, seal and head of the notes, which carry the hashes of all that was recorded and said; of every
other file its size and time of change, so that a file changed in place is seen too. Standard library only.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from pmabench.base.errors import InvalidFile
from pmabench.store import folder as files
from pmabench.store.folder import read_file
from pmabench.store.since import late_files

READ = (files.MANIFEST, files.SEAL, files.NOTES_HEAD)
PARTS = ("analysis", "base", "bench", "files", "kinds", "model", "plotting", "report", "store")
"""Packages that make results of runs, and reports of results."""
LIBRARIES = ("numpy", "scipy", "pandas", "pyarrow", "matplotlib", "jinja2")
GROUPS = ("pmabench.kinds", "pmabench.models", "pmabench.rules")
"""Entry points by which other packages bring code that makes results."""


def fingerprint(chain: Iterable[Path], about: str) -> str:
    """Hash of the runs of a chain and of `about` (options); empty where one of them is not closed or cannot be read."""
    digest = hashlib.sha256(about.encode())
    try:
        for run in chain:
            names = set()
            for name, entry in _walk(run):
                names.add(name)
                found = entry.stat(follow_symlinks=False)
                digest.update(f"{name}\0{found.st_size}\0".encode())
                if name in READ:
                    digest.update(read_file(run, name, files.LARGEST))
                else:
                    digest.update(f"{found.st_mtime_ns}\0".encode())
            digest.update("\0".join(["late", *late_files(run)]).encode("utf-8", "surrogateescape"))
            if files.SEAL not in names:
                return ""
    except (OSError, InvalidFile):
        return ""
    return digest.hexdigest()


def stamp(folder: Path) -> str:
    """Hash of the names, sizes and times of all files of a folder; empty where it cannot be read."""
    digest = hashlib.sha256()
    try:
        for name, entry in _walk(folder):
            found = entry.stat(follow_symlinks=False)
            digest.update(f"{name}\0{found.st_size}\0{found.st_mtime_ns}\0".encode())
    except OSError:
        return ""
    return digest.hexdigest()


def _walk(folder: Path, prefix: str = "") -> Iterator[tuple[str, os.DirEntry[str]]]:
    """Every file below a folder with its name there, in one order everywhere."""
    with os.scandir(folder) as entries:
        inside = sorted(entries, key=lambda entry: entry.name)
    for entry in inside:
        if entry.is_dir(follow_symlinks=False):
            yield from _walk(Path(entry.path), f"{prefix}{entry.name}/")
        else:
            yield f"{prefix}{entry.name}", entry


@cache
def program() -> str:
    """Hash of the code that makes results and reports, of pmabench and of packages that extend it, and of the versions
    of the libraries that reckon and draw.
    """
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[1]
    for place in [*(root / part for part in PARTS), *_extensions()]:
        inside = _walk(place) if place.is_dir() else [("", place)]
        for name, path in inside:
            if not name.endswith(".pyc"):
                digest.update(f"{place.name}/{name}\0".encode())
                digest.update(Path(path).read_bytes())
    for library in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            digest.update(f"{library} {metadata.version(library)}\0".encode())
    return digest.hexdigest()


def _extensions() -> Iterator[Path]:
    """Packages (folders) and modules (files) that are registered in `GROUPS`."""
    modules = {point.module.partition(".")[0] for group in GROUPS for point in metadata.entry_points(group=group)}
    for module in sorted(modules - {"pmabench"}):
        with suppress(ImportError, ValueError):
            found = find_spec(module)
            if found is not None and found.origin:
                yield Path(found.origin).parent if found.submodule_search_locations else Path(found.origin)
