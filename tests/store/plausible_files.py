"""Recordings of muscles by formulas of their own, clean or damaged, as a logger would have written them.

Independent of pmabench: plain numpy, units of the file (s, kPa, N, mm). Force of a muscle that is held by the formula of
Chou and Hannaford less a threshold, with friction that depends on the way; displacement of a hanging load by a lag.
"""

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass
class File:
    """Columns of a file, and what the muscle in it really does."""

    t: np.ndarray
    pressure: np.ndarray
    force: np.ndarray | None = None
    displacement: np.ndarray | None = None
    command: np.ndarray | None = None
    kind: str = "isometric"
    truth: dict = field(default_factory=dict)


def ramps(rate, cycles, rise, hold, low, high, rest=1.0):
    """Time and pressure of `cycles` trapezoids with rests, the rounded corners of a real regulator."""
    marks, levels = [0.0, rest], [low, low]
    for _ in range(cycles):
        for seconds, level in ((rise, high), (hold, high), (rise, low), (rest, low)):
            marks.append(marks[-1] + seconds)
            levels.append(level)
    t = np.arange(0.0, marks[-1], 1.0 / rate)
    pressure = np.interp(t, marks, levels)
    width = max(1, int(0.08 * rate))
    kernel = np.ones(width) / width
    return t, np.convolve(np.pad(pressure, (width, 0), mode="edge"), kernel, mode="valid")[1:]


def play(values, width):
    """Friction: the output follows the input only beyond a play of +- `width`."""
    out = np.empty_like(values)
    now = values[0]
    for k, value in enumerate(values):
        now = min(max(now, value - width), value + width)
        out[k] = now
    return out


def isometric(seed, rate=100.0, cycles=1, counts=None):
    """A held muscle filled and emptied; `counts`: force on the steps of a converter [N]."""
    rng = np.random.default_rng(seed)
    bore = rng.uniform(8.0, 40.0)
    slope = rng.uniform(3.0, 9.0) * np.pi * bore**2 / 4.0 * 1e-3
    high, threshold = rng.uniform(300.0, 700.0), rng.uniform(0.0, 120.0)
    t, pressure = ramps(rate, cycles, rng.uniform(4.0, 15.0), rng.uniform(1.0, 5.0), rng.uniform(0.0, 3.0), high)
    width = rng.uniform(0.0, 0.03) * high
    force = np.maximum(slope * (play(pressure, width) - threshold), 0.0)
    lag = rng.uniform(0.0, 0.02)
    force = np.interp(t - lag, t, force)
    noise = 0.001 * slope * high
    force = force + rng.normal(0.0, noise, len(t))
    pressure = pressure + rng.normal(0.0, 0.3, len(t))
    if counts:
        step = slope * high / counts
        force = np.round(force / step) * step
        pressure = np.round(pressure / (high / counts)) * (high / counts)
    return File(t, np.round(pressure, 3), np.round(force, 4), truth={"slope": slope, "bore": bore})


def stairs(seed, rate=100.0):
    """A held muscle whose pressure is set in steps, up and down, fast or slowly; friction, creep and coarse force."""
    rng = np.random.default_rng(seed)
    up = np.linspace(0.0, 600.0, rng.integers(6, 14))
    levels, dwell = np.concatenate([up, up[::-1]]), rng.uniform(1.0, 5.0)
    t = np.arange(0.0, dwell * len(levels), 1.0 / rate)
    pressure = levels[np.minimum((t / dwell).astype(int), len(levels) - 1)]
    pressure = first_order(t, pressure, rng.uniform(0.005, 0.3))
    slope = rng.uniform(0.5, 4.0)
    force = np.maximum(slope * (play(pressure, rng.uniform(0.0, 0.06) * 600.0) - rng.uniform(0.0, 100.0)), 0.0)
    force = first_order(t, force * (1.0 + 0.003 * np.log1p(t)), rng.uniform(0.005, 0.1))
    force = force + rng.normal(0.0, 0.6 * slope, len(t))
    if seed % 2:
        force = np.round(force / (1.2 * slope)) * 1.2 * slope
    return File(t, pressure + rng.normal(0.0, 0.3, len(t)), force, truth={"slope": slope})


def squares(seed, rate=10.0):
    """A held muscle that is filled and vented again and again, logged slowly or fast, without noise or with it."""
    rng = np.random.default_rng(seed)
    period = rng.uniform(4.0, 80.0)
    t = np.arange(0.0, period * rng.integers(3, 9), 1.0 / rate)
    pressure = np.where((t / period) % 1.0 < 0.5, 0.0, rng.uniform(200.0, 600.0))
    pressure = first_order(t, pressure, rng.uniform(0.01, 0.2))
    slope = rng.uniform(0.5, 4.0)
    force = first_order(t, np.maximum(slope * (pressure - 50.0), 0.0), 0.03)
    if seed % 3:
        return File(t, pressure + rng.normal(0.0, 0.3, len(t)), force + rng.normal(0.0, 0.3, len(t)))
    return File(t, np.round(pressure, 1), np.round(force, 1))


def steps(seed, rate=200.0, counts=False):
    """A hanging load, lifted and lowered by steps of pressure: dead time, lag of the regulator, slow muscle."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(rng.permutation([100.0, 200.0, 300.0, 400.0, 500.0]), 2)[: rng.integers(4, 9)]
    levels = np.where(np.arange(len(levels)) % 2, levels, 150.0)
    t = np.arange(0.0, 4.0 * len(levels), 1.0 / rate)
    command = levels[np.minimum((t / 4.0).astype(int), len(levels) - 1)]
    pressure = first_order(t, np.interp(t - 0.03, t, command), rng.uniform(0.03, 0.15))
    x = first_order(t, np.maximum(0.06 * (pressure - 80.0), 0.0), rng.uniform(0.05, 0.4))
    pressure = pressure + rng.normal(0.0, 0.4, len(t))
    x = np.round(x / 0.01) * 0.01 if counts else x + rng.normal(0.0, 0.003, len(t))
    return File(t, np.round(pressure, 3), None, np.round(x, 5), command, kind="recorded-step")


def sines(seed, rate=200.0):
    """A hanging load moved by a sine of pressure."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 1.0 / rate)
    command = 300.0 + rng.uniform(50.0, 150.0) * np.sin(2 * np.pi * rng.uniform(0.2, 3.0) * t)
    pressure = first_order(t, command, 0.08)
    x = first_order(t, 0.05 * pressure, 0.15) + rng.normal(0.0, 0.004, len(t))
    return File(t, pressure + rng.normal(0.0, 0.4, len(t)), None, x, command, kind="recorded-sine")


def first_order(t, values, seconds):
    """`values` behind a lag of first order."""
    out = np.empty_like(values)
    now, share = values[0], 1.0 - np.exp(-(t[1] - t[0]) / seconds)
    for k, value in enumerate(values):
        now += share * (value - now)
        out[k] = now
    return out


def damaged(file, **columns):
    """The same file with other columns."""
    return replace(file, **columns)
