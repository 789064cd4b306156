"""Commercial muscles with the limits of their data sheets, and muscles of papers 1 to 3 for simulated plants.

Commercial types give first estimates before a muscle was measured: lengths scale (force is a function of pressure and
relative contraction), diameters do not. Where no surface is known, the braid's geometry gives one, which overestimates
the force.

The formulas of contractors, modified Daerden and DMSP-40-305 are those of `pmabench.model.library`, with its default
numbers where a paper prints none.

Contractors of paper 2: force at a driven end and length at a free end are two independent fits, which disagree about
the contraction without load; neither is derived from the other.

DMSP-40-305 of paper 1, as a three-element muscle: S and D as printed, F_ce from the braid. S and D were fitted from 1
to 6 bar; outside they are constant, so that the damping is never negative.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from pmabench.model.air import Air
from pmabench.model.curve import Array, Curve
from pmabench.model.library import MODELS, daerden
from pmabench.model.library.braid import BRAID_ANGLE, braid_factors
from pmabench.model.library.chamber import R
from pmabench.model.library.coefficients import CENTRE, DMSP_PRESSURE, POLYNOMIALS, SCALE
from pmabench.model.library.contractor import contractor_force
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.real.muscle import Surface, reference


@dataclass(frozen=True)
class MuscleType:
    """A commercial type: name at the begin of labels, inner `diameter` [m], and the limits of its data sheet."""

    make: str
    name: str
    diameter: float
    highest_pressure: float
    """Highest gauge pressure [Pa]."""
    contraction: float
    """Highest contraction relative to the nominal length [1]."""
    surface: Surface | None = None
    source: str = ""
    """Source of the surface."""


DMSP_20 = reference().surface
DMSP_40 = Surface(A=442.66, A_P=0.9974e-3, s=19.918, C=-27.736e-3, D=9.4444e-3, E=-469.64)
"""Fitted to the 34 catalogue points above 0 kPa with a pulling force: rms error 21.5 N, at most 63 N of 6000 N."""
_CATALOGUE_20 = "the maker's catalogue of the DMSP-20, 46 points"
_CATALOGUE_40 = "the maker's catalogue of the DMSP-40, 34 points"
TYPES = (
    MuscleType("Festo", "DMSP-10", 10e-3, 8e5, 0.25),
    MuscleType("Festo", "DMSP-20", 20e-3, 6e5, 0.25, DMSP_20, _CATALOGUE_20),
    MuscleType("Festo", "DMSP-40", 40e-3, 6e5, 0.25, DMSP_40, _CATALOGUE_40),
    MuscleType("Festo", "MAS-10", 10e-3, 8e5, 0.25),
    MuscleType("Festo", "MAS-20", 20e-3, 6e5, 0.25, DMSP_20, f"{_CATALOGUE_20}, of the same hose"),
    MuscleType("Festo", "MAS-40", 40e-3, 6e5, 0.25, DMSP_40, f"{_CATALOGUE_40}, of the same hose"),
)
"""Types with values of the maker's data sheets; the DMSP-20 replaces the MAS-20, with other fittings."""
USUAL_ANGLE = math.radians(25)
"""Assumed braid angle where it is unknown [rad]."""


def find_type(make: str, name: str) -> MuscleType | None:
    """The type of a label such as `DMSP-20-250N`; None for an unknown one."""
    label = name.upper().replace(" ", "")
    same = (one for one in TYPES if one.make.lower() in make.lower())
    return next((one for one in same if re.match(rf"{one.name}(?!\d)", label)), None)


def length_on_label(name: str) -> float | None:
    """Nominal length [m] in a label such as `DMSP-20-250N`; None without one."""
    found = re.match(r"[A-Z]+-\d+-(\d{2,4})(?:N|\b)", name.upper().replace(" ", ""))
    return float(found[1]) * 1e-3 if found else None


def braid_surface(diameter: float, braid_angle: float = USUAL_ANGLE) -> Surface:
    """The force of a braid of free `diameter` [m] at `braid_angle` [rad] without contraction: Tondu and Lopez, k = 1.

    F = pi r0^2 P [a (1 - eps)^2 - b] (paper 1 eqs. 5-8), with the square replaced by an exponential of equal value,
    slope and curvature at eps = 0: the error is within 1.5 % of the force at eps = 0, up to the contraction without
    load.
    """
    a, b = (float(value) for value in braid_factors(braid_angle))  # type: ignore[arg-type]
    section, s = math.pi * diameter**2 / 4, 0.5
    bent = 2 * a / s**2
    return Surface(
        A=0.0, A_P=section * bent, s=s, C=section * (bent * s - 2 * a), D=section * (a - b - bent), E=0.0
    )  # fmt: skip


DEFAULT = {p.name: p.value for p in MODELS["corrected-force"].parameters}
HIGHEST = next(p.high for p in MODELS["sigmoid-length"].parameters if p.name == "pressure")
STIFFNESS, DAMPING, DAMPING_RELAX = 5e3, 1e3, 1.5e3
"""Assumed stiffness [N/m] and damping [N.s/m], for transients and loads; paper 2 gives none."""
POINTS = 201
"""Number of points of length over pressure, denser near 0, where the slope is infinite; interpolation within 10 um."""
CONTRACTOR_STOP = 0.40
"""End stop of a free contractor as contraction [1], beyond all data of paper 2."""


@dataclass(frozen=True)
class ContractorMuscle:
    """F = pi r0^2 (P - P_0) [a (1 - q eps)^2 - b], 0 below P_0 and below 0, eps = x / l0 (paper 2 eqs. 8-9).

    `length` l0 and `radius` r0 [m], `braid_angle` theta0 [rad], `threshold` P_0 [Pa]. `reach`: valid range of eps [1].
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
        """0: no damping is known [N.s/m]; P [Pa]."""
        return np.zeros(P.shape)

    def free(self) -> Muscle:
        """A three-element muscle for a free end: without load F_ce = K x gives the length of eqs. 1-2."""
        P = HIGHEST * np.linspace(0.0, 1.0, POINTS) ** 2
        eps = MODELS["sigmoid-length"].evaluate({"pressure": P, "nominal_length": self.length})["contraction"]
        return Muscle(
            name=self.name,
            F_ce=Curve.through(P.tolist(), (STIFFNESS * self.length * eps).tolist()),
            K=Curve(((STIFFNESS,),)),
            B_c=Curve(((DAMPING,),)),
            B_r=Curve(((DAMPING_RELAX,),)),
            length=self.length,
            stop=CONTRACTOR_STOP * self.length,
        )


def assumed_air() -> Air:
    """Air flow with the values assumed in the library's `driven-chamber`."""
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
        """0: the width of the loop depends on travel, not on speed [N.s/m]; P [Pa]."""
        return np.zeros(P.shape)

    def free(self) -> Muscle:
        """Raise ValueError: there is no free-end model."""
        raise ValueError(f"the muscle {self.name} is for a driven free end")

    def volume(self, x: Array) -> Array:
        """Volume inside [m3] at contractions x [m]."""
        eps: Any = x / self.length
        size: Any = (self.diameter, self.length, self.braid_angle, self.alpha)
        return daerden.muscle_volume(eps, *size)


LOW, HIGH = DMSP_PRESSURE.low, DMSP_PRESSURE.high
DMSP_STOP = 0.30
"""End stop as contraction [1], beyond the 25 % at 6 bar."""
GRID = np.linspace(LOW, HIGH, 501)
ORDER = 10
"""Order of the polynomial that approximates F_ce at x_max over pressure: within 0.02 N, or 0.3 um."""
FCE_EVAL = ("x0", "xmax")


def dmsp_40_305(fce_eval: str = "x0") -> Muscle:
    """The muscle with F_ce at x = 0, or with `xmax` at the final contraction under 5 N, as in paper 1.

    It relaxes with the time constant D_r / S at the pressure before the release, as in paper 1.
    """
    length = next(p.value for p in MODELS["dmsp-40-305-contraction"].parameters if p.name == "nominal_length")
    return Muscle(
        name="DMSP-40-305",
        F_ce=_contractile_force(fce_eval),
        K=_printed("S"),
        B_c=_printed("D_c"),
        B_r=_printed("D_r"),
        tau_r=Curve.through(GRID.tolist(), (_printed("D_r").values(GRID) / _printed("S").values(GRID)).tolist()),
        length=float(length),
        stop=DMSP_STOP * float(length),
    )


def _contractile_force(fce_eval: str) -> Curve:
    """F_ce(P) [N]; below 1 bar a straight line through the origin."""
    if fce_eval not in FCE_EVAL:
        raise ValueError(f'fce_eval can only be {" or ".join(FCE_EVAL)}, not "{fce_eval}"')
    F = MODELS["dmsp-40-305-contraction"].evaluate({"pressure": GRID, "fce_at": fce_eval})["force_ce"]
    line = (float(F[0]) / LOW, 0.0)
    return Curve((line,)) if fce_eval == "x0" else _held(Polynomial.fit(GRID, F, ORDER).convert(), below=line)


def _printed(symbol: str) -> Curve:
    """One of paper 1's polynomials in z = (P - CENTRE) / SCALE, as a curve over P [Pa]."""
    return _held(Polynomial(POLYNOMIALS[symbol][::-1])(Polynomial([-CENTRE / SCALE, 1 / SCALE])))


def _held(polynomial: Polynomial, below: tuple[float, ...] = ()) -> Curve:
    """A polynomial of P from 1 to 6 bar, `below` under 1 bar (default: constant), and constant above 6 bar."""
    inside = tuple(float(c) for c in polynomial.coef[::-1])
    return Curve((below or (float(polynomial(LOW)),), inside, (float(polynomial(HIGH)),)), (LOW, HIGH))
