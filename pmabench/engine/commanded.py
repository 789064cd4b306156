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
"""After the command went down, a pressure that falls may still follow it for so long [s], and no deeper."""


@dataclass
class _Course:
    at: course.Course
    begun: float
    before: course.Course | None
    """What was commanded until then."""


@dataclass
class _Lows:
    """The lowest values of the commands that still count, rising, and until when each does [s]: the last for ever."""

    until: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    def add(self, t: float, low: float) -> None:
        """From `t` [s] on the command is nowhere below `low` [SI]; the one before counts for `SETTLES` more."""
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
    """The falls that count, and a new one from `t` until `until` [s] where `rate` [SI/s] is not 0.

    From `t` on it stands for those that were no faster. What was over long before `t` no sample asks for any more.
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
    """The course of each output [SI over s of bench time], noted when it was commanded: `t` is before it was sent."""

    _courses: dict[str, _Course] = field(default_factory=dict)
    _falls: dict[str, list[tuple[float, float, float]]] = field(default_factory=dict)
    """From when on, and until when a pressure may follow each command down [s], and how fast that is [SI/s]."""
    _lows: dict[str, _Lows] = field(default_factory=dict)

    def set(self, output: str, t: float, value: float) -> None:
        """A step at `t` [s]."""
        before = self.at(output, t)
        falls = math.inf if before is not None and value < before else 0.0
        self._note(output, course.step(value), t, t, falls, value)

    def ramp(self, output: str, t: float, origin: float, target: float, rate: float) -> None:
        """A ramp that begins at `t` [s]; `rate` [SI/s] is above zero."""
        ends = t + abs(target - origin) / rate
        falls = rate if target < origin else 0.0
        self._note(output, course.ramp(t, origin, target, rate), t, ends, falls, min(origin, target))

    def sine(self, output: str, t: float, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """A sine that begins at `t` [s]; frequency in Hz."""
        fastest = 2 * math.pi * frequency * abs(amplitude)
        at, ends = course.sine(t, mean, amplitude, frequency, cycles), t + cycles / frequency
        self._note(output, at, t, ends, fastest, mean - abs(amplitude))

    def at(self, output: str, t: float) -> float | None:
        """The commanded value [SI] at `t` [s], or None before the first command."""
        known = self._courses.get(output)
        at = None if known is None else known.at if t >= known.begun else known.before
        return None if at is None else at(t)

    def falling(self, output: str, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """How fast the output was commanded down [SI/s], of shape (n,) as `t` [s]: a pressure may fall as fast.

        A sample that is looked at late is explained by the commands before it alone.
        """
        allowed = np.zeros(len(t))
        for begins, until, rate in self._falls.get(output, ()):
            allowed = np.where((begins <= t) & (t < until), np.maximum(allowed, rate), allowed)
        return allowed

    def lowest(self, output: str, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """The lowest value [SI] that was commanded up to `SETTLES` before `t` [s], of shape (n,) as `t`.

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
    """The guard as steps and laws see it: what is commanded is noted, and waits while a limit says `hold`."""

    def __init__(self, guard: AnyGuard, commanded: Commanded, clock: Clock, wait: Callable[[], None]) -> None:
        self._guard, self._commanded, self._clock = guard, commanded, clock
        self.wait = wait
        """Returns when nothing holds the bench any more."""

    def _wait(self) -> float:
        """When the next command can be sent [s]: now."""
        self.wait()
        return self._clock.now()

    def set(self, output: str, value: float) -> float:
        """Command `value` [SI]; returns what the device got."""
        t = self._wait()
        sent = self._guard.set(output, value)
        self._commanded.set(output, t, value)
        return sent

    def ramp(self, output: str, origin: float, target: float, rate: float) -> None:
        """From `origin` to `target` [SI] at `rate` [SI/s]."""
        t = self._wait()
        self._guard.ramp(output, origin, target, rate)
        self._commanded.ramp(output, t, origin, target, rate)

    def sine(self, output: str, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """Mean + amplitude sin(2 pi f t) [SI, Hz] for whole cycles."""
        t = self._wait()
        self._guard.sine(output, mean, amplitude, frequency, cycles)
        self._commanded.sine(output, t, mean, amplitude, frequency, cycles)

    def valve(self, name: str, *, safe: bool) -> None:
        """One valve into its safe state, or as in a run."""
        self.wait()
        self._guard.valves(closed=not safe, only=name)

    def steer(self, aims: Mapping[str, float], pulses: Mapping[str, float]) -> None:
        """Open valves for so long [s], to bring muscles to `aims` [SI]."""
        t = self._wait()
        self._guard.steer(aims, pulses)
        for name, value in aims.items():
            self._commanded.set(name, t, value)
