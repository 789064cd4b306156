"""Campaigns of holds at a pressure during which the rubber of a muscle gives way, sound or with a known fault.

The force relaxes by a share of log10(1 + t/t0) of itself, and what one hold did comes back after it in the same way.
"""

from __future__ import annotations

from math import log10

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

AREA, RUBBER = 8.2e-4, 35.0
"""Force by pressure [m2], and of the rubber alone at this contraction [N], which pulls back."""
AT = 12e-3
"""Contraction [m]."""
SHARE, SHORTEST = 0.018, 0.03
"""Loss in each decade [1] of the force without relaxation, and time from which on it counts in decades [s]."""
PRESSURES, REPEATS = (2.2e5, 4.1e5), 2
HOLD, REST, QUIET = 200.0, 700.0, 5.0
FOLLOWS = 0.22
"""Time constant of the regulator [s]."""
WANDERS, SLOWLY = 0.001, 9.0
"""Share by which the regulator wanders, and in what time [s]."""
RATE = 20.0
NOISE = {"pressure": 250.0, "force": 0.25, "displacement": 4e-6}
FULL = {
    "clean": 0.0, "cell-drift": 12.0, "power-law": 0.35, "two-times": 0.05, "slip": 0.01, "early": 0.25, "short-rest": 1.0,
    "gauge-drift": 0.01, "warm": 0.03,
}  # fmt: skip
"""Cause -> its full size: N over a campaign; exponent; share; share of the force; share of a hold that is lost at its
end; the rest is shorter; share of the pressure over a trial; share of the force that warm air adds at the step."""


def _loss(t: Array, cause: str, amount: float) -> Array:
    """Share of the force that is gone at times after the step [s]."""
    since = np.maximum(t, 0.0)
    log = SHARE * np.log10(1 + since / SHORTEST)
    if cause == "power-law":
        return np.asarray(log * (1 + amount * np.log10(1 + since)))
    if cause == "two-times":
        return np.asarray(log + amount * (1 - np.exp(-since / 25.0)))
    return log


def truth(cause: str, size: float) -> Truth:
    """Relaxation per decade and force at 1 s at each pressure, where the force is a straight line over log t."""
    if cause in {"power-law", "two-times"} and size:
        return {}
    right: Truth = {}
    for P in PRESSURES:
        force, at_once = AREA * P - RUBBER, 1 + SHARE * log10(SHORTEST)
        right["s", "", P] = (SHARE / at_once,) * 2
        right["F_1", "", P] = (force * at_once,) * 2
    return right


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials with a cause at `size` times its full size; chance by the seed.

    cell-drift
        The zero of the force cell goes away in proportion to time, over the whole campaign.
    power-law, two-times
        No straight line over log t: it bends, or an exponential of 25 s is added to it.
    slip
        A mount lets go by this share of the force in the middle of a hold.
    early
        A leak takes this share of the pressure in the last fifth of a hold, which the gauge sees.
    short-rest
        The rest is shorter, down to a tenth of the hold.
    gauge-drift
        The gauge reads that much too high at the end of each trial, and right at its start.
    warm
        Air that is warm after the fill pulls more for some seconds, at a pressure that the regulator holds.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    rest = REST if cause != "short-rest" else REST * (1 - amount) + 0.1 * HOLD * amount
    length = 2 * QUIET + HOLD
    t = np.arange(round(length * RATE)) / RATE
    whole = len(PRESSURES) * REPEATS * (length + rest)
    earlier: list[tuple[float, float]] = []
    trials = []
    for number, P in enumerate(chance.permutation(np.repeat(PRESSURES, REPEATS)).tolist()):
        begin = number * (length + rest)
        now, step, end = begin + t, begin + QUIET, begin + QUIET + HOLD
        held = np.where((now >= step) & (now < end), P, 0.0)
        wander = lagged(chance.standard_normal(len(t)), SLOWLY, RATE) * np.sqrt(2 * SLOWLY * RATE)
        inside = lagged(held, FOLLOWS, RATE) * (1 + WANDERS * wander)
        if cause == "early":
            inside *= 1 - amount * np.clip((now - end + 0.2 * HOLD) / (0.2 * HOLD), 0.0, 1.0)
        pull = AREA * inside - RUBBER * inside / P
        force = pull * (1 - _loss(now - step, cause, amount))
        full = AREA * P - RUBBER
        for of, since in earlier:  # what holds before did, fades as it came
            left = _loss(now - since, "clean", 0.0) - _loss(now - since - HOLD, "clean", 0.0)
            force -= (AREA * of - RUBBER) * left * inside / P
        if cause == "slip":
            force -= amount * full * (now > step + HOLD / 2) * inside / P
        if cause == "warm":
            force += amount * full * np.exp(-np.maximum(now - step, 0.0) / 3.0) * inside / P
        if cause == "cell-drift":
            force = force + amount * now / whole
        gauge = inside * (1 + amount * (now - begin) / length) if cause == "gauge-drift" else inside
        values = {"pressure": gauge, "force": force, "displacement": np.full(len(t), AT)}
        read = {name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in values.items()}
        commands = (
            Ramp(step, "pressure", P, 0.0, "step", 0.0),
            Ramp(end, "pressure", 0.0, P, "vent", 0.0),
        )
        trials.append(
            Trial({"contraction": AT, "pressure": P}, len([p for p, _ in earlier if p == P]), now, read, commands)
        )
        earlier.append((P, step))
    return trials
