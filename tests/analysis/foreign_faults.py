"""Campaigns of the simulated bench with faults that no candidate of the diagnosis describes; nothing of it is imported.

Each fault is put into the channels of a sound campaign, so that the truth is that of the sound muscle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.judge import campaign as bench
from tests.judge.campaign import RATE, STARTS, Trial
from tests.judge.muscle import Array

STILL = 1e-3
"""Speed [m/s] at which a friction in a pulley has three quarters of its size."""
PULLEY = 15e-3
"""Radius of the pulley that turns the encoder [m]."""
LASTS = float(STARTS[-1]) + bench.DURATION

truth = bench.truth
"""Of a cause of the bench: the sound muscle."""


def bent_sensor(trial: Trial, amount: float) -> Trial:
    """The displacement sensor reads x (1 - amount x), amount in 1/m."""
    return replace(trial, displacement=trial.displacement * (1 - amount * trial.displacement))


def backlash(trial: Trial, amount: float) -> Trial:
    """The displacement sensor follows only after a play of `amount` [m] at each turn."""
    return replace(trial, displacement=_play(trial.displacement, amount))


def dead_band(trial: Trial, amount: float) -> Trial:
    """The force cell reads no change below `amount` [N] after each turn of the force."""
    return replace(trial, force=_play(trial.force, amount))


def pulley_friction(trial: Trial, amount: float) -> Trial:
    """A pulley between muscle and cell takes a share of the force, against the motion."""
    speed = np.gradient(_smooth(trial.displacement), 1 / RATE)
    return replace(trial, force=trial.force * (1 - amount * np.tanh(speed / STILL)))


def eccentric(trial: Trial, amount: float) -> Trial:
    """The pulley of an encoder turns about a point that is `amount` [m] off its middle."""
    x = trial.displacement
    return replace(trial, displacement=x + amount * (np.sin(x / PULLEY + 1.0) - np.sin(1.0)))


def pressure_drift(trial: Trial, amount: float) -> Trial:
    """The zero of the pressure gauge drifts by `amount` [Pa] over the campaign."""
    return replace(trial, pressure=trial.pressure + amount * trial.t / LASTS)


FAULTS: dict[str, tuple[Callable[[Trial, float], Trial], tuple[float, ...]]] = {
    "bent-sensor": (bent_sensor, (0.5, 2.0, -2.0)),
    "backlash": (backlash, (0.1e-3, 0.5e-3, 1e-3)),
    "dead-band": (dead_band, (2.0, 5.0, 10.0)),
    "pulley-friction": (pulley_friction, (0.01, 0.03, 0.06)),
    "eccentric": (eccentric, (0.1e-3, 0.3e-3, 1e-3)),
    "pressure-drift": (pressure_drift, (1e3, 3e3, 10e3)),
}
"""Fault -> what it does to a trial, and the amounts that are tried."""
CASES = tuple((fault, amount) for fault, (_, amounts) in FAULTS.items() for amount in amounts)


def campaign(fault: str, amount: float, seed: int) -> list[Trial]:
    """A sound campaign in whose channels there is a fault."""
    return [FAULTS[fault][0](trial, amount) for trial in bench.campaign("clean", 1.0, seed)]


def _play(values: Array, width: float) -> Array:
    """Values behind a play: they follow at a distance of half of its width, whichever way they go."""
    found, now, half = np.empty_like(values), float(values[0]), 0.5 * width
    for row, value in enumerate(values.tolist()):
        now = min(max(now, value - half), value + half)
        found[row] = now
    return found


def _smooth(values: Array) -> Array:
    """Means over 20 ms."""
    return np.convolve(np.pad(values, 5, mode="edge"), np.full(11, 1 / 11), mode="valid")
