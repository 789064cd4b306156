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


class AtLines:
    """A person who answers line by line. `realtime`: bench time passes while they think; else it waits."""

    def __init__(self, *, realtime: bool) -> None:
        self._realtime = realtime
        self._typed = b""

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """No keys; lines are answers."""
        return ()

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Ask until a line is the word `clear`; nothing else counts, nor what was typed before the question."""
        if sys.stderr.isatty():
            rewrite()
        self._typed = b""
        while select.select([sys.stdin.fileno()], [], [], 0.0)[0]:
            _typed_at(sys.stdin.fileno())
        say(text)
        typed = before = ""
        while typed.lower() != "clear":
            pressure = highest_pressure(measured)
            shown = (
                "The pressure is not measured." if pressure is None else f"Measured pressure: {pressure / 1e3:.1f} kPa."
            )
            typed = self.line(f'{before}{shown} Type "clear" when it is done and hands are out: ', wait)
            before = f'"{typed}" does not count. '
        return "clear"

    def line(self, prompt: str, wait: Callable[[], None]) -> str:
        """The next line that is typed; raises Interrupted at the end of the input."""
        sys.stderr.write(prompt)
        sys.stderr.flush()
        descriptor = sys.stdin.fileno()
        while b"\n" not in self._typed:
            if select.select([descriptor], [], [], 0.0 if self._realtime else None)[0]:
                self._typed += _typed_at(descriptor)
            elif self._realtime:
                wait()
        line, _, self._typed = self._typed.partition(b"\n")
        return line.decode("utf-8", "replace").strip()


def _typed_at(descriptor: int) -> bytes:
    """What was typed; Interrupted at the end of the input."""
    read = b""
    with suppress(OSError):
        read = os.read(descriptor, 4096)
    if not read:
        raise Interrupted("end of input at the prompt", 130)
    return read
