"""The second muscle: geometry of a braid with ends, a rubber tube, Bouc-Wen hysteresis, creep by a power of time; SI.

Force at rest of a braid that is a cylinder: Chou and Hannaford 1996, IEEE Trans. Robotics and Automation 12(1), with
the correction of Tondu and Lopez 2000, IEEE Control Systems Magazine 20(2), for ends that do not widen. Energy of the
tube: Mooney-Rivlin, as Klute and Hannaford 2000, J. Dynamic Systems, Measurement and Control 122(2), have it. Their
five constants were fitted to 41 points of a maker's table for 20 mm x 250 mm (-2 to 24 %, 100 to 600 kPa): rms 17 N
of 1515 N. Hysteresis: Bouc-Wen with the asymmetry of Wang and Wen 1998, UCLA Civil Engineering report.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import gamma, log

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LENGTH, RADIUS = 0.25, 7.24e-3
BRAID = np.radians(19.3)
"""Angle of a strand to the axis, without contraction."""
ENDS = 1.036
"""By how much more than on average the middle contracts."""
RUBBER = (35.9, -23.4)
"""Mooney-Rivlin constants times the volume of rubber over the length [N]."""
OUTWARD, STEEPER = (-55.0, 2.44e-3), (6.4e3, 0.0262)
"""Straight lines over P [Pa] nearest to that muscle: force without contraction [N] and stiffness [N/m]."""
DAMPING = {1: (2.1e3, 1.6e-3), -1: (1.2e3, 1.7e-3)}
"""Straight lines over P of the damping [N s/m] while it contracts (1) and relaxes (-1)."""
FRICTION = 12.0
"""Coulomb friction [N]."""
FULL_PRESSURE, RUBS = 500e3, 0.7
"""Pressure [Pa] at which the hysteresis has its size, and the power of the pressure that it grows with."""
TURN, WIDENS = 1.7e-3, 1.1e-8
"""Motion of the strands over which hysteresis turns [m], and how far pressure moves them [m/Pa]."""
POWER, BETA, PHI = 1.4, 0.6, 0.12
"""Bouc-Wen: sharpness, how much of it opposes the motion (the rest is 1 - beta), asymmetry."""
CREEP_POWER, CREEP_BEGINS = 0.15, 0.12
"""Creep grows with (1 + t / 0.12 s)^0.15."""
LOOSE = 15e3
"""Pressure [Pa] on which it depends how much of what has crept carries force: all of it from 100 kPa on."""
LIGHT, HEAVIER = 0.6, 500.0
"""Creep by load: a share and N, so that it has its size at 200 N."""
RATES = np.geomspace(1e-6, 300.0, 22)
"""Rates [1/s] at which the integral for the power of time is summed up: a rule of quadrature, no property."""


@dataclass(frozen=True)
class Muscle:
    """F = S(x - x_c, P) - H(P) z - B x' - F_c sign x'; with all at 0, S is straight in x with straight lines over P.

    x_c is what has crept; without pressure the strands are loose and it carries no force (`tight`).
    """

    bend: float = 0.0
    """How much of the way from the straight lines to the geometry with rubber."""
    hysteresis: float = 0.0
    """H [N] at 500 kPa."""
    creep: float = 0.0
    """Share of a contraction by which it grows from 1 to 10 s after it began, at a load of 200 N."""

    def static(self, x: Array, P: Array) -> Array:
        """S [N] without hysteresis and creep. The whole force never pushes: what moves it cuts that off at 0."""
        force = OUTWARD[0] + OUTWARD[1] * P - (STEEPER[0] + STEEPER[1] * P) * x
        if self.bend:
            force = force + self.bend * (geometric(x, P) - force)
        return np.asarray(force)

    def tangent(self, x: Array, P: Array) -> Array:
        """K = -dS/dx [N/m]."""
        return (1 - self.bend) * (STEEPER[0] + STEEPER[1] * P) + self.bend * geometric_stiffness(x, P)

    def rubbed(self, P: Array) -> Array:
        """H [N]."""
        return self.hysteresis * (np.maximum(P, 0.0) / FULL_PRESSURE) ** RUBS

    def mean(self, x: Array, P: Array) -> Array:
        """Middle between long strokes of contraction and of relaxation [N], without creep."""
        return np.asarray(self.static(x, P) - 0.5 * (ends()[0] + ends()[1]) * self.rubbed(P))

    def gap(self, P: Array) -> Array:
        """Force of a long slow relaxation less that of a contraction [N]."""
        return (ends()[0] - ends()[1]) * self.rubbed(P) + 2 * FRICTION

    def crept(self, t: Array, load: float) -> Array:
        """Share of a contraction by which it has grown t [s] after it began, at a constant load [N]."""
        return self.creep * heavier(np.array(load)) * power(t)


def geometric(x: Array, P: Array) -> Array:
    """Force at rest of braid and rubber [N]; below 0 it would push."""
    braid = 3 * (1 - ENDS * x / LENGTH) ** 2 / np.tan(BRAID) ** 2 - 1 / np.sin(BRAID) ** 2
    return np.asarray(np.pi * RADIUS**2 * P * braid + np.interp(x, *_tube()))


def rubber(x: Array) -> Array:
    """Pull of the tube [N], below 0: the derivative of its energy by its length."""
    along = 1 - x / LENGTH
    around, turned = _around(along)
    first = 2 * along + 2 * around * turned - 2 * (around + along * turned) / (along * around) ** 3
    second = -2 / along**3 - 2 * turned / around**3 + 2 * along * around * (around + along * turned)
    return np.asarray(RUBBER[0] * first + RUBBER[1] * second)


@lru_cache(maxsize=1)
def _tube() -> tuple[Array, Array]:
    """Contractions [m] and `rubber` there, so dense that straight lines between them are as good."""
    x = np.linspace(-10e-3, 130e-3, 40001)
    return x, rubber(x)


def geometric_stiffness(x: Array, P: Array) -> Array:
    """Minus its derivative by the contraction [N/m], in closed form."""
    s = 1 - x / LENGTH
    w, dw = _around(s)
    ddw = (-1 / np.tan(BRAID) ** 2 - dw**2) / w
    area, darea, ddarea = s * w, w + s * dw, 2 * dw + s * ddw
    first = 2 + 2 * (dw**2 + w * ddw) + 6 * darea**2 / area**4 - 2 * ddarea / area**3
    second = 6 / s**4 + 6 * dw**2 / w**4 - 2 * ddw / w**3 + 2 * (darea**2 + area * ddarea)
    braid = 6 * ENDS * (1 - ENDS * x / LENGTH) / np.tan(BRAID) ** 2
    return np.asarray((np.pi * RADIUS**2 * P * braid + RUBBER[0] * first + RUBBER[1] * second) / LENGTH)


def _around(along: Array) -> tuple[Array, Array]:
    """Stretch of the circumference by that of the length, where strands keep their length, and its derivative."""
    around = np.sqrt(1 - (along * np.cos(BRAID)) ** 2) / np.sin(BRAID)
    return around, -along / (np.tan(BRAID) ** 2 * around)


# -- hysteresis ----------------------------------------------------------------------------------------------------


def slope(z: Array, way: Array) -> Array:
    """dz over the motion of the strands in `TURN`, of hysteresis z, for motion in the sense of `way`."""
    sense, side = np.sign(way), np.sign(z)
    return np.asarray(1 - np.abs(z) ** POWER * (1 - BETA + BETA * sense * side + PHI * (sense + side)))


def moved(z: Array, by: Array) -> Array:
    """z after the strands moved by a small part of a turn: the midpoint rule."""
    step = by / TURN
    return np.asarray(z + step * slope(z + 0.5 * step * slope(z, by), by))


@lru_cache(maxsize=1)
def ends() -> tuple[float, float]:
    """z after a long contraction and after a long relaxation."""
    return (1 + 2 * PHI) ** (-1 / POWER), -((1 - 2 * PHI) ** (-1 / POWER))


# -- creep ---------------------------------------------------------------------------------------------------------


def power(t: Array) -> Array:
    """Growth since a contraction began, 1 more at 10 s than at 1 s."""
    rise = (1 + 10 / CREEP_BEGINS) ** CREEP_POWER - (1 + 1 / CREEP_BEGINS) ** CREEP_POWER
    return np.asarray(((1 + np.maximum(t, 0.0) / CREEP_BEGINS) ** CREEP_POWER - 1) / rise)


@lru_cache(maxsize=1)
def weights() -> Array:
    """Of 1 - exp(-rate t) at each of `RATES` in `power`: a power of time is an integral of these over all rates."""
    rise = (1 + 10 / CREEP_BEGINS) ** CREEP_POWER - (1 + 1 / CREEP_BEGINS) ** CREEP_POWER
    spaced = log(RATES[1] / RATES[0])
    cut = np.exp(-CREEP_BEGINS * RATES) * (CREEP_BEGINS * RATES) ** -CREEP_POWER
    return np.asarray(CREEP_POWER / gamma(1 - CREEP_POWER) * cut * spaced / rise)


def tight(P: Array) -> Array:
    """Share of what has crept that carries force."""
    return np.asarray(-np.expm1(-np.maximum(P, 0.0) / LOOSE))


def heavier(load: Array) -> Array:
    """By how much more it creeps under a load [N] than under 200 N."""
    return np.asarray(LIGHT + np.maximum(load, 0.0) / HEAVIER)


def loop(muscle: Muscle, P: float, amplitude: float, cycles: int = 4) -> tuple[float, float]:
    """Gap at the centre [N] and area [J] of a slow cycle of +-`amplitude` [m] after many, without Coulomb friction."""
    one = amplitude * np.sin(2 * np.pi * np.arange(4001) / 4000)
    way = np.concatenate([one, *[one[1:]] * (cycles - 1)])
    z = tracked(way[:, None])[-4001:, 0]
    H = float(muscle.rubbed(np.array(P)))
    return H * (z[0] - z[2000]), H * float(np.sum(0.5 * (z[1:] + z[:-1]) * np.diff(one)))


def tracked(strands: Array) -> Array:
    """z over the places of the strands [m] of some records, arrays (samples, records), after a long relaxation."""
    z = np.empty_like(strands)
    z[0] = ends()[1]
    for n, by in enumerate(np.diff(strands, axis=0)):
        z[n + 1] = moved(z[n], by)
    return z
