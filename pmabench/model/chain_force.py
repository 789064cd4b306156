"""The one force of a chain of three-element muscles at rest; knows no time."""

from __future__ import annotations

import numpy as np

from pmabench.model.curve import Array


def held_force(F_ce: Array, K: Array, stops: Array, displacement: Array) -> Array:
    """The one force F [N] of a chain at rest that is held at a total contraction x [m].

    F solves sum over i of min(max((F_ce_i - F) / K_i, 0), stop_i) = x, F >= 0: every muscle pulls with the same
    force, none is longer than its length or shorter than its stop. At x = 0 it is the largest F_ce, for equal
    muscles F_ce - K x / N: always that of one muscle. 0 where the chain is slack. `F_ce`, `K`: shape (muscles,
    times); `stops`: (muscles,).
    """
    low, high = np.zeros(displacement.shape), F_ce.max(axis=0)
    limits = stops[:, None]
    for _ in range(60):
        middle = 0.5 * (low + high)
        reached = np.clip((F_ce - middle) / K, 0, limits).sum(axis=0)
        low, high = np.where(reached >= displacement, middle, low), np.where(reached >= displacement, high, middle)
    return np.asarray(np.where(displacement <= 0, F_ce.max(axis=0), 0.5 * (low + high)))
