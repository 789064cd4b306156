"""Values of bench and specimen files that a program derived and nobody has confirmed: their key `to_confirm`.

Comments are no data: what must not be overlooked is a list in the file. A person confirms a value by deleting its
entry; a bench file whose list is empty also needs a name under `reviewed`, because the safety values were among them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pmabench.base.errors import Problem, did_you_mean
from pmabench.bench.compilation import Compilation
from pmabench.files.document import Document, Location


def known_places(c: Compilation) -> None:
    """A problem for each entry of `to_confirm` that names no key of its file."""
    for document in (c.bench_document, c.specimen_document):
        for index, name in enumerate(_entries(document)):
            data: Any = document.data if document is not None else {}
            for part in name.split("."):
                known = list(data) if isinstance(data, dict) else [str(place) for place in range(_length(data))]
                if part not in known:
                    message = f'there is no "{part}" in this file{did_you_mean(part, known)}'
                    c.problems.append(_problem(document, ("to_confirm", index), message))
                    break
                data = data[part] if isinstance(data, dict) else data[int(part)]


def unconfirmed(c: Compilation) -> Iterator[Problem]:
    """A problem at each value that is listed in `to_confirm`, and one where nobody reviewed what was confirmed."""
    for document in (c.bench_document, c.specimen_document):
        for name in _entries(document):
            location = tuple(int(part) if part.isdecimal() else part for part in name.split("."))
            text = f'nobody has confirmed "{name}": look it up, correct it, and delete it from to_confirm'
            yield _problem(document, location, text)
    if c.bench.to_confirm is not None and c.bench.reviewed is None:
        text = "limits and safe state were derived by a program; who read them over: reviewed: {by: NAME, date: DAY}"
        yield c.bench_document.problem(("to_confirm",), text, key=True)


def _entries(document: Document | None) -> list[str]:
    found = document.data.get("to_confirm") if document is not None else None
    return [str(name) for name in found] if isinstance(found, list) else []


def _problem(document: Document | None, location: Location, message: str) -> Problem:
    assert document is not None  # noqa: S101  (it has the entries)
    return document.problem(location, message)


def _length(data: Any) -> int:
    return len(data) if isinstance(data, list) else 0
