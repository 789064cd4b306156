"""The outline of a muscle: a cylinder between two curved ends (paper 1 eq. 21); knows no drawing.

The braid does not stretch, so the body of a muscle that is shorter is wider:
r(eps) = r0 sqrt(1 - (1 - eps)^2 cos^2 theta0) / sin theta0. The ends stay at r0, where the fittings hold them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
"""Of shape (points, 2): along the axis and away from it [m]."""
ENTRY = math.radians(40)
"""Angle of the end's tangent at the fitting to the axis [rad]; paper 1 found its own by trial and prints none."""
REACH = 2.4
"""The body begins this many times as far from the fitting as the two tangents meet; paper 1 prints none."""


def quadratic(P0: Points, P1: Points, P2: Points, t: Points) -> Points:
    """B(t) = (1 - t)^2 P0 + 2 (1 - t) t P1 + t^2 P2 at t of 0..1 (paper 1 eq. 21, where "t - t0" must be t)."""
    t = np.asarray(t, dtype=np.float64)[:, None]
    return np.asarray((1 - t) ** 2 * P0 + 2 * (1 - t) * t * P1 + t**2 * P2)


def body_radius(contraction: float, radius: float, braid_angle: float) -> float:
    """Radius of the body [m] at a contraction eps [1] of a braid with r0 [m] and theta0 [rad] at eps = 0."""
    stretch = (1 - contraction) * math.cos(braid_angle)
    return radius * math.sqrt(max(1 - stretch * stretch, 0.0)) / math.sin(braid_angle)


@dataclass(frozen=True)
class Outline:
    """Upper half of a muscle's outline, from fitting to fitting [m].

    The end is the quadratic Bezier curve through `fitting` (0, r0) and (`body`, `radius`), where the cylinder begins;
    its middle control point (`meet`, `radius`) is where the tangents at both meet.
    """

    length: float
    fitting: float
    radius: float
    meet: float
    body: float

    @property
    def end(self) -> tuple[Points, Points, Points]:
        """The three control points of the end at the left."""
        return (
            np.array([0.0, self.fitting]),
            np.array([self.meet, self.radius]),
            np.array([self.body, self.radius]),
        )


def outline(length: float, contraction: float, radius: float, braid_angle: float) -> Outline:
    """The outline at a contraction eps [1] of a muscle of nominal `length` [m], r0 [m] and theta0 [rad].

    Ends longer than half the muscle are compressed along the axis: they stay smooth.
    """
    now = length * (1 - contraction)
    wide = body_radius(contraction, radius, braid_angle)
    meet = abs(wide - radius) / math.tan(ENTRY)
    shrink = min(1.0, 0.45 * now / (REACH * meet)) if meet else 1.0
    return Outline(now, radius, wide, meet * shrink, REACH * meet * shrink)
