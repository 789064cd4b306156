"""Slow tests of a muscle that remembers, and motion at random to judge by: times, contractions and pressures, SI."""

import numpy as np

from pmabench.analysis.surface.trials import Record, rows_of

HZ = 50.0


def through(points, speed):
    """Times and values along straight lines between points at a speed."""
    t = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(points)) / speed)])
    at = np.arange(0.0, t[-1], 1 / HZ)
    return at, np.interp(at, t, points)


def ramps(pressures=((200e3, 38e-3), (300e3, 50e-3), (400e3, 52e-3), (500e3, 52e-3), (600e3, 52e-3))):
    """Two strokes of contraction at each pressure, with a small loop inside."""
    for P, top in pressures:
        t, x = through([0.0, top, 0.4 * top, 0.7 * top, 0.0, top, 0.0], 3e-3)
        yield f"ramp {P / 1e3:g}", t, x, np.full_like(t, P)


def fills(places=(0.0, 6e-3, 12e-3, 20e-3, 30e-3), low=100e3, high=600e3):
    """Pressure up and down at each length, with a small loop inside."""
    for x in places:
        least = low + 5e6 * x
        t, P = through([least, high, 0.5 * (least + high), 0.8 * high, least, high, least], 15e3)
        yield f"fill {1e3 * x:g}", t, np.full_like(t, x), P


def sines(pressures=(250e3, 400e3, 550e3), means=(10e-3,), amplitude=8e-3):
    """Sines of three frequencies at each pressure."""
    for P in pressures:
        for f in (0.05, 0.2, 0.5):
            t = np.arange(0.0, max(3 / f, 20.0), 1 / HZ)
            for mean in means:
                yield f"sine {P / 1e3:g} {f}", t, mean - amplitude * np.cos(2 * np.pi * f * t), np.full_like(t, P)


def strokes(pressures=(300e3, 450e3, 600e3)):
    """Steps of contraction that are held."""
    for P in pressures:
        t, x = through([2e-3, 25e-3], 20e-3)
        hold = np.arange(1, 45 * HZ) / HZ
        back = t[::-1]
        t = np.concatenate([t, t[-1] + hold, t[-1] + hold[-1] + (back[0] - back) + 1 / HZ])
        x = np.concatenate([x, np.full(len(hold), x[-1]), x[::-1]])
        yield f"stroke {P / 1e3:g}", t, x, np.full_like(t, P)


def campaign():
    """All of them."""
    yield from ramps()
    yield from fills()
    yield from sines()
    yield from strokes()


def wandering(rng, seconds=40.0):
    """Contraction and pressure that wander at random where the muscle pulls."""
    t = np.arange(0.0, seconds, 1 / HZ)
    a, b = (np.interp(t, np.linspace(0, seconds, 21), rng.uniform(0, 1, 21)) for _ in range(2))
    smooth = np.hanning(60) / np.hanning(60).sum()
    a, b = (np.convolve(np.pad(one, 30, mode="edge"), smooth, mode="same")[30:-30] for one in (a, b))
    P = 220e3 + a * 370e3
    most = np.interp(P, [200e3, 300e3, 600e3], [32e-3, 45e-3, 50e-3])
    return "wandering", t, b * most, P


def record_of(muscle, trial, rng, noise=0.3, goes_on=True, by_hand=False):
    """The rows of a trial that a muscle is driven along, with white noise of the cell [N]."""
    name, t, x, P = trial
    F = muscle.drive(t, x, P) + noise * rng.standard_normal(len(t))
    rows = rows_of(t, P, x, F, np.ones(len(t), dtype=bool))
    return Record(name, name, *rows, rows[3] > 5.0, by_hand=by_hand, goes_on=goes_on)
