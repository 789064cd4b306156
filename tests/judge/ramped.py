"""Slow ramps both ways, one speed after another: a spring, a dashpot, friction, and springs that relax (standard linear).

F = F_0 - K (x - x_m) - B v - F_r(v) z - sum of K_i (x - e_i), e_i' = (x - e_i)/tau_i, dz/dx = (sign v - z)/w. Displacement
is straight between samples, and all of it exact there. The muscle rests at the lower end before the first ramp, and
between trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.judge.record import Array, Ramp, Trial, lagged

RATE = 50.0
REST, BETWEEN = 3.0, 1.0
"""Before the first ramp of a pressure, and between trials [s]."""
NOISE = {"displacement": 2e-6, "force": 0.15, "pressure": 300.0}


@dataclass(frozen=True)
class Bench:
    """SI throughout."""

    speeds: tuple[float, ...] = (2e-3, 5e-3, 10e-3)
    pressures: tuple[float, ...] = (3e5,)
    lower: float = 0.0
    upper: float = 20e-3
    cycles: int = 4
    middle: float = 500.0
    """Force at mid stroke."""
    stiff: float = 6500.0
    damps: float = 300.0
    friction: float = 12.0
    falls: float = 0.0
    """Friction that fades with the speed, as exp(-v/`fading`)."""
    fading: float = 3e-3
    reach: float = 0.8e-3
    """Way w on which a turn fades."""
    creeps: tuple[tuple[float, float], ...] = ()
    """Springs K_i and their time constants."""
    play: float = 0.0
    """Of what reads the displacement."""
    cell: float = 0.0
    """What the zero of the force cell goes away by in a second."""

    def without(self, x: Array) -> Array:
        """Force at rest, after any creep."""
        return self.middle - self.stiff * (x - 0.5 * (self.lower + self.upper))


def campaign(one: Bench, seed: int) -> list[Trial]:
    """The trials of all pressures; noise, and speeds within a thousandth, by the seed."""
    chance = np.random.default_rng([seed, *b"ramped"])
    knots, trials, now = [(0.0, one.lower)], [], 0.0
    for pressure in one.pressures:
        now += REST
        for speed in one.speeds:
            v, begun, ramps = speed * chance.uniform(0.999, 1.001), now, []
            for phase, start, end in (
                ("contract", one.lower, one.upper),
                ("expand", one.upper, one.lower),
            ) * one.cycles:
                ramps.append(Ramp(now, "displacement", end, start, phase, v))
                knots.append((now, start))
                now += (one.upper - one.lower) / v
                knots.append((now, end))
            trials.append((pressure, speed, begun, now, tuple(ramps)))
            now += BETWEEN
    t = np.arange(round(now * RATE)) / RATE
    x = np.interp(t, *np.array(knots).T)
    read = {"displacement": _held(x, one.play), "force": force(one, t, x), "pressure": np.zeros(len(t))}
    read = {name: values + NOISE[name] * chance.standard_normal(len(t)) for name, values in read.items()}
    found = []
    for pressure, speed, begun, ended, commands in trials:
        rows = (t >= begun - 1e-9) & (t <= ended + 2 / RATE)
        channels = {name: values[rows] + (pressure if name == "pressure" else 0.0) for name, values in read.items()}
        point = {"pressure": pressure, "speed": speed, "lower": one.lower, "upper": one.upper}
        found.append(Trial(point, 0, t[rows], channels, commands))
    return found


def force(one: Bench, t: Array, x: Array) -> Array:
    """[N], without noise."""
    v = np.gradient(x, t)
    F = one.without(x) - one.damps * v + one.cell * t
    F = F - (one.friction + one.falls * np.exp(-np.abs(v) / one.fading)) * _turned(x, one.reach)
    for stiff, time in one.creeps:
        F = F - stiff * (x - lagged(x, time, RATE))
    return np.asarray(F)


def _turned(x: Array, reach: float) -> Array:
    """Share and direction of the friction, z, which goes over to the other side exponentially along the way."""
    z, signs, keeps = np.zeros(len(x)), np.sign(np.diff(x)), np.exp(-np.abs(np.diff(x)) / reach)
    for i, (sign, keep) in enumerate(zip(signs.tolist(), keeps.tolist(), strict=True), 1):
        z[i] = sign + (z[i - 1] - sign) * keep
    return z


def _held(x: Sequence[float] | Array, play: float) -> Array:
    """What a sensor with play reads: it moves only where it is pushed."""
    seen, at = np.empty(len(x)), float(x[0])
    for i, here in enumerate(np.asarray(x).tolist()):
        at = min(max(at, here - play / 2), here + play / 2)
        seen[i] = at
    return seen
