"""Who answers the prompts: a person at a terminal, or nobody with everything confirmed beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from pmabench.base.errors import Interrupted, PmaError
from pmabench.base.quantities import highest_pressure


class NoOperator(PmaError):
    """The plan needs hands, and there is neither a terminal nor `--yes`."""

    exit_code = 2


class Operator(Protocol):
    """Answers a prompt; returns what was answered, for the record."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Show the text and the live values; return when it is done. `wait` lets a block of bench time pass."""
        ...

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """What the operator did since the last call: `("note", text)`, `("key", "p")` ...; never waits.

        `measured` are the newest values [SI], for whoever shows them while nothing is recorded. Without keys: nothing.
        """
        return ()


class ConfirmedBeforehand(Operator):
    """`--yes`: every prompt counts as answered, and the record says so."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Answered without a person."""
        return "confirmed beforehand (--yes)"


class AtTerminal(Operator):
    """A person at a bench in virtual time, which waits: sees the pressure, types `clear` when hands are out."""

    def __init__(self, read: Callable[[str], str], write: Callable[[str], None]) -> None:
        self._read = read
        self._write = write

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Ask until the word is `clear`; nothing else counts."""
        pressure = highest_pressure(measured)
        shown = "not measured" if pressure is None else f"{pressure / 1e3:.1f} kPa"
        self._write(f"{text}\nMeasured pressure: {shown}.")
        while True:
            try:
                answer = self._read('Type "clear" when it is done and hands are out: ').strip().lower()
            except EOFError:
                raise Interrupted("end of input at the prompt", 130) from None
            if answer == "clear":
                return "clear"


class Nobody(Operator):
    """No operator: neither a terminal nor `--yes`."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Refused."""
        raise NoOperator(f"hands are needed ({text}) and there is no terminal; with --yes prompts count as answered")
