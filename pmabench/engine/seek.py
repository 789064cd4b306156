"""Searches and closed loops: the ways to run a law, which cannot leave the output range of its step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from pmabench.base.clock import Clock
from pmabench.engine.acquire import Acquisition, Samples
from pmabench.engine.commanded import Commander
from pmabench.engine.laws import law_of
from pmabench.engine.moves import Moves
from pmabench.protocol.plan import Seek

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


def run_seek(
    step: Seek, guard: Commander, acquisition: Acquisition, clock: Clock, log: Callable[..., None]
) -> dict[str, Any]:
    """Run the step's law to its end; its result has `found` True or False and, when False, `reason`."""
    made = law_of(step.law)
    if not isinstance(made, type):
        found: dict[str, Any] = made(Moves(step, guard, acquisition, clock, log), **step.parameters)
        return found
    law: SampledLaw = made(**step.parameters)
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
