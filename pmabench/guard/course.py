"""Where an output is commanded to at any time, from its last command: pure functions of bench time [s]."""

from __future__ import annotations

import math
from collections.abc import Callable

Course = Callable[[float], float]
"""The commanded value [SI] at a bench time [s]."""


def step(value: float) -> Course:
    """At `value` from now on."""
    return lambda _now: value


def ramp(start: float, origin: float, target: float, rate: float) -> Course:
    """From `origin` at `start` [s] to `target` at `rate` [SI/s, above zero], then constant."""
    lasts = abs(target - origin) / rate
    return lambda now: target if now >= start + lasts else origin + (target - origin) * (now - start) / lasts


def sine(start: float, mean: float, amplitude: float, frequency: float, cycles: float) -> Course:
    """Whole cycles of mean + amplitude sin(2 pi f (t - start)), then constant at the mean; frequency in Hz."""
    end = start + cycles / frequency
    return lambda now: (
        mean if now >= end else mean + amplitude * math.sin(2 * math.pi * frequency * max(now - start, 0.0))
    )
