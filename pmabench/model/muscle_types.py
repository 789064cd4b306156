"""Types of muscles on sale with the limits of their data sheets, and force surfaces of some of them.

For first guesses, before a muscle was measured: lengths scale (force is a function of pressure and of contraction over
length), diameters do not. Where no surface is known, the braid's geometry gives one, which pulls more than a muscle.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from pmabench.model.library.braid import braid_factors
from pmabench.model.real.muscle import Surface, reference


@dataclass(frozen=True)
class MuscleType:
    """A type by a pattern of its name, with its inner `diameter` [m] and the limits of its data sheet."""

    make: str
    name: str
    diameter: float
    highest_pressure: float
    """Gauge [Pa]."""
    contraction: float
    """Highest contraction as share of the nominal length [1]."""
    surface: Surface | None = None
    source: str = ""
    """Where the surface is from."""


DMSP_20 = reference().surface
DMSP_40 = Surface(A=442.66, A_P=0.9974e-3, s=19.918, C=-27.736e-3, D=9.4444e-3, E=-469.64)
"""Fitted to the 34 points of the maker's catalogue above 0 kPa that pull: rms 21.5 N, at most 63 N of 6000 N."""
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
"""By the maker's data sheets; the DMSP-20 replaces the MAS-20, with other fittings."""
BRAID_ANGLE = math.radians(25)
"""Assumed where it is not known [rad]."""


def find_type(make: str, name: str) -> MuscleType | None:
    """The type that a label such as `DMSP-20-250N` begins with; None for an unknown one."""
    label = name.upper().replace(" ", "")
    same = (one for one in TYPES if one.make.lower() in make.lower())
    return next((one for one in same if re.match(rf"{one.name}(?!\d)", label)), None)


def length_on_label(name: str) -> float | None:
    """The nominal length in a label such as `DMSP-20-250N` [m]; None where it has none."""
    found = re.match(r"[A-Z]+-\d+-(\d{2,4})N?\b", name.upper().replace(" ", "")) or re.match(
        r"[A-Z]+-\d+-(\d{2,4})N", name.upper().replace(" ", "")
    )
    return float(found[1]) * 1e-3 if found else None


def braid_surface(diameter: float, braid_angle: float = BRAID_ANGLE) -> Surface:
    """The force of a braid of free `diameter` [m] at `braid_angle` [rad] without contraction: Tondu and Lopez, k = 1.

    F = pi r0^2 P [a (1 - eps)^2 - b] (paper 1 eqs. 5-8), its square written by an exponential with the same value,
    slope and curvature at eps = 0: within 1.5 % of the force at eps = 0 up to the contraction without load.
    """
    a, b = (float(value) for value in braid_factors(braid_angle))  # type: ignore[arg-type]
    section, s = math.pi * diameter**2 / 4, 0.5
    bent = 2 * a / s**2
    return Surface(
        A=0.0, A_P=section * bent, s=s, C=section * (bent * s - 2 * a), D=section * (a - b - bent), E=0.0
    )  # fmt: skip
