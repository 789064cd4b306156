"""Commanded values over time as closed forms: constants, ramps, sines; must not know what they command."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pmabench.model.curve import Array


def to_nanosecond(t: float) -> float:
    """A moment [s] on the grid of whole nanoseconds, so that equal moments compare equal however they were summed."""
    return round(t * 1e9) / 1e9


class Wave(NamedTuple):
    """u(t) = level + slope s + amplitude sin(omega s + phase), s = t - start [s], until the next wave starts."""

    start: float
    level: float
    slope: float = 0.0
    amplitude: float = 0.0
    omega: float = 0.0
    phase: float = 0.0

    def value(self, t: float) -> float:
        """The commanded value at time t [s]."""
        since = t - self.start
        wave = self.amplitude * math.sin(self.omega * since + self.phase) if self.amplitude else 0.0
        return self.level + self.slope * since + wave

    def values(self, t: Array) -> Array:
        """The commanded values at times t [s]."""
        since = t - self.start
        return np.asarray(self.level + self.slope * since + self.amplitude * np.sin(self.omega * since + self.phase))

    def later(self, t: float) -> Wave:
        """The same wave counted from t [s] on."""
        since = t - self.start
        return self._replace(start=t, level=self.level + self.slope * since, phase=self.phase + self.omega * since)

    @property
    def steady(self) -> bool:
        """Whether it is a constant."""
        return self.slope == 0 and self.amplitude == 0

    @property
    def steepest(self) -> float:
        """Highest rate of change [units/s]."""
        return abs(self.slope) + abs(self.amplitude * self.omega)


def constant(start: float, level: float) -> tuple[Wave, ...]:
    """One value from `start` [s] on."""
    return (Wave(to_nanosecond(start), level),)


def ramp(start: float, origin: float, target: float, rate: float) -> tuple[Wave, ...]:
    """From `origin` at `start` [s] to `target` with `rate` [units/s, > 0], then constant."""
    duration = abs(target - origin) / rate
    if to_nanosecond(duration) == 0:
        return constant(start, target)
    return (
        Wave(to_nanosecond(start), origin, slope=math.copysign(rate, target - origin)),
        Wave(to_nanosecond(start + duration), target),
    )


def sine(start: float, origin: float, amplitude: float, frequency: float, cycles: float) -> tuple[Wave, ...]:
    """`origin + amplitude sin(2 pi frequency (t - start))` for `cycles`, then constant at `origin`; [s, units, Hz]."""
    return (
        Wave(to_nanosecond(start), origin, amplitude=amplitude, omega=2 * math.pi * frequency),
        Wave(to_nanosecond(start + cycles / frequency), origin),
    )
