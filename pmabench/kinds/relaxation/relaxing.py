"""The force after a step: a straight line over log t, exponentials, jumps, and the noise of each.

Both are fitted to means over equal parts of log t, so that each decade has the same weight. Nothing here knows of
pressures, holds or trials.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from pmabench.analysis.shared import student
from pmabench.analysis.shared.samples import autocorrelation
from pmabench.store.records import Array

PER_DECADE = 20
"""Means in each decade of time."""
TIMES = (1.0, 10.0, 100.0, 1000.0)
"""Time constants of the exponentials [s]."""
JUMPS_OVER, JUMPS, LEAST_JUMP = 9, 8.0, 5e-3
"""Samples on either side of a jump; a jump in usual differences between them, and as a share of the force."""
LONGEST_LAG = 0.1
"""Longest lag of the noise's correlation, as a share of the samples."""


@dataclass(frozen=True, eq=False)
class Relaxing:
    """Samples y at equally spaced times t [s] after a step, shape (n,)."""

    t: Array
    y: Array

    @cached_property
    def _parts(self) -> NDArray[np.intp]:
        """Index of the part of log t for each sample; empty parts are not counted."""
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

    @cached_property
    def bent(self) -> float:
        """Value at t = 1 s of a parabola over log10 t minus that of the straight line [as y]."""
        return float(np.polyfit(self.decades, self.means(self.y), 2)[2]) - self.line[0]

    @cached_property
    def jump(self) -> tuple[float, float]:
        """The largest step between two samples that a course over log t cannot have, and its time; 0 without one.

        What the line through the medians of the next samples before and after has, is no step.
        """
        over, n = np.log10(self.t), JUMPS_OVER
        if len(self.y) < 4 * n:
            return 0.0, 0.0

        def steps(y: Array) -> Array:
            near = np.median(np.lib.stride_tricks.sliding_window_view(y, n), axis=1)
            return np.asarray(1.5 * (near[2 * n : -n] - near[n : -2 * n] - (near[3 * n :] - near[: -3 * n]) / 3))

        found, beyond = steps(self.y), np.abs(steps(self.y - np.polyval(np.polyfit(over, self.y, 1), over)))
        least = max(JUMPS * float(np.median(beyond)) / 0.6745, LEAST_JUMP * abs(float(self.y.mean())))
        place = int(np.argmax(np.abs(found) * (beyond > least)))
        return (float(found[place]), float(self.t[place + 2 * n])) if beyond[place] > least else (0.0, 0.0)

    def _of_parts(self, weights: Array) -> Array:
        """Weights of samples from those of the parts' means."""
        return np.asarray((weights / self._count)[self._parts])

    @cached_property
    def line(self) -> tuple[float, float]:
        """Value at t = 1 s and slope of the straight line over log10 t [as y]."""
        slope = float(self.slope_weights() @ self.y)
        return float(self.means(self.y).mean() - slope * self.decades.mean()), slope

    def by_line(self, t: Array) -> Array:
        """The straight line's part that changes, at times t [s, as y]."""
        return np.asarray(self.line[1] * np.log10(t))

    def by_exponentials(self, t: Array) -> Array:
        """The exponentials' part that changes, at times t [s, as y]."""
        return np.asarray(sum(size * np.exp(-t / T) for size, T in zip(self.prony[0][1:], TIMES, strict=True)))

    def residual(self, order: int) -> Array:
        """What a polynomial of `order` over log t leaves of the samples (n,)."""
        return np.asarray(self.y - np.polyval(np.polyfit(self.decades, self.means(self.y), order), np.log10(self.t)))

    def half(self, weights: Array, noise: Array | None = None) -> float:
        """Half width of the 95 % interval of the sum of `weights` (n,) and y, from its correlated `noise` (n,).

        Noise is what a fit leaves, so a bend that the fit has not counts as noise: by default the straight line. Lags
        of its autocovariance are tapered (Bartlett).
        """
        left = self.residual(1) if noise is None else noise
        n, most = len(left), max(1, int(LONGEST_LAG * len(left)))
        covariance = autocorrelation(left, most) / n * (1 - np.arange(most + 1) / (most + 1))
        total = covariance[0] + 2 * float(np.sum(covariance[1:]))
        independent = n / (max(1.0, total / covariance[0]) if covariance[0] > 0 else 1.0)
        own = autocorrelation(weights, most)
        variance = own[0] * covariance[0] + 2 * float(own[1:] @ covariance[1:])
        white = own[0] * covariance[0]
        return float(student.ppf(0.975, max(independent - 2, 2))) * sqrt(max(variance, white, 0.0))

    @cached_property
    def prony(self) -> tuple[Array, Array, Array]:
        """Constant and sizes of exponentials of `TIMES` (5,), the samples' weights in each (5, n), half widths (5,).

        Weights and half widths are those of all five together, without the bound at 0: a term that the samples do not
        show, or that is at its bound, takes from the others what the samples cannot tell apart.
        """
        terms = np.vstack([np.ones_like(self.t), *(np.exp(-self.t / T) for T in TIMES)])
        design = np.column_stack([self.means(term) for term in terms])
        sizes, _ = nnls(design, self.means(self.y))
        rows = np.array([self._of_parts(row) for row in np.linalg.pinv(design)])
        noise = self.y - sizes @ terms
        return np.asarray(sizes), rows, np.array([self.half(row, noise) for row in rows])

    def shows(self, T: float) -> bool:
        """Whether the time constant T [s] of an exponential lies within the samples."""
        return bool(self.t[0] <= T <= self.t[-1])
