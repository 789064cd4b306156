"""Campaigns of a muscle held at one length while its pressure goes slowly up and down, sound or with a known fault.

F = (S0 - S1 x (1 + bend (1 - x/X))) (P - P0) - K0 x, no force below 0; a stop on the pressure makes the force while
emptying greater than while filling. All of it in closed form.
"""

from __future__ import annotations

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

S0, S1, P0, K0 = 2.5e-3, 0.030, 40e3, 2e3
"""[N/Pa], [N/Pa/m], [Pa], [N/m]"""
STROKE = 50e-3
CONTRACTIONS = tuple(STROKE * share for share in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
REPEATS = 3
TOP, RAMP, RATE = 500e3, 20e3, 50.0
"""[Pa], [Pa/s], [Hz]"""
SETTLE, HOLD, PAUSE = 1.0, 2.0, 8.0
"""[s]"""
GAP, TURN = 6.0, 5e3
"""Force while emptying less while filling [N]; change of pressure over which half of it builds up [Pa]."""
SCATTER = 1e-3
"""Between trials, standard deviation as a share of the force."""
NOISE = {"pressure": 500.0, "displacement": 2e-6, "force": 0.3}
FULL = {
    "clean": 0.0, "cell-drift": 15.0, "slip": 1e-3, "gives-way": 0.5e-3, "bend-x": 0.20, "bend-P": 0.06,
    "force-lag": 50e-3,
}  # fmt: skip
"""Cause -> its full size: N over the campaign; m; m at the greatest force; share of K; share of the slope; s."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")
FOLLOWED = 50e3
"""F_ce, K and F_b are asked for at multiples of this pressure [Pa]."""


def slope(x: Array, bend: float = 0.0) -> Array:
    """DF/dP [N/Pa] at a contraction [m]."""
    return np.asarray(S0 - S1 * x * (1 + bend * (1 - x / STROKE)))


def force(P: Array, x: Array, bend: float = 0.0, bend_P: float = 0.0) -> Array:
    """Force without hysteresis [N]; above 0 it pulls."""
    over = P - P0
    return np.asarray(slope(x, bend) * over * (1 + bend_P * (over / (TOP - P0) - 0.5)) - K0 * x)


def truth(cause: str, size: float) -> Truth:
    """What is right: where a curve is bent, slopes lie between the least and the greatest of their tangents."""
    amount = size * FULL[cause]
    bend, bend_P = (amount if cause == name else 0.0 for name in ("bend-x", "bend-P"))
    right: Truth = {}
    for x in CONTRACTIONS:
        m = float(slope(np.array(x), bend))
        right["m", "slope", x] = (m * (1 - 0.5 * bend_P), m * (1 + 1.5 * bend_P))
        right["H", "", x] = (GAP, GAP)
        if not bend_P:
            right["c", "intercept", x] = (-m * P0 - K0 * x,) * 2
        begins = float(_root(x, bend, bend_P))
        right["p_0", "", x] = (begins, begins)
    for P in FOLLOWED * np.arange(1, round(TOP / FOLLOWED) + 1):
        over = float((P - P0) * (1 + bend_P * ((P - P0) / (TOP - P0) - 0.5)))
        right["F_b", "", float(P)] = right["F_ce", "", float(P)] = (S0 * over,) * 2
        right["K", "", float(P)] = tuple(S1 * over * (1 + sign * bend) + K0 for sign in (-1, 1))
    return right


def _root(x: float, bend: float, bend_P: float) -> float:
    P = np.linspace(0.0, TOP, 500001)
    return float(P[int(np.argmax(force(P, np.array(x), bend, bend_P) >= 0))])


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size; chance is drawn from the seed.

    cell-drift
        The zero of the cell goes evenly with time, up with even seeds and down with odd ones, at rest too.
    slip
        Before one trial, drawn from the middle half, a mount of the muscle gives way: from then on it is held at that
        much less of contraction (more with odd seeds) than the displacement says.
    gives-way
        The driven end is pulled towards the muscle, in proportion to the force; the displacement shows it.
    bend-x, bend-P
        The force is bent over the contraction, or over the pressure.
    force-lag
        The cell has a filter of first order with this time constant.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    plan = [(repeat, x) for repeat in range(REPEATS) for x in CONTRACTIONS]
    slips = int(chance.integers(len(plan) // 4, 3 * len(plan) // 4)) if cause == "slip" else len(plan)
    sign = 1 - 2 * (seed % 2)
    bend, bend_P = (amount if cause == name else 0.0 for name in ("bend-x", "bend-P"))
    up = SETTLE + TOP / RAMP
    corners = np.array([0.0, SETTLE, up, up + HOLD, up + HOLD + TOP / RAMP, up + HOLD + TOP / RAMP + SETTLE])
    t = np.arange(round(corners[-1] * RATE) + 1) / RATE
    P = np.interp(t, corners, [0.0, 0.0, TOP, TOP, 0.0, 0.0])
    wound = _stop(P)
    trials = []
    for number, (repeat, x) in enumerate(plan):
        start = number * (t[-1] + PAUSE)
        held = x - (sign * amount if number >= slips else 0.0)
        given = np.zeros_like(t)
        for _ in range(8 if cause == "gives-way" else 1):
            pull = np.maximum(0.0, force(P, held + given, bend, bend_P) - 0.5 * GAP * wound)
            given = amount * pull / (S0 * (TOP - P0)) if cause == "gives-way" else given
        pull = pull * (1 + SCATTER * chance.standard_normal())
        if cause == "cell-drift":
            pull = pull + sign * amount * (start + t) / (len(plan) * (t[-1] + PAUSE))
        if cause == "force-lag":
            pull = lagged(pull, amount, RATE)
        read = {
            name: one + NOISE[name] * chance.standard_normal(len(t))
            for name, one in (("pressure", P), ("displacement", x + given), ("force", pull))
        }
        commands = (
            Ramp(start + SETTLE, "pressure", TOP, 0.0, "fill", RAMP),
            Ramp(start + up + HOLD, "pressure", 0.0, TOP, "empty", RAMP),
        )
        trials.append(Trial({"contraction": x}, repeat, start + t, read, commands))
    return trials


def _stop(P: Array) -> Array:
    """State of a stop on the pressure, from -1 to 1, shape as P; -1 at first."""
    state = np.empty_like(P)
    last, before = -1.0, P[0]
    for n, here in enumerate(P):
        last = min(1.0, max(-1.0, last + (here - before) / TURN))
        state[n], before = last, here
    return state
