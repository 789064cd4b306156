"""Steps of attitude of a platform on three muscles, sound or with one fault of known size in body, loop or sensor.

Rotation vectors: the platform turns about a point by torques of three ropes, whose anchors are rotated by matrices; its
two angles come from the matrix. The muscles are those of `pair`; a valve lets air through at a rate that depends on the
pressure alone. Steps of 1 ms by the explicit midpoint rule, all trials of a campaign at once. Left out is what no such
record can show: an accelerometer that is mounted askew, for it shows g in any attitude.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from tests.judge.pair import BLOCKS, Joint, load
from tests.judge.record import Array, Trial, Truth, lagged

G = 9.81
SPREAD, HEIGHT = 0.06, 0.25
"""Of the anchors from the middle, and of a muscle [m]."""
SLACK = 0.09
"""Contraction of all muscles when it is level [1]."""
LEAN, TURN = 0.022, 1.6
"""Moment of inertia about both axes [kg m2], damping by the joint and the muscles [N.m.s]."""
ABOVE = 0.02
"""Of the accelerometer above the joint [m]."""
SUPPLY, FILL, EMPTY = 7.0e5, 2.2e6, 0.9e6
"""[Pa], [Pa/s] at 3 bar."""
PERIOD, LEAST = 20e-3, 2e-3
RATE, FINE = 500.0, 1e-3
LEVEL, HOLD, BACK = 2.0, 4.0, 1.0
MEAN = 2.5e5
GOALS = tuple((np.radians(phi), np.radians(psi)) for phi, psi in ((10.0, 0.0), (0.0, -10.0), (8.0, 6.0)))
REPEATS = 2
REFERENCE_LAG, ATTITUDE_LAG, K_P, K_I, MOST = 0.06, 0.016, 10.0, 130.0, 10.0
NOISE = {"acceleration": 0.02, "pressure": 1e3}
FULL = {
    "clean": 0.0, "bias-x": 0.3, "bias-z": 0.4, "scale-x": 0.08, "drift": 0.3, "filter": 0.08, "filter-x": 0.15,
    "other-height": 0.04, "shaking": 0.4, "gyroscope-bias": np.radians(2.0), "late": 0.02,
    "unequal": 0.15, "slip": 1.0, "creep": 0.1, "too-much-gain": 1.0, "coarse": 0.15, "noisy": 10.0, "other-gravity": 0.01,
}  # fmt: skip
"""Cause -> its full size: m/s2; m/s2; share; m/s2 over a trial; s; s; m; m/s2; rad; s; share; % of
contraction; share in a decade of time; times; m/s2; times; share."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")
ANGLES = np.radians([90.0, 210.0, 330.0])
ANCHORS = SPREAD * np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(3)])
BASES = ANCHORS - np.array([0.0, 0.0, HEIGHT * (1 - SLACK)])[:, None]
VALVES = tuple(f"{kind}_{i}" for i in (1, 2, 3) for kind in ("fill", "exhaust"))


def place(at: Mapping[str, float]) -> float:
    return 1.0 + int(np.argmin([np.hypot(at["phi"] - a, at["psi"] - b) for a, b in GOALS]))


def _turned(phi: Array, psi: Array) -> Array:
    """Matrices of attitudes, shape (3, 3, n): about x that is fixed, then about y of the platform."""
    one, none = np.ones_like(phi), np.zeros_like(phi)
    about_x = np.array([[one, none, none], [none, np.cos(phi), -np.sin(phi)], [none, np.sin(phi), np.cos(phi)]])
    about_y = np.array([[np.cos(psi), none, np.sin(psi)], [none, one, none], [-np.sin(psi), none, np.cos(psi)]])
    return np.einsum("ijn,jkn->ikn", about_x, about_y)


def _ropes(phi: Array, psi: Array) -> tuple[Array, Array]:
    """Contractions [%], shape (3, n), and what each muscle's pull of 1 N turns about both axes [m], shape (2, 3, n)."""
    ax, ay, _ = ANCHORS[:, :, None]
    s, c, S = np.sin(phi), np.cos(phi), np.sin(psi)
    x, y, z = anchors = np.stack([np.cos(psi) * ax, s * S * ax + c * ay, s * ay - c * S * ax])
    ropes = anchors - BASES[:, :, None]
    lengths = np.sqrt(np.sum(ropes * ropes, axis=0))
    dx, dy, dz = -ropes / lengths
    moments = np.stack([y * dz - z * dy, c * (z * dx - x * dz) + s * (x * dy - y * dx)])
    return 100 * (1 - lengths / HEIGHT), moments


def _wanted(phi: Array, psi: Array, moment: Array) -> Array:
    """Pressures [Pa] by which a linear muscle would make the moments (2, n) at an attitude, shape (3, n)."""
    _, arms = _ropes(np.zeros_like(phi), np.zeros_like(psi))
    by_force = np.linalg.pinv(arms[:, :, 0])
    hold = np.stack([phi, psi]) * 34.0
    return np.asarray(np.clip(MEAN + by_force @ (moment + hold) / 1.75e-3, 20e3, 550e3))


@lru_cache(maxsize=8)
def _moved(cause: str, size: float, seed: int) -> tuple[Array, Array, Array, list[list[tuple[float, str, float]]]]:
    """Time [s], attitude (2, trials, n), pressures (3, trials, n), pulses of each trial."""
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    goals = np.array([goal for goal in GOALS for _ in range(REPEATS)]).T
    n, count = goals.shape[1], round((LEVEL + HOLD + BACK) / FINE)
    muscle, weaker = Joint(), np.ones((3, n))
    if cause == "unequal":
        weaker[0] = 1 - amount
    weaker = weaker * (1 + 0.01 * chance.standard_normal((3, n)))
    width = np.array([w for w, _ in BLOCKS])[:, None, None]
    share = np.array([s for _, s in BLOCKS])[:, None, None]
    state = np.clip(0.15 * chance.standard_normal((len(BLOCKS), 3, n)), -1, 1)
    q, turning, P = np.zeros((2, n)), np.zeros((2, n)), np.full((3, n), MEAN)
    contraction, _ = _ropes(*q)
    first, second, seen_1, seen_2 = (np.zeros((2, n)) for _ in range(4))
    integral, wanted = np.zeros((2, n)), P.copy()
    crept, times = np.zeros((3, 2, n)), np.array([0.5, 5.0, 50.0])[:, None, None]
    opens, until = np.full((3, n), -1.0), np.full((3, n), -1.0)
    attitudes, pressures = np.empty((2, n, count)), np.empty((3, n, count))
    pulses: list[list[tuple[float, str, float]]] = [[] for _ in range(n)]
    gain = K_I * (1 + (2.0 * amount if cause == "too-much-gain" else 0.0))
    off = np.array([[amount], [0.0]]) if cause == "gyroscope-bias" else np.zeros((2, 1))
    slips = LEVEL + chance.uniform(0.5, 2.5, n)
    for step in range(count):
        t = step * FINE
        attitudes[:, :, step], pressures[:, :, step] = q, P
        goal = goals if LEVEL <= t < LEVEL + HOLD else np.zeros((2, n))
        first = first + FINE / REFERENCE_LAG * (goal - first)
        second = second + FINE / REFERENCE_LAG * (first - second)
        seen_1 = seen_1 + FINE / ATTITUDE_LAG * (q + off - seen_1)
        seen_2 = seen_2 + FINE / ATTITUDE_LAG * (seen_1 - seen_2)
        integral = np.minimum(np.maximum(integral + FINE * gain * (second - seen_2), -MOST), MOST)
        if step % round(PERIOD / FINE) == 0:
            wanted = _wanted(*second, K_P * (second - seen_2) + integral)
            needed = (wanted - P) / np.where(wanted > P, FILL, EMPTY * (P + 1e5) / 4e5)
            seconds = np.clip(np.abs(needed), 0, PERIOD - 1e-3)
            seconds = np.where(seconds < LEAST, 0.0, seconds)
            opens, until = np.sign(needed), np.where(seconds > 0, t + seconds, -1.0)
            for m, k in zip(*np.nonzero(seconds), strict=True):
                valve = VALVES[2 * m + (0 if needed[m, k] > 0 else 1)]
                pulses[k].append((t, valve, float(seconds[m, k])))
        open_ = np.minimum(np.maximum((until - t) / FINE, 0), 1)
        P = P + FINE * open_ * np.where(opens > 0, FILL * (1 - (P / SUPPLY) ** 4), -EMPTY * (P + 1e5) / 4e5)
        new, arms = _ropes(*q)
        if cause == "slip":
            new[0] -= amount * (t > slips)
        state = np.minimum(np.maximum(state + (new - contraction) / width, -1), 1)
        contraction = new
        pulls = np.maximum(0.0, weaker * muscle.pull(new, P, False) - load(P) * (share * state).sum(axis=0))
        moment = np.einsum("amn,mn->an", arms, pulls)
        if cause == "creep":
            crept = crept + FINE / times * (moment - crept)
            moment = moment + amount * (moment - crept).sum(axis=0)
        middle = turning + 0.5 * FINE * (moment - TURN * turning) / LEAN
        turning = turning + FINE * (moment - TURN * middle) / LEAN
        q = q + FINE * middle
    return np.arange(count) * FINE, attitudes, pressures, pulses


def declared(cause: str, size: float) -> tuple[dict[str, dict[str, object]], dict[str, float]]:
    """What is known of the channels: a filter on all of them to 15 %, a clock to the time by which it is late, counts."""
    amount, names = size * FULL[cause], [f"acceleration_{axis}" for axis in "xyz"]
    facts: dict[str, object] = {}
    if cause == "filter":
        facts = {"sensor_lag": 0.85 * amount}
    elif cause == "late":
        facts = {"stream": "accelerometer"}
    elif cause == "coarse":
        facts = {"unit": "count", "slope": amount}
    return dict.fromkeys(names, facts) if facts else {}, {"accelerometer": amount} if cause == "late" else {}


def truth(cause: str, size: float, seed: int) -> Truth:
    """By the definitions, of the true attitude of these trials."""
    t, attitudes, _, pulses = _moved(cause, size, seed)
    since, right = t - LEVEL, Truth()
    held = (since > 0) & (since <= HOLD)
    for row, goal in enumerate(GOALS):
        found: dict[str, list[float]] = {"t_1": [], "OS_q": [], "e_q": [], "n_v": []}
        for k in range(row * REPEATS, (row + 1) * REPEATS):
            phi, psi = attitudes[:, k]
            away = np.hypot(phi - goal[0], psi - goal[1])
            outside = since[held & (away > np.radians(1.0))]
            if len(outside) == 0 or outside[-1] < 0.5 * HOLD:
                found["t_1"].append(float(outside[-1]) if len(outside) else 0.0)
            along = (phi * goal[0] + psi * goal[1]) / np.hypot(*goal)
            found["OS_q"].append(max(0.0, float(along[held].max() - np.hypot(*goal))))
            late = held & (since > HOLD - 1)
            found["e_q"].append(float(np.hypot(phi[late].mean() - goal[0], psi[late].mean() - goal[1])))
            found["n_v"].append(max(_openings(pulses[k], valve) for valve in VALVES) / HOLD)
        for symbol, values in found.items():
            exact = (float(np.mean(values)),) * 2 if len(values) == REPEATS else (np.inf, np.inf)
            right[symbol, "", 1.0 + row] = exact
    return right


def _openings(pulses: list[tuple[float, str, float]], valve: str) -> int:
    """How often a valve opens in a hold; it stays open from a pulse that fills its period to the next one."""
    count, shuts = 0, -1.0
    for begin, name, seconds in pulses:
        if name == valve:
            count += LEVEL < begin <= LEVEL + HOLD and begin - shuts > 1.5e-3
            shuts = begin + seconds
    return count


def _felt(cause: str, amount: float, t: Array, attitude: Array, chance: np.random.Generator) -> Array:
    """What the accelerometer shows [m/s2], shape (3, n)."""
    R = _turned(attitude[0], attitude[1])
    above = ABOVE + (amount if cause == "other-height" else 0.0)
    where = above * R[:, 2]
    swung = np.gradient(np.gradient(where, t, axis=1), t, axis=1)
    g = G * (1 + (amount if cause == "other-gravity" else 0.0))
    pushed = swung + np.array([0.0, 0.0, g])[:, None]
    if cause == "shaking":
        pushed[0] += amount * np.sin(2 * np.pi * 2.5 * t + chance.uniform(0, 6.28))
        pushed[1] += amount * np.sin(2 * np.pi * 2.5 * t + chance.uniform(0, 6.28))
    felt = np.einsum("ijn,in->jn", R, pushed)
    if cause == "bias-x":
        felt[0] += amount
    elif cause == "bias-z":
        felt[2] += amount
    elif cause == "scale-x":
        felt[0] *= 1 + amount
    elif cause == "drift":
        felt[1] += amount * t / t[-1]
    elif cause == "filter":
        felt = np.array([lagged(one, amount, 1 / FINE) for one in felt])
    elif cause == "filter-x":
        felt[0] = lagged(felt[0], amount, 1 / FINE)
    elif cause == "late":
        felt = np.array([np.interp(t - amount, t, one) for one in felt])
    return felt


def campaign(cause: str, size: float, seed: int) -> list[tuple[Trial, dict, list[tuple[float, str, float]]]]:
    """The trials, each with its law's report and its pulses, at `size` times the full size of a cause.

    bias-x, bias-z, scale-x, drift, filter, filter-x, other-height, late, coarse, noisy
        Of the accelerometer in the record; the loop has one of its own, which is right.
    shaking, other-gravity
        The base shakes; gravity is not what it is thought to be.
    gyroscope-bias
        The loop holds another attitude than it should.
    unequal, slip, creep, too-much-gain
        Of muscles, mount and loop.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed + 7, *cause.encode(), round(1000 * size)])
    t, attitudes, pressures, pulses = _moved(cause, size, seed)
    every = round(1 / (RATE * FINE))
    found = []
    for k in range(attitudes.shape[1]):
        since, few = k * 10.0, t[::every]
        felt = _felt(cause, amount, t, attitudes[:, k], chance)[:, ::every]
        noise = NOISE["acceleration"] * (1 + (amount if cause == "noisy" else 0.0))
        felt = felt + noise * chance.standard_normal(felt.shape)
        if cause == "coarse":
            felt = amount * np.round(felt / amount)
        read = {f"acceleration_{axis}": one for axis, one in zip("xyz", felt, strict=True)}
        read |= {
            f"pressure_{i + 1}": one[::every] + NOISE["pressure"] * chance.standard_normal(len(few))
            for i, one in enumerate(pressures[:, k])
        }
        goal = GOALS[k // REPEATS]
        law = {
            "t0": since, "ended": "time", "chain": "reference", "saturated": 0.0, "reference_lag": REFERENCE_LAG,
            "goals": [[0.0, 0.0, 0.0], [LEVEL, *goal], [LEVEL + HOLD, 0.0, 0.0]],
        }  # fmt: skip
        point = {"phi": float(goal[0]), "psi": float(goal[1])}
        mine = [(since + begin, valve, seconds) for begin, valve, seconds in pulses[k]]
        found.append((Trial(point, k % REPEATS, since + few, read, ()), law, mine))
    return found
