"""Sines of pressure as another program's file holds them: a muscle behind a lag, in closed form or folded numerically.

The command is a sine, the pressure follows it through one lag, the contraction follows a curve of the pressure through
another.
"""

from __future__ import annotations

import numpy as np

from tests.judge.record import Array, Ramp, Trial, Truth, lagged

FREQUENCIES, REPEATS, CYCLES = (0.2, 0.4, 0.8, 1.2, 1.8, 2.6), 2, 12
RATE, FINE = 100.0, 10
MEAN, SWING = 260e3, 90e3
"""[Pa]"""
VALVE, MUSCLE = 0.030, 0.110
"""Lags of pressure behind command and of contraction behind pressure [s]."""
GAIN = 6e-8
"""[m/Pa]"""
NOISE = {"pressure": 300.0, "displacement": 5e-6, "pressure_command": 0.0}
START_UP = 4.0
"""Time in which what the start left of the contraction's swing comes [s]."""
FULL = {
    "clean": 0.0, "bent": 0.30, "friction": 0.10, "drift": 1.5e-3, "start-up": 0.10, "late": 4e-3, "clipped": 0.12,
    "other-frequency": 0.004,
}  # fmt: skip
"""Cause -> its full size: share of the gain over a swing; share of the swing; m over a trial; share of the swing that
is missing at first; s; share of the swing; share of the frequency."""
CAUSES = tuple(cause for cause in FULL if cause != "clean")


def _signals(f: float, cause: str, amount: float, cycles: int) -> tuple[Array, Array, Array, Array]:
    """Time [s], command and pressure [Pa], contraction [m], `FINE` times as often as sampled, settled at the start."""
    before = 4
    real = f * (1 + amount) if cause == "other-frequency" else f
    t = np.arange(-round(before / f * RATE) * FINE, round((cycles + 0.3) / f * RATE) * FINE) / (RATE * FINE)
    command = MEAN + SWING * np.sin(2 * np.pi * real * t)
    pressure = lagged(command, VALVE, RATE * FINE)
    over = (pressure - MEAN) / SWING
    pulled = over * (1 + 0.5 * amount * over) if cause == "bent" else over
    if cause == "friction":
        pulled = _play(pulled, amount)
    x = lagged(GAIN * (MEAN + SWING * pulled), MUSCLE, RATE * FINE)
    rows = t >= 0
    return t[rows], command[rows], pressure[rows], x[rows]


def _play(u: Array, width: float) -> Array:
    """What follows `u` only where that leaves a gap of half of `width`."""
    found, here = np.empty_like(u), 0.0
    for n, value in enumerate(u):
        here = min(max(here, value - width / 2), value + width / 2)
        found[n] = here
    return found


def _settled(f: float, cause: str, amount: float) -> tuple[complex, complex, complex, float]:
    """First harmonics of command, pressure and contraction, and the width of the loop at mean pressure."""
    t, command, pressure, x = _signals(f, cause, amount if cause in ("bent", "friction", "other-frequency") else 0.0, 6)
    real = f * (1 + amount) if cause == "other-frequency" else f
    turns = 2j * np.pi * real * t[:, None] * np.arange(1, 8)
    design = np.column_stack([np.ones(len(t)), np.cos(turns.imag), np.sin(turns.imag)])
    found = np.linalg.lstsq(design, np.column_stack([command, pressure, x]), rcond=None)[0]
    harmonics = [complex(*one) for one in zip(found[1], -found[8], strict=True)]
    off = pressure - MEAN
    rows = np.flatnonzero(off[:-1] * off[1:] < 0)
    share = off[rows] / (off[rows] - off[rows + 1])
    places = x[rows] + share * (x[rows + 1] - x[rows])
    up = off[rows] < 0
    return harmonics[0], harmonics[1], harmonics[2], abs(float(places[up].mean() - places[~up].mean()))


def truth(cause: str, size: float) -> Truth:
    """First harmonics in the settled state; the loop at mean pressure, whatever its shape."""
    amount = size * FULL[cause]
    right: Truth = {}
    gains = []
    for f in FREQUENCIES:
        u, P, x, width = _settled(f, cause, amount)
        gains.append(abs(x / u))
        for symbol, value in (
            ("P", abs(P)), ("x", abs(x)), ("P/x", abs(P / x)), ("phi_x", float(np.angle(x / P))), ("H", width),
            ("P/P_set", abs(P / u)), ("phi_P", float(np.angle(P / u))),
        ):  # fmt: skip
            right[symbol, "", f] = (value, value)
    if cause not in ("bent", "friction"):
        fine = np.linspace(FREQUENCIES[0], FREQUENCIES[-1], 200001)
        gain = 1 / np.sqrt((1 + (2 * np.pi * fine * VALVE) ** 2) * (1 + (2 * np.pi * fine * MUSCLE) ** 2))
        place = float(fine[int(np.argmax(gain < gain[0] * np.sqrt(0.5)))])
        right["f_b", "", 0.0] = (place, place)
    return right


def campaign(cause: str, size: float, seed: int) -> list[Trial]:
    """The trials of a campaign with a cause at `size` times its full size; chance is drawn from the seed.

    bent
        The contraction is a parabola of the pressure.
    friction
        It follows the pressure after a gap only.
    drift
        The displacement goes evenly with time.
    start-up
        At first the swing of the contraction is that much smaller.
    late
        The pressure was read that much earlier than it is written down.
    clipped
        The displacement sensor ends below the top of the swing.
    other-frequency
        The frequency is not quite the one that was named.
    """
    amount = size * FULL[cause]
    chance = np.random.default_rng([seed, *cause.encode(), round(1000 * size)])
    trials, since = [], 0.0
    for f in FREQUENCIES:
        for repeat in range(REPEATS):
            fine, command, pressure, way = _signals(f, cause, amount, CYCLES)
            t = fine[::FINE]
            P = np.interp(t - amount, fine, pressure) if cause == "late" else pressure[::FINE]
            x = way[::FINE]
            if cause == "drift":
                x = x + amount * t / t[-1]
            if cause == "start-up":
                x = GAIN * MEAN + (x - GAIN * MEAN) * (1 - amount * np.exp(-t / START_UP))
            read = {
                name: one + NOISE[name] * chance.standard_normal(len(t))
                for name, one in (("pressure", P), ("displacement", x), ("pressure_command", command[::FINE]))
            }
            if cause == "clipped":
                end = float(x.max()) - amount * np.ptp(x) / 2
                read["displacement"] = np.minimum(read["displacement"], end)
            commands = (Ramp(since, "pressure", MEAN, MEAN, "sine", 0.0),)
            trials.append(Trial({"frequency": f}, repeat, since + t, read, commands))
            since += float(t[-1]) + 5.0
    return trials
