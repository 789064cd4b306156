"""Slow tests of the second muscle with a driven end, a motion at random, and weights that are held long; SI.

Ramps at constant pressure and pressures at constant contraction have a minor loop each way. Records of one list follow
each other: what has crept goes over to the next, after a rest without pressure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

from tests.judge.second.bench import GRAVITY, noise, regulated, stepped
from tests.judge.second.campaign import RATE, REAL, Trial
from tests.judge.second.hanging import hang
from tests.judge.second.muscle import (
    DAMPING,
    FRICTION,
    RATES,
    WIDENS,
    Array,
    Muscle,
    heavier,
    tight,
    tracked,
    weights,
)

SAMPLED, FINE = 100.0, 5
"""Samples a second, and steps between two."""
LEAD, AWAY = 6.0, 30.0
"""Before a record, to reach its first point and rest there, and after it without pressure [s]."""
LEAST, FAR, TOP = 40.0, 45e-3, 560e3
"""No test goes below this force [N] nor beyond this contraction [m] and pressure [Pa]."""
LOOPED = (0.0, 0.6, 0.35, 1.0, 0.4, 0.65, 0.0)
"""Turning points of a slow test, as shares of its range."""
SPEED, FILLING = 3e-3, 25e3
"""Of slow tests [m/s], [Pa/s]."""
HELD, LONG = (8.0, 30.0), 45.0
"""Weights [kg] that hang, for so long [s], at 400 kPa."""


@dataclass(frozen=True)
class Record:
    """One test with a driven end [SI]; `t` counts from its start."""

    kind: str
    """isobaric-ramp, isometric-pressurisation, sine, hold, step or random."""
    point: dict[str, float]
    t: Array
    pressure: Array
    displacement: Array
    force: Array
    command: Array
    """Pressure that was asked for."""
    way: Array
    """Contraction that was asked for."""
    true: Array
    """Force without noise."""


@dataclass(frozen=True)
class Asked:
    """What a test asks for: pressure [Pa] and contraction [m] at the fine steps."""

    kind: str
    point: dict[str, float]
    P: Array
    x: Array


def session(muscle: Muscle = REAL, seed: int = 0, colour: float = 1.0) -> tuple[list[Record], list[Record]]:
    """Slow tests of a muscle that has rested for long, and then three motions at random within what they reached.

    The tests are 5 ramps, 5 pressurisations, 18 sines, 2 holds and 3 times steps of pressure, in this order.
    """
    tests = [_ramp(muscle, 1e3 * P) for P in (170, 250, 340, 430, 520)]
    tests += [_pressurised(muscle, 1e-3 * x) for x in (0, 6, 14, 24, 34)]
    tests += [_sine(f, 1e3 * P, 1e-3 * x) for f in (0.15, 1.5) for P, x in (
        (200, 5), (200, 9), (200, 13), (330, 6), (330, 15), (330, 24), (480, 6), (480, 19), (480, 32))]  # fmt: skip
    tests += [_hold(1e3 * P, 1e-3 * x) for P, x in ((300, 18), (480, 20))]
    tests += [_steps(1e-3 * x) for x in (4, 10, 16)]
    motions = _motions(muscle, np.random.default_rng([seed, 2]))
    records = _recorded(muscle, [*tests, *motions], [seed, 1], colour)
    return records[: len(tests)], records[len(tests) :]


def wander(muscle: Muscle = REAL, seed: int = 0, colour: float = 1.0, lasts: float = 40.0) -> list[Record]:
    """Three motions at random of a muscle that has rested for long."""
    return _recorded(muscle, _motions(muscle, np.random.default_rng([seed, 2]), lasts), [seed, 3], colour)


def held(muscle: Muscle = REAL, seed: int = 0, colour: float = 1.0) -> list[Trial]:
    """Two weights lifted in one step of pressure and held for long, one trial each; at the end they still hang."""
    x, force = _hung(muscle)
    chance = np.random.default_rng([seed, 4])
    t = np.arange(round(LONG * RATE) + 1) / RATE
    P, trials = stepped(((0.5, 400e3),), t), []
    for number, mass in enumerate(HELD):
        begin = number * (LONG + AWAY)
        true = {"pressure": P, "displacement": x[number], "force": force[number]}
        read = {name: value + noise(name, len(t), RATE, chance, colour) for name, value in true.items()}
        trials.append(Trial(mass, mass * GRAVITY, 400e3, ((begin + 0.5, 400e3),), begin + t, **read))
    return trials


@lru_cache(maxsize=4)
def _hung(muscle: Muscle) -> tuple[Array, Array]:
    t = np.arange(round(LONG * RATE) + 1) / RATE
    P = np.tile(stepped(((0.5, 400e3),), t), (len(HELD), 1))
    return hang(muscle, np.array(HELD), P, RATE, np.full(len(HELD), AWAY))


def follow(muscle: Muscle, P: Sequence[Array], x: Sequence[Array], rate: float = SAMPLED * FINE) -> list[Array]:
    """Force [N] of records one after the other: pressures [Pa] in the muscle and contractions [m] at `rate` [Hz].

    Each is reached from no pressure and no contraction; between two the muscle rests. Friction keeps its sense where
    the motion stops.
    """
    lead = np.linspace(0.0, 1.0, round(LEAD / 3 * rate))
    stay = np.ones(round(LEAD * rate) - len(lead))
    Ps, xs = ([np.concatenate([lead * one[0], stay * one[0], one]) for one in many] for many in (P, x))
    longest = max(len(one) for one in Ps)
    strands = np.array(
        [np.pad(a + WIDENS * b, (0, longest - len(a)), mode="edge") for a, b in zip(xs, Ps, strict=True)]
    )
    z = tracked(strands.T) if muscle.hysteresis else np.zeros((longest, len(Ps)))
    left, found = np.zeros(len(RATES)), []
    for number, (here, pressure) in enumerate(zip(xs, Ps, strict=True)):
        stress, crept = z[: len(here), number], np.zeros_like(here)
        v = np.gradient(here) * rate
        way = _last_sense(v)
        for _ in range(4 if muscle.creep else 1):  # it creeps by the load, which its creep changes a little
            B = np.where(v >= 0, *(a + b * pressure for a, b in DAMPING.values()))
            static = muscle.static(here - tight(pressure) * crept, pressure)
            force = np.maximum(0.0, static - muscle.rubbed(pressure) * stress - B * v - FRICTION * way)
            if muscle.creep:
                crept, after = _creep(muscle.creep * heavier(force) * here, left, rate)
        left = after * np.exp(-RATES * AWAY) if muscle.creep else left
        found.append(force[-len(P[number]) :])
    return found


def _creep(drive: Array, left: Array, rate: float) -> tuple[Array, Array]:
    """What has crept [m] for a drive over time, from what was left in each part, and what is in each at the end."""
    keep = np.exp(-RATES / rate)
    parts = [lfilter([w * (1 - k)], [1.0, -k], drive, zi=[k * before])[0]
             for w, k, before in zip(weights(), keep, left, strict=True)]  # fmt: skip
    return np.asarray(sum(parts)), np.array([part[-1] for part in parts])


def _last_sense(v: Array) -> Array:
    """Sign of the last motion at each sample; 0 before any."""
    moving = np.abs(v) > 1e-9
    last = np.maximum.accumulate(np.where(moving, np.arange(len(v)), -1))
    return np.where(last < 0, 0.0, np.sign(v[np.maximum(last, 0)]))


def _recorded(muscle: Muscle, asked: Sequence[Asked], seed: Sequence[int], colour: float) -> list[Record]:
    chance = np.random.default_rng(seed)
    P = [regulated(one.P, SAMPLED * FINE) for one in asked]
    records = []
    for one, pressure, force in zip(asked, P, follow(muscle, P, [one.x for one in asked]), strict=True):
        true = {"pressure": pressure[::FINE], "displacement": one.x[::FINE], "force": force[::FINE]}
        n = len(true["force"])
        read = {name: value + noise(name, n, SAMPLED, chance, colour) for name, value in true.items()}
        t = np.arange(n) / SAMPLED
        records.append(
            Record(one.kind, one.point, t, **read, command=one.P[::FINE], way=one.x[::FINE], true=true["force"])
        )
    return records


# -- what is asked for ---------------------------------------------------------------------------------------------


def _farthest(muscle: Muscle, P: float) -> float:
    """Contraction of a slow test at most [m]."""

    def over(x: float) -> float:
        return float(muscle.static(np.array(x), np.array(P))) - LEAST

    return min(FAR, brentq(over, 0.0, 0.12) if over(0.12) < 0 else FAR)


def _turned(low: float, high: float, speed: float) -> Array:
    """Through all turning points of a slow test at one speed."""
    places = low + (high - low) * np.array(LOOPED)
    times = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(places)) / speed)])
    return np.interp(np.arange(0, times[-1], 1 / (SAMPLED * FINE)), times, places)


def _ramp(muscle: Muscle, P: float) -> Asked:
    x = _turned(0.0, _farthest(muscle, P), SPEED)
    return Asked("isobaric-ramp", {"pressure": P}, np.full(len(x), P), x)


def _pressurised(muscle: Muscle, x: float) -> Asked:
    def over(P: float) -> float:
        return float(muscle.static(np.array(x), np.array(P))) - LEAST

    P = _turned(brentq(over, 1e3, TOP), TOP, FILLING)
    return Asked("isometric-pressurisation", {"displacement": x}, P, np.full(len(P), x))


def _sine(f: float, P: float, x: float, amplitude: float = 4e-3) -> Asked:
    t = np.arange(0, (4 if f < 1 else 10) / f, 1 / (SAMPLED * FINE))
    way = x + amplitude * np.sin(2 * np.pi * f * t)
    return Asked("sine", {"frequency": f, "pressure": P, "displacement": x}, np.full(len(t), P), way)


def _hold(P: float, x: float) -> Asked:
    t = np.arange(0, 50.0, 1 / (SAMPLED * FINE))
    return Asked("hold", {"pressure": P, "displacement": x}, np.full(len(t), P), x * np.clip((t - 1.0) / 0.6, 0, 1))


def _steps(x: float) -> Asked:
    t = np.arange(0, 16.0, 1 / (SAMPLED * FINE))
    levels = np.array([350e3, 520e3, 280e3, 420e3])
    return Asked("step", {"displacement": x}, levels[np.minimum((t / 4).astype(int), 3)], np.full(len(t), x))


def _motions(muscle: Muscle, chance: np.random.Generator, lasts: float = 40.0) -> list[Asked]:
    """Pressure and contraction that go about at random."""
    pressures = np.linspace(170e3, 520e3, 36)
    tops = np.array([_farthest(muscle, P) for P in pressures])
    asked = []
    for number in range(3):
        P = 345e3 + 165e3 * np.sin(1.3 * _random(chance, 0.02, 0.25, lasts))
        share = 0.5 + 0.5 * np.sin(1.3 * _random(chance, 0.02, 0.2, lasts))
        x = 1e-3 + share * (0.75 * np.interp(P, pressures, tops) - 2e-3)
        asked.append(Asked("random", {"record": float(number)}, P, x))
    return asked


def _random(chance: np.random.Generator, low: float, high: float, lasts: float) -> Array:
    """Sum of twelve sines from `low` to `high` [Hz] with a standard deviation of 1."""
    t = np.arange(0, lasts, 1 / (SAMPLED * FINE))[:, None]
    f = chance.uniform(low, high, 12)
    return np.asarray(np.sin(2 * np.pi * (f * t + chance.random(12))).sum(axis=1) / np.sqrt(6))
