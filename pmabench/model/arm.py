"""The arm of paper 2: four contractors, one of which bends it against a load at its end; knows no time.

Its state is the contraction of the bending muscle against the arm's middle, x = r alpha: an arc of one curvature whose
middle keeps its length. The angle is that of `arm-angle` of the library; below 0.45 bar, where the paper says nothing,
it goes on a straight line to 0 without pressure.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.plant import Plant
from pmabench.model.regulator import Regulator

STIFFNESS, DAMPING = 5e3, 1e3
"""Assumed, for the way there; paper 2 gives none [N/m, N.s/m]."""
STEP = 1e3
"""Between the points of angle over pressure [Pa]; the lines between are within 0.02 deg."""
STOP = 0.20
"""Contraction of the bending muscle at which it can go no further [1]: 115 deg, beyond all of paper 2."""
GRAVITY = 9.81
"""What turns the weight at the arm's end into the mass of the formula [m/s2]."""


@dataclass(frozen=True)
class Arm:
    """`length` of its muscles, `radius` of the circle of the outer ones [m] (paper 2)."""

    name: str = "arm of four contractors of 30 cm"
    length: float = 0.30
    radius: float = 0.03
    friction: Friction = field(default_factory=Friction)

    def under(self, force: float) -> Muscle:
        """The arm as a muscle without load that comes to x = r alpha with `force` [N] at its end.

        Raises
        ------
        ValueError
            Beyond the loads of paper 2.
        """
        from pmabench.model.library import MODELS  # needs the presets, which need this module

        model = MODELS["arm-angle"]
        pressure, known = model.parameters
        load = force / GRAVITY
        if not known.low <= load <= known.high * (1 + 1e-9):
            most = f"{known.low:g} to {known.high:g} kg"
            raise ValueError(f"the arm of paper 2 is known for {most} at its end, not for {load:.4g} kg")
        P = np.linspace(pressure.low, pressure.high, round((pressure.high - pressure.low) / STEP) + 1)
        angle = model.evaluate({"pressure": P, "load": min(load, known.high)})["angle"]
        pull = STIFFNESS * self.radius * np.maximum(angle, 0.0)
        return Muscle(
            name=self.name,
            F_ce=Curve.through([0.0, *P.tolist()], [0.0, *pull.tolist()]),
            K=Curve(((STIFFNESS,),)),
            B_c=Curve(((DAMPING,),)),
            B_r=Curve(((DAMPING,),)),
            friction=self.friction,
            length=self.length,
            stop=STOP * self.length,
        )


class ArmPlant(Plant):
    """The arm behind the regulator of its bending muscle; a load changes where it comes to, and moves with it."""

    def __init__(
        self, arm: Arm, regulator: Regulator, *, force: float = 0.0, mass: float = 0.5, start: float = 0.0
    ) -> None:
        self.arm = arm
        super().__init__(arm.under(force), regulator, force=force, mass=mass, start=start)

    def load(self, force: float, mass: float) -> None:
        """From now on `force` [N] hangs on the arm's end and moves with `mass` [kg > 0]; ValueError as `Arm.under`."""
        super().load(0.0, mass)
        self.muscle = self.arm.under(force)
        self._f_ce, self._stiffness = self.muscle.F_ce.function(), self.muscle.K.function()
        self._damping = {1: self.muscle.B_c.function(), -1: self.muscle.B_r.function()}
