"""Control and search laws by name, and the commands of a law of several quantities at one sample.

A class is a small state machine that is fed one sample at a time: `pmabench.engine.seek.SampledLaw` for one output,
`LawOfSeveral` for several quantities and valves, whose `Orders` the guard checks before anything moves. A function
ramps and waits through the `pmabench.engine.seek.Moves` that it receives. Their parameters come as keywords from the
plan's step. Laws ship with pmabench, or come from entry points of the group `pmabench.laws`.
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
    """Raise ValueError with the texts of all broken rules (holds, text)."""
    wrong = [text for good, text in rules if not good]
    if wrong:
        raise ValueError("; ".join(wrong))


def outside_range(bias: float, low: float, high: float) -> str:
    """Message for a bias [SI of the output] outside the range of the command."""
    return f"bias {bias:g} is outside the range of the command, {low:g} to {high:g}"


@dataclass(frozen=True)
class Pulse:
    """Open a valve now for `seconds` [s], timed by its device: it need not be a multiple of the sample period."""

    valve: str
    seconds: float


@dataclass(frozen=True)
class Orders:
    """Commands of a law at one sample; each part may be empty."""

    aims: Mapping[str, float] = field(default_factory=dict)
    """Target pressures of muscles, and other quantities with a limit in the step, by name [SI]."""
    pulses: tuple[Pulse, ...] = ()
    sets: Mapping[str, float] = field(default_factory=dict)
    """Set-points of outputs with their own regulators, by name [SI]."""


class Timed:
    """State of a law of limited duration: first and newest sample, count of clipped samples, and how it ended."""

    done = False
    _ended = "limit"
    _first: float | None = None
    _t = 0.0
    _samples = _clipped = 0

    def _step(self, t: float) -> tuple[float, float]:
        """Note the time `t` of a sample [s]; the times since the one before and since the first [s]."""
        if self._first is None:
            self._first = self._t = t
        before, self._t = self._t, t
        return t - before, t - self._first

    def _end(self, why: str) -> None:
        self.done, self._ended = True, why

    def _search(self, found: bool, reason: str, **data: float) -> dict[str, Any]:
        """`ended`, `found` and `data` for the result of a search, and the reason where there is one."""
        return {"ended": self._ended, "found": found, **data} | ({"reason": reason} if reason else {})

    def _how_it_went(self, lost: str) -> dict[str, Any]:
        """Times `t0`, `t1` [s], `saturated` (share of clipped samples), and `ended`, for the result.

        `ended` is `time` (as planned), `no signal` (then `lost` is the reason), or `limit` where the caller stopped it.
        """
        saturated = self._clipped / self._samples if self._samples else 0.0
        data = {"t0": self._first, "t1": self._t, "saturated": saturated, "ended": self._ended}
        return data | ({"found": False, "reason": lost} if self._ended == "no signal" else {})


class LawOfSeveral(Protocol):
    """A law that is called at every sample and steers several quantities, by pulses of valves or by set-points.

    With a `called_every` [s] above 0 it is called only at this interval, with the newest sample.
    """

    done: bool

    def update(self, t: float, values: Mapping[str, float]) -> Orders:
        """The commands for the measured values [SI] at bench time `t` [s]."""
        ...

    def result(self) -> dict[str, Any]:
        """What was found, as plain data."""
        ...
