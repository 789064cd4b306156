"""Who answers the prompts: a person at a terminal, nobody, or `--yes`, which confirms all of them beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from pmabench.base.errors import Interrupted, PmaError
from pmabench.base.quantities import highest_pressure


class NoOperator(PmaError):
    """The plan needs hands, and there is neither a terminal nor `--yes`."""

    exit_code = 2


class Operator(Protocol):
    """Answers prompts, and reports what the operator typed."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Show the text and live values [SI]; return the answer for the record when all is done.

        `wait` lets a block of bench time pass.
        """
        ...

    def poll(self, measured: Mapping[str, float]) -> Sequence[tuple[str, str]]:
        """What the operator did since the last call: `("note", text)`, `("key", "p")` ...; never waits.

        `measured` are the newest values [SI], for whoever shows them while nothing is recorded. Without keys: nothing.
        """
        return ()


class ConfirmedBeforehand(Operator):
    """`--yes`: every prompt counts as answered, and the record says so."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """The fixed answer for the record; nobody is asked."""
        return "confirmed beforehand (--yes)"


class AtTerminal(Operator):
    """A person at a bench in virtual time, which waits meanwhile; sees the pressure and types `clear`."""

    def __init__(self, read: Callable[[str], str], write: Callable[[str], None]) -> None:
        self._read = read
        self._write = write

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Ask until the answer is `clear`; raises Interrupted at the end of input."""
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
        """Raise NoOperator."""
        raise NoOperator(f"hands are needed ({text}) and there is no terminal; with --yes prompts count as answered")
