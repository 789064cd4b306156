"""Samples of a trial of any kind: stretches of them, whether they can be used, their noise, a sine in them."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array, RunData, TrialData

UNUSABLE_SHARE = 0.02
"""Share of flagged samples above which a trial is not used."""


class NotUsable(Exception):
    """A trial that cannot be measured, with the reason."""


@dataclass(frozen=True)
class Samples:
    """One stretch of samples on its way into segments: arrays of shape (n,), SI.

    `force` is the measured F_L, None where there is no load cell: then it is `load` [N] moving with `mass` [kg].
    """

    trial: int
    t: Array
    P: Array
    x: Array
    force: Array | None
    ok: NDArray[np.bool_]
    load: float
    mass: float


@dataclass(frozen=True)
class Noise:
    """Standard deviation of the white noise of each channel, as seen in the samples [SI]."""

    pressure: float = 0.0
    displacement: float = 0.0
    force: float = 0.0


def noise_of(y: Array) -> float:
    """Standard deviation of the white noise on `y`, shape (n,), from its third differences; robust to the signal.

    The third difference of white noise has 20 times its variance.
    """
    if len(y) < 8:
        return 0.0
    third = np.abs(np.diff(y, n=3))
    return float((np.median(third) / 0.6745 or np.sqrt(np.mean(third**2))) / np.sqrt(20.0))


def on_time(run: RunData, trial: TrialData, name: str) -> Array:
    """A channel without the lag of its sensor, which along a ramp tells what was there one lag ago; NaN if missing."""
    if name not in trial.channels:
        return np.full(trial.t.shape, np.nan)
    lag = run.channels[name].sensor_lag if name in run.channels else 0.0
    values = trial.channels[name]
    return np.interp(trial.t + lag, trial.t, values) if lag else values


def three_parameter(t: Array, signals: Array, frequency: float) -> tuple[Array, NDArray[np.complex128]]:
    """Means, shape (m,), and complex amplitudes A with Re(A exp(j 2 pi f t)), shape (m,), of `signals`, shape (n, m).

    Least squares of c + a cos + b sin at the known frequency (IEEE 1057, three-parameter sine fit).
    """
    angle = 2 * pi * frequency * t
    fitted, *_ = np.linalg.lstsq(np.column_stack([np.ones_like(t), np.cos(angle), np.sin(angle)]), signals, rcond=None)
    return np.asarray(fitted[0]), np.asarray(fitted[1] - 1j * fitted[2], dtype=np.complex128)
