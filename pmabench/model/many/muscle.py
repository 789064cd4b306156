"""One braided muscle with its air, by numbers and not arrays: force with hysteresis, volume, flow through valves.

Plain floats, because a plant of three muscles calls this six thousand times for a second of motion and an array of
three values takes ten times as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from pmabench.model.library.braid import BRAID_ANGLE
from pmabench.model.library.daerden import ALPHA, ATMOSPHERE, B1, B2, DIAMETER, LENGTH, A

R_T = 287.0 * 293.15
"""Of air at 20 degrees [J/kg]."""
DENSITY = 1.185
"""Of air at the reference of ISO 6358 [kg/m3]."""


@dataclass(frozen=True)
class Valve:
    """A valve that is open or shut, by ISO 6358."""

    conductance: float = 3e-9
    """C [m3/(s Pa)]."""
    critical: float = 0.4
    """b [1]: ratio of pressures below which the flow does not depend on the one behind it."""

    def flow(self, before: float, behind: float) -> float:
        """Mass flow [kg/s] from one absolute pressure [Pa] to another; below 0 where it goes back."""
        high, low = max(before, behind), min(before, behind)
        ratio = low / high
        passed = self.conductance * DENSITY * high
        if ratio > self.critical:
            passed *= math.sqrt(1 - ((ratio - self.critical) / (1 - self.critical)) ** 2)
        return passed if before >= behind else -passed


@dataclass(frozen=True)
class Braided:
    """A muscle of the modified Daerden model (paper 3 eqs. 8-10) with hysteresis over its contraction and air in it."""

    diameter: float = float(DIAMETER.value)
    length: float = float(LENGTH.value)
    braid_angle: float = float(BRAID_ANGLE.value)
    alpha: float = float(ALPHA.value)
    A: float = float(A.value)
    B1: float = float(B1.value)
    B2: float = float(B2.value)
    hysteresis: float = 30.0
    """Force between the mean and a branch after a long way [N]."""
    way: float = 0.006
    """Contraction after a reversal in which 63 % of it are passed [1]."""
    damping: float = 150.0
    """[N s/m]."""
    polytropic: float = 1.2
    atmosphere: float = float(ATMOSPHERE.value)
    steep: float = field(init=False)
    """Of the section: S = steep (1 - eps)^alpha - flat [m2]."""
    flat: float = field(init=False)

    def __post_init__(self) -> None:
        area = math.pi / 4 * self.diameter**2
        tangent, sine = 1 / math.tan(self.braid_angle) ** 2, 1 / math.sin(self.braid_angle) ** 2
        object.__setattr__(self, "steep", 3 * area * tangent)
        object.__setattr__(self, "flat", area * sine)

    def force(self, P: float, eps: float, speed: float, strain: float) -> float:
        """Pull [N] at gauge pressure [Pa], contraction [1], its rate [1/s] and share of the hysteresis [-1 to 1]."""
        section = self.steep * math.pow(1 - eps, self.alpha) - self.flat
        rubber = self.A * eps * (eps - self.B1) / (eps + self.B2)
        whole = section * P + rubber + self.hysteresis * strain - self.damping * self.length * speed
        return max(0.0, whole)

    def strain_rate(self, strain: float, speed: float) -> float:
        """Rate of the share of the hysteresis [1/s] at a rate of contraction [1/s]."""
        return (-speed - strain * abs(speed)) / self.way

    def pressure_rate(self, P: float, eps: float, speed: float, inflow: float) -> float:
        """[Pa/s] at gauge pressure [Pa], contraction [1], its rate [1/s] and mass flow into the muscle [kg/s]."""
        power = math.pow(1 - eps, self.alpha)
        steep, flat = self.steep * power / 3, self.flat
        volume = self.length * (flat - steep) * (1 - eps)
        slope = self.length * ((self.alpha + 1) * steep - flat)
        return self.polytropic / volume * (R_T * inflow - (P + self.atmosphere) * slope * speed)
