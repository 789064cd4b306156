"""What each output is commanded to at any time: for limits that compare what is measured with what was asked for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from pmabench.base.clock import Clock
from pmabench.guard import course


class Commands(Protocol):
    """What both faces of the guard take."""

    def set(self, name: str, value: float) -> float:
        """A set-point [SI]; what the device got."""
        ...

    def ramp(self, name: str, origin: float, target: float, rate: float) -> None:
        """A ramp."""
        ...

    def sine(self, name: str, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """A sine."""
        ...

    def value_sent(self, name: str, value: float) -> float:
        """What the device would get [SI]."""
        ...


@dataclass
class _Course:
    at: course.Course
    fell: float
    """When it was last going down [s]."""
    begun: float
    before: course.Course | None
    """What was commanded until then."""


@dataclass
class Commanded:
    """The course of each output [SI over s of bench time], noted when it is commanded."""

    _courses: dict[str, _Course] = field(default_factory=dict)

    def set(self, output: str, t: float, value: float) -> None:
        """A step at `t` [s]."""
        before = self.at(output, t)
        self._note(output, course.step(value), t, t, down=before is not None and value < before)

    def ramp(self, output: str, t: float, origin: float, target: float, rate: float) -> None:
        """A ramp that begins at `t` [s]; `rate` [SI/s] is above zero."""
        ends = t + abs(target - origin) / rate
        self._note(output, course.ramp(t, origin, target, rate), t, ends, down=target < origin)

    def sine(self, output: str, t: float, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """A sine that begins at `t` [s]; frequency in Hz."""
        self._note(output, course.sine(t, mean, amplitude, frequency, cycles), t, t + cycles / frequency, down=True)

    def at(self, output: str, t: float) -> float | None:
        """The commanded value [SI] at `t` [s], or None before the first command."""
        known = self._courses.get(output)
        at = None if known is None else known.at if t >= known.begun else known.before
        return None if at is None else at(t)

    def fell(self, output: str) -> float:
        """Since when the output is not going down any more [s]; minus infinity where it never was."""
        known = self._courses.get(output)
        return -math.inf if known is None else known.fell

    def _note(self, output: str, at: course.Course, t: float, until: float, *, down: bool) -> None:
        before = self._courses.get(output)
        fell = until if down else (before.fell if before is not None else -math.inf)
        self._courses[output] = _Course(at, fell, t, before.at if before is not None else None)


class Commander:
    """The guard as steps and laws see it: what is commanded is noted, and waits while a limit says `hold`."""

    def __init__(self, guard: Commands, commanded: Commanded, clock: Clock, wait: Callable[[], None]) -> None:
        self._guard, self._commanded, self._clock = guard, commanded, clock
        self._wait = wait

    def set(self, output: str, value: float) -> float:
        """Command `value` [SI]; returns what the device got."""
        self._wait()
        sent = self._guard.set(output, value)
        self._commanded.set(output, self._clock.now(), value)
        return sent

    def ramp(self, output: str, origin: float, target: float, rate: float) -> None:
        """From `origin` to `target` [SI] at `rate` [SI/s]."""
        self._wait()
        self._guard.ramp(output, origin, target, rate)
        self._commanded.ramp(output, self._clock.now(), origin, target, rate)

    def sine(self, output: str, mean: float, amplitude: float, frequency: float, cycles: float) -> None:
        """Mean + amplitude sin(2 pi f t) [SI, Hz] for whole cycles."""
        self._wait()
        self._guard.sine(output, mean, amplitude, frequency, cycles)
        self._commanded.sine(output, self._clock.now(), mean, amplitude, frequency, cycles)

    def value_sent(self, output: str, value: float) -> float:
        """The value [SI] that the device would get."""
        return self._guard.value_sent(output, value)
