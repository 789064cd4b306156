"""Verifies that a run folder is unchanged: hashes, checksums, sequences, rows, time; never repairs anything."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.errors import InvalidFile, invalid
from pmabench.store import folder as files
from pmabench.store.livestream import LiveReader, pa
from pmabench.store.notes import check_notes
from pmabench.store.reader import RunFiles, events_of
from pmabench.store.records import Flag, trial_spans
from pmabench.store.seal import read_archive
from pmabench.store.since import added

_FLAGGED = np.uint16(Flag.GAP | Flag.LATE | Flag.TIME_JUMP)


@dataclass(frozen=True)
class Finding:
    """A fault of one file of a run, or a file that was added to it."""

    file: str
    message: str
    added: bool = False
    """Whether it is an added file and not damage to the sealed part."""

    def __str__(self) -> str:
        """`file: message`."""
        return f"{self.file}: {self.message}"


def verify(path: Path | str) -> list[Finding]:
    """All faults of a run and additions to it; empty for a closed and unchanged run.

    Only regular files of the run are opened. Gaps that are flagged in the record are not reported. Raises InvalidFile
    for a folder that is not a run.
    """
    try:
        return _verify(Path(path))
    except OSError as error:
        raise invalid(error.filename or path, f"cannot be read: {error.strerror or error}") from error


def _verify(folder: Path) -> list[Finding]:
    if not os.path.lexists(folder / files.SEAL) or not os.path.lexists(folder / files.MANIFEST):
        files.read_manifest(folder)
    found: list[Finding] = []
    manifest = _or_finding(found, files.MANIFEST, lambda: files.read_manifest(folder)) or {}
    seal = _or_finding(found, files.SEAL, lambda: files.read_seal(folder))
    if seal is not None:
        found += _changed(folder, {name: (entry["sha256"], entry["bytes"]) for name, entry in seal["files"].items()})
    else:
        if not os.path.lexists(folder / files.SEAL):
            found.append(Finding(files.SEAL, f"is missing: the run is {files.status_of(manifest, None)}"))
        found += _changed(folder, {name: (digest, None) for name, digest in manifest.get("snapshots", {}).items()})
        found += [Finding(name, files.odd(path)) for name, path in files.files_of(folder) if not files.is_regular(path)]
    found += _events(folder, seal)
    found += _streams(folder, seal)
    found += [Finding(name, what) for name, what in check_notes(folder)]
    if not found and "imported" not in manifest:
        found += _time(folder)
    if seal is not None:
        found += [Finding(entry.name, entry.sentence, added=True) for entry in added(folder, seal)]
    return found


def _or_finding(found: list[Finding], name: str, read: Callable[[], dict[str, Any] | None]) -> dict[str, Any] | None:
    try:
        return read()
    except InvalidFile as error:
        found += [Finding(name, problem.message) for problem in error.problems]
        return None


def _changed(folder: Path, known: Mapping[str, tuple[str, int | None]]) -> Iterator[Finding]:
    """Findings for changed files; `known`: name -> sha256 and size [bytes], None where not known."""
    for name, (digest, size) in sorted(known.items()):
        if fault := files.fault_of(folder, name, digest, size):
            yield Finding(name, fault)


def _read(folder: Path, seal: Mapping[str, Any] | None, name: str) -> bytes:
    """The bytes of a file; of a sealed one at most one more than its size, which shows whether it has grown."""
    sealed = seal["files"].get(name) if seal is not None else None
    return files.read_file(folder, name, None if sealed is None else sealed["bytes"] + 1)


def _events(folder: Path, seal: Mapping[str, Any] | None) -> list[Finding]:
    try:
        raw = _read(folder, seal, files.EVENTS) if files.is_regular(folder / files.EVENTS) else b""
    except InvalidFile as error:
        return [Finding(files.EVENTS, error.problems[0].message)]
    journal = files.decode_lines(raw)
    if seal is None:
        return [Finding(files.EVENTS, journal.fault)] if journal.fault else []
    found = []
    if journal.fault != seal.get("events_fault"):
        found.append(Finding(files.EVENTS, journal.fault or "has lost the fault that it was sealed with"))
    if len(journal.lines) != seal.get("events"):
        found.append(Finding(files.EVENTS, f"has {len(journal.lines)} whole lines; {seal.get('events')} were sealed"))
    if seal.get("status") not in ("interrupted", "error") and (not journal.lines or journal.lines[-1]["kind"] != "end"):
        found.append(Finding(files.EVENTS, "has no end mark"))
    return found


def _streams(folder: Path, seal: Mapping[str, Any] | None) -> list[Finding]:
    found = []
    sealed = {} if seal is None else seal.get("streams", {})
    for name, path in files.files_of(folder / files.STREAMS) if (folder / files.STREAMS).is_dir() else ():
        known = next((stream for stream in sealed.values() if stream.get("file") == name), None)
        place = f"{files.STREAMS}/{name}"
        if not files.is_regular(path) or (seal is not None and known is None):
            continue
        try:
            if path.suffix == ".parquet":
                rows, fault = read_archive(pa.BufferReader(_read(folder, seal, place)))[0].num_rows, ""
            elif path.suffix == ".arrows":
                reader = LiveReader(pa.py_buffer(_read(folder, seal, place)))
                for _batch in reader:
                    pass
                rows, fault = reader.rows, reader.fault
            else:
                continue
        except (InvalidFile, ValueError) as error:
            rows, fault = None, str(error)
        if seal is None and fault:
            found.append(Finding(place, f"{fault}; {rows or 0} whole rows before that"))
        elif known is not None and known.get("rows") not in (None, rows):
            found.append(Finding(place, f"has {rows} rows; {known['rows']} were sealed {fault}"))
    return found


def _time(folder: Path) -> list[Finding]:
    """Findings for gaps and backward steps of time within a trial that are not flagged."""
    run = RunFiles(folder)
    events = events_of(run.journal())
    found = []
    for name in run.stream_names():
        samples = run.stream(name, events)
        if samples.rate <= 0 or len(samples.t) < 2:
            continue
        step = np.diff(samples.t)
        odd = ((step > 1.5 / samples.rate) | (step <= 0)) & ((samples.flags[1:] & _FLAGGED) == 0)
        inside = np.zeros(len(step), dtype=bool)
        for begin, end in trial_spans(events):
            inside |= (samples.t[:-1] >= begin - 1e-6) & (samples.t[1:] <= end + 1e-6)
        for at, gap in zip(samples.t[:-1][odd & inside][:20], step[odd & inside][:20], strict=True):
            what = f"{gap:.6g} s without a sample" if gap > 0 else "time does not go on"
            found.append(Finding(f"{files.STREAMS}/{name}", f"{what} after t = {at:.6g} s, and no flag says so"))
    return found
