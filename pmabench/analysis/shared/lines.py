"""Straight lines and means over repeated points, with intervals that allow for correlation.

Also least squares for many values of one non-linear parameter: variable projection (Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.store.records import Array

ALIKE = 1e-12
"""Relative cut-off of the pseudo-inverse: columns that differ by less than its root count as one."""
AT_ONCE = 30_000
"""Numbers processed at once, so that they fit the processor's cache."""


def left_by(fixed: Array, tried: Array, y: Array) -> Array:
    """Residual sum of squares of y, shape (n,), for each of k sets of columns: shape (k,).

    `fixed`, shape (p, n): columns of every set; `tried`, shape (k, m, n): columns that differ from set to set.
    """
    basis, _ = np.linalg.qr(fixed.T)
    y = y - basis @ (basis.T @ y)
    share = max(1, AT_ONCE // tried[0].size)
    return np.concatenate([_left(basis, tried[i : i + share], y) for i in range(0, len(tried), share)])


def _left(basis: Array, tried: Array, y: Array) -> Array:
    tried = tried - (tried @ basis) @ basis.T
    products = tried @ tried.transpose(0, 2, 1)
    size = np.sqrt(np.diagonal(products, axis1=1, axis2=2))
    size = np.where(size > 0, size, 1.0)
    inverse = np.linalg.pinv(products / (size[:, :, None] * size[:, None, :]), ALIKE, hermitian=True)
    terms = (inverse @ (tried @ y / size)[:, :, None])[:, :, 0] / size
    rest = y - (terms[:, None] @ tried)[:, 0]
    return np.asarray(np.sum(rest**2, axis=1))


PROPORTIONAL = 2e-3
"""Least relative error of a point."""


@dataclass(frozen=True)
class Line:
    """y = start + slope s, with half widths of the 95 % intervals; None without degrees of freedom."""

    start: float
    slope: float
    half_start: float | None
    half_slope: float | None


def weighted_line(group: Array, s: Array | None, y: Array, size: Array | None = None) -> Line:
    """Weighted least squares of y = start + slope s (a mean where `s` is None), all of shape (n,).

    The error of a point is `PROPORTIONAL` times its `size` and the pooled scatter of repeats, added as squares; values
    with equal `group` are repeats. Intervals are by Student's t, the wider of that from all points and that from group
    means: points of one group share the departure from the line. NaN with fewer groups than coefficients.
    """
    size = np.abs(y) if size is None else size
    floor = PROPORTIONAL * np.maximum(size, 1e-3 * size.max())
    names, rows, count = np.unique(group, return_inverse=True, return_counts=True)

    def mean(values: Array) -> Array:
        """Of each group."""
        return np.asarray(np.bincount(rows, values) / count)

    error = np.hypot(floor, _scatter(y - mean(y)[rows], len(names)))
    weight = 1.0 / error if error.min() > 0 else np.ones_like(error)
    columns = 1 if s is None else 2
    if len(names) < columns:
        return Line(nan, nan, None, None)

    def solve(design: Array, values: Array, w: Array) -> tuple[Array, list[float] | None]:
        inverse = np.linalg.inv((design * w[:, None] ** 2).T @ design)
        fitted = inverse @ (design * w[:, None] ** 2).T @ values
        freedom = len(values) - columns
        if freedom < 1:
            return fitted, None
        residual = (values - design @ fitted) * w
        spread = float(residual @ residual) / freedom
        half = float(student.ppf(0.975, freedom)) * np.sqrt(spread * np.diag(inverse))
        return fitted, [float(value) for value in half]

    design = np.ones((len(y), 1)) if s is None else np.column_stack([np.ones_like(y), s])
    fitted, points = solve(design, y, weight)
    _, grouped = solve(np.column_stack([mean(column) for column in design.T]), mean(y), mean(weight))
    both = [half for half in (points, grouped) if half is not None]
    wider = [max(half[i] for half in both) for i in range(columns)] if both else [None] * columns
    if s is None:
        return Line(float(fitted[0]), nan, wider[0], None)
    return Line(float(fitted[0]), float(fitted[1]), wider[0], wider[1])


def _scatter(off: Array, groups: int) -> float:
    """Pooled standard deviation from deviations (n,) from the means of so many groups [as y]; 0 without repeats."""
    freedom = len(off) - groups
    return sqrt(float(off @ off) / freedom) if freedom else 0.0


def mean_of_cycles(values: Sequence[Array]) -> tuple[float, float | None]:
    """Mean of the trials' means over cycles, and its half width by `mean_half`; `values` has an array per trial."""
    means = np.array([float(one.mean()) for one in values])
    return float(means.mean()), mean_half(means, values)


def mean_half(values: Array, by_cycle: Sequence[Array]) -> float | None:
    """95 % half width of the mean of `values`, one per trial, with the cycles of each in `by_cycle`; None if unknown.

    The scatter of cycles is widened by the correlation of neighbours. With several trials the larger of that and of the
    scatter between trials counts.
    """
    halves = []
    for cycles in by_cycle:
        n = len(cycles)
        if n < 2:
            continue
        off = cycles - cycles.mean()
        power = float(off @ off)
        rho = min(max(float(off[1:] @ off[:-1]) / power, 0.0), 0.9) if n > 3 and power > 0 else 0.0
        halves.append(float(student.ppf(0.975, n - 1)) * sqrt(power / (n - 1) / n * (1 + rho) / (1 - rho)))
    return student.half_of_trials(values, halves or [nan])
