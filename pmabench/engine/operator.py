"""Who answers the prompts: a person at a terminal, nobody, or `--yes`, which confirms all of them beforehand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from pmabench.base.errors import PmaError


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


class Nobody(Operator):
    """No operator: neither a terminal nor `--yes`."""

    def ask(self, text: str, measured: Mapping[str, float], wait: Callable[[], None]) -> str:
        """Raise NoOperator."""
        raise NoOperator(f"hands are needed ({text}) and there is no terminal; with --yes prompts count as answered")
