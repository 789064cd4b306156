"""Muscles in series, each with its own pressure steps, over time.

Without inertia the same force F_L acts in the whole chain. So each muscle moves as if it were alone with this load, and
the contractions add up. Forces do not: the sum of F_ce that paper 1 plots is a sum of coefficients, and never acts at
an end of the chain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.coefficients import DMSP_PRESSURE, DMSP_SHAPE, dmsp_40_305, dmsp_40_305_contraction
from pmabench.model.muscle import held_force
from pmabench.model.plant import Plant
from pmabench.model.regulator import Wave, constant


@dataclass(frozen=True)
class Step:
    """Commanded pressure [Pa gauge] from `at` [s] on; before the first step it is 0."""

    at: float
    pressure: float


@dataclass(frozen=True)
class Block:
    """Result for one muscle: pressure [Pa], contraction [m], F_ce [N], K [N/m], and its largest contraction [m]."""

    P: Array
    x: Array
    F_ce: Array
    K: Array
    stop: float


@dataclass(frozen=True)
class Course:
    """Result for a chain at times `t` [s]; arrays per muscle have shape (muscles, times), SI."""

    t: Array
    P: Array
    x: Array
    F_ce: Array
    force: Array
    """Pull of the chain when held at its present length [N], see `held_force`."""

    @property
    def displacement(self) -> Array:
        """Contraction of the chain, the sum over all muscles [m]."""
        return np.asarray(self.x.sum(axis=0))

    @property
    def force_ce_sum(self) -> Array:
        """Paper 1's total F_ce: a sum of coefficients, not a force of the chain [N]."""
        return np.asarray(self.F_ce.sum(axis=0))

    @property
    def force_ce(self) -> Array:
        """F_ce of the chain [N]: that of its strongest muscle, which is the pull at zero contraction of the chain."""
        return np.asarray(self.F_ce.max(axis=0))


def simulate(members: Sequence[Member], times: Array) -> Course:
    """Simulate a chain from rest at 0 s, with results at increasing `times` [s]; another call continues."""
    blocks = [member.advance(times) for member in members]
    P, x, F_ce, K = (np.array([getattr(block, name) for block in blocks]) for name in ("P", "x", "F_ce", "K"))
    return Course(times, P, x, F_ce, held_force(F_ce, K, np.array([block.stop for block in blocks]), x.sum(axis=0)))


# -- paper 1's muscle ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Stretch:
    """From `start` [s] on: x = target + (x0 - target) exp(-(t - start) / tau)."""

    start: float
    pressure: float
    x0: float
    target: float
    tau: float
    F_ce: float
    K: float

    def at(self, t: Array) -> Array:
        return np.asarray(self.target + (self.x0 - self.target) * np.exp(-(t - self.start) / self.tau))


class PrintedMuscle:
    """DMSP-40-305 by paper 1's printed polynomials (eqs. 17-20), in closed form between the steps.

    Contraction towards (F_ce - F_L) / S with tau_c = D_c / S at the new pressure; relaxation with tau_r = D_r / S at
    the pressure before the release, as in the paper. F_ce is constant during a step, evaluated at x = 0 or at x_max
    (`fce_at`). The pressure follows a step without delay.

    Raises
    ------
    OutsideDomain
        For a pressure that is neither 0 nor 1 to 6 bar.

    Examples
    --------
    >>> muscle = PrintedMuscle([Step(0.0, 6e5)], load=5.0)
    >>> (muscle.advance(np.array([0.355, 100.0])).x * 1e3).round(1).tolist()
    [48.2, 76.3]
    """

    def __init__(self, steps: Sequence[Step], load: float = 0.0, fce_at: str = "x0") -> None:
        lowest = float(dmsp_40_305(np.asarray(DMSP_PRESSURE.low), "polynomial")["stiffness"])
        stretches = [_Stretch(-math.inf, 0.0, 0.0, 0.0, 1.0, 0.0, lowest)]
        tau_r, S_r = 1.0, lowest
        for step in steps:
            before = stretches[-1]
            x0 = float(before.at(np.asarray(step.at))) if math.isfinite(before.start) else 0.0
            if step.pressure > 0:
                F_ce, S, tau_c = self._coefficients(step.pressure, load, fce_at)
                target = max(0.0, F_ce - load) / S
            else:
                F_ce, S, tau_c, target = 0.0, S_r, tau_r, 0.0
            tau = tau_c if target >= x0 else tau_r
            stretches.append(_Stretch(step.at, step.pressure, x0, target, tau, F_ce, S))
            if step.pressure > 0:
                tau_r, S_r = float(dmsp_40_305(np.asarray(step.pressure), "polynomial")["tau_relax"]), S
        self._stretches = stretches

    @staticmethod
    def _coefficients(pressure: float, load: float, fce_at: str) -> tuple[float, float, float]:
        """F_ce [N], S [N/m] and tau_c [s]; F_ce at x = 0 if the muscle cannot lift the load."""
        one = np.asarray(1.0)
        radius, length, angle = (one * size for size in DMSP_SHAPE)
        least = dmsp_40_305_contraction(one * pressure, one * 0.0, radius, length, angle, "x0")
        if load < float(least["force_ce"]) and fce_at == "xmax":
            least = dmsp_40_305_contraction(one * pressure, one * load, radius, length, angle, "xmax")
        tau_c = dmsp_40_305(one * pressure, "polynomial")["tau_contract"]
        return float(least["force_ce"]), float(least["stiffness"]), float(tau_c)

    def advance(self, times: Array) -> Block:
        """The muscle at `times` [s] in any order, from the closed form."""
        starts = np.array([stretch.start for stretch in self._stretches])
        index = np.searchsorted(starts, times, side="right") - 1
        x = np.zeros(times.shape)
        for number in np.unique(index[index > 0]):
            mine = index == number
            x[mine] = self._stretches[number].at(times[mine])
        P, F_ce, K = (
            np.array([getattr(stretch, name) for stretch in self._stretches])[index]
            for name in ("pressure", "F_ce", "K")
        )
        return Block(P, x, F_ce, K, DMSP_SHAPE[1])


# -- plants of the simulated bench -----------------------------------------------------------------------------------


class PlantMuscle:
    """A plant of the simulated bench with its regulator, friction and dead time, under the chain's load.

    F_ce and K are those at the pressure in the muscle.
    """

    def __init__(self, plant: Plant, steps: Sequence[Step]) -> None:
        self._plant = plant
        waves: list[Wave] = [] if steps and steps[0].at == 0 else list(constant(0.0, 0.0))
        for step in steps:
            waves += constant(step.at, step.pressure)
        plant.command(tuple(waves))

    def advance(self, times: Array) -> Block:
        """Simulate to the last of the `times` [s]; results at all of them."""
        motion = self._plant.advance(float(times[-1]), times)
        muscle = self._plant.muscle
        return Block(motion.P, motion.x, muscle.F_ce.values(motion.P), muscle.K.values(motion.P), muscle.stop)


Member = PrintedMuscle | PlantMuscle
"""A muscle of a chain, at rest at 0 s."""
