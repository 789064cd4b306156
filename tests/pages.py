"""The commands that a page lists, executed in the order written in a folder of their own.

A fenced block without a language whose lines begin with `pmabench` is executed, unless the line above it is the comment
`<!-- by hand: why -->`. `<!-- with: WORD = PATTERN, ... -->` there says what a placeholder is: the newest path that the
pattern matches, or a text in quotes. `<!-- after demo: WORD = PATTERN, ... -->` is the same where the runs of `campaign
demo` and their analyses are there. A fenced `yaml` block that begins with `# name.yaml` is written as that file first.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner

from pmabench.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
NOTE = re.compile(r"<!-- (by hand|with|after demo): (.*) -->")
FILE = re.compile(r"```yaml\n# (\S+\.yaml)\n(.*?)```", re.DOTALL)


@dataclass(frozen=True)
class Command:
    """One command of a page."""

    place: str
    """Page and line, as editors understand it."""
    line: str
    by_hand: str
    """Why nobody but a person can do it; empty where it is executed."""
    stands_for: dict[str, str]
    """Placeholder -> pattern of the path that it stands for, or a text in quotes."""
    after_demo: bool = False
    """Whether it works on the runs of `campaign demo`."""


def pages() -> list[Path]:
    """Every page of the project."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page: Path) -> Iterator[Command]:
    """The commands of a page in order."""
    lines = page.read_text("utf-8").splitlines()
    fence, begun, number = "", "", 0
    note: re.Match[str] | None = None
    for at, line in enumerate(map(str.strip, lines), 1):
        if line.startswith("```"):
            note = None if fence else NOTE.fullmatch(lines[at - 2].strip())
            fence = "" if fence else line
        elif fence == "```" and (begun or line.startswith("pmabench ")):
            number = number if begun else at
            begun += line.removesuffix("\\")
            if line.endswith("\\"):
                continue
            kind, told = (note[1], note[2]) if note else ("", "")
            pairs = [pair.partition(" = ") for pair in told.split(",")] if kind in ("with", "after demo") else []
            stands_for = {word.strip(): pattern.strip() for word, _, pattern in pairs}
            place = f"{page.relative_to(ROOT)}:{number}"
            yield Command(place, begun, told if kind == "by hand" else "", stands_for, kind == "after demo")
            begun = ""


def write_files(page: Path, folder: Path) -> None:
    """The files that a page shows, and the shipped tables under the name that pages use for them."""
    for name, text in FILE.findall(page.read_text("utf-8")):
        (folder / name).write_text(text)
    (folder / "fixtures").symlink_to(ROOT / "fixtures")


def execute(command: Command) -> str:
    """Run a command in the current folder, as a shell would; what it printed. Fails where its exit code is not 0."""
    words = shlex.split(command.line, comments=True)
    out = words[words.index(">") + 1] if ">" in words else ""
    words = words[1 : words.index(">")] if out else words[1:]
    given: list[str] = []
    for word in words:
        pattern = command.stands_for.get(word)
        if pattern is not None and pattern.startswith('"'):
            given.append(pattern.strip('"'))
        elif pattern is not None:
            matches = sorted(Path().glob(pattern), key=lambda path: path.stat().st_mtime)
            assert matches, f"{command.place}: nothing matches {pattern}"
            given.append(str(matches[-1]))
        else:
            given += sorted(map(str, Path().glob(word))) if "*" in word else [word]
    told = CliRunner().invoke(main, given)
    assert told.exit_code == 0, f"{command.place}: {command.line}\n{told.output}"
    if out:
        Path(out).write_text(told.stdout)
    return told.stdout
