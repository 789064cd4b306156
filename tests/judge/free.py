"""Campaigns of lengths without load over pressure, sound or with one fault of known size.

The length is that of paper 2 (home-made contractors, equations 1 and 2, exponent -0.248) for 30 cm; it follows the
pressure through a lag. Every pressure is reached from below and from above, after a rest without pressure.
"""

from __future__ import annotations

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

LENGTH = 0.30
"""[m]"""
PRESSURES = tuple(1e3 * P for P in (0, 40, 60, 80, 100, 120, 140, 170, 200, 260, 340, 420, 500))
REPEATS = 3
RATE = 50.0
RAMP = 100e3
"""[Pa/s]"""
REST, HOLD, PAUSE = 2.0, 4.0, 3.0
"""[s]"""
LAG = 0.1
"""Of the length behind the pressure [s]."""
GAP = 0.01
"""Contraction from above less from below, as a share of it."""
SCATTER = 2e-4
"""Between trials, standard deviation as a share of the contraction."""
NOISE = {"pressure": 500.0, "displacement": 10e-6}
CREEP_TIME = 3.0
"""[s]"""
FULL = {"clean": 0.0, "creep": 0.03, "slip": 1e-3, "zero-drift": 1e-3, "other-curve": 0.01}
"""Cause -> its full size: share of a contraction; m; m over the campaign; share of the length."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")
CM, BAR = 1e-2, 1e5


def coefficients() -> dict[str, float]:
    """A to e of paper 2 for this length [SI]: length = a + b/(1 + (p/c)^d)^e - 0.009 L0 sqrt(p), p in bar."""
    L = LENGTH / CM
    a = 0.4351 * L + 0.0183 * L**2 - 0.0003 * L**3
    c = -0.0141 * L + 0.0031 * L**2 - 0.00006 * L**3
    d = 0.5487 * L - 0.0136 * L**2 + 0.00007 * L**3
    return {"a": a * CM, "b": (L - a) * CM, "c": c * BAR, "d": d, "e": 0.3694 * L**-0.248}


def contraction(P: Array, other: float = 0.0) -> Array:
    """L0 less the length [m] at P [Pa]; `other` is by which share of L0 a wave over pressure makes it another curve."""
    k, p = coefficients(), np.maximum(P, 0.0)
    length = k["a"] + k["b"] / (1 + (p / k["c"]) ** k["d"]) ** k["e"] - 0.009 * LENGTH * np.sqrt(p / BAR)
    return np.asarray(LENGTH - length - other * LENGTH * np.sin(2 * np.pi * p / PRESSURES[-1]))


def truth(cause: str, size: float) -> Truth:
    """Lengths to which it comes at rest, from which side it may; the coefficients where the curve has them."""
    amount = size * FULL[cause]
    other = amount if cause == "other-curve" else 0.0
    more = 1 + (amount if cause == "creep" else 0.0)
    right: Truth = {}
    for P in PRESSURES:
        x = float(contraction(np.array(P), other)) * more
        right["L", "", P] = (LENGTH - x,) * 2
        right["x_H", "", P] = (GAP * x,) * 2
    fine = np.linspace(0.0, PRESSURES[-1], 50001)
    curve = contraction(fine, other)
    right["P_half", "", 0.0] = (float(fine[int(np.argmax(curve >= 0.5 * curve[-1]))]),) * 2
    top = max(float(contraction(np.array(P), other)) for P in PRESSURES) * more
    right["eps_max", "", PRESSURES[-1]] = (top / LENGTH,) * 2
    if cause not in ("creep", "other-curve"):
        right |= {("L", name, 0.0): (value, value) for name, value in coefficients().items()}
    return right


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size; chance is drawn from the seed.

    creep
        It goes on contracting by this share, with a time constant of 3 s.
    slip
        From one trial on, drawn from the middle half, the mount of the displacement sensor makes it read that much
        less, at rest too.
    zero-drift
        The zero of the displacement goes evenly with time, up with even seeds and down with odd ones.
    other-curve
        The length over pressure has a wave that the sigmoid has not.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    plan = [(repeat, P, side) for repeat in range(REPEATS) for P in PRESSURES for side in (-1.0, 1.0)]
    slips = int(chance.integers(len(plan) // 4, 3 * len(plan) // 4)) if cause == "slip" else len(plan)
    trials, start = [], 0.0
    for number, (repeat, P, side) in enumerate(plan):
        t, asked, commands = _pressure(P, side, start)
        factor = 1 + 0.5 * side * GAP + SCATTER * chance.standard_normal()
        x = factor * lagged(contraction(asked, amount if cause == "other-curve" else 0.0), LAG, RATE)
        if cause == "creep":
            x = x + amount * lagged(x, CREEP_TIME, RATE)
        if number >= slips:
            x = x - amount
        if cause == "zero-drift":
            x = x + (1 - 2 * (seed % 2)) * amount * number / (len(plan) - 1)
        read = {
            name: one + NOISE[name] * chance.standard_normal(len(t))
            for name, one in (("pressure", asked), ("displacement", x))
        }
        trials.append(Trial({"pressure": P, "side": side}, repeat, t, read, commands))
        start = float(t[-1]) + PAUSE
    return trials


def _pressure(P: float, side: float, start: float) -> tuple[Array, Array, tuple[Ramp, ...]]:
    """Times [s], pressure [Pa] and commands of one trial."""
    top = PRESSURES[-1]
    way = [("rest", 0.0, REST)]
    if side > 0:
        way += [("fill", top, REST)]
    way += [("empty" if side > 0 and top > P else "fill", P, HOLD), ("vent", 0.0, 0.0)]
    at, value, corners, commands = start, 0.0, [(start, 0.0)], []
    for phase, goal, hold in way:
        if abs(goal - value) > 1.0:
            commands.append(Ramp(at, "pressure", goal, value, phase, RAMP))
            at += abs(goal - value) / RAMP
            corners.append((at, goal))
        at += hold
        corners.append((at, goal))
        value = goal
    t = start + np.arange(round((at - start) * RATE) + 1) / RATE
    places, values = np.array(corners).T
    return t, np.interp(t, places, values), tuple(commands)
