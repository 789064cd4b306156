"""Steps of pressure of plant 5.1 under a hanging mass: every coefficient follows the pressure; solved by scipy.

M x'' + B x' + K(P) x = F_ce(P) - m g with F_ce = 1.08 P - 49, K = 5.6 + 1e-3 P + 9.7e-6 P^2, B = 1.2 + 1.6e-3 P
contracting and 1.1 + 3.4e-3 P relaxing (P in kPa, N, mm, s).
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from tests.judge.record import Array, Ramp, Trial
from tests.judge.stepped import AFTER, BEFORE, GRAVITY, NOISE, pressure


def pull(P: Array | float) -> Array:
    """F_ce [N] at a pressure [Pa]."""
    return np.maximum(0.0, 1.08e-3 * np.asarray(P) - 49.0)


def stiffness(P: Array | float) -> Array:
    """K [N/m]."""
    P = np.asarray(P)
    return np.asarray(5600.0 + 1e-3 * P + 9.7e-9 * P * P)


def damping(P: float, way: float) -> float:
    """B [N s/m]; `way` is above 0 while contracting."""
    return 1200.0 + 1.6e-3 * P if way > 0 else 1100.0 + 3.4e-3 * P


def step(
    before: float, after: float, mass: float, seed: int, *, dead: float = 0.04, lag: float = 0.0955, tube: float = 0.0,
    late: float = 0.0, rate: float = 500.0,
) -> Trial:  # fmt: skip
    """One step from rest; mass [kg], 0 for none and no load; `tube` [s]: the muscle has its pressure that much later."""
    W = GRAVITY * mass
    chance = np.random.default_rng([seed, round(before), round(after), round(1e3 * mass)])

    def moved(t: float, y: Array) -> list[float]:
        x, v = y
        P = float(pressure(t - tube, before, after, dead, lag))
        free = float(pull(P)) - W - float(stiffness(P)) * x
        if mass == 0.0:
            return [free / damping(P, free), 0.0]
        return [v, (free - damping(P, v) * v) / mass]

    rest = float((pull(before) - W) / stiffness(before))
    t = np.arange(-round(BEFORE * rate), round(AFTER * rate) + 1) / rate
    later = t[t > 0]
    solved = solve_ivp(moved, (0.0, AFTER), [rest, 0.0], t_eval=later, rtol=1e-9, atol=1e-11, max_step=5e-3)
    x = np.where(t > 0, np.interp(t, later, solved.y[0]), rest)
    read = {"pressure": pressure(t - late, before, after, dead, lag), "displacement": x}
    channels = {name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in read.items()}
    command = Ramp(BEFORE, "pressure", after, before, "step", 0.0)
    return Trial({"from": before, "pressure": after, "load": W, "mass": mass}, 0, BEFORE + t, channels, (command,))
