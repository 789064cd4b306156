"""A position loop about an operating point: dead time, lag of the regulator, lag of the muscle; or with a known fault.

The plant goes forward sample by sample with whatever command it gets. Ultimate gain and period follow from the phase:
omega L + sum atan(omega T_i) = pi, K_u = prod sqrt(1 + (omega T_i)^2) / k_g (Ziegler and Nichols 1942).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import atan, exp, pi, prod, sqrt

import numpy as np

RATE = 500.0
GAIN, DEAD_TIME = 0.15e-6, 0.030
"""[m/Pa], [s]; the hold of a controller adds half a sample to the dead time."""
REGULATOR, MUSCLE = 0.10, 0.25
"""[s]"""
SETPOINT, BIAS = 30e-3, 250e3
"""Where it rests [m], and the pressure there [Pa]."""
NOISE = {"pressure": 500.0, "displacement": 2e-6}
FULL = {"clean": 0.0, "second-lag": 0.05, "slew": 1.0, "creep": 0.10, "backlash": 0.2e-3, "gain-drift": 0.10}
"""Cause -> its full size: s; a slew of 300 kPa/s over it; share of the gain; m; share of the gain in 60 s."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")
SLEW = 300e3
CREEP_TIME = 4.0


def truth(cause: str, size: float, *, at: float = 0.0) -> tuple[float, float]:
    """K_u [Pa/m] and T_u [s] of the linear loop; with a gain that drifts those `at` a time [s]."""
    amount = size * FULL[cause]
    lags = [REGULATOR, MUSCLE, *([amount] if cause == "second-lag" else [])]
    gain = GAIN * (1 - amount * at / 60.0) if cause == "gain-drift" else GAIN
    creeps = amount if cause == "creep" else 0.0
    L = DEAD_TIME + 0.5 / RATE

    def slow(w: float) -> complex:
        return 1 + creeps / (1 + 1j * w * CREEP_TIME)

    low, high = 1e-2, pi / L
    for _ in range(200):
        w = 0.5 * (low + high)
        phase = w * L + sum(atan(w * T) for T in lags) - float(np.angle(slow(w)))
        low, high = (w, high) if phase < pi else (low, w)
    return prod(sqrt(1 + (low * T) ** 2) for T in lags) / (gain * abs(slow(low))), 2 * pi / low


@dataclass
class Plant:
    """At rest at its set-point; `step` puts in a command [Pa] for one sample, `read` gives what sensors say.

    second-lag
        The regulator has a second lag.
    slew
        It follows no faster than a rate, the slower the larger the size.
    creep
        The muscle goes on moving by a share, with a time constant of 4 s.
    backlash
        The displacement follows only beyond a play.
    gain-drift
        The gain of the muscle falls evenly with time.
    """

    cause: str
    size: float
    seed: int
    time: float = 0.0
    line: deque[float] = field(default_factory=deque)
    states: list[float] = field(default_factory=lambda: [0.0] * 4)
    seen: float = 0.0

    def __post_init__(self) -> None:
        self.amount = self.size * FULL[self.cause]
        self.chance = np.random.default_rng([self.seed, *self.cause.encode(), round(1000 * self.size)])
        self.line.extend([0.0] * round(DEAD_TIME * RATE))

    def step(self, command: float) -> None:
        """Go forward by one sample."""
        self.line.append(command - BIAS)
        held, h = self.line.popleft(), 1 / (4 * RATE)
        first, second, muscle, crept = self.states
        for _ in range(4):
            after = held + (first - held) * exp(-h / REGULATOR)
            if self.cause == "slew" and self.size > 0:
                most = SLEW / self.size * h
                after = first + min(most, max(-most, after - first))
            middle, first = 0.5 * (first + after), after
            if self.cause == "second-lag" and self.amount > 0:
                after = middle + (second - middle) * exp(-h / self.amount)
                middle, second = 0.5 * (second + after), after
            else:
                second = first
            gain = GAIN * (1 - (self.amount * self.time / 60.0 if self.cause == "gain-drift" else 0.0))
            muscle = gain * middle + (muscle - gain * middle) * exp(-h / MUSCLE)
            if self.cause == "creep":
                crept = self.amount * muscle + (crept - self.amount * muscle) * exp(-h / CREEP_TIME)
            self.time += h
        self.states = [first, second, muscle, crept]
        place = muscle + crept
        play = 0.5 * self.amount if self.cause == "backlash" else 0.0
        self.seen = min(max(self.seen, place - play), place + play)

    def read(self) -> dict[str, float]:
        """Displacement [m] and pressure [Pa], with noise."""
        noise = self.chance.standard_normal(2)
        return {
            "displacement": SETPOINT + self.seen + NOISE["displacement"] * float(noise[0]),
            "pressure": BIAS + self.states[1] + NOISE["pressure"] * float(noise[1]),
        }
