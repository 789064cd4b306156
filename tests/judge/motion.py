"""Motion of weights that hang from the simulated muscle while its pressure goes up and down in steps; no noise.

All trials of a campaign go forward together in time, in steps of a millisecond (trapezoidal rule). Dry friction
is exact in the sense of Coulomb: a weight at rest moves when its pull exceeds the friction, and one that would turn
round within a step stays at rest at its end. `test_judge` halves the step and compares with another solver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.judge.muscle import (
    CREEP_TIMES,
    FRICTION,
    SLIDES,
    STROKE,
    Array,
    Muscle,
    damping_down,
    damping_up,
    pull,
    stiffness,
)
from tests.judge.record import lagged

GRAVITY = 9.81
RATE = 500.0
"""Samples a second."""
FINE = 2
"""Steps of the integration between two samples."""
DEAD_TIME = 0.025
"""From a command to the first change of pressure [s]."""
FILLING, VENTING = 0.09, 0.14
"""Time constants of the pressure [s]."""

Steps = tuple[tuple[float, float], ...]
"""Time [s] and value [Pa] of each command of a trial."""


@dataclass(frozen=True)
class Motion:
    """Samples of all trials, arrays (trials, samples): contraction of the load [m] and force in the cell [N]."""

    x: Array
    force: Array


def pressure(steps: Steps, t: Array) -> Array:
    """Pressure [Pa] at times [s] of a trial that begins vented: each command after its dead time through a lag."""
    P = np.zeros_like(t)
    begin, last = 0.0, 0.0
    value = 0.0
    for at, target in (*steps, (np.inf, 0.0)):
        until = at + DEAD_TIME
        lag = FILLING if value > last else VENTING
        rows = (t >= begin) & (t < until)
        P[rows] = value + (last - value) * np.exp(-(t[rows] - begin) / lag)
        last = value + (last - value) * float(np.exp(-(until - begin) / lag))
        begin, value = until, target
    return P


def hang(
    muscle: Muscle, masses: Array, commands: Sequence[Steps], duration: float, pauses: Array, *,
    slack: float = 0.0, tube: float = 0.0, fine: int = FINE,
) -> Motion:  # fmt: skip
    """The motion of trials with `masses` [kg] one after the other, with `pauses` [s] after each at no pressure.

    `slack` [m] is how far the fixed end of the muscle is nearer to the load's support than it should be; `tube` [s] is
    the time constant by which the muscle's pressure follows that of the regulator.
    """
    t = np.arange(round(duration * RATE) * fine + 1) / (RATE * fine)
    P = np.array([lagged(pressure(steps, t), tube, RATE * fine) for steps in commands]).T
    crept, strained = (np.zeros((len(of), len(masses))) for of in (CREEP_TIMES, SLIDES))
    # each pass knows the creep and the strain that one more of the trials before has left
    for _ in range(5 if muscle.creep else 2 if muscle.hysteresis else 1):
        motion, crept, strained = _advance(muscle, masses, P, crept, strained, slack, fine)
        crept, strained = np.roll(crept, 1, axis=1), np.roll(strained, 1, axis=1)
        crept[:, 1:] *= np.exp(-pauses[:-1] / CREEP_TIMES[:, None])
        crept[:, 0] = strained[:, 0] = 0.0
    return motion


def _advance(
    muscle: Muscle, masses: Array, P: Array, crept: Array, strained: Array, slack: float, fine: int
) -> tuple[Motion, Array, Array]:
    """Motion from rest on the support, and the creep and the strain of the braid at the end."""
    h = 1.0 / (RATE * fine)
    weight = masses * GRAVITY
    slides = SLIDES[:, None]
    gap = muscle.gap(P)
    rubbed = np.zeros_like(masses)
    force, K, up, down = pull(P), stiffness(P), damping_up(P), damping_down(P)
    x, v = np.zeros_like(masses), np.zeros_like(masses)
    share = muscle.creep / len(CREEP_TIMES)
    follow = -np.expm1(-h / CREEP_TIMES)[:, None]
    crept, strained = crept.copy(), strained.copy()
    offset = slack - crept.sum(axis=0)
    places, forces = np.empty(((len(P) - 1) // fine + 1, len(x))), np.empty(((len(P) - 1) // fine + 1, len(x)))
    for n in range(len(P)):
        u = x + offset
        if muscle.hysteresis:
            rubbed = gap[n] * np.mean(strained / slides, axis=0)
        elastic = force[n] - K[n] * u * (1 + muscle.bend * (1 - u / STROKE)) - rubbed
        excess = elastic - weight
        start = np.where(excess > FRICTION, 1.0, np.where((excess < -FRICTION) & (x > 0), -1.0, 0.0))
        way = np.where(v != 0, np.sign(v), start)
        if n % fine == 0:
            moving = elastic - np.where(way > 0, up[n], down[n]) * v - FRICTION * way
            resting = np.where(x > 0, weight, np.clip(elastic, 0.0, weight))
            places[n // fine], forces[n // fine] = x, np.where(way != 0, moving, resting)
        if n + 1 == len(P):
            break
        b0, b1 = np.where(way > 0, up[n : n + 2], down[n : n + 2])
        ahead = u + 0.5 * h * v
        bent = 1 + muscle.bend * (1 - ahead / STROKE)
        k0, k1 = K[n] * bent, K[n + 1] * bent
        if muscle.hysteresis:
            rubbed = gap[n] * np.mean(np.clip(strained + 0.5 * h * v, -slides, slides) / slides, axis=0)
        push = 0.5 * (force[n] + force[n + 1] - (k0 + k1) * u - k1 * 0.5 * h * v - b0 * v) - weight - FRICTION * way
        push = push - rubbed
        after = (masses * v / h + push) / (masses / h + 0.5 * b1 + 0.25 * h * k1)
        after = np.where(after * way > 0, after, 0.0)
        there = x + 0.5 * h * (v + after)
        landed = there < 0
        there, v = np.where(landed, 0.0, there), np.where(landed, 0.0, after)
        if share:
            crept += follow * (share * 0.5 * (x + there) - crept)
            offset = slack - crept.sum(axis=0)
        if muscle.hysteresis:
            strained = np.clip(strained + there - x, -slides, slides)
        x = there
    return Motion(places.T.copy(), forces.T.copy()), crept, strained
