"""V(eps) of the modified Daerden model through volumes: D0, theta0 and alpha. Knows volumes over contraction, no test.

V = (pi/4) D0^2 l0 [1/sin^2 theta0 - (1 - eps)^alpha / tan^2 theta0] (1 - eps) (paper 3). For a given alpha it is
linear in D0^2/sin^2 theta0 and D0^2/tan^2 theta0, so only alpha is searched; no start values.
"""

from __future__ import annotations

from math import atan, pi, sqrt

import numpy as np
from scipy.optimize import minimize_scalar

from pmabench.store.records import Array

ALPHAS = (1.0, 5.0)
"""Where alpha is looked for: the domain of the model."""
FEWEST = 4


def fit_volume(eps: Array, V: Array, length: float) -> tuple[float, float, float] | None:
    """D0 [m], theta0 [rad], alpha [1] of volumes V [m3] at eps [1], shape (n,); None where no such curve fits."""
    if len(eps) < FEWEST or not np.isfinite(V).all():
        return None
    size, y = pi / 4 * length, V / V.max()

    def solve(alpha: float) -> tuple[Array, float]:
        design = np.column_stack([1 - eps, -((1 - eps) ** (alpha + 1))])
        terms, *_ = np.linalg.lstsq(design, y, rcond=None)
        return np.asarray(terms), float(np.sum((y - design @ terms) ** 2))

    found = minimize_scalar(lambda a: solve(a)[1], bounds=ALPHAS, method="bounded", options={"xatol": 1e-9})
    alpha = float(found.x)
    (round_, straight), _ = solve(alpha)
    ends = min(alpha - ALPHAS[0], ALPHAS[1] - alpha)
    if not round_ > straight > 0 or ends < 1e-3:
        return None
    # round = D0^2/sin^2, straight = D0^2/tan^2: their difference is D0^2
    square = float((round_ - straight) * V.max() / size)
    return sqrt(square), atan(sqrt((round_ - straight) / straight)), alpha


def volume_at(eps: Array, length: float, D_0: float, theta_0: float, alpha: float) -> Array:
    """V [m3] at eps [1], any shape."""
    s = 1 - eps
    return np.asarray(pi / 4 * D_0**2 * length * (1 / np.sin(theta_0) ** 2 - s**alpha / np.tan(theta_0) ** 2) * s)
