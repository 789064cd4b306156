"""A straight line F_ce(P) through the pressures of loads, with what it is uncertain by; knows no records."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.kinds.static_load.points import Points
from pmabench.store.records import Array


@dataclass(frozen=True, eq=False)
class Line:
    """F_ce = a + s P [N, N/Pa] with the covariance (2, 2) of (a, s), to be multiplied by t squared."""

    a: float
    s: float
    covariance: Array
    factor: float
    """Student's t for 95 %."""
    r2: float
    rms: float
    """Residual [N]."""
    lack: float
    """Root mean square distance of the loads' means from the line, by what their repeats allow; 0 if not known."""

    def __call__(self, P: float) -> float:
        """F_ce [N] at P [Pa]."""
        return self.a + self.s * P

    def half(self, row: Array) -> float:
        """95 % half width of row @ (a, s)."""
        return self.factor * sqrt(max(0.0, float(row @ self.covariance @ row)))


def fit_side(points: Points, method: str) -> Line | None:
    """The line through the pressures of one method; None below two loads."""
    usable = np.isfinite(points.side(method))
    return _fit(points.load[usable], points.side(method)[usable])


def _fit(load: Array, P: Array) -> Line | None:
    """P = c + m F_L by least squares, turned into F_ce = (P - c) / m; None below two loads.

    The covariance is that of single points or that of the loads' means, whichever is wider: repeats of one load share
    what the line cannot follow there.
    """
    names, group, count = np.unique(np.round(load, 3), return_inverse=True, return_counts=True)
    if len(names) < 2:
        return None
    design = np.column_stack([np.ones_like(load), load])
    inverse = np.linalg.inv(design.T @ design)
    c, m = inverse @ (design.T @ P)
    if m <= 0:
        return None
    residual = P - c - m * load
    chosen, factor = np.zeros((2, 2)), 0.0
    middle = np.array([1.0, float(load.mean())])
    means = np.bincount(group, residual) / count
    for power, freedom in ((float(residual @ residual), len(P) - 2), (float(count @ means**2), len(names) - 2)):
        if freedom < 1:
            continue
        covariance, t = power / freedom * inverse, float(student.ppf(0.975, freedom))
        if t**2 * (middle @ covariance @ middle) > factor**2 * (middle @ chosen @ middle):
            chosen, factor = covariance, t
    turn = np.array([[-1 / m, c / m**2], [0.0, -1 / m**2]])
    total = float(np.sum((P - P.mean()) ** 2))
    return Line(
        a=float(-c / m),
        s=float(1 / m),
        covariance=turn @ chosen @ turn.T,
        factor=factor,
        r2=1.0 - float(residual @ residual) / total,
        rms=float(np.sqrt(np.mean(residual**2)) / m),
        lack=_lack(residual, group, means, count),
    )


def _lack(residual: Array, group: NDArray[np.intp], means: Array, count: NDArray[np.intp]) -> float:
    """Scatter of the loads' means about the line by what the scatter of repeats explains, as a ratio of deviations."""
    within, freedom = residual - means[group], len(residual) - len(means)
    if freedom < 1 or len(means) < 3:
        return 0.0
    pure = float(within @ within) / freedom
    between = float(count @ means**2) / (len(means) - 2)
    return sqrt(between / pure) if pure > 0 else 0.0
