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
    FRICTION,
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
    slack: float = 0.0, tube: float = 0.0, guide: float = 0.0, fine: int = FINE,
) -> Motion:  # fmt: skip
    """The motion of trials with `masses` [kg] one after the other, with `pauses` [s] after each at no pressure.

    `slack` [m] is how far the fixed end of the muscle is nearer to the load's support than it should be; `tube` [s] is
    the time constant by which the muscle's pressure follows that of the regulator; `guide` [N] rubs on the load, below
    the cell.
    """
    t = np.arange(round(duration * RATE) * fine + 1) / (RATE * fine)
    P = np.array([lagged(pressure(steps, t), tube, RATE * fine) for steps in commands]).T
    times = np.array(muscle.times)[:, None]
    crept, strained = (np.zeros((len(of), len(masses))) for of in (muscle.times, muscle.slides))
    # what a trial begins with changes little of how it creeps, so that few passes find what each leaves to the next
    for _ in range(3 if muscle.creep else 2 if muscle.hysteresis else 1):
        motion, end, strained = _advance(muscle, masses, P, crept, strained, slack, fine, guide)
        added = end - crept * np.exp(-duration / times)
        for number in range(1, len(masses)):
            left = crept[:, number - 1] * np.exp(-duration / times[:, 0]) + added[:, number - 1]
            crept[:, number] = left * np.exp(-pauses[number - 1] / times[:, 0])
        strained = np.roll(strained, 1, axis=1)
        strained[:, 0] = 0.0
    return motion


def _advance(
    muscle: Muscle, masses: Array, P: Array, crept: Array, strained: Array, slack: float, fine: int, guide: float = 0.0
) -> tuple[Motion, Array, Array]:
    """Motion from rest on the support, and the creep and the strain of the braid at the end."""
    h = 1.0 / (RATE * fine)
    weight, friction = masses * GRAVITY, FRICTION + guide
    slides = np.array(muscle.slides)[:, None]
    gap = muscle.gap(P)
    force, K, up, down = pull(P), stiffness(P), damping_up(P), damping_down(P)
    x, v = np.zeros_like(masses), np.zeros_like(masses)
    share = muscle.creep / len(muscle.times)
    follow = -np.expm1(-h / np.array(muscle.times))[:, None]
    crept, strained = crept.copy(), strained.copy()
    offset = slack - crept.sum(axis=0)
    shape = ((len(P) - 1) // fine + 1, len(x))
    places, speeds, pulls, ways = np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape)
    inertia, pushed = masses / h, force[:-1] + force[1:]  # numpy takes a microsecond for each line: none of these twice
    k0, k1, twice = K[:-1], K[1:], K[:-1] + K[1:]
    for n in range(len(P)):
        u = x + offset
        spring = K[n] * u
        if muscle.bend:
            spring *= 1 + muscle.bend * (1 - u / STROKE)
        elastic = force[n] - spring
        if muscle.hysteresis:
            elastic -= gap[n] * (np.add.reduce(strained / slides) / len(slides))
        way = np.sign(v)
        if not v.all():
            excess = elastic - weight
            start = np.where(excess > friction, 1.0, np.where((excess < -friction) & (x > 0), -1.0, 0.0))
            way = np.where(v != 0, way, start)
        if n % fine == 0:
            places[n // fine], speeds[n // fine], pulls[n // fine], ways[n // fine] = x, v, elastic, way
        if n + 1 == len(P):
            break
        there = x
        if way.any():
            b0, b1 = np.where(way > 0, up[n : n + 2], down[n : n + 2])
            ahead = 0.5 * h * v
            both, end = twice[n], k1[n]
            if muscle.bend:
                bent = 1 + muscle.bend * (1 - (u + ahead) / STROKE)
                both, end = k0[n] * bent + k1[n] * bent, k1[n] * bent
            push = 0.5 * (pushed[n] - both * u - end * 0.5 * h * v - b0 * v) - weight - friction * way
            if muscle.hysteresis:
                half = np.minimum(np.maximum(strained + ahead, -slides), slides)
                push -= gap[n] * (np.add.reduce(half / slides) / len(slides))
            after = (masses * v / h + push) / (inertia + 0.5 * b1 + 0.25 * h * end)
            after = np.where(after * way > 0, after, 0.0)
            there, v = x + 0.5 * h * (v + after), after
            landed = there < 0
            if landed.any():
                there, v = np.where(landed, 0.0, there), np.where(landed, 0.0, after)
            if muscle.hysteresis:
                strained = np.minimum(np.maximum(strained + there - x, -slides), slides)
        if share:
            crept += follow * (share * 0.5 * (x + there) - crept)
            offset = slack - np.add.reduce(crept)
        x = there
    moving = pulls - np.where(ways > 0, up[::fine], down[::fine]) * speeds - FRICTION * ways
    rubbing = guide / friction * np.clip(pulls - weight, -friction, friction)  # its share of what holds the load
    resting = np.where(places > 0, weight + rubbing, np.clip(pulls, 0.0, weight))
    forces = np.where(ways != 0, moving, resting)
    return Motion(places.T.copy(), forces.T.copy()), crept, strained
