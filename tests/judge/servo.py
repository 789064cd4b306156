"""Steps and sines of a joint that two muscles turn in closed loop, sound or with one fault of known size.

The muscles are those of `pair`, with slipping blocks, which yield along every motion; the regulators answer with two
real poles and stick within a dead band; the joint is a pendulum that swings freely. Steps of 2 ms by Heun's rule, all
trials of a campaign at once. The controller knows another muscle than the one that is there.
Left out is what no record of such a loop can show: an encoder that is loose or drifts, for the loop goes by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from tests.judge.pair import BLOCKS, RADIUS, Joint, load
from tests.judge.record import Array, Trial, Truth, lagged

INERTIA, RUBS = 0.02, 0.55
"""[kg m2], [N.m.s/rad]: of the joint and of both muscles."""
WEIGHT = 0.4
"""Of what hangs on the joint, at 90 deg [N.m]."""
SLOW, SLOWER, STICKS = 0.05, 0.09, 600.0
"""Poles of a regulator [s], and its dead band [Pa]."""
FINE, RATE = 2e-3, 100.0
EVERY = round(1 / (RATE * FINE))
BASELINE, HOLD, WINDOW, BAND, LAG = 2.0, 6.0, (4.5, 6.0), np.radians(0.5), 0.07
"""[s]; [s]; [s]; [rad]; of each of the two lags of the reference [s]."""
SINE, SINES_FROM, SINE_HOLD = 0.5, 2.0, 10.0
"""[Hz]; [s]; [s]"""
GOALS = ((np.radians(20.0), 0.0), (np.radians(20.0), 10.0), (np.radians(-12.0), 10.0))
"""[rad], integral gain [N.m/(rad s)] of the steps; the first has no integral action."""
SWING = (np.radians(8.0), 10.0)
REPEATS = 3
MEAN = 2.6e5
NOISE = {"angle": 3.5e-4, "pressure_1": 300.0, "pressure_2": 300.0}
FULL = {
    "clean": 0.0, "angle-lag": 0.10, "angle-late": 0.05, "slip": np.radians(3.0),
    "mount-slips": 0.6, "creep": 0.15, "unequal": 0.15, "wrong-radius": 0.10, "hunting": 1.0, "restless": np.radians(2.0),
    "shaking": 0.3, "slow-regulators": 4.0, "noisy": 20.0, "coarse": np.radians(0.35),
}  # fmt: skip
"""Cause -> its full size: s; s; rad; % of contraction; share of the torque in a decade of time; share; share; of
the gain that makes it hunt; rad; N.m; times; times; rad."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")


def place(at: Mapping[str, float]) -> float:
    """One number for each operating point."""
    if "frequency" in at:
        return 4.0
    near = [abs(goal - at["goal"]) + abs(gain - at["integral"]) for goal, gain in GOALS]
    return 1.0 + int(np.argmin(near))


def _pressures(reference: Array, torque: Array, radius: float) -> list[Array]:
    """Of both muscles [Pa], by what the controller believes: straight lines through the middle of `pair`'s muscle."""
    arm = radius * 1.65e-3
    """Torque by pressure [N.m/Pa]."""
    stiff = 17.0 * radius / RADIUS
    more = (torque + stiff * reference) / (2 * arm)
    return [np.clip(MEAN + sign * more, 20e3, 550e3) for sign in (1, -1)]


class _Blocks:
    """Slipping blocks of both muscles of each trial, shape (blocks, 2, trials)."""

    def __init__(self, trials: int, chance: np.random.Generator) -> None:
        self.width = np.array([width for width, _ in BLOCKS])[:, None, None]
        self.share = np.array([share for _, share in BLOCKS])[:, None, None]
        self.state = np.clip(0.15 * chance.standard_normal((len(BLOCKS), 2, trials)), -1, 1)

    def moved(self, way: Array) -> Array:
        """State from -1 to 1 after the contractions changed by `way` [%], shape (2, trials)."""
        self.state = np.clip(self.state + way / self.width, -1.0, 1.0)
        return np.asarray((self.share * self.state).sum(axis=0))


@lru_cache(maxsize=8)
def _swung(cause: str, size: float, seed: int) -> tuple[Array, Array, Array, Array]:
    """Time from the closing of the loop [s], true angle and both pressures [trials, n]."""
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    rows = [*(row for row in GOALS for _ in range(REPEATS)), *[SWING] * REPEATS]
    goal, gain = (np.array(column) for column in zip(*rows, strict=True))
    sines = np.arange(len(rows)) >= len(GOALS) * REPEATS
    count, n = round((BASELINE + SINE_HOLD) / FINE), len(rows)
    joint = Joint.of(cause, amount)
    if cause == "hunting":
        gain = gain * (1 + 4.0 * amount)
    radius = RADIUS * (1 + (amount if cause == "wrong-radius" else 0.0))
    blocks, slow = _Blocks(n, chance), np.array([SLOW, SLOWER]) * (1 + (amount if cause == "slow-regulators" else 0.0))
    angle, turning = np.zeros(n), np.zeros(n)
    if cause == "restless":
        angle = amount * chance.uniform(-1, 1, n)
    valves, pressures, first, second = (np.full((2, n), MEAN) for _ in range(4))
    integral, lag_1, lag_2 = np.zeros(n), angle.copy(), angle.copy()
    crept = np.zeros((3, n))
    times = np.array([0.5, 5.0, 50.0])[:, None]
    slips = BASELINE + chance.uniform(0.5, 4.0, n)
    differs = 1 + 0.01 * chance.standard_normal((2, n))
    phase = chance.uniform(0, 2 * np.pi, n)
    course, inside = np.empty((count, n)), np.empty((count, 2, n))
    contraction = np.stack([joint.contraction(angle, sign) for sign in (1, -1)])
    seen = angle.copy()
    for step in range(count):
        t = step * FINE
        course[step], inside[step] = angle, pressures
        if step % EVERY == 0:  # the controller, 100 times a second
            target = np.where((t >= BASELINE) & ~sines, goal, 0.0)
            for _ in range(EVERY):
                lag_1 = lag_1 + FINE / LAG * (target - lag_1)
                lag_2 = lag_2 + FINE / LAG * (lag_1 - lag_2)
            reference = lag_2 + np.where(sines & (t >= BASELINE), goal * np.sin(2 * np.pi * SINE * (t - BASELINE)), 0.0)
            seen = _encoder(cause, amount, angle, t, slips, seen)
            integral = np.clip(integral + 0.01 * gain * (reference - seen), -8, 8)
            wanted = np.stack(_pressures(reference, integral, radius))
            valves = np.where(np.abs(wanted - valves) > STICKS, wanted, valves)
        first = first + FINE / slow[0] * (valves - first)
        second = second + FINE / slow[1] * (first - second)
        pressures = second
        new = np.stack([joint.contraction(angle, sign) for sign in (1, -1)])
        if cause == "mount-slips":
            new[0] -= amount * (t > slips)
        state = blocks.moved(new - contraction)
        contraction = new
        loads = np.stack([load(pressures[0]), load(pressures[1])])
        pulls = [
            np.maximum(0.0, differs[m] * joint.pull(new[m], pressures[m], m == 1) - loads[m] * state[m]) for m in (0, 1)
        ]
        torque = joint.radius(angle) * (pulls[0] - pulls[1])
        if cause == "creep":
            crept = crept + FINE / times * (torque - crept)
            torque = torque + amount * (torque - crept).sum(axis=0)
        if cause == "shaking":
            torque = torque + amount * np.sin(2 * np.pi * 0.9 * t + phase)
        pushed = torque - WEIGHT * np.sin(angle) - RUBS * turning
        ahead = turning + FINE * pushed / INERTIA
        again = torque - WEIGHT * np.sin(angle) - RUBS * ahead
        angle = angle + FINE * 0.5 * (turning + ahead)
        turning = turning + FINE * 0.5 * (pushed + again) / INERTIA
    return np.arange(count) * FINE, course.T, inside[:, 0].T, inside[:, 1].T


def _encoder(cause: str, amount: float, angle: Array, t: float, slips: Array, seen: Array) -> Array:
    """What the encoder shows, 10 ms after it showed `seen`."""
    if cause == "angle-lag":
        return seen + (1 - np.exp(-0.01 / amount)) * (angle - seen)
    if cause == "slip":
        return angle + amount * (t > slips)
    if cause == "coarse":
        return amount * np.round(angle / amount)
    return angle


def declared(cause: str, size: float) -> tuple[dict[str, dict[str, object]], dict[str, float]]:
    """What is known of the encoder: a filter to 15 %, a clock to the time by which it is late, a count."""
    amount = size * FULL[cause]
    if cause == "angle-lag":
        return {"angle": {"sensor_lag": 0.85 * amount}}, {}
    if cause == "angle-late":
        return {"angle": {"stream": "encoder"}}, {"encoder": amount}
    return {"angle": {"unit": "count", "slope": amount}} if cause == "coarse" else {}, {}


def truth(cause: str, size: float, seed: int) -> Truth:
    """By the definitions, of the true angle of these trials."""
    t, course, _, _ = _swung(cause, size, seed)
    since = t - BASELINE
    right: Truth = {}
    for row, (goal, _) in enumerate(GOALS):
        mine = course[row * REPEATS : (row + 1) * REPEATS]
        held = (since > 0) & (since <= HOLD)
        way = np.sign(goal)
        late = held & (since >= WINDOW[0]) & (since <= WINDOW[1])
        found: dict[str, list[float]] = {"e_th": [], "t_s": [], "t_r": [], "OS_th": []}
        for angle in mine:
            found["e_th"].append(float(angle[late].mean() - goal))
            origin = float(angle[(since >= -0.3) & (since < 0)].mean())
            outside = np.flatnonzero(np.abs(angle - goal)[held] > BAND)
            if len(outside) and outside[-1] < held.sum() - 2:
                found["t_s"].append(float(since[held][outside[-1]]))
            along = way * (angle[held] - origin) / abs(goal - origin)
            if along.max() >= 0.9:
                found["t_r"].append(float(since[held][along >= 0.9][0] - since[held][along >= 0.1][0]))
            found["OS_th"].append(max(0.0, float((way * angle[held]).max() - abs(goal))))
        for symbol, values in found.items():
            if len(values) == REPEATS:
                right[symbol, "", 1.0 + row] = (float(np.mean(values)),) * 2
            else:
                right[symbol, "", 1.0 + row] = (np.inf, np.inf)  # it has none, and a value is wrong
    goal = SWING[0]
    begin = (since >= SINES_FROM) & (since < SINE_HOLD)
    turn = np.exp(-2j * np.pi * SINE * since[begin])
    reference = goal * np.sin(2 * np.pi * SINE * since[begin])
    answers, errors = [], []
    for angle in course[len(GOALS) * REPEATS :]:
        answers.append(np.sum((angle[begin] - angle[begin].mean()) * turn) / np.sum(reference * turn))
        errors.append(float(np.sqrt(np.mean((angle[begin] - reference) ** 2))))
    middle = complex(np.mean(answers))
    right["g_th", "", 4.0] = (float(np.mean(np.abs(answers))),) * 2
    right["phi_th", "", 4.0] = (float(np.angle(middle)),) * 2
    right["e_s", "", 4.0] = (float(np.mean(errors)),) * 2
    return right


def campaign(cause: str, size: float, seed: int) -> list[tuple[Trial, dict[str, float]]]:
    """The trials, each with the time at which its loop closed, at `size` times the full size of a cause.

    angle-lag, angle-late
        The encoder has a filter, and the loop goes by it; its stream alone is late in the record.
    slip, noisy, coarse
        The encoder slips on its shaft; is noisy; counts in large steps.
    mount-slips, creep, unequal, wrong-radius, hunting, restless, shaking, slow-regulators
        Of the joint: a muscle's mount gives way; the muscles go on yielding; muscle 2 is weaker; the controller believes
        in another pulley; has too much gain; it is not at rest when the loop closes; a torque shakes it; the regulators are
        slow.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed + 7, *cause.encode(), round(1000 * size)])
    t, course, P_1, P_2 = _swung(cause, size, seed)
    trials = []
    for number in range(len(course)):
        sine = number >= len(GOALS) * REPEATS
        goal, gain = SWING if sine else GOALS[number // REPEATS]
        last = round((BASELINE + (SINE_HOLD if sine else HOLD)) / FINE)
        since = number * 30.0
        few, true = t[:last:EVERY], course[number][:last]
        seen = true[::EVERY]
        if cause == "angle-lag":
            seen = lagged(seen, amount, RATE)
        elif cause == "angle-late":
            seen = np.interp(few - amount, t[:last], true)
        elif cause in ("slip", "coarse"):
            seen = _shown(cause, amount, seen, few, size, seed, number)
        noise = NOISE["angle"] * ((1 + amount) if cause == "noisy" else 1.0)
        read = {
            "angle": seen + noise * chance.standard_normal(len(few)),
            "pressure_1": P_1[number][:last:EVERY] + NOISE["pressure_1"] * chance.standard_normal(len(few)),
            "pressure_2": P_2[number][:last:EVERY] + NOISE["pressure_2"] * chance.standard_normal(len(few)),
        }
        point = {"goal": float(goal), "integral": float(gain)} | ({"frequency": SINE} if sine else {})
        law = {"t0": since, "reference_lag": LAG, "saturated": 0.0}
        trials.append((Trial(point, number % REPEATS, since + few, read, ()), law))
    return trials


def _shown(cause: str, amount: float, true: Array, t: Array, size: float, seed: int, number: int) -> Array:
    """The encoder's course along a trial, as the loop saw it."""
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    blocks = _Blocks(len(GOALS) * REPEATS + REPEATS, chance)
    slips = BASELINE + chance.uniform(0.5, 4.0, blocks.state.shape[2])
    seen = true[:1]
    shown = np.empty_like(true)
    for n, (angle, at) in enumerate(zip(true, t, strict=True)):
        seen = _encoder(cause, amount, np.array([angle]), float(at), slips[number : number + 1], seen)
        shown[n] = seen[0]
    return shown
