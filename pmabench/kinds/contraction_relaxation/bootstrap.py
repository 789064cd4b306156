"""The bootstrap over trials of a pooled fit: normal equations drawn again, nothing refitted; knows no protocol.

A check of the repeats part, which is the limit of many draws, by what the draws themselves say. Of n trials n - 1 are
drawn and weigh n / (n - 1), or a draw from two would scatter by a half too little (Rao and Wu 1988, J. Am. Stat. Assoc.
83, 231).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmabench.kinds.contraction_relaxation.pooled import Solved
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.store.records import Array


@dataclass(frozen=True, eq=False)
class Draws:
    """Theta of each draw, shape (count, p)."""

    theta: Array
    within: bool
    """Drawn within cells; else among all trials, for hardly a cell is repeated."""

    def half(self, combination: Array) -> float:
        """Half the width between the percentiles 2.5 and 97.5 of a linear combination (p,)."""
        low, high = np.percentile(self.theta @ combination, [2.5, 97.5])
        return float(high - low) / 2


def bootstrap(
    segments: Segments, fit: Solved, cells: NDArray[np.intp], count: int, within: bool, seed: int = 0
) -> Draws:
    """`count` fits to trials drawn with replacement: within their cells, or among all.

    `cells` holds the cell of each trial number in `segments.trial`. The prior of the fit stays in every draw; the same
    `seed` gives the same draws.
    """
    trials, rows = np.unique(segments.trial, return_inverse=True)
    normal = np.array([_square(fit.design[rows == i]) for i in range(len(trials))])
    right = np.zeros((len(trials), fit.design.shape[1]))
    np.add.at(right, rows, fit.design * segments.force[:, None])
    prior = np.linalg.inv(fit.inverse) - normal.sum(axis=0)
    groups = [np.flatnonzero(cells[trials] == cell) for cell in np.unique(cells[trials])]
    groups = groups if within else [np.arange(len(trials))]
    chance = np.random.default_rng(seed)
    drawn = np.empty((count, len(fit.theta)))
    for draw in range(count):
        weight = np.zeros(len(trials))
        for group in groups:
            n = len(group)
            if n == 1:
                weight[group] = 1.0
            else:
                np.add.at(weight, chance.choice(group, n - 1), n / (n - 1))
        total = np.tensordot(weight, normal, 1) + prior
        scale = np.sqrt(np.diag(total))
        drawn[draw] = np.linalg.solve(total / np.outer(scale, scale), (weight @ right) / scale) / scale
    return Draws(drawn, within)


def _square(design: Array) -> Array:
    return np.asarray(design.T @ design)
