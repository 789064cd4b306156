"""Weights that a muscle of plant 5.5 lifts off a support and sets down again while the pressure goes slowly up and down.

At rest but for friction f: on the way up the curve force(x, P) is at m g + f, on the way down at m g - f, and between
them the load does not move. The formula turned round, no integration: the ramps are slow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.judge.daerden import force
from tests.judge.record import Array

RAMP, RATE = 2e3, 50.0
"""[Pa/s], [Hz]"""
LIFTED = 3e-3
"""Contraction at which the ramp turns [m]."""
NOISE = {"pressure": 500.0, "displacement": 2e-6}


@dataclass(frozen=True)
class Lift:
    """One lift and set-down: samples, and where a search sees the load cross `moved` [m]: time [s] and pressure [Pa]."""

    load: float
    t: Array
    channels: dict[str, Array]
    lift: tuple[float, float]
    set_down: tuple[float, float]
    moved: float


def pressure_for(pull: float, x: Array | float) -> Array:
    """Pressure [Pa] at which the curve is at a force [N] at a contraction [m]: the formula is a line over pressure."""
    return np.asarray((pull - force(x, 0.0)) / (force(x, 1.0) - force(x, 0.0)))


def places(pull: float, P: Array) -> Array:
    """Contractions [m] at which the curve is at a force at pressures [Pa]; the load rests on its support at 0."""
    x = np.linspace(0.0, 2 * LIFTED, 20001)
    return np.interp(P, pressure_for(pull, x), x)


def lift(load: float, friction: float, seed: int, moved: float, slip: float = 0.0) -> Lift:
    """A load [N] under a friction [N]; `moved` [m] is the contraction at which lift and set-down are noticed.

    `slip` [m]: the load follows in jumps of that height, as a load does whose friction at rest is the greater one.
    """
    chance = np.random.default_rng([seed, round(load), round(10 * friction)])
    begin, top = float(pressure_for(load + friction, 0.0)) - 10e3, float(pressure_for(load + friction, LIFTED))
    end = float(pressure_for(load - friction, 0.0)) - 10e3
    P = np.concatenate([np.arange(begin, top, RAMP / RATE), np.arange(top, end, -RAMP / RATE)])
    t = np.arange(len(P)) / RATE
    x, here = np.empty(len(P)), 0.0
    for n, (low, high) in enumerate(zip(places(load + friction, P), places(load - friction, P), strict=True)):
        there = min(max(here, low), high)
        here = there if abs(there - here) >= slip or there == 0.0 else here
        x[n] = here
    off = np.flatnonzero(x > moved)
    crossed = [(float(t[n]), float(P[n])) for n in (off[0], off[-1])]
    read = {
        name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in (("pressure", P), ("displacement", x))
    }
    return Lift(load, t, read, crossed[0], crossed[1], moved)
