"""What a simulated bench writes down of one trial, and the filters and truths that its plants share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
Truth = dict[tuple[str, str, float], tuple[float, float]]
"""Symbol, coordinate (empty where a symbol has one value), place (pressure, contraction or step; SI, 0 without) ->
the least and the greatest value that is right."""


@dataclass(frozen=True)
class Ramp:
    """One command: time [s], output, value and value before [SI], phase, rate [SI/s]."""

    t: float
    output: str
    value: float
    before: float
    phase: str
    rate: float


@dataclass(frozen=True)
class Trial:
    """One trial: operating point [SI], repeat, samples, commands; `t` counts from the start of the campaign."""

    point: Mapping[str, float]
    repeat: int
    t: Array
    channels: Mapping[str, Array]
    commands: tuple[Ramp, ...]


def lagged(values: Array, constant: float, rate: float) -> Array:
    """Samples [at `rate`, Hz] behind a lag of first order [s], at rest before; exact for straight lines between."""
    if constant <= 0:
        return values
    a = 1.0 / (rate * constant)
    keep = float(np.exp(-a))
    b1 = 1.0 - (1.0 - keep) / a
    b0 = 1.0 - keep - b1
    return np.asarray(lfilter([b1, b0], [1.0, -keep], values - values[0]) + values[0])
