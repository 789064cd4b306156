"""Positions that a loop holds: the answer to a step of the set-point in closed form, with or without what unsettles it."""

from __future__ import annotations

import numpy as np

from tests.judge.record import Array, Trial, Truth

SETPOINTS, REPEATS = (0.012, 0.025), 3
RATE, BEFORE, HOLD = 100.0, 1.0, 30.0
WINDOW, BAND = (12.0, 30.0), 0.03
"""[s], share of the step."""
SWING, DAMPED = 3.2, 0.35
"""Natural frequency [rad/s], damping ratio."""
OFFSET = 0.002
"""Of the set-point, left at the end."""
SCATTER, NOISE = 3e-4, 4e-6
"""Between trials, standard deviation of the end as a share; white noise [m]."""
FULL = {"clean": 0.0, "tail": 0.03, "drift": 0.3e-3, "hunting": 0.8e-3}
"""Cause -> its full size: share of the step that comes with 12 s; m over a hold; m from peak to peak in 7 s."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")
PERIOD = 7.0


def answer(t: Array, setpoint: float, cause: str, amount: float, phase: float = 0.0) -> Array:
    """Position [m] after the step."""
    fast = SWING * np.sqrt(1 - DAMPED**2)
    swing = np.exp(-DAMPED * SWING * t) * (np.cos(fast * t) + DAMPED * SWING / fast * np.sin(fast * t))
    x = setpoint * (1 - OFFSET) * (1 - swing)
    if cause == "tail":
        x = x - amount * setpoint * (np.exp(-t / 12.0) - np.exp(-t / 0.5))
    if cause == "hunting":
        x = x + 0.5 * amount * -np.expm1(-t / 0.5) * np.sin(2 * np.pi * t / PERIOD + phase)
    return np.asarray(x)


def truth(cause: str, size: float) -> Truth:
    """Of the settled loop; the way there only where nothing unsettles it."""
    amount = size * FULL[cause]
    right: Truth = {}
    t = np.arange(round(HOLD * 20000)) / 20000
    for setpoint in SETPOINTS:
        right["e_ss", "", setpoint] = (OFFSET, OFFSET)
        if cause == "hunting":
            right["x_pp", "", setpoint] = (amount, amount)
            right["T_c", "", setpoint] = (PERIOD, PERIOD)
        if cause == "clean":
            x = answer(t, setpoint, cause, amount)
            rise = [float(t[int(np.argmax(x >= share * setpoint))]) for share in (0.1, 0.9)]
            outside = np.flatnonzero(np.abs(x - setpoint) > BAND * setpoint)
            for symbol, value in (
                ("OS", float(x.max()) / setpoint - 1), ("t_r", rise[1] - rise[0]),
                ("t_s", float(t[outside[-1] + 1])), ("IAE", float(np.mean(np.abs(setpoint - x)) * HOLD)),
            ):  # fmt: skip
                right[symbol, "", setpoint] = (value, value)
    return right


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size; chance is drawn from the seed.

    tail
        A part of the step comes slowly.
    drift
        The displacement sensor goes evenly with time, and the loop follows what it reads: the record has no drift but
        that of the loop against it, a slow ramp.
    hunting
        A slow limit cycle.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    t = np.arange(-round(BEFORE * RATE), round(HOLD * RATE) + 1) / RATE
    trials, since = [], BEFORE
    for setpoint in SETPOINTS:
        for repeat in range(REPEATS):
            phase = float(chance.uniform(0, 2 * np.pi))
            x = np.where(t > 0, answer(np.maximum(t, 0.0), setpoint, cause, amount, phase), 0.0)
            x = x * (1 + SCATTER * chance.standard_normal())
            if cause == "drift":
                x = x + amount * t / HOLD
            channels = {"displacement": x + NOISE * chance.standard_normal(len(t))}
            trials.append(Trial({"setpoint": setpoint}, repeat, since + t, channels, ()))
            since += BEFORE + HOLD + 5.0
    return trials
