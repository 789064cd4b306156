"""What a lab still has to fill in: `??` in a bench, a specimen or a calibration file is a question, never a value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, Problem
from pmabench.bench.channels import NAME
from pmabench.files.document import Document, Location, read_document

OPEN = "??"
"""As a value: nobody has said it yet. The guesses of `import --guess` have the same mark."""


def unfilled(bench: Path, documents: Sequence[Document]) -> list[Problem]:
    """A problem for each `??` in these files and in the calibrations next to the bench file."""
    found = [problem for document in documents for problem in _open_places(document)]
    channels = documents[0].data.get("channels")
    for channel in channels.values() if isinstance(channels, dict) else ():
        name = channel.get("calibration") if isinstance(channel, dict) else None
        if not isinstance(name, str) or not NAME.fullmatch(name):
            continue  # reported with all that is wrong with the bench
        path = bench.parent / "calibrations" / f"{name}.yaml"
        if path.is_file():
            try:
                found += _open_places(read_document(path))
            except InvalidFile:
                continue  # reported with all that is wrong with the bench
    return list(dict.fromkeys(found))


def _open_places(document: Document) -> Iterator[Problem]:
    for location in _open(document.data, ()):
        name = next((str(part) for part in reversed(location) if isinstance(part, str)), "a value")
        yield document.problem(
            location, f'"{name}" is not filled in yet ({OPEN}): write here what is true at your bench'
        )


def _open(data: Any, at: Location) -> Iterator[Location]:
    if data == OPEN:
        yield at
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _open(value, (*at, key))
