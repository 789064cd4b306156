"""A file while it is written: each line says where its value is from; what nobody said is listed for confirmation."""

from __future__ import annotations

from pmabench.bench.lab.answers import Answers

COLUMN = 60
"""Where comments begin, in lines that are shorter."""
SOURCES = {"never_above": "data sheet", "contraction": "data sheet", "sensors": "data sheets", "supply": "as built"}
"""Question -> where its answer is from; all others: asked."""


class Sheet:
    """Lines of a YAML file."""

    def __init__(self, answers: Answers, schema: str, *head: str) -> None:
        self.answers = answers
        self.lines = [f"# yaml-language-server: $schema={schema}", *(f"# {line}" for line in head)]
        self.to_confirm: list[str] = []

    def add(self, *lines: str) -> None:
        """Lines as they are."""
        self.lines += lines

    def said(self, line: str, key: str, *places: str) -> None:
        """A line by the answer to question `key`; where nobody gave it, `places` are to be confirmed."""
        if self.answers.said(key):
            self._noted(line, f"{SOURCES.get(key, 'as said')}, asked {self.answers.asked.isoformat()}")
        else:
            self.guessed(line, "derived, not asked", *places)

    def guessed(self, line: str, why: str, *places: str) -> None:
        """A line with a derived value at `places`, which are to be confirmed."""
        self._noted(line, f"TO CONFIRM: {why}")
        self.to_confirm += places

    def _noted(self, line: str, note: str) -> None:
        self.lines.append(f"{line:{COLUMN - 1}} # {note}" if len(line) < COLUMN else f"{line}   # {note}")

    def text(self) -> str:
        """The file, with the list of what is to be confirmed at its end."""
        lines = [*self.lines, "to_confirm:   # delete an entry when you have looked it up; nothing runs before"]
        lines += [f"  - {place}" for place in self.to_confirm]
        if not self.to_confirm:
            lines[-1] = "to_confirm: []"
        return "\n".join(lines) + "\n"
