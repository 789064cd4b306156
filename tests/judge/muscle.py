"""The simulated muscle: published lines over pressure, and what a reader of a report should find; SI, gauge pressure.

Lines as printed for a 20 mm x 250 mm muscle between 150 and 550 kPa by Serres, Reynolds, Phillips, Gerschutz and
Repperger (2009), "Characterisation of a phenomenological model for commercial pneumatic muscle actuators".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Range = tuple[Array, Array]
"""Least and greatest value that is right, over the pressures that were asked for."""

FRICTION = 15.0
"""Coulomb friction [N]; not in the paper, a tenth of the greatest gap that was seen in such muscles or less."""
SLACK = 5e3
"""Scale of the pressure [Pa] below which a vented muscle carries no force; nothing is left of it at 50 kPa."""
STROKE = 60e-3
"""Contraction [m] over which a bent muscle is softened: about what the paper reports at 550 kPa."""
CREEP_TIMES = tuple(np.geomspace(0.2, 60.0, 8).tolist())
"""Times of the chain that creeps [s], three in a decade: together nearly a logarithm of time."""
CREEP_DECADES = len(CREEP_TIMES) * math.log10(CREEP_TIMES[1] / CREEP_TIMES[0])
"""Decades of time over which the chain creeps: its whole amount over these is its amount in a decade."""
SLIDES = tuple(np.geomspace(0.12e-3, 6.5e-3, 10).tolist())
"""Motions [m] after which the strands of the braid slide on each other, an equal share of them after each."""
BRAIDED = 500e3
"""Pressure [Pa] at which the hysteresis of the braid has the force that it is named after."""


def filled(P: Array) -> Array:
    """Share of the printed force that a muscle has at a pressure [Pa]: 0 without pressure, 1 from 50 kPa on."""
    return -np.expm1(-np.maximum(P, 0.0) / SLACK)


def pull(P: Array) -> Array:
    """F_ce [N], the force without contraction."""
    return (2.91e-3 * P + 44.6) * filled(P)


def stiffness(P: Array) -> Array:
    """K [N/m]."""
    return np.where(P <= 314e3, 32.7e3 - 0.0321 * P, 17.0e3 + 0.0179 * P) * filled(P)


def damping_up(P: Array) -> Array:
    """B_c [N s/m], while it contracts."""
    return np.full_like(P, 2.90e3)


def damping_down(P: Array) -> Array:
    """B_r [N s/m], while it relaxes."""
    return np.where(P <= 372e3, 1.57e3, 311.0 + 3.38e-3 * P)


@dataclass(frozen=True)
class Muscle:
    """F = F_ce(P) - K(P) u (1 + bend (1 - u/60 mm)) - B(P, direction) x' - F_c sign x' - H(P) s, u = contraction - creep.

    s is the mean over the strands of the braid of how far each is strained, from -1 to 1 where it slides; H(P) is
    proportional to a power of the pressure.
    """

    bend: float = 0.0
    """By which share K is greater than its line at no contraction; it is as much smaller at 60 mm."""
    creep: float = 0.0
    """Share of a contraction that is added to it when the pull is held for ever."""
    hysteresis: float = 0.0
    """H [N] at 500 kPa: half the gap between relaxing and contracting that is left at any low speed."""
    times: tuple[float, ...] = CREEP_TIMES
    """Of the parts of the creep [s]; the amount is shared out evenly among them."""
    slides: tuple[float, ...] = SLIDES
    """Motions [m] after which the strands of the braid slide, an equal share of them after each."""
    power: float = 1.0
    """H is proportional to this power of the pressure."""

    @classmethod
    def drawn(cls, chance: np.random.Generator, bend: float, creep: float, hysteresis: float) -> Muscle:
        """A muscle whose creep and braid have times, widths and a power that are drawn.

        No fit can have been made for them. `creep` is what it would creep in the times of `CREEP_TIMES`: in a
        decade of time it creeps as much as a muscle with these.
        """
        least, most = chance.uniform(0.08, 0.4), chance.uniform(30.0, 150.0)
        times = tuple(np.geomspace(least, most, int(chance.integers(6, 14))).tolist())
        decades = len(times) * math.log10(times[1] / times[0])
        narrow, wide = chance.uniform(0.05e-3, 0.3e-3), chance.uniform(3e-3, 9e-3)
        slides = tuple(np.geomspace(narrow, wide, int(chance.integers(5, 14))).tolist())
        power = float(chance.uniform(0.85, 1.2))
        return cls(bend, creep * decades / CREEP_DECADES, hysteresis, times, slides, power)

    def gap(self, P: Array) -> Array:
        """H [N] at pressures [Pa]."""
        return self.hysteresis * (np.maximum(P, 0.0) / BRAIDED) ** self.power

    def truth(self, light: float, heavy: float, hold: float) -> dict[str, Callable[[Array], Range]]:
        """Symbol -> right values over pressure, of a test with loads from `light` to `heavy` [N], held for `hold` [s].

        Where the muscle is straight each value is exact. What a reader may take K for where it is not:

        Bent: K of a report predicts forces where the muscle was tested. There are two such numbers: the slope of the
        tangent between the rest points of the heaviest and of the lightest load at that pressure, and the secants from
        no contraction to these points. All of them lie between the tangent at the lightest load, the least, and the
        secant at the heaviest, the greatest. F_ce is the force at no contraction, whatever K is: a line that was
        extrapolated from long contractions does not give it.

        Creep: K is greatest before it creeps, and least after the longest hold of the test. A K between the two holds
        at a time scale of the test, any other at none. F_ce, B and F_c have nothing to do with creep: it vanishes with
        the contraction, and is no friction.

        Hysteresis: F_c is what slides at once, or that and the braid when all of it slides. The other values do not
        change: after a long stroke the braid adds a constant.

        `K_0` is the slope without contraction, before any creep: what remains where bend and creep have columns of
        their own in a fit.
        """

        def exactly(line: Callable[[Array], Array]) -> Callable[[Array], Range]:
            return lambda P: (line(P), line(P))

        def of_K(P: Array) -> Range:
            return self.slope(P, light, heavy, hold)

        def friction(P: Array) -> Range:
            return np.full_like(P, FRICTION), np.full_like(P, FRICTION + self.hysteresis)

        def steepest(P: Array) -> Array:
            return stiffness(P) * (1 + self.bend)

        lines = {"F_ce": pull, "B_c": damping_up, "B_r": damping_down, "K_0": steepest}
        return {"K": of_K, "F_c": friction, **{symbol: exactly(line) for symbol, line in lines.items()}}

    def slope(
        self, P: Array, light: float, heavy: float, hold: float, x: Array | None = None, crept: bool = False
    ) -> Range:
        """K [N/m] as `truth` has it; where it is said to be the slope at contractions `x` [m] the tangent there, and
        where creep is said to be taken off (`crept`) that before any.
        """
        held = self._held(hold)
        least, most = stiffness(P) * (1.0 if crept else held), stiffness(P)
        if x is not None:
            return least * (1 + self.bend * (1 - 2 * x / STROKE)), most * (1 + self.bend * (1 - 2 * x * held / STROKE))
        low, high = (self._rest(P, load) / STROKE for load in (light, heavy))
        return least * (1 + self.bend * (1 - 2 * low)), most * (1 + self.bend * (1 - high))

    def _held(self, hold: float) -> float:
        """Share of a contraction that is no creep after a hold [s]."""
        return 1.0 / (1.0 + self.creep * float(np.mean(-np.expm1(-hold / np.array(self.times)))))

    def _rest(self, P: Array, load: float) -> Array:
        """Contraction at which it carries a load without friction [m]; root of a quadratic where it is bent."""
        straight = np.maximum(0.0, pull(P) - load) / stiffness(P)
        if not self.bend:
            return straight
        a, b = -self.bend / STROKE, 1 + self.bend
        return (b - np.sqrt(b * b + 4 * a * straight)) / (-2 * a)
