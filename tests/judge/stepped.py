"""Steps of pressure under a hanging mass or against a spring: M x'' + B x' + (K + k) x = S (P - P0) - m g + ..., solved.

The force cell is above the muscle: it reads S (P - P0) - K x - B x'. Runge-Kutta in small steps by scipy, the pressure
in closed form; plain numbers, no curve of a published muscle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

from tests.judge.record import Array, Ramp, Trial

S, P0 = 1.05e-3, 50e3
"""dF_ce/dP [N/Pa], and the pressure from which on the muscle pulls [Pa]."""
GRAVITY = 9.81
BEFORE, AFTER = 1.0, 3.0
NOISE = {"pressure": 300.0, "displacement": 5e-6, "force": 0.3}


def pressure(t: Array | float, before: float, after: float, dead: float, lag: float) -> Array:
    """Behind a command at t = 0 [Pa]."""
    since = np.maximum(np.asarray(t) - dead, 0.0)
    return np.asarray(before - (after - before) * np.expm1(-since / lag))


def step(
    before: float, after: float, *, mass: float, K: float, B: float, seed: int, load: float | None = None,
    spring: float = 0.0, dead: float = 0.04, lag: float = 0.0955, tube: float = 0.0, late: float = 0.0,
    rate: float = 500.0, start: float = 0.0, repeat: int = 0, cell: bool = False,
) -> Trial:  # fmt: skip
    """One step from rest; `late`: the pressure is written down that much after it was read [s].

    `tube`: the muscle has the pressure that much later than its sensor [s]; `load` [N] hangs, the weight of `mass` [kg]
    where it is not given; `spring` [N/m] pulls back from x = 0 on.
    """
    W = GRAVITY * mass if load is None else load
    chance = np.random.default_rng([seed, round(before), round(after), round(1e3 * mass), repeat])

    def moved(t: float, y: Array) -> list[float]:
        x, v = y
        pull = S * (float(pressure(t - tube, before, after, dead, lag)) - P0) - K * x - B * v
        if mass == 0.0:
            return [(S * (float(pressure(t - tube, before, after, dead, lag)) - P0) - W - (K + spring) * x) / B, 0.0]
        return [v, (pull - W - spring * x) / mass]

    rest = (S * (before - P0) - W) / (K + spring)
    t = np.arange(-round(BEFORE * rate), round(AFTER * rate) + 1) / rate
    after_it = t[t > 0]
    solved = solve_ivp(moved, (0.0, AFTER), [rest, 0.0], t_eval=after_it, rtol=1e-9, atol=1e-11, max_step=5e-3)
    x = np.where(t > 0, np.interp(t, after_it, solved.y[0]), rest)
    v = np.gradient(x, 1 / rate) if mass == 0.0 else np.where(t > 0, np.interp(t, after_it, solved.y[1]), 0.0)
    read = {"pressure": pressure(t - late, before, after, dead, lag), "displacement": x}
    if cell:
        read["force"] = S * (pressure(t - tube, before, after, dead, lag) - P0) - K * x - B * v
    channels = {name: one + NOISE[name] * chance.standard_normal(len(t)) for name, one in read.items()}
    point = {"from": before, "pressure": after, "load": W, "mass": mass}
    began = start + BEFORE
    return Trial(point, repeat, began + t, channels, (Ramp(began, "pressure", after, before, "step", 0.0),))


def steps(levels: Sequence[tuple[float, float]], **how: float) -> list[Trial]:
    """Several steps, one after another."""
    return [step(*pair, start=n * (BEFORE + AFTER + 3.0), **how) for n, pair in enumerate(levels)]  # type: ignore[arg-type]
