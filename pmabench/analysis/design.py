"""How well coefficients will be known after further trials: covariance of a least squares whose trials are clusters.

A trial in cell c has rows X of the fit and N_c = X'X. Trials scatter: the coefficients of each lie about theirs,
with the covariance T; samples scatter by the noise sigma. Least squares weighs all rows alike, so that (Liang and Zeger
1986, Biometrika 73, 13: working independence, clusters)

    C = N^-1 (sum S_i) N^-1,   S_c = sigma^2 N_c + N_c T N_c,   N = N_0 + sum N_i,

with N_0 the weak prior of the fit. Knows matrices only: no kind of test, no run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

SCATTER = 0.02
"""Scatter between trials where no repeats show it, of each coefficient; muscles show 0.3 to 2 %."""
FEWEST = 10
"""Degrees of freedom among repeats from which on their scatter takes the place of that."""
NORMAL = 1.96
"""Half width of a 95 % interval by its standard deviation."""
LEAST, MOST = 1e-5, 0.2
"""Of the scatter between trials that is found."""
BISECTIONS = 20


@dataclass(frozen=True, eq=False)
class Design:
    """What one more trial in each cell adds to a fit with p unknowns, of which m combinations are wanted."""

    prior: Array
    """N_0, shape (p, p)."""
    cells: Array
    """N_c of one trial in each cell, shape (cells, p, p)."""
    noise: float
    """Standard deviation of a row's noise, sigma."""
    between: Array
    """T, covariance of the unknowns from trial to trial, shape (p, p)."""
    wanted: Array
    """Combinations of the unknowns, shape (m, p)."""

    def variances(self, counts: Array) -> Array:
        """Variance of each wanted combination after `counts` (cells,) trials, shape (m,)."""
        return np.asarray(self._variances(*self._sums(counts)))

    def after_each(self, counts: Array) -> Array:
        """The same after one more trial in each cell in turn, shape (cells, m)."""
        normal, spread = self._sums(counts)
        return np.asarray(self._variances(normal + self.cells, spread + self._spreads))

    def slopes(self, counts: Array) -> Array:
        """Derivatives of the variances by the count of each cell, shape (cells, m)."""
        normal, spread = self._sums(counts)
        solved = np.linalg.solve(normal, self.wanted.T)
        left = np.linalg.solve(normal, (self.noise**2 * normal + spread) @ solved)
        cells, between = self.cells @ solved, self._spreads @ solved
        own = np.einsum("pm,cpm->cm", solved, self.noise**2 * cells + between)
        return np.asarray(own - 2 * np.einsum("pm,cpm->cm", left, cells))

    def without_each(self, counts: Array, cells: NDArray[np.intp]) -> Array:
        """The same after one trial less in each of some cells in turn, which have at least one; shape (len(cells), m).

        Infinite where nothing is left that tells a combination.
        """
        normal, spread = self._sums(counts)
        found = self._variances(normal - self.cells[cells], spread - self._spreads[cells])
        return np.where(found > 0, found, np.inf)

    def covariance(self, counts: Array) -> Array:
        """Covariance of all unknowns after `counts` (cells,) trials, shape (p, p)."""
        normal, spread = self._sums(counts)
        inverse = np.linalg.inv(normal)
        return np.asarray(inverse @ (self.noise**2 * normal + spread) @ inverse)

    @cached_property
    def _spreads(self) -> Array:
        """N_c T N_c of each cell, shape (cells, p, p)."""
        return np.asarray(self.cells @ self.between @ self.cells)

    def _sums(self, counts: Array) -> tuple[Array, Array]:
        """N, and the sum of all N_c T N_c."""
        normal = self.prior + np.tensordot(counts, self.cells, 1)
        return normal, np.tensordot(counts, self._spreads, 1)

    def _variances(self, normal: Array, spread: Array) -> Array:
        """Diagonal of W N^-1 (sigma^2 N + spread) N^-1 W', for matrices of shape (..., p, p)."""
        scale = np.sqrt(np.einsum("...ii->...i", normal))
        even = normal / (scale[..., :, None] * scale[..., None, :])
        right = np.swapaxes(self.wanted / scale[..., None, :], -1, -2)
        solved = np.linalg.solve(even, right) / scale[..., :, None]
        total = self.noise**2 * normal + spread
        return np.asarray(np.einsum("...pm,...pm->...m", solved, total @ solved))


def scatter_like(design: Design, counts: Array, halves: Array, prior: float) -> float:
    """How much trials scatter, so that the design has the intervals that an analysis found from the repeats.

    `design.between` is for a scatter of 1. The share is that at which the median of the design's half widths over
    `halves` (m,) is 1, between `LEAST` and `MOST`; `prior` where there are none.
    """
    if not len(halves):
        return prior
    low, high = log(LEAST), log(MOST)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        known = replace(design, between=exp(2 * middle) * design.between)
        if float(np.median(NORMAL * np.sqrt(known.variances(counts)) / halves)) > 1:
            high = middle
        else:
            low = middle
    return exp(0.5 * (low + high))
