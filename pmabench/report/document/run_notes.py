"""What was said of runs afterwards, for the page: words, exclusions and pictures, which go into it as they are."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pmabench.plotting.wording import clean
from pmabench.store.folder import open_regular
from pmabench.store.records import RunData

KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
"""Pictures are known by how their bytes begin, not by their names."""
LARGEST = 5_000_000
"""Bytes of a picture; a larger one is only named."""
MOST = 40_000_000
"""Bytes of all pictures of a page."""


@dataclass(frozen=True)
class Said:
    """One note."""

    run: str
    """Short name of the run."""
    utc: str
    operator: str
    text: str
    pictures: tuple[tuple[str, str], ...]
    """Name and data URI."""
    files: tuple[str, ...]
    """Attached files that are not shown."""


def notes_of(runs: Sequence[RunData], names: Mapping[str, str]) -> list[Said]:
    """Every note of every run; `names` are the short names of runs."""
    left = MOST
    found = []
    for run in runs:
        for note in run.notes:
            words = [note.text] if note.text else []
            if note.exclude is not None:
                words.append(f"Trial {note.excluded} is left out: {note.because}")
            pictures, others = [], []
            for file in note.files:
                data = _picture(Path(run.path) / file, min(LARGEST, left))
                left -= len(data)
                name = clean(file.rpartition("/")[2], 120)
                if data:
                    pictures.append((name, data))
                else:
                    others.append(name)
            text = clean(". ".join(words), 2000)
            who = clean(note.operator, 120)
            when = clean(note.utc, 40)[:16].replace("T", " ")
            found.append(Said(names.get(run.id, "?"), when, who, text, tuple(pictures), tuple(others)))
    return found


def _picture(path: Path, most: int) -> str:
    """The file as a data URI; empty where it is no picture that a page can show, or too large."""
    try:
        with open_regular(path) as file:
            raw = file.read(most + 1)
        if len(raw) > most:
            return ""
    except (OSError, ValueError):
        return ""
    kind = next((kind for begin, kind in KINDS.items() if raw.startswith(begin)), "")
    return f"data:{kind};base64,{base64.b64encode(raw).decode()}" if kind else ""
