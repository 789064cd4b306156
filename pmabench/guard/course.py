"""Commanded value of an output as a function of bench time [s] since its last command; pure functions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Course:
    """Commanded value [SI] over bench time [s]; a sine has a peak or trough at `crest` [s] and every `half` [s]."""

    value: Callable[[float], float]
    crest: float = 0.0
    half: float = math.inf

    def __call__(self, now: float) -> float:
        """Commanded value [SI] at the time `now` [s]."""
        return self.value(now)

    def crests(self, now: float) -> list[float]:
        """Times [s] of the peak or trough of a sine nearest to `now`, and of its neighbours; empty for other courses.

        Between two of them the value stays between its values there, so they are enough for finding its extremes.
        """
        if self.half == math.inf:
            return []
        nearest = self.crest + self.half * round((now - self.crest) / self.half)
        return [nearest - self.half, nearest, nearest + self.half]


def step(value: float) -> Course:
    """Constant at `value` [SI]."""
    return Course(lambda _now: value)


def ramp(start: float, origin: float, target: float, rate: float) -> Course:
    """From `origin` at `start` [s] to `target` at `rate` [SI/s, above zero], then constant."""
    lasts = abs(target - origin) / rate
    return Course(lambda now: target if now >= start + lasts else origin + (target - origin) * (now - start) / lasts)


def sine(start: float, mean: float, amplitude: float, frequency: float, cycles: float) -> Course:
    """Whole cycles of mean + amplitude sin(2 pi f (t - start)), then constant at the mean; frequency in Hz."""
    end, turn = start + cycles / frequency, 2 * math.pi * frequency
    return Course(
        lambda now: mean if now >= end else mean + amplitude * math.sin(turn * max(now - start, 0.0)),
        start + 0.25 / frequency, 0.5 / frequency,
    )  # fmt: skip
