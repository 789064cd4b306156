"""A muscle: three-element force with friction, a chain of several at rest, and its outline; no load, no time.

The outline is a cylinder between two curved ends (paper 1 eq. 21). The braid does not stretch, so a shorter muscle is
wider: r(eps) = r0 sqrt(1 - (1 - eps)^2 cos^2 theta0) / sin theta0. The ends stay at r0, held by the fittings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.model.curve import Array, Curve


@dataclass(frozen=True)
class Friction:
    """Coulomb friction inside the muscle, with stiction.

    The force opposing motion is at most `F_s` at rest, falls linearly to `F_c` at `speed`, and is `F_c` above it
    (forces [N], speed [m/s]). 0 for no friction.
    """

    F_s: float = 0.0
    F_c: float = 0.0
    speed: float = 1e-3

    def __post_init__(self) -> None:
        if not 0 <= self.F_c <= self.F_s or self.speed <= 0:
            raise ValueError(f"friction needs 0 <= F_c <= F_s and a speed above 0, not {self}")

    @property
    def slope(self) -> float:
        """Decrease of the friction force with speed near rest [N.s/m]."""
        return (self.F_s - self.F_c) / self.speed

    @property
    def knee(self) -> float:
        """Speed above which the friction is `F_c` [m/s]; 0 if F_s = F_c."""
        return self.speed if self.F_s > self.F_c else 0.0

    def values(self, v: Array) -> Array:
        """Friction force at speeds v >= 0 [m/s], while moving [N]."""
        return np.asarray(np.maximum(self.F_c, self.F_s - self.slope * v), dtype=np.float64)


@dataclass(frozen=True)
class Muscle:
    """A muscle as F = F_ce(P) - K(P) x - B(P) x' - friction sign(x'), x = contraction (paper 0 eq. 2).

    Every coefficient follows the instantaneous gauge pressure. B is `B_c` while it contracts, `B_r` while it relaxes.
    SI: F_ce [N], K [N/m], B_c and B_r [N.s/m] over P [Pa]; `length` nominal [m]; `stop` contraction at which the
    muscle cannot go further [m]. With `tau_r` [s] a free end relaxes with that time constant, evaluated at the pressure
    before its fall: B = tau_r K (as in paper 1). `diameter` [m] and `braid_angle` to the axis [rad], both without
    contraction, give its volume; 0 if unused.
    """

    name: str
    F_ce: Curve
    K: Curve
    B_c: Curve
    B_r: Curve
    friction: Friction = field(default_factory=Friction)
    length: float = 0.25
    stop: float = 0.07
    tau_r: Curve | None = None
    diameter: float = 0.0
    braid_angle: float = 0.0

    def pull(self, P: Array, x: Array) -> Array:
        """Force at rest without friction, F_ce(P) - K(P) x [N]; P [Pa] and x [m] of one shape."""
        return self.F_ce.values(P) - self.K.values(P) * x

    def volume(self, x: Array) -> Array:
        """Volume [m3] of a braid that does not stretch, at contractions x [m] (paper 3, with the exponent 2)."""
        size, round_, long = self.sizes
        left = 1 - x / self.length
        return np.asarray(size * left * (round_ - long * left * left))

    @property
    def sizes(self) -> tuple[float, float, float]:
        """(pi / 4) D^2 l [m3], 1 / sin^2 and 1 / tan^2 of the braid angle [1]."""
        size = 0.25 * math.pi * self.diameter**2 * self.length
        return size, 1 / math.sin(self.braid_angle) ** 2, 1 / math.tan(self.braid_angle) ** 2

    def contraction(self, P: float, load: float = 0.0) -> float:
        """Contraction at rest without friction, (F_ce - F_L) / K, between 0 and `stop` [m]; P [Pa], load F_L [N]."""
        return min(max(0.0, (self.F_ce(P) - load) / self.K(P)), self.stop)

    def released(self, P: float) -> Muscle:
        """The muscle for relaxation after a pressure of P [Pa]; unchanged without `tau_r`."""
        return self if self.tau_r is None else replace(self, B_r=self.K.times(self.tau_r(P)))

    def damping(self, P: Array, v: Array) -> Array:
        """B_c where v > 0, else B_r [N.s/m]; P [Pa] and v [m/s] of one shape."""
        return np.where(v > 0, self.B_c.values(P), self.B_r.values(P))


def held_force(F_ce: Array, K: Array, stops: Array, displacement: Array) -> Array:
    """The common force F [N] of a chain at rest that is held at a total contraction x [m].

    F solves sum over i of min(max((F_ce_i - F) / K_i, 0), stop_i) = x, F >= 0: every muscle pulls with the
    same force, and its contraction is between 0 and its stop. At x = 0 it is the largest F_ce, for N equal muscles
    F_ce - K x / N: always the force of one muscle. 0 if the chain is slack. `F_ce`, `K`: shape (muscles,
    times); `stops`: (muscles,).
    """
    low, high = np.zeros(displacement.shape), F_ce.max(axis=0)
    limits = stops[:, None]
    for _ in range(60):
        middle = 0.5 * (low + high)
        reached = np.clip((F_ce - middle) / K, 0, limits).sum(axis=0)
        low, high = np.where(reached >= displacement, middle, low), np.where(reached >= displacement, high, middle)
    return np.asarray(np.where(displacement <= 0, F_ce.max(axis=0), 0.5 * (low + high)))


Points = NDArray[np.float64]
"""Coordinates along the axis and away from it [m], shape (points, 2)."""
ENTRY = math.radians(40)
"""Angle between axis and tangent of the outline at the fitting [rad]; assumed, paper 1 prints none."""
REACH = 2.4
"""Distance from fitting to cylinder, relative to that of the tangents' intersection; assumed, not in paper 1."""


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

    An end is a quadratic Bezier curve from (0, `fitting`) with `fitting` = r0 to (`body`, `radius`), where the cylinder
    begins; its middle control point (`meet`, `radius`) is the intersection of both tangents.
    """

    length: float
    fitting: float
    radius: float
    meet: float
    body: float

    @property
    def end(self) -> tuple[Points, Points, Points]:
        """The three control points of the left end."""
        return (
            np.array([0.0, self.fitting]),
            np.array([self.meet, self.radius]),
            np.array([self.body, self.radius]),
        )


def outline(length: float, contraction: float, radius: float, braid_angle: float) -> Outline:
    """The outline at a contraction eps [1] of a muscle of nominal `length` [m], r0 [m] and theta0 [rad].

    Ends longer than half the muscle are compressed along the axis, and stay smooth.
    """
    now = length * (1 - contraction)
    wide = body_radius(contraction, radius, braid_angle)
    meet = abs(wide - radius) / math.tan(ENTRY)
    shrink = min(1.0, 0.45 * now / (REACH * meet)) if meet else 1.0
    return Outline(now, radius, wide, meet * shrink, REACH * meet * shrink)
