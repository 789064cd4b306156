"""A muscle with nonlinear force, hysteresis and creep: its parameters and its force.

    F = F_s(x - x_c, P) - H(P) sum w S_r[x] / r - H_P sum q S_rho[P] / rho - B(P, sign x') x',  never below 0

* F_s is the force without any history. With eps = x / length it is
  (A + A_P P) e(eps) + (C eps + D) P + E, e = exp(-s eps) (form after Sarosi 2012), or a straight line if
  `bend` is 0.
* S_r[u] is a stop: a spring that slides at +-r, S <- min(r, max(-r, S + du)). S_r[x] starts at 0, S_rho[P] at -rho in a
  vented muscle.
* x_c creeps after x: the sum of x_j, T_j x_j' = share x - x_j.
* B is B_c(P) in contraction and B_r(P) in relaxation.

SI throughout. `reference` describes a DMSP-20 of 250 mm: six constants fitted to 46 points of the maker's catalogue;
hysteresis, creep and damping are assumed, with magnitudes from the literature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from pmabench.model.curve import Array, Curve
from pmabench.model.muscle import Friction
from pmabench.model.overrides import Overrides

N_PER_KPA, N_PER_MM = 1e-3, 1e3
"""SI values of N/kPa [N/Pa] and of N/mm [N/m]; the latter also for N.s/mm."""


@dataclass(frozen=True)
class Surface:
    """Force without history F_s [N] over relative contraction eps [1] and pressure P [Pa].

    `A`, `E` [N], `A_P`, `C`, `D` [N/Pa], `s` [1]. `bend` 1 is the nonlinear form; with 0 the exponential is replaced by
    the straight line through its values at eps = 0 and `span`, so that F_ce(P) and K(P) are linear in P.
    """

    A: float
    A_P: float
    s: float
    C: float
    D: float
    E: float
    bend: float = 1.0
    span: float = 0.16

    def __post_init__(self) -> None:
        if not self.s > 0 or not self.span > 0:
            raise ValueError(f"a bent force needs s and span above 0, not {self}")

    @property
    def line(self) -> float:
        """Slope of the straight line in place of the exponential [1]."""
        return -math.expm1(-self.s * self.span) / self.span

    def force(self, eps: Array, P: Array) -> Array:
        """F_s [N]; eps [1] and P [Pa] of one shape."""
        straight = 1 - self.line * eps
        shape = straight + self.bend * (np.exp(-self.s * eps) - straight) if self.bend else straight
        return np.asarray((self.A + self.A_P * P) * shape + (self.C * eps + self.D) * P + self.E)

    def slope(self, eps: Array, P: Array) -> Array:
        """-dF_s / d eps [N]; divided by the length it is the stiffness."""
        bent = self.s * np.exp(-self.s * eps) - self.line
        return np.asarray((self.A + self.A_P * P) * (self.line + self.bend * bent) - self.C * P)


@dataclass(frozen=True)
class Stops:
    """Rate-independent hysteresis by stops of given widths, whose weights add up to 1.

    `widths` [m] or [Pa], empty for no hysteresis; the largest force is `height` + `per_pressure` P [N], [N/Pa]. In a
    rested muscle it is larger by the share `extra` [1], which falls to 1 / e over a travel of `way` [m], about one full
    cycle.
    """

    widths: tuple[float, ...]
    weights: tuple[float, ...]
    height: float
    per_pressure: float = 0.0
    extra: float = 0.0
    way: float = 0.08

    def __post_init__(self) -> None:
        if len(self.widths) != len(self.weights) or not all(width > 0 for width in self.widths):
            raise ValueError(f"stops need widths above 0 and as many weights, not {self}")
        if any(weight < 0 for weight in self.weights) or (self.weights and abs(sum(self.weights) - 1) > 1e-6):
            raise ValueError(f"the weights of stops are not negative and add up to 1, not {self.weights}")
        if not self.height >= 0 or not self.per_pressure >= 0 or not self.extra >= 0 or not self.way > 0:
            raise ValueError(f"stops need a height of at least 0 and a way above 0, not {self}")

    def most(self, P: Array) -> Array:
        """Largest force [N] at P [Pa], without `extra`."""
        return np.asarray(self.height + self.per_pressure * P)

    def scaled(self, factor: float) -> Stops:
        """The hysteresis with its force multiplied by `factor` [1]."""
        if not factor >= 0:
            raise ValueError(f"a factor on a hysteresis cannot be negative, as {factor:g} is")
        return replace(self, height=factor * self.height, per_pressure=factor * self.per_pressure)


@dataclass(frozen=True)
class Creep:
    """Creep after a contraction: `share` of it [1] for each of the time constants `times` [s]."""

    share: float
    times: tuple[float, ...]

    def __post_init__(self) -> None:
        if not 0 <= self.share * len(self.times) < 1 or not all(time > 0 for time in self.times):
            raise ValueError(f"creep needs times above 0 and shares that add up to less than 1, not {self}")


@dataclass(frozen=True)
class RealMuscle:
    """A muscle with nonlinear force, hysteresis and creep, of nominal `length` [m].

    `reach`: range of relative contraction [1]; a free end moves between 0 and its upper end.
    """

    name: str
    length: float
    surface: Surface
    B_c: Curve
    B_r: Curve
    over_x: Stops
    over_P: Stops
    creep: Creep
    reach: tuple[float, float] = (-0.03, 0.28)
    friction: Friction = field(default_factory=Friction)

    def __post_init__(self) -> None:
        if not self.reach[0] <= 0 < self.reach[1]:
            raise ValueError(f"a muscle's reach lies around 0, not {self.reach}")

    @property
    def stop(self) -> float:
        """End stop of a free end as contraction [m]."""
        return self.reach[1] * self.length

    def pull(self, P: Array, x: Array) -> Array:
        """F_s, without history, negative where it would push [N]; P [Pa] and x = contraction - x_c [m] of one shape."""
        return self.surface.force(x / self.length, P)

    def stiffness(self, P: Array, x: Array) -> Array:
        """-dF_s/dx [N/m]; P [Pa] and x = contraction - x_c [m] of one shape."""
        return self.surface.slope(x / self.length, P) / self.length

    def damping(self, P: Array, v: Array) -> Array:
        """B_c where v > 0, else B_r [N.s/m]; P [Pa] and v [m/s] of one shape."""
        return np.where(v > 0, self.B_c.values(P), self.B_r.values(P))

    def changed(self, change: Overrides) -> RealMuscle:
        """The muscle with its nonlinearity, hysteresis and creep multiplied by the factors of `change`."""

        def factor(value: float | None) -> float:
            return 1.0 if value is None else value

        over_x = self.over_x.scaled(factor(change.friction) * factor(change.hysteresis_x))
        if change.first_cycle is not None:
            over_x = replace(over_x, extra=change.first_cycle)
        return replace(
            self,
            surface=replace(self.surface, bend=factor(change.bend) * self.surface.bend),
            over_x=over_x,
            over_P=self.over_P.scaled(factor(change.friction) * factor(change.hysteresis_p)),
            creep=replace(self.creep, share=factor(change.creep) * self.creep.share),
            B_r=self.B_c if change.b_relax else self.B_r,
        )


def reference() -> RealMuscle:
    """A DMSP-20 of 250 mm."""
    return RealMuscle(
        name="DMSP-20-250 real",
        length=0.25,
        surface=Surface(A=244.7, A_P=-0.1115e-3, s=33.4, C=-8.30e-3, D=2.650e-3, E=-249.4),
        B_c=Curve.printed((1.0, 2.0e-3), unit=N_PER_MM),
        B_r=Curve.printed((0.7, 1.5e-3), unit=N_PER_MM),
        over_x=Stops((0.2e-3, 0.8e-3, 2.5e-3, 8e-3), (0.2, 0.3, 0.3, 0.2), 5.0, 0.05 * N_PER_KPA),
        over_P=Stops((20e3, 100e3), (0.4, 0.6), 18.0),
        creep=Creep(0.004, (0.5, 1.58, 5.0, 15.8, 50.0, 158.0)),
    )
