"""What a law of several quantities wants at one sample: plain data, checked by the guard before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol


@dataclass(frozen=True)
class Pulse:
    """Open a valve now, for a time that its device keeps: no multiple of the sample period."""

    valve: str
    seconds: float


@dataclass(frozen=True)
class Orders:
    """What is wanted at one sample; all may be empty."""

    aims: Mapping[str, float] = field(default_factory=dict)
    """Where muscles are to be brought, and what else has a limit, by name [SI]."""
    pulses: tuple[Pulse, ...] = ()
    sets: Mapping[str, float] = field(default_factory=dict)
    """Set-points of outputs whose regulators bring the muscles there, by name [SI]."""


class LawOfSeveral(Protocol):
    """A law that is called at every sample and steers several quantities, by pulses of valves or by set-points.

    With a `called_every` [s] above 0 it is called so often only, with the newest sample.
    """

    done: bool

    def update(self, t: float, values: Mapping[str, float]) -> Orders:
        """The commands for the measured values [SI] at bench time `t` [s]."""
        ...

    def result(self) -> dict[str, Any]:
        """What was found, as plain data."""
        ...
