"""Searches and closed loops: the table of laws, and the two ways to run one; a law cannot leave its output range."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, Protocol

from pmabench.base.clock import Clock
from pmabench.engine.acquire import Acquisition, Samples
from pmabench.engine.commanded import Commander
from pmabench.protocol.plan import Seek

SAMPLED = {
    "p": ("proportional", "Proportional"),
    "gain-steps": ("gain_steps", "GainSteps"),
    "relay": ("relay", "Relay"),
    "pid": ("position_loop", "PositionLoop"),
}
"""Laws that compute a command from every sample: module in `engine.laws` and class."""

SCRIPTED = {
    "ramp-until": ("ramp_until", "ramp_until"),
    "closed-strokes": ("closed_strokes", "closed_strokes"),
}
"""Laws that ramp, and wait or watch for a crossing: module in `engine.laws` and function."""


AT_ONCE = 100
"""Samples that a law which rarely changes its command is given at once [1]."""


class SampledLaw(Protocol):
    """A law that is called at every sample. With a true `rarely` it keeps its command for many of them."""

    done: bool

    def update(self, t: float, values: Mapping[str, float]) -> float:
        """The command [SI] for the measured values [SI] at bench time `t` [s]."""
        ...

    def result(self) -> dict[str, Any]:
        """What was found, as plain data."""
        ...


class Moves:
    """What a scripted law may do: ramp its output inside the step's range, and let time pass until a crossing."""

    def __init__(self, step: Seek, guard: Commander, acquisition: Acquisition, clock: Clock, log: Callable[..., None]):
        self.step = step
        self.acquisition = acquisition
        self.clock = clock
        self.deadline = clock.now() + step.limit
        self._guard = guard
        self._log = log
        self.commanded: float | None = None

    def inside(self, value: float) -> float:
        """The nearest value in the step's range."""
        return min(max(value, self.step.low), self.step.high)

    def set(self, value: float) -> None:
        """Command a value at once."""
        value = self.inside(value)
        self._guard.wait()  # first: the record says when it was commanded
        before = self.commanded
        self._log("set", value, value if before is None else before)
        self._guard.set(self.step.output, value)
        self.commanded = value

    def ramp(self, origin: float, target: float, rate: float) -> float:
        """Start a ramp; returns the bench time [s] when it will be there."""
        origin, target = self.inside(origin), self.inside(target)
        self._guard.wait()
        self._log("ramp", target, origin, rate=rate)
        self._guard.ramp(self.step.output, origin, target, rate)
        self.commanded = target
        return self.clock.now() + abs(target - origin) / rate

    def valve(self, name: str, *, safe: bool) -> float:
        """One valve into its safe state, or as in a run; returns the bench time [s]."""
        self._guard.valve(name, safe=safe)
        self.acquisition.switched(name, safe=safe)
        return self.clock.now()

    def wait(self, until: float) -> None:
        """Let time pass until `until` [s], but not beyond the step's limit."""
        self.acquisition.until(min(until, self.deadline))


def run_seek(
    step: Seek, guard: Commander, acquisition: Acquisition, clock: Clock, log: Callable[..., None]
) -> dict[str, Any]:
    """Run the step's law to its end; its result has `found` True or False and, when False, `reason`."""
    if step.law in SCRIPTED:
        module, name = SCRIPTED[step.law]
        script = getattr(import_module(f"pmabench.engine.laws.{module}"), name)
        found: dict[str, Any] = script(Moves(step, guard, acquisition, clock, log), **step.parameters)
        return found
    module, name = SAMPLED[step.law]
    law: SampledLaw = getattr(import_module(f"pmabench.engine.laws.{module}"), name)(**step.parameters)
    deadline = clock.now() + step.limit
    run = _rarely if getattr(law, "rarely", False) and acquisition.goes_back else _always
    return run(step, law, guard, acquisition, clock, deadline)


def _always(
    step: Seek, law: SampledLaw, guard: Commander, acquisition: Acquisition, clock: Clock, deadline: float
) -> dict[str, Any]:
    """Sample by sample; a command that is unchanged is not sent again."""
    sent: float | None = None
    t, values = acquisition.sample()
    while not law.done:
        command = min(max(law.update(t, values), step.low), step.high)
        if command == sent:
            guard.wait()
        else:
            guard.set(step.output, command)
            sent = command
        if clock.now() >= deadline:
            return _late(step, law)
        t, values = acquisition.sample()
    return {"found": True, **law.result()}


def _rarely(
    step: Seek, law: SampledLaw, guard: Commander, acquisition: Acquisition, clock: Clock, deadline: float
) -> dict[str, Any]:
    """The same, block by block, where time can be taken back to the sample at which the law changes its command."""
    sent: float | None = None
    command = step.low

    def changes(samples: Samples) -> int | None:
        """The first sample of a block after which the command is another one, or the law is done."""
        nonlocal command
        columns = {name: column.tolist() for name, column in samples.values.items()}
        for i, t in enumerate(samples.t.tolist()):
            command = min(
                max(law.update(t, {name: column[i] for name, column in columns.items()}), step.low), step.high
            )
            if command != sent or law.done:
                return i
        return None

    while not law.done:
        if acquisition.until(min(clock.now() + AT_ONCE / acquisition.rate, deadline), changes) is None:
            guard.wait()
        else:
            guard.set(step.output, command)
            sent = command
        if clock.now() >= deadline:
            return _late(step, law)
    acquisition.sample()
    return {"found": True, **law.result()}


def _late(step: Seek, law: SampledLaw) -> dict[str, Any]:
    return {"found": False, "reason": f"not done within {step.limit:g} s", **law.result()}
