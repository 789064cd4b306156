"""Motion of weights that hang from the second muscle, one trial after the other, without noise; SI.

All trials go forward together. Friction and damping are in one implicit step, so that a weight stops and starts by
itself; the force in the cell is the weight and what the mass is accelerated by. What creep and hysteresis keep from
one trial to the next is put in before the next pass over all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.judge.second.bench import GRAVITY
from tests.judge.second.muscle import (
    DAMPING,
    FRICTION,
    RATES,
    WIDENS,
    Array,
    Muscle,
    ends,
    heavier,
    moved,
    tight,
    weights,
)


@dataclass(frozen=True)
class State:
    """What a muscle keeps between trials: parts of the creep (rates, trials) [m] and hysteresis (trials,)."""

    crept: Array
    z: Array


def hang(
    muscle: Muscle, masses: Array, P: Array, rate: float, pauses: Array, *, slack: float = 0.0, fine: int = 1
) -> tuple[Array, Array]:  # fmt: skip
    """Contraction of the load [m] and force in the cell [N], arrays (trials, samples), with every `fine`-th sample.

    `P` (trials, samples) is the pressure in the muscle, `rate` [Hz] that of `P`; `masses` [kg] hang; `pauses` [s]
    without pressure follow each trial. `slack` [m]: how far the fixed end of the muscle is nearer to the support.
    """
    state = State(np.zeros((len(RATES), len(masses))), np.full(len(masses), ends()[1]))
    lasts = P.shape[1] / rate
    for _ in range(2 if muscle.creep or muscle.hysteresis else 1):
        x, force, ended = _together(muscle, masses, P, rate, state, slack)
        grown = ended.crept - np.exp(-RATES * lasts)[:, None] * state.crept
        begun, left = np.zeros_like(grown), np.zeros(len(RATES))
        for number, pause in enumerate(pauses):
            begun[:, number] = left
            left = np.exp(-RATES * pause) * (np.exp(-RATES * lasts) * left + grown[:, number])
        state = State(begun, np.concatenate([[ends()[1]], ended.z[:-1]]))
    return x[:, ::fine], force[:, ::fine]


def _together(
    muscle: Muscle, masses: Array, P: Array, rate: float, state: State, slack: float
) -> tuple[Array, Array, State]:
    """One pass over all trials from given states."""
    h, weight = 1.0 / rate, masses * GRAVITY
    forget, learn = np.exp(-RATES * h)[:, None], (weights() * -np.expm1(-RATES * h))[:, None]
    crept, z = state.crept.copy(), state.z.copy()
    x, v = np.zeros_like(masses), np.zeros_like(masses)
    places, forces = np.empty((P.shape[1], len(x))), np.empty((P.shape[1], len(x)))
    pull, ahead = np.zeros_like(x), np.vstack([P.T[1:], P.T[-1:]])
    middles = 0.5 * (P.T + ahead)
    tightened, rubbing = tight(middles), muscle.rubbed(middles)
    ups, downs = (a + b * middles for a, b in DAMPING.values())
    strands = WIDENS * middles[0]
    for n, middle in enumerate(middles):
        half = x + 0.5 * h * v
        if muscle.hysteresis:
            last, strands = strands, half + WIDENS * middle
            z = moved(z, strands - last)
        gone = tightened[n] * crept.sum(axis=0) if muscle.creep else 0.0
        held = muscle.static(half + slack - gone, middle) - rubbing[n] * z - weight
        B = np.where(v + h * held / masses >= 0, ups[n], downs[n])
        free = (masses / h - 0.5 * B) * v + held
        there = np.sign(free) * np.maximum(np.abs(free) - FRICTION, 0.0) / (masses / h + 0.5 * B)
        there = np.where(masses * (there - v) / h + weight < 0, v - h * GRAVITY, there)
        lies = x + 0.5 * h * (v + there) <= 0
        before, pull = pull, np.where(lies, np.clip(held + weight, 0.0, weight), masses * (there - v) / h + weight)
        places[n], forces[n] = x, 0.5 * (before + pull)
        there = np.where(lies, 0.0, there)
        x, v = np.where(lies, 0.0, x + 0.5 * h * (v + there)), there
        if muscle.creep:
            crept = forget * crept + learn * muscle.creep * heavier(pull) * x
    return places.T, forces.T, State(crept, z)
