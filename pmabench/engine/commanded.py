"""The commanded value of each output at any time: for limits that compare what is measured with what was asked for."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmabench.base.clock import Clock
from pmabench.guard import course

if TYPE_CHECKING:
    from pmabench.guard.remote import AnyGuard

SETTLES = 2.0
"""Time for which a pressure may still fall after the end of a falling command [s]."""


@dataclass
class _Course:
    at: course.Course
    begun: float
    before: course.Course | None
    """Course before `begun`."""


@dataclass
class _Lows:
    """Lowest values of the commands that still count, ascending, and until when each counts [s]; the last: for ever."""

    until: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    def add(self, t: float, low: float) -> None:
        """Note that from `t` [s] on the command is never below `low` [SI]; the former one counts for `SETTLES` more."""
        if self.until:
            self.until[-1] = t + SETTLES
        gone = bisect_right(self.until, t)
        del self.until[:gone], self.values[:gone]
        while self.values and self.values[-1] >= low:
            self.until.pop()
            self.values.pop()
        self.until.append(math.inf)
        self.values.append(low)


def _with_fall(
    before: Iterable[tuple[float, float, float]], t: float, until: float, rate: float
) -> list[tuple[float, float, float]]:
    """The falls (begin [s], end [s], rate [SI/s]) that still count, and a new one from `t` to `until` if `rate` > 0.

    From `t` on it replaces those that were not faster. Falls that ended long before `t` are dropped: no sample needs
    them.
    """
    kept, begins = [], t
    for first, last, fall in before:
        if fall == rate and last > t:
            begins = min(begins, first)
        elif last > t - SETTLES:
            kept.append((first, min(last, t) if fall < rate else last, fall))
    return [*kept, (begins, until, rate)] if rate else kept


@dataclass
class Commanded:
    """Course of each output [SI] over bench time [s]. Times of commands are those just before they were sent."""

    _courses: dict[str, _Course] = field(default_factory=dict)
    _falls: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    """Output -> falls: begin and end [s] of the time in which the pressure may follow it down, and rate [SI/s]."""
    _lows: dict[str, _Lows] = field(default_factory=dict)

    def set(self, output: str, t: float, value: float) -> None:
        """Note a step to `value` [SI] at `t` [s]."""
        before = self.at(output, t)
        falls = math.inf if before is not None and value < before else 0.0
        self._note(output, course.step(value), t, t, falls, value)

    def ramp(self, output: str, t: float, origin: float, target: float, rate: float) -> None:
        """Note a ramp that begins at `t` [s]; `rate` [SI/s] is above zero."""
        ends = t + abs(target - origin) / rate
        falls = rate if target < origin else 0.0
        self._note(output, course.ramp(t, origin, target, rate), t, ends, falls, min(origin, target))

    def sine(self, output: str, t: float, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """Note a sine that begins at `t` [s]; frequency in Hz."""
        fastest = 2 * math.pi * frequency * abs(amplitude)
        at, ends = course.sine(t, mean, amplitude, frequency, cycles), t + cycles / frequency
        self._note(output, at, t, ends, fastest, mean - abs(amplitude))

    def at(self, output: str, t: float) -> float | None:
        """The commanded value [SI] at `t` [s], or None before the first command."""
        known = self._courses.get(output)
        at = None if known is None else known.at if t >= known.begun else known.before
        return None if at is None else at(t)

    def falling(self, output: str, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fastest fall that commands explain at each time `t` [s] [SI/s], shape (n,); 0 where none does.

        Only commands before a sample count, even if the sample is processed late.
        """
        allowed = np.zeros(len(t))
        for begins, until, rate in self._falls.get(output, ()):
            allowed = np.where((begins <= t) & (t < until), np.maximum(allowed, rate), allowed)
        return allowed

    def lowest(self, output: str, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lowest value [SI] that was commanded within the last `SETTLES` before each time `t` [s], shape (n,).

        Infinite before the first command: nothing explains a fall then.
        """
        known = self._lows.get(output)
        if known is None:
            return np.full(len(t), math.inf)
        return np.array([known.values[bisect_right(known.until, moment)] for moment in t.tolist()])

    def _note(self, output: str, at: course.Course, t: float, ends: float, falls: float, low: float) -> None:
        before = self._courses.get(output)
        self._courses[output] = _Course(at, t, before.at if before is not None else None)
        self._falls[output] = _with_fall(self._falls.get(output, ()), t, ends + SETTLES, falls)
        self._lows.setdefault(output, _Lows()).add(t, low)


class Commander:
    """The guard as steps and laws use it: notes each command, and delays it while a limit holds the bench."""

    def __init__(self, guard: AnyGuard, commanded: Commanded, clock: Clock, wait: Callable[[], None]) -> None:
        self._guard, self._commanded, self._clock = guard, commanded, clock
        self.wait = wait
        """Blocks until no limit holds the bench any more."""

    def _wait(self) -> float:
        """Wait while the bench is held; bench time [s] after that."""
        self.wait()
        return self._clock.now()

    def set(self, output: str, value: float) -> float:
        """Command `value` [SI]; returns the value that was sent to the device."""
        t = self._wait()
        sent = self._guard.set(output, value)
        self._commanded.set(output, t, value)
        return sent

    def ramp(self, output: str, origin: float, target: float, rate: float) -> None:
        """Ramp from `origin` to `target` [SI] at `rate` [SI/s]."""
        t = self._wait()
        self._guard.ramp(output, origin, target, rate)
        self._commanded.ramp(output, t, origin, target, rate)

    def sine(self, output: str, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """Mean + amplitude sin(2 pi f t) [SI, Hz] for whole cycles."""
        t = self._wait()
        self._guard.sine(output, mean, amplitude, frequency, cycles)
        self._commanded.sine(output, t, mean, amplitude, frequency, cycles)

    def valve(self, name: str, *, safe: bool) -> None:
        """Switch one valve to its safe state, or to its state in a run."""
        self.wait()
        self._guard.valves(closed=not safe, only=name)

    def steer(self, aims: Mapping[str, float], pulses: Mapping[str, float]) -> None:
        """Open valves for the times `pulses` [s], to bring muscles to `aims` [SI]."""
        t = self._wait()
        self._guard.steer(aims, pulses)
        for name, value in aims.items():
            self._commanded.set(name, t, value)
