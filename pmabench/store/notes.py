"""Notes on a run: texts, files and exclusions, appended as a chain of hashes; the sealed part is not changed.

A note is a folder `notes/0001` with `note.json` and copies of its files; a rename makes it appear complete. It contains
the sha256 of the note before (the first one: of the manifest) and of each file. `notes.json` has the number of notes
and the sha256 of the last, so that a note missing at the end is detected too. Standard library only.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, UsageError, invalid
from pmabench.base.text import unused
from pmabench.store import folder as files

NOTE_SCHEMA = "pmabench.note/1"
HEAD_SCHEMA = "pmabench.notes/1"
NAME = re.compile(r"\d{4,}")
"""Pattern of the name of a note's folder."""
NOTE = "note.json"
PART = ".part-"
"""Prefix of the folder of a note that is being written."""
_LONGEST = 100_000


@dataclass(frozen=True)
class Note:
    """A note added to a run afterwards."""

    number: int
    """Number, from 1."""
    utc: str
    operator: str
    text: str
    exclude: int | None
    """Index of a trial to exclude from fits; None for none."""
    because: str
    files: tuple[str, ...]
    """Attached files, as names inside the run folder."""

    @property
    def excluded(self) -> int | None:
        """Number, from 1, of the trial to exclude from fits; None for none."""
        return None if self.exclude is None else self.exclude + 1

    def as_data(self) -> dict[str, Any]:
        """Plain data for users and programs; trials count from 1."""
        return {**vars(self), "exclude": self.excluded}


def add_note(
    run: Path,
    text: str = "",
    *,
    attach: Sequence[Path] = (),
    exclude: int | None = None,
    because: str = "",
    operator: str = "",
) -> Note:
    """Append a note to an open or closed run, atomically and synced.

    Raises UsageError for an empty note or an exclusion without reason, InvalidFile for a folder that is not a run, has
    no such trial, or whose notes were changed, RecordError where the note cannot be written.
    """
    if not (text.strip() or attach or exclude is not None):
        raise UsageError("the note says nothing: give a TEXT, --attach FILE, or --exclude TRIAL --because TEXT")
    if (exclude is not None) != bool(because.strip()):
        raise UsageError("--exclude TRIAL and --because TEXT go together: the record says why a trial is left out")
    if len(text) + len(because) > _LONGEST:
        raise UsageError(f"the note is longer than {_LONGEST} characters; attach it as a file")
    manifest = files.read_manifest(run)
    if exclude is not None:
        _check_trial(run, exclude)
    for source in attach:
        if not source.is_file():
            raise invalid(source, "cannot be attached: it is no file")
    said = {"operator": operator, "text": text.strip(), "exclude": exclude, "because": because.strip()}
    try:
        with _alone(run):
            return _append(run, manifest, said, attach)
    except OSError as error:
        raise files.cannot_write(run / files.NOTES, error) from error


def _append(run: Path, manifest: Mapping[str, Any], said: Mapping[str, Any], attach: Sequence[Path]) -> Note:
    """Write a note and return it; `said`: operator, text, exclude and because."""
    known, faults, last = _look(run)
    if faults:
        raise InvalidFile(problem for name, what in faults for problem in invalid(run / name, what).problems)
    folder = run / files.NOTES
    folder.mkdir(exist_ok=True)
    for left in folder.glob(f"{PART}*"):
        shutil.rmtree(left, ignore_errors=True)
    _write_head(run, manifest, len(known), last)  # after a crash it may be missing, or one note behind
    number = len(known) + 1
    part = folder / f"{PART}{secrets.token_hex(4)}"
    part.mkdir()
    try:
        copied = [_copy(source, part, name) for source, name in zip(attach, _names(attach), strict=True)]
        content = {
            "schema": NOTE_SCHEMA,
            "run": manifest["id"],
            "number": number,
            "before": last,
            "utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
            **said,
            "files": copied,
        }
        raw = files.sealed_json(content)
        files.write_whole(part / NOTE, raw)
        for path in part.iterdir():
            path.chmod(0o444)
        part.rename(folder / f"{number:04d}")
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    files.sync_folder(folder)
    files.sync_folder(run)
    _write_head(run, manifest, number, hashlib.sha256(raw).hexdigest())
    return _note(content)


def _check_trial(run: Path, trial: int) -> None:
    lines = files.decode_lines(files.read_file(run, files.EVENTS)).lines if files.is_regular(run / files.EVENTS) else ()
    begun = sorted({line["data"].get("trial") for line in lines if line["kind"] == "trial-begin"} - {None})
    if trial not in begun:
        text = f"trials {begun[0] + 1} to {begun[-1] + 1}" if begun else "no trial yet"
        raise invalid(run, f"has no trial {trial + 1} to exclude; it has {text} (`pmabench runs show` lists them)")


def _names(attach: Sequence[Path]) -> list[str]:
    """A legal, unique name for each attached file."""
    taken = {NOTE}
    names = []
    for source in attach:
        stem = re.sub(r"[^A-Za-z0-9_-]+", "-", source.stem)[:60].strip("-") or "file"
        names.append(unused(stem, taken, re.sub(r"[^A-Za-z0-9.]+", "", source.suffix)[:12]))
    return names


def _copy(source: Path, part: Path, name: str) -> dict[str, Any]:
    digest, size = files.copy_file(source, part / name)
    return {"name": name, "given": source.name, "sha256": digest, "bytes": size}


def _write_head(run: Path, manifest: Mapping[str, Any], count: int, last: str) -> None:
    head = {"schema": HEAD_SCHEMA, "run": manifest["id"], "notes": count, "last": last}
    files.write_whole(run / files.NOTES_HEAD, files.sealed_json(head))


@contextmanager
def _alone(run: Path) -> Iterator[None]:
    """Lock the run folder, so that only one note is written at a time; no lock on Windows."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    fd = os.open(run, os.O_RDONLY)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX)
        yield
    finally:
        os.close(fd)


def read_notes(run: Path) -> tuple[Note, ...]:
    """The notes of a run in order; raises InvalidFile where one was changed, removed or moved."""
    notes, faults, _last = _look(run)
    if faults:
        name, what = faults[0]
        raise invalid(run / name, f"{what}; `pmabench runs verify` says more")
    return notes


def check_notes(run: Path) -> list[tuple[str, str]]:
    """All faults in the notes of a run, as (file, sentence)."""
    return _look(run)[1]


def _look(run: Path) -> tuple[tuple[Note, ...], list[tuple[str, str]], str]:
    """The unchanged notes, the faults, and the sha256 of the last note.

    Files that were put among the notes are not faults: `pmabench.store.since` reports them.
    """
    notes, faults, last = list[Note](), list[tuple[str, str]](), ""
    with suppress(InvalidFile):
        last = hashlib.sha256(files.read_file(run, files.MANIFEST, files.LARGEST)).hexdigest()
    chain = [last]
    for number, name in enumerate(_folders(run), start=1):
        place = f"{files.NOTES}/{name}"
        if name != f"{number:04d}":
            faults.append((place, f"comes where note {number:04d} should be: a note was removed or renamed"))
            break
        try:
            raw = files.read_file(run, f"{place}/{NOTE}", files.LARGEST)
            content = files.open_json(raw, run / place / NOTE)
            note = _note(content)
        except (InvalidFile, KeyError, TypeError, ValueError) as error:
            what = error.problems[0].message if isinstance(error, InvalidFile) else "is no note"
            faults.append((f"{place}/{NOTE}", what))
            break
        if note.number != number or content.get("before") != last:
            faults.append((f"{place}/{NOTE}", "does not follow the note before it: notes were changed or moved"))
            break
        faults += _attached(run, place, content["files"])
        notes.append(note)
        last = hashlib.sha256(raw).hexdigest()
        chain.append(last)
    else:
        faults += _head(run, chain)
    return tuple(notes), faults, last


def _folders(run: Path) -> list[str]:
    folder = run / files.NOTES
    if folder.is_symlink() or not folder.is_dir():
        return []
    names = [path.name for path in folder.iterdir() if NAME.fullmatch(path.name) and not path.is_symlink()]
    return sorted(names, key=lambda name: (len(name), name))


def _attached(run: Path, place: str, entries: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    for entry in entries:
        name = f"{place}/{entry['name']}"
        there = files.is_regular(run / name)
        if fault := files.fault_of(run, name, entry["sha256"], entry.get("bytes", -1)) if there else "is missing":
            yield name, fault


def _head(run: Path, chain: Sequence[str]) -> list[tuple[str, str]]:
    """Faults of the head file; `chain`: sha256 of the manifest and of each note.

    The last note may be missing in the head, if the writer died.
    """
    if not files.is_regular(run / files.NOTES_HEAD):
        return [] if len(chain) == 1 else [(files.NOTES_HEAD, f"is missing; there are {len(chain) - 1} notes")]
    try:
        head = files.open_json(files.read_file(run, files.NOTES_HEAD, files.LARGEST), run / files.NOTES_HEAD)
        count, last = int(head["notes"]), head["last"]
    except (InvalidFile, KeyError, TypeError, ValueError) as error:
        return [(files.NOTES_HEAD, error.problems[0].message if isinstance(error, InvalidFile) else "is damaged")]
    if count > len(chain) - 1:
        return [(files.NOTES_HEAD, f"counts {count} notes; there are {len(chain) - 1}: notes were removed")]
    if len(chain) - 1 > count + 1 or last != chain[count]:
        return [(files.NOTES_HEAD, "does not fit the notes: notes or the manifest were changed")]
    return []


def _note(content: Mapping[str, Any]) -> Note:
    if content["schema"] != NOTE_SCHEMA:
        raise ValueError(f"the schema is not {NOTE_SCHEMA}")
    exclude = content["exclude"]
    number = int(content["number"])
    return Note(
        number=number,
        utc=str(content["utc"]),
        operator=str(content["operator"]),
        text=str(content["text"]),
        exclude=None if exclude is None else int(exclude),
        because=str(content["because"]),
        files=tuple(f"{files.NOTES}/{number:04d}/{_legal(entry['name'])}" for entry in content["files"]),
    )


def _legal(name: Any) -> str:
    if not isinstance(name, str) or not files.PLAIN_NAME.fullmatch(name):
        raise ValueError("an attached file has a name that leads elsewhere")
    return name
