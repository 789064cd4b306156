"""The commands that pages list, executed in the order written, each page in a folder of its own.

In a fenced block without a language, each line that begins with `pmabench` is a command. The line above the block may be
a comment `<!-- CLAUSE; CLAUSE -->`:

| clause | means |
| --- | --- |
| `by hand: WHY` | not executed: only a person at hardware can do it |
| `after: demo` | the runs of `campaign demo` and their analyses are in the folder |
| `after: kill` | a run on `mock-realtime` was killed, and its bench is tripped |
| `with: WORD = WHAT, ...` | what replaces a placeholder: the newest path that a pattern matches (all of them where WORD has a `*`), or a text in quotes |
| `serve: BENCH` | the devices of that bench, which a reader has in hardware, are emulated from here on |
| `until: PATTERN` | it does not end by itself: it is stopped by Ctrl-C (or, with `end: kill`, by SIGKILL) when it has printed that |
| `keys: KEYS` | pressed one by one at its terminal, after that text |
| `add: OPTIONS` | what the test adds to the commands, so that they take seconds or need no hands |
| `install: FOLDER` | what `pip install` in this block installs: found by its entry points from here on |
| `shell: WHY` | lines that are no command of pmabench are executed by a shell |

`pmabench emulate` serves to the end of the page; lines below it in its block that are no command, and blocks with
`typed: emulate`, are typed into its terminal. A fenced block of code whose first line is `# NAME.yaml` (or another ending) is written as that file.
"""

from __future__ import annotations

import os
import pty
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from click.testing import CliRunner

from pmabench.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
CLAUSES = ("by hand", "after", "with", "serve", "until", "end", "keys", "add", "install", "typed", "shell")
NOT_TYPED = ("pip ", "python ", "make ", "git ", "#")
"""How lines begin that no block executes."""
NOTE = re.compile(rf"<!-- ((?:{'|'.join(CLAUSES)}): .*) -->")
PAIR = re.compile(r",\s+(?=[^,]* = )")
FILE = re.compile(r"```(?:yaml|python|toml|text)\n# ([\w./-]+\.(?:yaml|py|toml|txt))\n(.*?)```", re.DOTALL)
DONE = re.compile(r"(the free end carries|plant: |[\w-]+: )")
"""How the emulator confirms what was typed."""
ENDLESS = ("run", "watch", "monitor")
"""Commands that a note with `until` stops."""
STOPPED = (0, 130)
"""Exit codes of what Ctrl-C ended as it should."""
START = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background leaves it ignored
if sys.stdin.isatty():
    os.open(os.ttyname(0), os.O_RDWR)  # makes it the controlling terminal
from pmabench.cli.main import main
main()
"""
BUSY = ("did not answer within", "has not answered yet", "engine was silent", "no sample for", "stood still", "stale")
"""Ends of a run at which nothing is wrong but that processes were not given the time that they need."""
PATIENCE = 150.0
"""Longest that a text is waited for [s]."""


@dataclass(frozen=True)
class Command:
    """One command of a page."""

    place: str
    """Page and line, as editors understand it."""
    line: str
    note: dict[str, str] = field(default_factory=dict)
    """Clause -> its text."""

    @property
    def by_hand(self) -> str:
        """Why only a person can do it; empty where it is executed."""
        return self.note.get("by hand", "")

    def placeholders(self) -> dict[str, str]:
        """Word -> pattern of the path that it stands for, or a text in quotes."""
        pairs = [pair.partition(" = ") for pair in PAIR.split(self.note.get("with", "")) if pair]
        return {word.strip(): pattern.strip() for word, _, pattern in pairs}


def pages() -> list[Path]:
    """Every page of the project."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page: Path) -> Iterator[Command]:
    """The commands of a page in order, and the lines that are typed into an emulator."""
    lines = page.read_text("utf-8").splitlines()
    fence, begun, number, typed = "", "", 0, False
    note: dict[str, str] = {}
    for at, line in enumerate(map(str.strip, lines), 1):
        if line.startswith("```"):
            found = None if fence else NOTE.fullmatch(lines[at - 2].strip())
            note = dict(clause.split(": ", 1) for clause in found[1].split("; ")) if found else {}
            fence, typed = "" if fence else line, bool({"typed", "shell"} & set(note))
        elif fence == "```" and (begun or line.startswith("pmabench ") or (typed and line)):
            if line.startswith(NOT_TYPED):
                continue
            typed = typed or line.startswith("pmabench emulate ")
            number = number if begun else at
            begun += line.removesuffix("\\")
            if not line.endswith("\\"):
                yield Command(f"{page.relative_to(ROOT)}:{number}", begun, note)
                begun = ""


def in_real_time(command: Command) -> bool:
    """Whether it waits for processes, and takes the addresses of a shipped bench."""
    note = command.note
    return "serve" in note or "until" in note or note.get("after") == "kill" or "pmabench emulate" in command.line


def write_files(page: Path, folder: Path) -> None:
    """The files that a page shows, and the shipped ones under the name that pages use for them."""
    for name, text in FILE.findall(page.read_text("utf-8")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    for shipped in ("fixtures", "docs"):
        (folder / shipped).symlink_to(ROOT / shipped)


def install(project: Path, into: Path) -> str:
    """Lay the entry points of a project next to it, as an installer does; the PYTHONPATH by which both are found."""
    about = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    info = into / f"{about['name'].replace('-', '_')}-{about['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {about['name']}\nVersion: {about['version']}\n")
    groups = about.get("entry-points", {}).items()
    lines = [line for group, points in groups for line in (f"[{group}]", *(f"{n} = {v}" for n, v in points.items()))]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return os.pathsep.join([str(into.resolve()), str(project.resolve())])


def words_of(command: Command) -> list[str]:
    """The words of a command after `pmabench`, its placeholders replaced."""
    placeholders = command.placeholders()
    given: list[str] = []
    for word in shlex.split(command.line, comments=True)[1:]:
        pattern = placeholders.get(word)
        if pattern is not None and pattern.startswith('"'):
            given.append(pattern.strip('"'))
        elif pattern is not None:
            matches = sorted(Path().glob(pattern), key=lambda path: path.stat().st_mtime)
            assert matches, f"{command.place}: nothing matches {pattern}"
            given += map(str, matches) if "*" in word else [str(matches[-1])]
        else:
            given += sorted(map(str, Path().glob(word))) if "*" in word else [word]
    return given


def execute(command: Command, accepted: tuple[int, ...] = (0,)) -> str:
    """Run a command in the current folder, as a shell would; what it printed. Fails where its exit code is another."""
    words = words_of(command)
    out = words[words.index(">") + 1] if ">" in words else ""
    words = words[: words.index(">")] if out else words
    result = CliRunner().invoke(main, [*words, *shlex.split(command.note.get("add", ""))])
    assert result.exit_code in accepted, f"{command.place}: {command.line}\n{result.output}"
    if out:
        Path(out).write_text(result.stdout)
    return result.stdout


class Terminal:
    """`pmabench` as a process: what it prints, and what is typed into it. With `keys` it has a terminal of its own."""

    def __init__(self, words: list[str], *, keys: bool = False, path: str = "") -> None:
        self.words = words
        self._here, outside = pty.openpty() if keys else (end.detach() for end in socket.socketpair())
        self.process = subprocess.Popen(
            [sys.executable, "-c", START, *words],
            stdin=outside,
            stdout=outside,
            stderr=outside,
            start_new_session=True,
            env={**os.environ, "TERM": "xterm"} | ({"PYTHONPATH": path} if path else {}),
        )
        os.close(outside)
        self.printed, self._closed = "", False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with suppress(OSError):
            while data := os.read(self._here, 65536):
                self.printed += data.decode("utf-8", "replace")

    def wait_for(self, text: str) -> None:
        """Until it has printed what a pattern matches; fails where it ends before."""
        end = time.monotonic() + PATIENCE
        while not re.search(text, self.printed, re.DOTALL):
            assert self.process.poll() is None, f"ended, no {text!r}:\n{self.printed}"
            assert time.monotonic() < end, f"late, no {text!r}:\n{self.printed}"
            time.sleep(0.02)

    def type(self, text: str) -> None:
        """Press keys."""
        os.write(self._here, text.encode())

    def stop(self, number: int = signal.SIGINT) -> int:
        """Its exit code after a signal."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.over()

    def over(self) -> int:
        """Its exit code, when it has ended and all that it printed was read."""
        code = self.process.wait(PATIENCE)
        self._reader.join(PATIENCE)
        if not self._closed:
            self._closed = True
            os.close(self._here)
        return code


class Desk:
    """A person's terminals: the current folder, and programs that go on while others are typed."""

    def __init__(self) -> None:
        self._served: list[Terminal] = []
        self._installed: dict[str, str] = {}

    def __enter__(self) -> Desk:
        return self

    def __exit__(self, *_: object) -> None:
        for terminal in self._served:
            terminal.stop(signal.SIGTERM)

    def execute(self, command: Command) -> str:
        """Run a command to its end, or as far as its note says; what it printed."""
        note, word = command.note, command.line.split()[1]
        if not command.line.startswith("pmabench "):
            return _shell(command) if "shell" in note else self._type(command)
        if "install" in note and note["install"] not in self._installed:
            self._installed[note["install"]] = install(Path(note["install"]), Path("installed"))
        if "serve" in note:
            self._serve(["emulate", note["serve"]])
        if word == "emulate":
            return self._serve(words_of(command))
        if "until" in note and word in ENDLESS:
            return _until(command)
        if "until" in note:  # what it adds is for the others
            command = replace(command, note={**note, "add": ""})
        alone = self._installed or word == "vent"  # which keeps the lock of its bench to its end
        return _process(command, self._path()) if alone else execute(command)

    def _path(self) -> str:
        """Where processes find what was installed on this page."""
        return os.pathsep.join(self._installed.values())

    def _serve(self, words: list[str]) -> str:
        """Emulate a bench to the end of the page, if it is not served yet."""
        if not any(terminal.words == words for terminal in self._served):
            self._served.append(Terminal(words, path=self._path()))
            self._served[-1].wait_for("serving until Ctrl-C")
        return self._served[-1].printed

    def _type(self, command: Command) -> str:
        """A line into the emulator, and what it answers, if it happens at once."""
        line = command.line.partition("#")[0].strip()
        before = len(self._served[-1].printed)
        self._served[-1].type(line + "\n")
        time.sleep(0.2)
        answer = self._served[-1].printed[before:]
        assert "after" in line or DONE.match(answer), f"{command.place}: {line}\n{answer}"
        return answer


def _shell(command: Command) -> str:
    """A line that a shell executes."""
    return subprocess.run(command.line, shell=True, check=True, capture_output=True, text=True).stdout


def _process(command: Command, path: str) -> str:
    """A command as a process that finds what was installed on this page."""
    terminal = Terminal([*words_of(command), *shlex.split(command.note.get("add", ""))], path=path)
    code = terminal.over()
    assert code == 0, f"{command.place}: {command.line}: {code}\n{terminal.printed}"
    return terminal.printed


def _until(command: Command) -> str:
    """A program that does not end by itself, stopped as its note says."""
    note = command.note
    terminal = Terminal([*words_of(command), *shlex.split(note.get("add", ""))], keys="keys" in note)
    try:
        terminal.wait_for(note["until"])
        for key in note.get("keys", "").replace("Enter", "\n"):
            terminal.type(key)
            time.sleep(0.3)
        killed = note.get("end") == "kill"
        ends = note.get("keys", "").endswith("v")  # vents, and ends by itself: Ctrl-C would meet it on its way out
        code = terminal.over() if ends else terminal.stop(signal.SIGKILL if killed else signal.SIGINT)
    finally:
        terminal.stop(signal.SIGKILL)
    assert killed or code in STOPPED, f"{command.place}: {command.line}: {code}\n{terminal.printed}"
    return terminal.printed
