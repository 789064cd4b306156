"""The plan: a finite list of small immutable steps that is printed, timed, checked, executed and stored with the run.

No step uses the result of another. Whatever depends on a measurement happens inside one `WaitUntil`, `Seek` or
`Control`, which have a time limit and a range for each output, so that the longest duration and the range of each
command are known in advance.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

HANDS_OUT = 3.0
"""Time without motion after hands were in the bench [s] (promise S8)."""
VENTED_WITHIN = 30.0
"""Longest wait for the pressure to vanish before hands are allowed in [s]."""


@dataclass(frozen=True)
class Step:
    """Base of all steps; `phase` names the part of the trial that it belongs to, for later segmentation."""

    kind: ClassVar[str]
    phase: str

    def longest(self) -> float:
        """Longest duration [s]: the time limit if there is one, else 0; the operator's time does not count."""
        return float(getattr(self, "limit", 0.0))

    def shortest(self) -> float:
        """Shortest duration [s]."""
        return self.longest()

    def commands(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value [SI] of each output that this step can command."""
        return {}


@dataclass(frozen=True)
class Set(Step):
    """Command `value` [SI] to `output` at once."""

    kind: ClassVar[str] = "set"
    output: str
    value: float

    def commands(self) -> dict[str, tuple[float, float]]:
        """The value itself."""
        return {self.output: (self.value, self.value)}


@dataclass(frozen=True)
class Ramp(Step):
    """Take `output` from `origin` to `to` [SI] at `rate` [SI/s, > 0]; lasts until it is there."""

    kind: ClassVar[str] = "ramp"
    output: str
    origin: float
    to: float
    rate: float

    def longest(self) -> float:
        """Distance divided by rate [s]."""
        return abs(self.to - self.origin) / self.rate

    def commands(self) -> dict[str, tuple[float, float]]:
        """The two ends."""
        return {self.output: (min(self.origin, self.to), max(self.origin, self.to))}


@dataclass(frozen=True)
class Follow(Step):
    """Move `output` as mean + amplitude sin(2 pi f t) [SI, Hz] for whole `cycles`."""

    kind: ClassVar[str] = "follow"
    output: str
    mean: float
    amplitude: float
    frequency: float
    cycles: int

    def longest(self) -> float:
        """Cycles divided by frequency [s]."""
        return self.cycles / self.frequency

    def commands(self) -> dict[str, tuple[float, float]]:
        """Mean minus and plus amplitude."""
        return {self.output: (self.mean - self.amplitude, self.mean + self.amplitude)}


@dataclass(frozen=True)
class Hold(Step):
    """Let `duration` [s] pass with all outputs as they are."""

    kind: ClassVar[str] = "hold"
    duration: float

    def longest(self) -> float:
        """The duration."""
        return self.duration


@dataclass(frozen=True)
class Record(Step):
    """Begin (`on`) or end recording of samples; a begin with a `trial` opens that trial, its end closes it."""

    kind: ClassVar[str] = "record"
    on: bool
    trial: int | None = None


@dataclass(frozen=True)
class WaitUntil(Step):
    """Wait until `channel` is `below` or `above` `value` [SI], or `steady` (peak to peak at most `value`).

    The condition must hold for `window` [s] without a break; after `limit` [s] the trial fails (`fail`), or the run
    continues and is flagged (`flag`).
    """

    kind: ClassVar[str] = "wait-until"
    channel: str
    comparison: str
    value: float
    window: float
    limit: float
    at_limit: str = "fail"

    def shortest(self) -> float:
        """The window."""
        return self.window


@dataclass(frozen=True)
class Ask(Step):
    """Ask the operator for manual work, which is allowed only while the bench is in the state `demands`.

    `demands` is `vented` or `at-pressure`; `load` is what the free end carries afterwards: F_L [N] and the moving
    mass [kg].
    """

    kind: ClassVar[str] = "ask"
    text: str
    demands: str = "vented"
    load: tuple[float, float] | None = None

    def longest(self) -> float:
        """Longest time for venting, and `HANDS_OUT` afterwards [s]; the operator's own time does not count."""
        return HANDS_OUT + (VENTED_WITHIN if self.demands == "vented" else 0.0)

    def shortest(self) -> float:
        """The wait after hands were in [s]."""
        return HANDS_OUT


@dataclass(frozen=True)
class Seek(Step):
    """A search or closed loop: `law` of the engine's table moves `output` inside `low`..`high` [SI].

    It ends by its own stop rule, after at most `limit` [s]. `parameters` are SI numbers, names of channels and lists
    of them. What it finds becomes an event `found` with its `result`. `at_limit`: `fail` the trial, or go on
    and `flag` it.
    """

    kind: ClassVar[str] = "seek"
    law: str
    output: str
    low: float
    high: float
    limit: float
    parameters: Mapping[str, Any] = field(default_factory=dict)
    at_limit: str = "fail"

    def shortest(self) -> float:
        """A search may end at once."""
        return 0.0

    def commands(self) -> dict[str, tuple[float, float]]:
        """The range that the law cannot leave."""
        return {self.output: (self.low, self.high)}


@dataclass(frozen=True)
class Control(Step):
    """A closed loop over several quantities: `law` of the engine's table steers each of `aims` inside its range [SI].

    It opens valves for times that their devices measure, or sends set-points. It ends by its own stop rule, after at
    most `limit` [s]. `parameters` and `at_limit` as in `Seek`; what it found becomes an event `found` with its
    `result`.
    """

    kind: ClassVar[str] = "control"
    law: str
    aims: Mapping[str, tuple[float, float]]
    limit: float
    parameters: Mapping[str, Any] = field(default_factory=dict)
    at_limit: str = "fail"

    def shortest(self) -> float:
        """The parameter `duration` [s] where the law has one; else 0, for it may end at once."""
        return float(self.parameters.get("duration", 0.0))

    def commands(self) -> dict[str, tuple[float, float]]:
        """The ranges that the law cannot leave."""
        return {name: (low, high) for name, (low, high) in self.aims.items()}


STEPS: dict[str, type[Step]] = {
    step.kind: step for step in (Set, Ramp, Follow, Hold, Record, WaitUntil, Ask, Seek, Control)
}


@dataclass(frozen=True)
class TrialRecord:
    """One repetition at one operating point.

    `point` in SI, keyed by name: `load` F_L [N], `mass` (moving) [kg], `pressure` [Pa], `frequency` [Hz],
    `setpoint` [m] ...
    """

    index: int
    point: Mapping[str, float]
    repeat: int = 0
    reference: bool = False


@dataclass(frozen=True)
class Plan:
    """A protocol compiled against a bench and a specimen."""

    kind: str
    """Protocol kind, for instance `contraction-relaxation`."""
    name: str
    source: str
    free_end: str
    rate: float
    """Sample rate [Hz]."""
    record: tuple[str, ...]
    """Channels to record."""
    trials: tuple[TrialRecord, ...]
    steps: tuple[Step, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the protocol that the reduction needs, SI."""
    accept: Mapping[str, Any] = field(default_factory=dict)
    """Largest relative interval by coefficient, and under `limits` every limit with its place in the protocol."""
    hazards: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain data; steps as objects with their kind under `step`."""
        data = asdict(replace(self, steps=()))
        data["schema"] = "pmabench.plan/1"
        data["steps"] = [{"step": step.kind, **asdict(step)} for step in self.steps]
        return data

    def to_json(self) -> str:
        """The plan as the JSON text that is stored with the run."""
        return self._json

    @cached_property
    def _json(self) -> str:
        return json.dumps(self.to_dict(), indent=1, sort_keys=True)

    @property
    def sha256(self) -> str:
        """Hash of the plan's JSON."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    def duration(self) -> tuple[float, float]:
        """Shortest and longest duration [s], without the operator's time."""
        return sum(step.shortest() for step in self.steps), sum(step.longest() for step in self.steps)

    def rows(self) -> int:
        """Largest number of samples that can be recorded."""
        recorded, on = 0.0, False
        for step in self.steps:
            if isinstance(step, Record):
                on = step.on
            elif on:
                recorded += step.longest()
        return round(recorded * self.rate)

    def commands(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value [SI] of each output over the whole plan."""
        span: dict[str, tuple[float, float]] = {}
        for step in self.steps:
            for output, (low, high) in step.commands().items():
                before = span.get(output, (low, high))
                span[output] = (min(before[0], low), max(before[1], high))
        return span
