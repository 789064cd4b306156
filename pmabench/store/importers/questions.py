"""Questions that a map leaves open (`??`): where they are, what the map says of them, how they are answered.

A value that begins with `??` is a question; what follows the marks is what may be taken until somebody answers. The
comment above it that begins with `??` is the question in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, did_you_mean, invalid
from pmabench.files.document import Document, Location

OPEN = "??"
"""What a proposed map begins a value with that no file gives."""


@dataclass(frozen=True)
class Question:
    """One question that an import left open."""

    what: str
    """The key in the map: `columns.F.unit`."""
    where: str
    """`path:line:column`."""
    question: str
    used: str
    """What may be taken until it is answered; empty where nothing may."""


def settle(
    document: Document, answers: Sequence[tuple[str, str]] = (), *, unresolved: bool = False
) -> tuple[Question, ...]:
    """Put the answers (key, value) into a map's data, and say which questions are left with what is taken for them.

    Raises InvalidFile with every question that is not answered; with `unresolved` only with those for which the map
    proposes nothing.
    """
    asked = {question.what: (location, question) for location, question in _asked(document)}
    for key, text in answers:
        if key not in asked:
            known = f"; open are {', '.join(asked)}" if asked else "; nothing is open in it"
            raise invalid(f"--set {key}", f"{document.path} does not ask that{did_you_mean(key, asked) or known}")
        document.put(asked.pop(key)[0], text, f"--set {key}")
    left, problems = list[Question](), list[Problem]()
    for key, (location, question) in asked.items():
        if unresolved and question.used:
            left.append(question)
            document.put(location, _quoted(question.used), document.path)
            continue
        more = f"; --unresolved takes {question.used} until then" if question.used and not unresolved else ""
        sentence = f"not answered: {question.question}; write the answer here, or give --set '{key}=...'{more}"
        problems.append(document.problem(location, sentence))
    if problems:
        raise InvalidFile(problems)
    return tuple(left)


def questions_of(document: Document) -> list[Question]:
    """Every question of a map, in the order of its lines."""
    return [question for _, question in _asked(document)]


def _asked(document: Document) -> Iterator[tuple[Location, Question]]:
    for location in left_open(document.data, ()):
        used = str(_at(document.data, location))[len(OPEN) :].strip()
        yield location, Question(dotted(location), document.where(location), _question(document, location), used)


def left_open(value: Any, location: Location) -> Iterator[Location]:
    """Places of texts that begin with `??`."""
    if isinstance(value, str) and value.startswith(OPEN):
        yield location
    elif isinstance(value, Mapping | list):
        for key, inside in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from left_open(inside, (*location, key))


def dotted(location: Location) -> str:
    """A place as people type it: `columns.F.unit`."""
    return ".".join(str(part) for part in location)


def _question(document: Document, location: Location) -> str:
    """The comments with `??` right above a place."""
    path, line, _ = document.place(location)
    lines = document.texts.get(path, "").split("\n")[: line - 1]
    found: list[str] = []
    while lines and (text := lines.pop().strip()).startswith("#"):
        if text.removeprefix("#").strip().startswith(OPEN):
            found.insert(0, text.removeprefix("#").strip()[len(OPEN) :].strip())
    return " ".join(found) or "no file gives it"


def _at(data: Any, location: Location) -> Any:
    for part in location:
        data = data[part]
    return data


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
