"""A straight line and exponentials through a relaxing signal over log t, and what correlated noise does to both.

Knows samples at times, no test. Both fits go through means over equal parts of log t, so that each decade counts alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log10, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from pmabench.analysis.shared import student
from pmabench.store.records import Array

PER_DECADE = 20
"""Means in each decade of time."""
TIMES = (1.0, 10.0, 100.0, 1000.0)
"""Time constants of the exponentials [s]."""
LONGEST_LAG = 0.1
"""Share of the samples up to which their noise is looked at for correlation."""


@dataclass(frozen=True, eq=False)
class Relaxing:
    """Samples y at equally spaced times t [s] after a step, shape (n,)."""

    t: Array
    y: Array

    @cached_property
    def _parts(self) -> NDArray[np.intp]:
        """Number of the part of log t that each sample is in; only parts that hold samples are counted."""
        place = np.log10(self.t / self.t[0]) * PER_DECADE
        return np.asarray(np.unique(place.astype(int), return_inverse=True)[1])

    @cached_property
    def _count(self) -> NDArray[np.intp]:
        return np.bincount(self._parts)

    def means(self, values: Array) -> Array:
        """Means of values (n,) over the parts, shape (parts,)."""
        return np.asarray(np.bincount(self._parts, values) / self._count)

    @cached_property
    def decades(self) -> Array:
        """Mean of log10 t in each part."""
        return self.means(np.log10(self.t))

    def slope_weights(self, low: float = 0.0, high: float = 1.0) -> Array:
        """Weights of samples whose sum with y is the slope over log10 t, from shares `low` to `high` of the decades."""
        u = (self.decades - self.decades[0]) / (self.decades[-1] - self.decades[0])
        rows = (u >= low - 1e-9) & (u <= high + 1e-9)
        off = np.where(rows, self.decades - self.decades[rows].mean(), 0.0)
        return self._of_parts(off / np.sum(off**2))

    def _of_parts(self, weights: Array) -> Array:
        """Weights of samples from those of the parts' means."""
        return np.asarray((weights / self._count)[self._parts])

    @cached_property
    def line(self) -> tuple[float, float]:
        """Value at t = 1 s and slope of the straight line over log10 t [as y]."""
        slope = float(self.slope_weights() @ self.y)
        return float(self.means(self.y).mean() - slope * self.decades.mean()), slope

    def _correlation(self, order: int) -> tuple[Array, float]:
        """Covariances of the noise by lag, and how many independent samples there are.

        From what a polynomial of `order` over log t leaves. Lags are tapered (Bartlett).
        """
        left = self.y - np.polyval(np.polyfit(self.decades, self.means(self.y), order), np.log10(self.t))
        n, most = len(left), max(1, int(LONGEST_LAG * len(self.t)))
        size = 2 ** int(np.ceil(np.log2(2 * n)))
        power = np.abs(np.fft.rfft(left, size)) ** 2
        covariance = np.fft.irfft(power, size)[: most + 1] / n
        tapered = covariance * (1 - np.arange(most + 1) / (most + 1))
        total = tapered[0] + 2 * float(np.sum(tapered[1:]))
        alike = max(1.0, total / tapered[0]) if tapered[0] > 0 else 1.0
        return tapered, n / alike

    def half(self, weights: Array, order: int = 1) -> float:
        """Half width of the 95 % interval of the sum of `weights` (n,) and y, from its correlated noise.

        Noise is what the straight line leaves, and so holds a bend; with `order` 3 it does not.
        """
        covariance, independent = self._correlation(order)
        n = len(weights)
        size = 2 ** int(np.ceil(np.log2(2 * n)))
        own = np.fft.irfft(np.abs(np.fft.rfft(weights, size)) ** 2, size)[: len(covariance)]
        variance = own[0] * covariance[0] + 2 * float(own[1:] @ covariance[1:])
        white = own[0] * covariance[0]
        return float(student.ppf(0.975, max(independent - 2, 2))) * sqrt(max(variance, white, 0.0))

    @cached_property
    def prony(self) -> tuple[Array, Array, float]:
        """Constant and sizes of exponentials of `TIMES` (5,), their half widths (5,), and the rms of what is left [y].

        The half widths are those without the bound at 0; infinite for a term that the samples do not show.
        """
        design = np.column_stack([np.ones(len(self._count)), *(self.means(np.exp(-self.t / T)) for T in TIMES)])
        sizes, left = nnls(design, self.means(self.y))
        shown = [0, *(1 + i for i, T in enumerate(TIMES) if self.shows(T))]
        inverse = np.linalg.pinv(design[:, shown])
        halves = np.full(len(TIMES) + 1, np.inf)
        for row, term in zip(inverse, shown, strict=True):
            halves[term] = self.half(self._of_parts(row))
        return np.asarray(sizes), halves, float(left) / sqrt(len(self._count))

    def shows(self, T: float) -> bool:
        """Whether the samples show an exponential of time constant T [s]: neither over before nor still to come."""
        return bool(self.t[0] <= T <= self.t[-1])


def decades_of(begin: float, end: float) -> float:
    """Decades of time from `begin` to `end` [s]."""
    return log10(end / begin) if 0 < begin < end else 0.0
