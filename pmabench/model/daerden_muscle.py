"""The muscle of paper 3 (modified Daerden) for a driven end; knows no hysteresis, no load and no time.

The formulas are those of `pmabench.model.library.daerden`, the numbers its defaults: paper 3 prints none.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmabench.model.air import Air
from pmabench.model.curve import Array
from pmabench.model.library import MODELS, daerden
from pmabench.model.library.braid import BRAID_ANGLE
from pmabench.model.library.chamber import R
from pmabench.model.muscle import Friction, Muscle


def assumed_air() -> Air:
    """Air behind the regulator that the library's `driven-chamber` assumes."""
    value = {p.name: p.value for p in MODELS["driven-chamber"].parameters}
    return Air(
        fill=float(value["conductance_fill"]),
        vent=float(value["conductance_vent"]),
        polytropic=float(value["polytropic"]),
        rT=R * float(value["temperature"]),
        atmosphere=float(value["atmosphere"]),
    )


@dataclass(frozen=True)
class DaerdenMuscle:
    """F = S(eps) P + F_e(eps), eps = x / l0, below 0 stretched: the mean of the two branches (paper 3 eq. 10).

    `length` l0 and `diameter` D0 [m], `braid_angle` theta0 [rad], `alpha` [1], `A` [N], `B1` and `B2` [1]. `reach` is
    from where to where eps may go [1]: a little beyond what paper 3 measured, and short of the pole at -B2.
    """

    name: str = "modified Daerden"
    length: float = float(daerden.LENGTH.value)
    diameter: float = float(daerden.DIAMETER.value)
    braid_angle: float = float(BRAID_ANGLE.value)
    alpha: float = float(daerden.ALPHA.value)
    A: float = float(daerden.A.value)
    B1: float = float(daerden.B1.value)
    B2: float = float(daerden.B2.value)
    reach: tuple[float, float] = (-0.035, 0.22)
    friction: Friction = field(default_factory=Friction)

    def pull(self, P: Array, x: Array) -> Array:
        """S(eps) P + F_e(eps) [N]; P [Pa] and x [m] of one shape."""
        eps: Any = x / self.length
        size: Any = (self.diameter, self.braid_angle, self.alpha)
        rubber: Any = (self.A, self.B1, self.B2)
        return np.asarray(daerden.section_factor(eps, *size) * P + daerden.rubber_force(eps, *rubber))

    def damping(self, P: Array, v: Array) -> Array:
        """None: the loop's width comes from the way gone, not from the speed [N.s/m]; P [Pa]."""
        return np.zeros(P.shape)

    def free(self) -> Muscle:
        """It has none: a ValueError that says so."""
        raise ValueError(f"the muscle {self.name} is for a driven free end")

    def volume(self, x: Array) -> Array:
        """Volume inside [m3] at contractions x [m]."""
        eps: Any = x / self.length
        size: Any = (self.diameter, self.length, self.braid_angle, self.alpha)
        return daerden.muscle_volume(eps, *size)
