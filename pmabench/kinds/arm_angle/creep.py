"""Creep of an arm that takes longer than a hold: how far each rest is from its end, by the drifts of all rests.

One hold shows slow creep as a straight drift, without an end. All steps of a staircase together show how a drift dies
away, and so how long it takes. Knows times and angles only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.shared.samples import Held
from pmabench.store.records import Array

TIMES = np.geomspace(0.3, 120.0, 19)
"""Time constants that are tried, over the length of the stretch of a hold that is looked at."""
SLOW = 4.0
"""From here on one hold does not show them (`samples.TIMES`)."""
SURE = 8.0
"""Standard deviations from which on creep is seen."""
MORE = 1.3
"""Factor on what is still to come: creep is no exponential, and goes on for longer than one."""


@dataclass(frozen=True)
class Step:
    """A step of a staircase and the rest after it."""

    t: float
    """Of its middle [s]."""
    by: float
    """Change of the angle to this rest [rad]."""
    since: float
    """Begin of the stretch that `held` is of [s]."""
    held: Held


def still_to_come(stairs: Sequence[Sequence[Step]]) -> Array:
    """What slow creep still adds at each rest of like staircases [rad], the mean of them; 0 where none is seen.

    A share of each step comes with one time constant, and what was left before the first one dies away with it.
    """
    count = {len(steps) for steps in stairs}
    if len(count) != 1 or (rests := count.pop()) < 4:
        return np.zeros(max((len(steps) for steps in stairs), default=0))
    length = float(np.mean([step.held.t[-1] for steps in stairs for step in steps]))
    drifts = np.array([_drift(step.held.y) for steps in stairs for step in steps])
    best = min((_fitted(stairs, drifts, length * time) for time in TIMES), key=lambda one: one[0])
    cost, time, share, error, far = best
    if time < SLOW * length or share < SURE * error or cost <= 0:
        return np.zeros(rests)
    return np.asarray(MORE * np.abs(far.reshape(-1, rests).mean(axis=0)))


def _drift(y: Array) -> float:
    """Mean of the later half less that of the earlier."""
    half = len(y) // 2
    return float(y[half:].mean() - y[:half].mean())


def _fitted(stairs: Sequence[Sequence[Step]], drifts: Array, time: float) -> tuple[float, float, float, float, Array]:
    """Sum of squares left, the time constant [s], the share of each step and its error [1], what is to come [rad]."""
    moves, ends = [], []
    for steps in stairs:
        at, by = (np.array([getattr(step, name) for step in steps]) for name in ("t", "by"))
        for n, step in enumerate(steps):
            t = step.since + step.held.t
            open_ = np.exp(-(t[:, None] - at[: n + 1]) / time)
            left = np.column_stack([open_ @ by[: n + 1], open_[:, 0]])
            moves.append([-_drift(column) for column in left.T])
            ends.append(left[step.held.late > 0].mean(axis=0))
    columns = np.array(moves)
    found, *_ = np.linalg.lstsq(columns, drifts, rcond=None)
    cost = float(np.sum((drifts - columns @ found) ** 2))
    error = float(np.sqrt(cost / (len(drifts) - 2) * np.linalg.pinv(columns.T @ columns)[0, 0]))
    return cost, time, float(found[0]), error, np.array(ends) @ found
