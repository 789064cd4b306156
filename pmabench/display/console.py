"""The loop of the display: reads the run four times a second, draws, reads keys, talks to the run if it is linked.

The terminal is always restored at the end. Blocking calls here do not block the run.
"""

from __future__ import annotations

import argparse
import io
import os
import select
import shlex
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any, TextIO

from rich.console import Console as Rich
from rich.text import Text

from pmabench.base import terminal
from pmabench.base.errors import Interrupted, UsageError
from pmabench.base.system import ordinary
from pmabench.base.text import printable, raw
from pmabench.display.child import LEAVE, Link
from pmabench.display.lines import first_line, last_line, plain_line
from pmabench.display.state import RunState
from pmabench.display.verdicts import prepare
from pmabench.display.view import Extra, Question, closing, screen

PERIOD = 0.25
"""Shortest interval between screens [s], unless a key was pressed."""
LONGEST_NOTE = 500
ENTER_SCREEN = b"\x1b[?1049h\x1b[?25l\x1b[2J"
LINKED = "r repeat this trial  p pause or go on  n note  v vent now  Ctrl-C stop and vent"  # fits 80 columns
ALONE = "q quits; the run goes on"
ORPHANED = "the program of this run died; the guard vents then and keeps the bench tripped. Look at the bench, then:"
PRESSED = {
    "r": "repeat this trial",
    "p": "pause at low pressure, or go on",
    "v": "vent now",
    "q": "Ctrl-C stops and vents",
}


class Terminate(BaseException):
    """A signal ends the display; not an Exception, for what catches any of them must not go on."""

    def __init__(self, number: int) -> None:
        self.number = number
        super().__init__(signal.Signals(number).name)


@contextmanager
def tidy_signals(*, child: bool) -> Iterator[None]:
    """Handle signals so that the terminal is restored; a child of a run ignores Ctrl-C, which is for the run."""

    def ended(number: int, _frame: object) -> None:
        raise Terminate(number)

    ignored = ("SIGINT", "SIGTTIN", "SIGTTOU", "SIGTSTP") if child else ("SIGTTIN", "SIGTTOU")
    wanted: dict[str, Any] = dict.fromkeys(("SIGTERM", "SIGHUP", "SIGQUIT"), ended)
    wanted |= dict.fromkeys(ignored, signal.SIG_IGN)
    numbers = {getattr(signal, name): handler for name, handler in wanted.items() if hasattr(signal, name)}
    before = {number: signal.signal(number, handler) for number, handler in numbers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Painter:
    """Draws lines on a terminal's alternate screen; only changed ones are written."""

    def __init__(self, stream: TextIO, *, color: bool) -> None:
        self._fd = stream.fileno()
        self._ascii = "utf" not in (stream.encoding or "").lower()
        self._color = color
        self._drawn: list[str] = []
        self._size = (0, 0)

    def size(self) -> tuple[int, int]:
        """Present columns and rows of the terminal."""
        try:
            width, height = os.get_terminal_size(self._fd)
        except OSError:
            width, height = shutil.get_terminal_size()
        return width or 80, height or 24

    @contextmanager
    def open(self) -> Iterator[None]:
        """Switch to the terminal's alternate screen, and back at the end."""
        self._write(ENTER_SCREEN)
        try:
            yield
        finally:
            with suppress(OSError):
                self._write(LEAVE)

    def draw(self, lines: Sequence[Text], size: tuple[int, int]) -> None:
        """Show these lines; only changed ones are written."""
        drawn = rendered(lines, size[0], color=self._color, ascii_only=self._ascii)
        before = self._drawn if size == self._size else []
        out = "" if before else "\x1b[0m\x1b[2J"
        for row, line in enumerate(drawn):
            if row >= len(before) or before[row] != line:
                out += f"\x1b[{row + 1};1H\x1b[2K{line}"
        self._drawn, self._size = drawn, size
        self._write(out.encode("ascii" if self._ascii else "utf-8", "replace"))

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            try:
                rest = rest[os.write(self._fd, rest) :]
            except BlockingIOError:
                select.select([], [self._fd], [], 1.0)


_ASCII = dict(zip("━─●╎┃…±·▏\N{REPLACEMENT CHARACTER}", "=-O:|~~|_?", strict=True))


def rendered(lines: Sequence[Text], width: int, *, color: bool, ascii_only: bool = False) -> list[str]:
    """Lines with codes for the sixteen colours; without `color` only bold, dim and reverse."""
    plain: dict[str, Any] = dict.fromkeys(("legacy_windows", "highlight", "markup", "emoji"), False)
    terminal_like: dict[str, Any] = {"force_terminal": True, "color_system": "standard", "no_color": not color}
    rich = Rich(file=io.StringIO(), width=width, **terminal_like, **plain)
    texts = []
    for line in lines:
        with rich.capture() as captured:
            rich.print(line, end="", no_wrap=True, overflow="crop", crop=True)
        texts.append(captured.get())
    if ascii_only:
        texts = [
            "".join(_ASCII.get(c) or (_dots(c) if "\u2800" <= c <= "\u28ff" else c) for c in line) for line in texts
        ]
    return texts


def _dots(character: str) -> str:
    """A braille character as an ASCII character that resembles its dots."""
    code = ord(character) - 0x2800
    return " '.:"[bool(code & 0x1B) + 2 * bool(code & 0xE4)]


@dataclass(eq=False)
class Console:
    """Shows one run until it ends, until `q` if it is not linked, or until the link ends."""

    folder: Path
    stream: TextIO
    link: Link | None = None
    color: bool = True
    plain: bool = False

    def __post_init__(self) -> None:
        self.state = RunState(self.folder)
        self._keys: terminal.Keyboard | None = None
        self._reading = threading.Lock()
        self._evaluating = threading.Event()
        """Set while what is new in the run is read and evaluated."""
        self._parent = os.getppid()
        self._asked: dict[str, Any] | None = None
        self._typed = self._refused = ""
        self._note: str | None = None
        self._over = False
        self._orphaned = False
        """The run has ended without a message."""
        self._quiet = False

    def run(self, *, quiet: bool = False) -> RunState:
        """Show the run; returns its last known state. `quiet`: print nothing, only follow."""
        self._quiet = quiet
        if self.plain or quiet:
            self._run_plain()
            return self.state
        painter = Painter(self.stream, color=self.color)
        with ExitStack() as stack:
            stack.enter_context(painter.open())
            with suppress(UsageError):  # without keys the screen is still useful
                self._keys = stack.enter_context(terminal.key_by_key(0))
            with suppress(EOFError):
                self._run_drawn(painter)
        self._close(painter.size()[0])
        return self.state

    def _run_drawn(self, painter: Painter) -> None:
        prepared = ""
        threading.Thread(target=self._read_keys_meanwhile, name="keys", daemon=True).start()
        while not self._over:
            started = time.monotonic()
            self._evaluating.set()
            behind = self.state.poll()
            self._evaluating.clear()
            if self.state.kind != prepared:
                prepared = self.state.kind
                threading.Thread(target=prepare, args=(prepared,)).start()
            self._listen()
            size = painter.size()
            painter.draw(screen(self.state, *size, self._extra()), size)
            self._look_for_end(behind)
            due = started + (0.0 if behind else PERIOD)
            while not self._over and not self._pressed(max(0.0, due - time.monotonic())):
                if time.monotonic() >= due:
                    break

    def _run_plain(self) -> None:
        begun: RunState | None = None
        while not self._over:
            behind = self.state.poll()
            self._listen()
            if self.state.files.there and begun is not self.state:
                begun = self.state
                self._print(first_line(self.state))
            fresh, self.state.fresh = self.state.fresh, []
            for item in fresh:
                self._print(plain_line(item, self.state.trials))
            self._look_for_end(behind)
            if not behind and not self._over:
                self._wait(PERIOD)
        if self.link is None:
            self._print(last_line(self.state))

    def _print(self, line: str) -> None:
        if not self._quiet:
            encoding = self.stream.encoding or "utf-8"
            print(line.encode(encoding, "replace").decode(encoding), file=self.stream, flush=True)

    def _close(self, width: int) -> None:
        """Print the last trials, which remain on the terminal, and how it ended, unless the run prints that."""
        lines = closing(self.state, width)
        if self.link is None:
            lines = [*lines, Text(last_line(self.state))]
        ascii_only = "utf" not in (self.stream.encoding or "").lower()
        for line in rendered(lines, width, color=self.color, ascii_only=ascii_only):
            self._print(line)
        if self._orphaned:
            for line in wrap(ORPHANED, width):
                self._print(line)
            self._print(f"  pmabench continue {shlex.quote(printable(str(self.state.files.folder)))}")  # whole

    def _look_for_end(self, behind: bool) -> None:
        if self.link is None:
            self._over |= self.state.ended
        elif self.link.closed or os.getppid() != self._parent:
            self._over = self._orphaned = not behind

    # -- the run ------------------------------------------------------------------------------------------------------

    def _listen(self) -> bool:
        """Handle messages of the run; True if a question was asked or withdrawn, or the run ended."""
        urgent = False
        for message in self.link.receive() if self.link is not None else ():
            urgent |= "ask" in message or "end" in message
            if "ask" in message:
                asked = message["ask"]
                self._asked = asked if isinstance(asked, dict) else None
                self._typed = self._refused = ""
                self._note = None
                if self._asked is not None and self.plain:
                    self.state.log(
                        f"asked: {self._asked.get('text')} (no terminal here: it cannot be answered)", "doubt"
                    )
            if isinstance(message.get("live"), dict):
                self.state.live(message["live"])
            if "end" in message:
                self.state.poll()
                self._over = True
        return urgent

    def _words(self) -> tuple[str, ...]:
        return tuple(str(word) for word in (self._asked or {}).get("words") or ("clear",))

    def _extra(self) -> Extra:
        footer = (LINKED if self.link is not None else ALONE) if self._keys is not None else ""
        if self._asked is None:
            return Extra(footer=footer, typing=self._note)
        question = Question(str(self._asked.get("text", "")), self._words(), self._typed, self._refused)
        return Extra(question, "Ctrl-C stops and vents" if self._keys is not None else "")

    # -- keys ---------------------------------------------------------------------------------------------------------

    def _wait(self, seconds: float) -> None:
        if self.link is not None and not self.link.closed:
            select.select([self.link.fileno()], [], [], seconds)
        else:
            time.sleep(seconds)

    def _pressed(self, seconds: float) -> bool:
        """Wait for keys and messages; True if the screen must be redrawn at once."""
        keys = self._keys
        if keys is None or not terminal.in_front(keys.fd):
            self._wait(seconds)
            return self._listen()
        sources = [keys.fd] + ([self.link.fileno()] if self.link is not None and not self.link.closed else [])
        ready = select.select(sources, [], [], seconds)[0]
        pressed = keys.fd in ready and self._read_keys(keys)
        return self._listen() or pressed

    def _read_keys(self, keys: terminal.Keyboard) -> bool:
        """Handle the keys that wait; whether there were some."""
        with self._reading:
            pressed = keys.read()
            for key in pressed:
                self._key(key)
        return bool(pressed)

    def _read_keys_meanwhile(self) -> None:
        """Handle keys while a trial is evaluated, which can take seconds: `v` (vent now) does not wait for it."""
        while not self._over:
            if self._evaluating.wait(PERIOD) and self._keys is not None:
                with suppress(EOFError):  # the other thread sees it, too, and ends
                    self._read_keys(self._keys)
                time.sleep(0.02)

    def _key(self, key: str) -> None:
        if self._asked is not None:
            self._answer(key)
        elif self._note is not None:
            self._type_note(key)
        elif self.link is None:
            self._over |= key.lower() == "q"
        elif key.lower() == "n":
            self._note = ""
        elif key.lower() in PRESSED:
            self._send({"key": key.lower()}, f"{key.lower()} pressed: {PRESSED[key.lower()]}")

    def _send(self, message: dict[str, Any], text: str, *, comes_back: bool = False) -> None:
        """Send a message and add it to the log, unless the run's own record of it will be shown."""
        taken = self.link is not None and self.link.send(message)
        if not taken:
            self.state.log(f"{text}; the run did not take it", "fault")
        elif not comes_back:
            self.state.log(text)

    def _answer(self, key: str) -> None:
        """Handle one key of an answer; only the requested words are accepted."""
        if key == terminal.ENTER:
            text = self._typed.strip().lower()
            self._typed, self._refused = "", text
            match = next((word for word in self._words() if word.lower() == text), None)
            if match is not None and self._asked is not None:
                asked, self._asked, self._refused = self._asked, None, ""
                self._send({"answer": {"id": asked.get("id"), "text": match}}, f'answered "{match}"')
            return
        self._typed = _edited(self._typed, key, 40)

    def _type_note(self, key: str) -> None:
        if key == terminal.ESCAPE:
            self._note = None
        elif key == terminal.ENTER:
            text, self._note = (self._note or "").strip(), None
            if text:
                self._send({"note": text}, f"note: {text}", comes_back=True)
        else:
            self._note = _edited(self._note or "", key, LONGEST_NOTE)


def _edited(text: str, key: str, longest: int) -> str:
    """The text after one more key: backspace, Ctrl-U (delete all), or a printable character."""
    if key == terminal.BACKSPACE:
        return text[:-1]
    if key == "\x15":
        return ""
    return (text + key)[:longest] if key.isprintable() else text


def watch(folder: Path, *, plain: bool, color: bool, quiet: bool = False) -> RunState:
    """Watch a run until it ends; on a screen if standard output is a terminal, else as plain lines.

    Raises Interrupted at a signal that ends it.
    """
    plain = plain or not sys.stdout.isatty() or os.environ.get("TERM") == "dumb"
    try:
        with tidy_signals(child=False):
            return Console(folder, raw(sys.stdout), color=color, plain=plain).run(quiet=quiet)
    except Terminate as end:
        raise Interrupted(str(end), 128 + end.number) from None


def main() -> int:
    """The display of `pmabench run`, as its child process: show the run until the link ends."""
    parser = argparse.ArgumentParser(prog="python -m pmabench.display.console")
    parser.add_argument("run", type=Path, help="the run folder")
    parser.add_argument("--link", type=int, required=True, metavar="FD", help="an inherited socket")
    parser.add_argument("--no-color", action="store_true")
    given = parser.parse_args()
    ordinary()
    with suppress(OSError):
        os.nice(5)  # the bench goes first
    link = Link(socket.socket(fileno=given.link))
    color = not given.no_color and "NO_COLOR" not in os.environ
    plain = not sys.stderr.isatty() or os.environ.get("TERM") == "dumb"
    console = Console(given.run, sys.stderr, link=link, color=color, plain=plain)
    with suppress(Terminate, BrokenPipeError), tidy_signals(child=True):
        console.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
