"""Weights that the second muscle lifts off a support, raises and sets down again, as a static-load test does it; SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from tests.judge.second.bench import GRAVITY
from tests.judge.second.hanging import hang
from tests.judge.second.muscle import Array, Muscle

RATE, FINE = 200.0, 1
"""Samples [Hz], and steps of the motion for each."""
FAST, STROKE, SLOW = 20e3, 5e3, 2e3
"""Ramps [Pa/s]: to the neighbourhood, of the stroke, of lift and set-down."""
MOVED = 20e-6
"""Contraction at which a search sees the load off its support [m]."""
NOISE = {"pressure": 500.0, "displacement": 2e-6}


@dataclass(frozen=True)
class Lifted:
    """Samples of one load [N], and where it crossed `MOVED`: times [s] and pressures [Pa] of lift and set-down."""

    load: float
    t: Array
    channels: dict[str, Array]
    lift: tuple[float, float]
    set_down: tuple[float, float]


def lifted(of: Muscle, masses: Sequence[float], stroke: float, seed: int) -> list[Lifted]:
    """Masses [kg], raised by `stroke` [Pa] above their lift (0: not raised)."""
    chance = np.random.default_rng(seed)
    near = [brentq(lambda P, m=m: float(of.static(np.zeros(()), np.array(P))) - m * GRAVITY, 0, 9e5) for m in masses]
    begins = [max(0.0, P - 25e3) for P in near]
    P, x = _hung(of, masses, [_way((a, FAST), (b + 30e3, SLOW)) for a, b in zip(begins, near, strict=True)])
    lifts = [float(p[np.argmax(one > MOVED)]) for p, one in zip(P, x, strict=True)]
    ways = []
    for a, b in zip(begins, lifts, strict=True):
        up = ((b + stroke, STROKE), (b + stroke, 1.0), (b, STROKE)) if stroke else ()
        ways.append(_way((a, FAST), (b + 1e3, SLOW), (b + 1e3, 1.0), *up, (max(0.0, b - 45e3), SLOW)))
    found = []
    for mass, p, one in zip(masses, *_hung(of, masses, ways), strict=True):
        t, off = np.arange(len(p)) / RATE, np.flatnonzero(one > MOVED)
        read = {
            name: values + NOISE[name] * chance.standard_normal(len(t))
            for name, values in (("pressure", p), ("displacement", one))
        }
        crossed = [(float(t[n]), float(p[n])) for n in (off[0], off[-1])]
        found.append(Lifted(mass * GRAVITY, t, read, crossed[0], crossed[1]))
    return found


def _way(*ramps: tuple[float, float]) -> list[float]:
    """Pressure [Pa] from 0 on: ramps to a pressure at a rate [Pa/s]; where it is there already, so many seconds there."""
    way = [0.0]
    for target, rate in ramps:
        lasts = abs(target - way[-1]) / rate if target != way[-1] else rate
        way += np.linspace(way[-1], target, max(1, round(lasts * RATE * FINE)) + 1)[1:].tolist()
    return way


def _hung(of: Muscle, masses: Sequence[float], ways: list[list[float]]) -> tuple[list[Array], list[Array]]:
    """Pressure and contraction of each mass, as long as its way."""
    longest = max(map(len, ways))
    P = np.array([way + [way[-1]] * (longest - len(way)) for way in ways])
    x, _ = hang(of, np.array(masses), P, RATE * FINE, np.full(len(masses), 10.0), fine=FINE)
    ends = [len(way) // FINE for way in ways]
    return [p[::FINE][:n] for p, n in zip(P, ends, strict=True)], [one[:n] for one, n in zip(x, ends, strict=True)]
