"""What a law that ramps and waits may do, inside the output range of its step."""

from __future__ import annotations

from collections.abc import Callable

from pmabench.base.clock import Clock
from pmabench.engine.acquire import Acquisition
from pmabench.engine.commanded import Commander
from pmabench.protocol.plan import Seek


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
        """Switch a valve to its safe state, or to its state in a run; returns the bench time [s]."""
        self._guard.valve(name, safe=safe)
        self.acquisition.switched(name, safe=safe)
        return self.clock.now()

    def wait(self, until: float) -> None:
        """Let time pass until `until` [s], but not beyond the step's limit."""
        self.acquisition.until(min(until, self.deadline))
