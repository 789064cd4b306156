"""Staircases of pressure of an arm that bends, sound or with a known fault: rests on the way up and down, three loads.

The angle is a sigmoid of the pressure; friction holds it back by half a gap on either way.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

LOADS = {0.0: (1.32, -1.30, 1.30e5, 2.9), 0.15: (1.21, -1.20, 1.38e5, 2.75), 0.35: (1.02, -1.04, 1.46e5, 2.6)}
"""Load [kg] -> a, b [rad], c [Pa], d of angle = a + b / (1 + (P/c)^d)."""
Terms = tuple[float, float, float, float]
POWERS = {"a": (1.32, -0.75, 0.1), "b": (-1.30, 0.70, -0.1), "c": (1.30e5, 0.45e5, 0.0), "d": (2.9, -0.9, 0.2)}
"""The same as powers of the load, from 0 on, for campaigns with more loads."""
PRELOAD, PRESSURES = 40e3, tuple(1e3 * P for P in (70, 100, 130, 160, 190, 230, 280, 340, 410, 490))
REPEATS, RATE = 3, 50.0
RAMP, HOLD = 80e3, 3.0
"""[Pa/s], [s]"""
GAP = 6e-3
"""Angle from above less from below [rad]."""
TURN = 4e-3
"""Motion over which half of the gap builds up [rad]."""
LAG = 0.06
"""Of the angle behind the pressure [s]."""
SCATTER = 5e-4
"""Between trials, standard deviation [rad]."""
NOISE = {"pressure": 300.0, "angle": 5e-4}
CREEP_TIME = 4.0
FULL = {"clean": 0.0, "creep": 0.06, "slow-sensor": 1.5, "slip": 0.03, "other-curve": 0.03}
"""Cause -> its full size: share of the angle; s; rad; rad."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")
NEAR = np.radians(1.0)


def by_powers(load: float) -> Terms:
    """a, b, c, d at a load [kg]."""
    a, b, c, d = (sum(value * load**n for n, value in enumerate(POWERS[name])) for name in "abcd")
    return a, b, c, d


def angle(P: Array, terms: Terms, other: float = 0.0) -> Array:
    """Angle without friction [rad] at P [Pa]; `other` is the height of a wave that makes it another curve."""
    a, b, c, d = terms
    over = np.maximum(P, 0.0)
    return np.asarray(a + b / (1 + (over / c) ** d) + other * np.sin(2 * np.pi * over / PRESSURES[-1]))


def truth(cause: str, size: float) -> Truth:
    """At rest after long; on the way up friction holds it back by half the gap, and may do so in any value."""
    amount = size * FULL[cause]
    other = amount if cause == "other-curve" else 0.0
    more = 1 + (amount if cause == "creep" else 0.0)
    fine = np.linspace(PRELOAD, PRESSURES[-1], 200001)
    right: Truth = {}
    for load in LOADS:
        low, top = (float(angle(np.array(P), LOADS[load], other)) * more for P in (PRELOAD, PRESSURES[-1]))
        right["alpha_0", "", load] = (low - GAP / 2, low)
        right["alpha_H", "", load] = (GAP, GAP)
        curve = angle(fine, LOADS[load], other) * more
        if other:
            top = max(float(angle(np.array(P), LOADS[load], other)) for P in PRESSURES)
        else:
            flat = float(fine[int(np.argmax(curve >= top - NEAR))])
            right["P_flat", "", load] = (flat, flat)
        right["alpha_max", "", load] = (top - GAP / 2, top)
    return right


def _behind(target: Array) -> Array:
    """What friction leaves of half the gap, from -1 on the way up to 1 on the way down."""
    state = np.empty_like(target)
    last, before = -1.0, float(target[0])
    for n, here in enumerate(target.tolist()):
        last = min(1.0, max(-1.0, last - (here - before) / TURN))
        state[n], before = last, here
    return state


def campaign(cause: str, size: float, seed: int, loads: Mapping[float, Terms] = LOADS) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size; chance is drawn from the seed.

    `loads` [kg] with their a, b [rad], c [Pa], d.

    creep
        The arm goes on bending by this share, with a time constant of 4 s.
    slow-sensor
        The angle has a filter of first order with this time constant.
    slip
        In one trial of a load, at a rest, the cable of the angle slips; from then on it reads that much less.
    other-curve
        A wave over the pressure, which the sigmoid has not.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    stairs = [("preload", PRELOAD), *(("up", P) for P in PRESSURES)]
    stairs += [("down", P) for P in [*PRESSURES[-2::-1], PRELOAD]]
    at, values, begins, before = [0.0, 0.2], [0.0, 0.0], [], 0.0
    for phase, P in stairs:
        begins.append((at[-1], phase, P, before))
        at += [at[-1] + abs(P - before) / RAMP, at[-1] + abs(P - before) / RAMP + HOLD]
        values += [P, P]
        before = P
    t = np.arange(round(at[-1] * RATE) + 1) / RATE
    P = np.interp(t, at, values)
    trials, since = [], 0.0
    for load, terms in loads.items():
        slips = int(chance.integers(REPEATS)) if cause == "slip" else -1
        slipped = 0.0
        for repeat in range(REPEATS):
            target = angle(P, terms, amount if cause == "other-curve" else 0.0)
            read = target - GAP / 2 * -_behind(target)
            if cause == "creep":
                read = read + amount * lagged(target, CREEP_TIME, RATE)
            read = lagged(read, amount if cause == "slow-sensor" else LAG, RATE)
            gone = np.full(len(t), slipped)
            if repeat == slips:
                gone = gone + amount * (t > chance.uniform(0.2, 0.8) * t[-1])
                slipped += amount
            read = read - gone + SCATTER * chance.standard_normal()
            channels = {
                name: one + NOISE[name] * chance.standard_normal(len(t))
                for name, one in (("pressure", P), ("angle", read))
            }
            commands = tuple(Ramp(since + when, "pressure", to, fro, phase, RAMP) for when, phase, to, fro in begins)
            trials.append(Trial({"tip_mass": load}, repeat, since + t, channels, commands))
            since += float(t[-1]) + 10.0
    return trials
