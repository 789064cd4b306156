"""Operators at a terminal: they answer prompts, press keys, type notes; the bench is watched while they think."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from pmabench.base.errors import Interrupted
from pmabench.base.quantities import highest_pressure
from pmabench.cli.common import rewrite, say
from pmabench.engine.operator import ConfirmedBeforehand, Nobody

if TYPE_CHECKING:
    from pmabench.display.child import Display


class _Keys:
    """What comes from the display."""

    def __init__(self, display: Display) -> None:
        self._display = display
        self._answer: tuple[int, str] | None = None
        self._keys: list[tuple[str, str]] = []

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """Keys and notes since the last call."""
        self._display.live(measured)
        self._take()
        keys, self._keys = self._keys, []
        return keys

    def _take(self) -> None:
        for message in self._display.poll():
            if "answer" in message:
                self._answer = (message["answer"]["id"], message["answer"]["text"])
            self._keys += [(what, message[what]) for what in ("key", "note") if what in message]


class Confirmed(_Keys):
    """`--yes`: every prompt counts as answered, and the record says so; keys and notes still count."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Answered without a person."""
        return ConfirmedBeforehand().ask(text, measured, wait)


class AtDisplay(_Keys):
    """A person in front of the display, or of what is left of it."""

    def __init__(self, display: Display, *, answers: bool) -> None:
        super().__init__(display)
        self._answers = answers
        """Whether there is a terminal to type at."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Show the prompt until it is answered; the bench is watched meanwhile. A lost terminal ends the run."""
        if not self._answers:
            return Nobody().ask(text, measured, wait)
        number = self._display.ask(text)
        try:
            while self._answer is None or self._answer[0] != number:
                if not self._display.alive:
                    raise Interrupted("loss of the display while a prompt was open", 129)
                wait()
                self._display.live(measured)
                self._take()
        finally:
            self._display.withdraw()
        return self._answer[1]


class InLines:
    """A person at a terminal without a picture (`--quiet`, `--json`): lines come and go, the bench is watched."""

    def __init__(self, write: Callable[[str], None], fd: int = 0) -> None:
        self._write, self._fd = write, fd

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Ask until a line is the word `clear`; nothing else counts, nor what was typed before the question."""
        self._lines()
        self._write(f'{text}\n{_pressure(measured)} Type "clear" and Enter when it is done and hands are out.')
        while True:
            wait()
            for line in self._lines():
                if line.strip().lower() == "clear":
                    return "clear"
                self._write(f'"{line.strip()}" does not count. {_pressure(measured)} Type "clear" and Enter.')

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """Nothing: there are no keys without a picture."""
        return ()

    def _lines(self) -> list[str]:
        """Whole lines that were typed, as a terminal hands them over; never waits."""
        if not select.select([self._fd], [], [], 0)[0]:
            return []
        typed = b""
        with suppress(OSError):
            typed = os.read(self._fd, 4096)
        if not typed:
            raise Interrupted("end of input at the prompt", 130)
        return typed.decode("utf-8", "replace").splitlines()


def _pressure(measured: Mapping[str, float]) -> str:
    pressure = highest_pressure(measured)
    return "The pressure is not measured." if pressure is None else f"Measured pressure: {pressure / 1e3:.1f} kPa."


class AtLines:
    """A person at standard input. `realtime`: bench time passes while they think; else it waits."""

    def __init__(self, *, realtime: bool) -> None:
        self._realtime = realtime
        self._typed = b""

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """No keys; lines are answers."""
        return ()

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Ask until the word is `clear`."""
        if sys.stderr.isatty():
            rewrite()
        say(text)
        while True:
            pressure = highest_pressure(measured)
            shown = "not measured" if pressure is None else f"{pressure / 1e3:.1f} kPa"
            prompt = f'Measured pressure: {shown}. Type "clear" when it is done and hands are out: '
            if self.line(prompt, wait).lower() == "clear":
                return "clear"

    def line(self, prompt: str, wait: Callable[[], None]) -> str:
        """The next line that is typed; raises Interrupted at the end of the input."""
        sys.stderr.write(prompt)
        sys.stderr.flush()
        descriptor = sys.stdin.fileno()
        while b"\n" not in self._typed:
            if select.select([descriptor], [], [], 0.0 if self._realtime else None)[0]:
                read = os.read(descriptor, 4096)
                if not read:
                    raise Interrupted("end of input at the prompt", 130)
                self._typed += read
            elif self._realtime:
                wait()
        line, _, self._typed = self._typed.partition(b"\n")
        return line.decode("utf-8", "replace").strip()
