"""The three-element muscle: force, stiffness, damping over pressure, and friction; knows no load and no time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from pmabench.model.curve import Array, Curve


@dataclass(frozen=True)
class Friction:
    """Coulomb friction inside the muscle, with stiction.

    The force opposing motion is at most `F_s` at rest, falls on a straight line to `F_c` at `speed`, and stays `F_c`
    above it (all [N], speed [m/s]). 0 for none.
    """

    F_s: float = 0.0
    F_c: float = 0.0
    speed: float = 1e-3

    def __post_init__(self) -> None:
        if not 0 <= self.F_c <= self.F_s or self.speed <= 0:
            raise ValueError(f"friction needs 0 <= F_c <= F_s and a speed above 0, not {self}")

    @property
    def slope(self) -> float:
        """Fall of the friction force with speed near rest [N.s/m]."""
        return (self.F_s - self.F_c) / self.speed

    @property
    def knee(self) -> float:
        """Speed from which on the friction is `F_c` [m/s]; 0 where F_s = F_c."""
        return self.speed if self.F_s > self.F_c else 0.0

    def values(self, v: Array) -> Array:
        """Friction force at speeds v >= 0 [m/s], while moving [N]."""
        return np.asarray(np.maximum(self.F_c, self.F_s - self.slope * v), dtype=np.float64)


@dataclass(frozen=True)
class Muscle:
    """A muscle as F = F_ce(P) - K(P) x - B(P) x' - friction sign(x'), x = contraction (paper 0 eq. 2).

    Every coefficient follows the instantaneous gauge pressure. B is `B_c` while it contracts, `B_r` while it relaxes.
    SI: F_ce [N], K [N/m], B_c and B_r [N.s/m] over P [Pa]; `length` nominal [m]; `stop` contraction at which the
    muscle cannot go further [m]. With `tau_r` [s] a muscle with a free end relaxes with that time constant, at the
    pressure before the command that lets the pressure fall: B = tau_r K (paper 1 indexes its D_r so). Free `diameter`
    [m] and `braid_angle` to the axis [rad] are those of its braid, where its volume matters.
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
        """The muscle as it relaxes after a pressure of P [Pa]; itself where that does not matter."""
        return self if self.tau_r is None else replace(self, B_r=self.K.times(self.tau_r(P)))

    def damping(self, P: Array, v: Array) -> Array:
        """B_c where v > 0, else B_r [N.s/m]; P [Pa] and v [m/s] of one shape."""
        return np.where(v > 0, self.B_c.values(P), self.B_r.values(P))
