"""Where an output is commanded to at any time, from its last command: pure functions of bench time [s]."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Course:
    """The commanded value [SI] at a bench time [s]; a sine has crests at `crest` [s] and each `half` [s] from there."""

    value: Callable[[float], float]
    crest: float = 0.0
    half: float = math.inf

    def __call__(self, now: float) -> float:
        """The value that is commanded at this time."""
        return self.value(now)

    def crests(self, now: float) -> list[float]:
        """Times of the crests next to this one: what lies between two of them is nowhere beyond both."""
        if self.half == math.inf:
            return []
        nearest = self.crest + self.half * round((now - self.crest) / self.half)
        return [nearest - self.half, nearest, nearest + self.half]


def step(value: float) -> Course:
    """At `value` from now on."""
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
