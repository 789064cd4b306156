"""The three-element muscle as rates of change, in one function that is also copied into exported models; numpy only."""

from __future__ import annotations

from typing import Any

import numpy as np


def rates(t: float, state: Any, inputs: Any, params: dict[str, Any]) -> Any:
    """Rates of [contraction m, speed m/s] under [pressure Pa gauge, load N]: M x'' = F_ce - K x - B x' - F_c - F_L.

    Coefficients are joined by straight lines over the pressure, which go on beyond its ends; stiffness and damping stay
    above 0. Friction grows with the speed up to F_c within a few `v_0`; a stop of 1e8 N/m holds the muscle at 0.
    """
    x, v = float(state[0]), float(state[1])
    pressure, load = float(inputs[0]), float(inputs[1])
    knots = params["P"]
    left = min(max(int(np.searchsorted(knots, pressure)) - 1, 0), max(len(knots) - 2, 0))
    share = (pressure - knots[left]) / (knots[left + 1] - knots[left]) if len(knots) > 1 else 0.0

    def at(name: str) -> float:
        values = params[name]
        return float(values[left] + share * (values[left + 1] - values[left])) if len(knots) > 1 else float(values[0])

    damping = max(at("B_c" if v >= 0 else "B_r"), 1.0)
    friction = params["F_c"] * np.tanh(v / params["v_0"])
    stop = max(0.0, -1e8 * x - 4e4 * v) if x < 0 else 0.0
    a = (at("F_ce") - max(at("K"), 1.0) * x - damping * v - friction - load + stop) / params["M"]
    return np.array([v, a])
