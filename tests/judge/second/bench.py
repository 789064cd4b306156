"""Bench of the second muscle: a regulator of second order, sensors with noise that has a colour, faults; SI."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from tests.judge.second.muscle import Array

GRAVITY = 9.80665
DEAD, REGULATOR = 0.018, 0.052
"""Dead time and, twice, the lag of the regulator [s]."""
WHITE = {"pressure": 400.0, "displacement": 2e-6, "force": 0.25}
"""Standard deviation of the white part of the noise."""
DRIFTING = {"pressure": (80.0, 0.04), "displacement": (1e-6, 0.06), "force": (0.10, 0.025)}
"""Standard deviation and time constant [s] of the part of first order."""
HUM, MAINS = {"pressure": 0.0, "displacement": 0.0, "force": 0.10}, 50.0
"""Amplitude of the hum and its frequency [Hz]."""


def stepped(steps: Sequence[tuple[float, float]], t: Array) -> Array:
    """Pressure [Pa] at times [s] after steps (time, value) from 0: each through the dead time and both lags."""
    P, before = np.zeros_like(t), 0.0
    for at, value in steps:
        since = np.maximum(t - at - DEAD, 0.0) / REGULATOR
        P += (value - before) * (1 - (1 + since) * np.exp(-since))
        before = value
    return P


def regulated(command: Array, rate: float) -> Array:
    """Pressure [Pa] that follows a command, sampled at `rate` [Hz]; it has rested at the first value."""
    late = np.concatenate([np.full(round(DEAD * rate), command[0]), command])[: len(command)]
    return behind(behind(late, REGULATOR, rate), REGULATOR, rate)


def behind(values: Array, constant: float, rate: float) -> Array:
    """Samples behind a lag of first order [s], by the trapezoidal rule; at rest at the first value before."""
    if not constant:
        return values
    c = 2 * constant * rate
    return np.asarray(lfilter([1 / (1 + c)] * 2, [1, (1 - c) / (1 + c)], values - values[0]) + values[0])


def noise(channel: str, n: int, rate: float, chance: np.random.Generator, colour: float = 1.0) -> Array:
    """Noise of a channel, `n` samples; with `colour` 0 it is white."""
    size, constant = DRIFTING[channel]
    keep = float(np.exp(-1 / (rate * constant)))
    kicks = size * np.sqrt(1 - keep**2) * chance.standard_normal(n)
    kicks[0] /= np.sqrt(1 - keep**2)
    hum = HUM[channel] * np.sin(2 * np.pi * (MAINS * np.arange(n) / rate + chance.random()))
    coloured = lfilter([1.0], [1.0, -keep], kicks) + hum
    return np.asarray(WHITE[channel] * chance.standard_normal(n) + colour * coloured)
