"""Steps of displacement of a muscle at constant pressure: springs and dampers in closed form, sound or with a fault.

F = F0 - K x - B x' - sum of Maxwell branches, each a spring K_j that relaxes with its time constant. The driven end
follows a ramp through a short lag.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

F0, K, B = 500.0, 8e3, 300.0
"""[N], [N/m], [N s/m]"""
BRANCH, TAU = 2e3, 0.05
"""[N/m], [s]"""
START, STEP, SPEED = 10e-3, 5e-3, 100e-3
"""[m], [m], [m/s]"""
ACTUATOR = 3e-3
"""Lag of the driven end [s]."""
HOLD, CYCLES, TRIALS = 2.0, 4, 3
RATE, FINE = 1000.0, 10
PAUSE = 5.0
NOISE = {"pressure": 500.0, "displacement": 2e-6, "force": 0.3}
FULL = {"clean": 0.0, "creep": 0.10, "two-times": 1.0, "cell-drift": 5.0, "force-lag": 5e-3}
"""Cause -> its full size: share of K that relaxes in 4 s; share of the branch that relaxes in 0.3 s instead; N over a
trial; s."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")


def branches(cause: str, size: float) -> list[tuple[float, float]]:
    """Spring [N/m] and time constant [s] of each branch."""
    amount = size * FULL[cause]
    found = [(BRANCH, TAU)]
    if cause == "creep":
        found.append((amount * K, 4.0))
    if cause == "two-times":
        found = [(BRANCH * (1 - 0.5 * amount), TAU), (0.5 * BRANCH * amount, 0.3)]
    return found


def moved(fine: int) -> tuple[Array, Array, Array]:
    """Time of the corners of the commanded ramps [s]; time [s] and displacement [m], `fine` times as often as sampled."""
    way = STEP / SPEED
    corners = HOLD + (HOLD + way) * np.arange(2 * CYCLES)
    t = np.arange(round((corners[-1] + way + HOLD) * RATE) * fine + 1) / (RATE * fine)
    places = np.sort(np.concatenate([[0.0], corners, corners + way]))
    values = [START, *np.concatenate([[START, START + STEP], [START + STEP, START]] * CYCLES)]
    return corners, t, lagged(np.interp(t, places, values), ACTUATOR, RATE * fine)


def force(x: Array, t: Array, springs: Sequence[tuple[float, float]]) -> Array:
    """Force [N] along a motion from rest, without noise."""
    step = float(t[1] - t[0])
    F = F0 - K * x - B * np.gradient(x, step)
    for spring, tau in springs:
        F = F - spring * (x - lagged(x, tau, 1 / step))
    return np.asarray(F)


def truth(cause: str, size: float) -> Truth:
    """Of the step away (+) and back (-); forces before and after, at rest; the peak is that of a much finer clock."""
    right: Truth = {}
    corners, t, x = moved(FINE)
    F = force(x, t, branches(cause, size))
    ends = [*corners[1:], t[-1]]
    for sign, first in ((1.0, 2), (-1.0, 3)):
        rows = (t >= corners[first]) & (t < ends[first])
        here = F[rows]
        peak = float(here.min() if sign > 0 else here.max())
        before, after = (START, START + STEP)[:: int(sign)]
        rest = F0 - K * before
        right["K", "relaxed", sign * STEP] = (K, K)
        right["K", "peak", sign * STEP] = (-(peak - rest) / (after - before),) * 2
        right["F", "before", sign * STEP] = (rest, rest)
        right["F", "relaxed", sign * STEP] = (F0 - K * after,) * 2
        right["F", "peak", sign * STEP] = (peak, peak)
        if cause not in ("two-times", "creep"):
            right["tau_F", "", sign * STEP] = (TAU, TAU)
    if cause == "creep":  # its peak depends on what is left of the last step
        for key in [key for key in right if "peak" in key]:
            del right[key]
    return right


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """Three trials of one cell with a cause at `size` times its full size; chance is drawn from the seed."""
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    corners, fine, way = moved(FINE)
    clean = force(way, fine, branches(cause, size))
    if cause == "force-lag":
        clean = lagged(clean, amount, RATE * FINE)
    t, x, F = fine[::FINE], way[::FINE], clean[::FINE]
    if cause == "cell-drift":
        F = F + (1 - 2 * (seed % 2)) * amount * t / t[-1]
    trials = []
    for repeat in range(TRIALS):
        start = repeat * (float(t[-1]) + PAUSE)
        read = {
            name: one + NOISE[name] * chance.standard_normal(len(t))
            for name, one in (("pressure", np.full(len(t), 300e3)), ("displacement", x), ("force", F))
        }
        commands = tuple(
            Ramp(start + float(at), "displacement", START + STEP * (1 - back), START + STEP * back, phase, SPEED)
            for number, at in enumerate(corners)
            for back, phase in [(number % 2, "back" if number % 2 else "step")]
        )
        point = {"pressure": 300e3, "step": STEP, "speed": SPEED, "start": START, "cycles": float(CYCLES)}
        trials.append(Trial(point, repeat, start + t, read, commands))
    return trials
