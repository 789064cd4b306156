"""Steps of pressure that make a hanging mass ring, as another program's file holds them, sound or with a known fault.

M x'' = S P - K x (1 + bend (1/2 - x/X)) - B x' - friction - what is fixed; solved in small steps, the pressure in
closed form.
"""

from __future__ import annotations

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth

MASS, K, B, S = 4.0, 9.0e3, 60.0, 8.0e-4
"""[kg], [N/m], [N s/m], [N/Pa]"""
LOW, HIGH = 180e3, 280e3
WAY = S * (HIGH - LOW) / K
"""Of a step [m]."""
DEAD, LAG = 0.014, 0.024
"""Of the pressure behind its command [s]."""
BEFORE, AFTER, REPEATS = 1.0, 4.0, 3
RATE, FINE = 250.0, 8
NOISE = {"pressure": 200.0, "displacement": 3e-6}
CREEP_TIME = 2.5
FULL = {"clean": 0.0, "friction": 8.0, "bend": 0.30, "creep": 0.08, "drift": 0.5e-3, "late": 4e-3}
"""Cause -> its full size: N; share of K over the way; share of the way; m over a trial; s."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")


def truth(cause: str, size: float) -> Truth:
    """By the pressure before: of a step up and of one down; a muscle that creeps is given its end after long."""
    amount = size * FULL[cause]
    right: Truth = {("t_d", "", 0.0): (DEAD, DEAD)}
    stuck = 2 * amount / K if cause == "friction" else 0.0
    more = 1 + (amount if cause == "creep" else 0.0)
    bend = amount if cause == "bend" else 0.0
    for before, way in ((LOW, WAY), (HIGH, -WAY)):
        ends = sorted((way * more - stuck, way * more + stuck)) if not bend else sorted(_bent_way(amount, way))
        right["t_d", "", before] = (DEAD, DEAD)
        right["tau_P", "", before] = (LAG, LAG)
        right["X", "", before] = (ends[0], ends[1])
        size_P = (HIGH - LOW) * (1 if way > 0 else -1)
        slopes = sorted(size_P / end for end in ends)
        right["dP/dx", "", before] = (slopes[0], slopes[1])
        right["K", "", before] = (K * (1 + bend / 2 - 2 * bend * _rest(HIGH, bend) / WAY), K * (1 + bend / 2))
        right["B", "", before] = (B, B)
    return right


def _rest(P: float, bend: float) -> float:
    """Contraction at rest at a pressure, from that at the lower one on [m]."""
    pull = S * (P - LOW) / K
    if not bend:
        return pull
    a, b = -bend / WAY, 1 + bend / 2
    return float((b - np.sqrt(b * b + 4 * a * pull)) / (-2 * a))


def _bent_way(bend: float, way: float) -> tuple[float, float]:
    end = _rest(HIGH, bend) * np.sign(way)
    return end, end


def _pressure(t: Array, before: float, after: float) -> Array:
    late = np.maximum(t - DEAD, 0.0)
    return np.asarray(before + (after - before) * -np.expm1(-late / LAG))


def _moved(t: Array, P: Array, start: float, friction: float, bend: float) -> Array:
    """Contraction [m] over time from rest."""
    h = float(t[1] - t[0])
    x, v = start, 0.0
    found = np.empty(len(t))
    for n, pull in enumerate((S * (P - LOW)).tolist()):
        found[n] = x
        stiff = K * (1 + bend * (0.5 - x / WAY))
        free = pull - stiff * x
        if v == 0.0 and abs(free) <= friction:
            continue
        way = np.sign(v) if v else np.sign(free)
        damped = 0.5 * h * B / MASS
        after = ((1 - damped) * v + h / MASS * (free - friction * way)) / (1 + damped)
        v = 0.0 if friction and after * way < 0 else after
        x += h * v
    return found


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size; chance is drawn from the seed.

    friction
        Dry friction: the swing dies along a line, and rests anywhere near its end.
    bend
        The spring is steeper at the lower end of the way and flatter at the upper.
    creep
        The contraction goes on by this share.
    drift
        The displacement goes evenly with time.
    late
        The pressure is written down that much later than it was read (earlier with odd seeds).
    """
    amount = size * FULL[cause]
    sign = 1 - 2 * (seed % 2)
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    trials, since = [], 0.0
    fine = np.arange(-round(BEFORE * RATE) * FINE, round(AFTER * RATE) * FINE + 1) / (RATE * FINE)
    late = sign * amount if cause == "late" else 0.0
    for repeat in range(REPEATS):
        for before, after in ((LOW, HIGH), (HIGH, LOW)):
            bend = amount if cause == "bend" else 0.0
            P = _pressure(fine, before, after)
            way = _moved(fine, P, _rest(before, bend), amount if cause == "friction" else 0.0, bend)
            t, x = fine[::FINE], way[::FINE]
            if cause == "creep":
                x = x + amount * (WAY if after > before else -WAY) * -np.expm1(-np.maximum(t, 0) / CREEP_TIME)
            if cause == "drift":
                x = x + amount * (t - t[0]) / (t[-1] - t[0])
            read = {
                name: one + NOISE[name] * chance.standard_normal(len(t))
                for name, one in (("pressure", _pressure(t - late, before, after)), ("displacement", x))
            }
            start = since + BEFORE
            point = {"from": before, "pressure": after, "mass": MASS}
            trials.append(Trial(point, repeat, start + t, read, (Ramp(start, "pressure", after, before, "step", 0.0),)))
            since += BEFORE + AFTER + 3.0
    return trials
