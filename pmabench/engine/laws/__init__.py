"""Laws of seeks by name, and what a law of several quantities wants at one sample.

A class is a small state machine that is fed one sample at a time: `pmabench.engine.seek.SampledLaw` for one output,
`LawOfSeveral` for several quantities and valves, whose `Orders` the guard checks before anything moves. A function
ramps and waits by the `pmabench.engine.seek.Moves` that it is handed. What they need comes as keywords from the plan's
step. Laws ship with pmabench, or come by entry points of the group `pmabench.laws`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Protocol

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.system import registered

GROUP = "pmabench.laws"
LAWS = {
    "gain-steps": "gain_steps:GainSteps",
    "relay": "relay:Relay",
    "pid": "position_loop:PositionLoop",
    "ramp-until": "scripted:ramp_until",
    "closed-strokes": "scripted:closed_strokes",
    "platform": "platform_loop:PlatformLoop",
    "joint": "joint_loop:JointLoop",
}
"""Name of a law in a plan -> its module here, and its class or function."""


def law_of(name: str) -> Any:
    """The class or function of a law; UsageError where no installed package has one of this name."""
    if name in LAWS:
        module, _, attribute = LAWS[name].partition(":")
        return getattr(import_module(f"{__name__}.{module}"), attribute)
    brought = {point.name: point for point in registered(GROUP)}
    if name not in brought:
        known = (*LAWS, *brought)
        raise UsageError(f'no installed package has a law "{name}"{did_you_mean(name, known)}')
    return brought[name].load()


def refuse_wrong(*rules: tuple[bool, str]) -> None:
    """Raise ValueError with the text of every rule that is not kept."""
    wrong = [text for good, text in rules if not good]
    if wrong:
        raise ValueError("; ".join(wrong))


def outside_range(bias: float, low: float, high: float) -> str:
    """The sentence for a bias [SI of the output] that is no command."""
    return f"bias {bias:g} is outside the range of the command, {low:g} to {high:g}"


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


class Timed:
    """What a law that lasts a time keeps: its first and newest sample, how often a limit was in its way, its end."""

    done = False
    _ended = "limit"
    _first: float | None = None
    _t = 0.0
    _samples = _clipped = 0

    def _end(self, why: str) -> None:
        self.done, self._ended = True, why

    def _how_it_went(self, lost: str) -> dict[str, Any]:
        """Times t0, t1 [s], share of samples with a limit in the way, why it ended; `lost` says which signal was.

        `ended` is `time` (as planned), `no signal`, or `limit` where the caller stopped it.
        """
        saturated = self._clipped / self._samples if self._samples else 0.0
        data = {"t0": self._first, "t1": self._t, "saturated": saturated, "ended": self._ended}
        return data | ({"found": False, "reason": lost} if self._ended == "no signal" else {})


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
