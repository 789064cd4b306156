"""The home-made contractors of paper 2: force at a driven end, length at a free one; knows no load and no time.

The formulas are those of `pmabench.model.library.contractor`, two independent fits that do not agree on where a
contractor without load ends: none is derived from the other. Radius and braid angle are the library's defaults.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmabench.model.curve import Array, Curve
from pmabench.model.library import MODELS
from pmabench.model.library.contractor import contractor_force
from pmabench.model.muscle import Friction, Muscle

DEFAULT = {p.name: p.value for p in MODELS["corrected-force"].parameters}
HIGHEST = next(p.high for p in MODELS["sigmoid-length"].parameters if p.name == "pressure")
STIFFNESS, DAMPING, DAMPING_RELAX = 5e3, 1e3, 1.5e3
"""Assumed, for the way there and for loads; paper 2 gives none [N/m, N.s/m]."""
POINTS = 201
"""Points of length over pressure, close together where its slope is infinite; the lines between are within 10 um."""
STOP = 0.40
"""Contraction at which a free one can go no further [1]: beyond all of paper 2."""


@dataclass(frozen=True)
class ContractorMuscle:
    """F = pi r0^2 (P - P_0) [a (1 - q eps)^2 - b], 0 below P_0 and below 0, eps = x / l0 (paper 2 eqs. 8-9).

    `length` l0 and `radius` r0 [m], `braid_angle` theta0 [rad], `threshold` P_0 [Pa]. `reach` is from where to where
    eps may go [1].
    """

    name: str = "contractor of 30 cm"
    length: float = 0.30
    radius: float = float(DEFAULT["radius"])
    braid_angle: float = float(DEFAULT["braid_angle"])
    threshold: float = float(DEFAULT["threshold"])
    reach: tuple[float, float] = (0.0, 0.36)
    friction: Friction = field(default_factory=Friction)

    def pull(self, P: Array, x: Array) -> Array:
        """Force at rest [N]; P [Pa] and x [m] of one shape."""
        size: Any = (self.radius, self.braid_angle, self.threshold)
        return contractor_force(P, x / self.length, *size)[0]

    def damping(self, P: Array, v: Array) -> Array:
        """None is known [N.s/m]; P [Pa]."""
        return np.zeros(P.shape)

    def free(self) -> Muscle:
        """The same with a free end: without load it comes to the length of eqs. 1-2, by F_ce = K x."""
        P = HIGHEST * np.linspace(0.0, 1.0, POINTS) ** 2
        eps = MODELS["sigmoid-length"].evaluate({"pressure": P, "nominal_length": self.length})["contraction"]
        return Muscle(
            name=self.name,
            F_ce=Curve.through(P.tolist(), (STIFFNESS * self.length * eps).tolist()),
            K=Curve(((STIFFNESS,),)),
            B_c=Curve(((DAMPING,),)),
            B_r=Curve(((DAMPING_RELAX,),)),
            length=self.length,
            stop=STOP * self.length,
        )
