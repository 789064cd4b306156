"""A joint of two antagonistic muscles on a pulley, each behind its own regulator: free, or turned by a drive.

`Braided` is one muscle with its air: force with hysteresis, volume, flow through valves. It uses plain floats, because
a plant of three muscles calls it six thousand times per second of motion, and arrays of three values are ten times
slower.

Muscle 1 shortens with a positive angle. The statics are those of `model.library.joint`, with hysteresis and damping of
the muscles, inertia, and gravity of a load on the pulley added. Numbers are assumed: no paper prints a pair.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.braid import BRAID_ANGLE
from pmabench.model.library.daerden import ALPHA, ATMOSPHERE, B1, B2, DIAMETER, LENGTH, A
from pmabench.model.regulator import Regulated, Regulator, Wave, commanded

R_T = 287.0 * 293.15
"""Gas constant times temperature of air at 20 degrees Celsius [J/kg]."""
DENSITY = 1.185
"""Density of air at the reference conditions of ISO 6358 [kg/m3]."""


@dataclass(frozen=True)
class Valve:
    """Flow characteristics of an open valve according to ISO 6358."""

    conductance: float = 3e-9
    """Sonic conductance C [m3/(s Pa)]."""
    critical: float = 0.4
    """Critical pressure ratio b [1]: below it the flow does not depend on the downstream pressure."""

    def flow(self, before: float, behind: float) -> float:
        """Mass flow [kg/s] from one absolute pressure [Pa] to another; negative for reversed flow."""
        high, low = max(before, behind), min(before, behind)
        ratio = low / high
        passed = self.conductance * DENSITY * high
        if ratio > self.critical:
            passed *= math.sqrt(1 - ((ratio - self.critical) / (1 - self.critical)) ** 2)
        return passed if before >= behind else -passed


@dataclass(frozen=True)
class Braided:
    """A muscle of the modified Daerden model (paper 3 eqs. 8-10) with hysteresis over contraction, and its air."""

    diameter: float = float(DIAMETER.value)
    length: float = float(LENGTH.value)
    braid_angle: float = float(BRAID_ANGLE.value)
    alpha: float = float(ALPHA.value)
    A: float = float(A.value)
    B1: float = float(B1.value)
    B2: float = float(B2.value)
    hysteresis: float = 30.0
    """Half width of a large hysteresis loop [N]."""
    way: float = 0.006
    """Contraction over which a reversal fades to 1/e [1]."""
    damping: float = 150.0
    """Viscous damping [N s/m]."""
    polytropic: float = 1.2
    atmosphere: float = float(ATMOSPHERE.value)
    steep: float = field(init=False)
    """Terms of the section: S = steep (1 - eps)^alpha - flat [m2]."""
    flat: float = field(init=False)

    def __post_init__(self) -> None:
        area = math.pi / 4 * self.diameter**2
        tangent, sine = 1 / math.tan(self.braid_angle) ** 2, 1 / math.sin(self.braid_angle) ** 2
        object.__setattr__(self, "steep", 3 * area * tangent)
        object.__setattr__(self, "flat", area * sine)

    def force(self, P: float, eps: float, speed: float, strain: float) -> float:
        """Pull [N] at gauge pressure [Pa], contraction [1], its rate [1/s] and state of the hysteresis [-1 to 1]."""
        section = self.steep * math.pow(1 - eps, self.alpha) - self.flat
        rubber = self.A * eps * (eps - self.B1) / (eps + self.B2)
        whole = section * P + rubber + self.hysteresis * strain - self.damping * self.length * speed
        return max(0.0, whole)

    def strain_rate(self, strain: float, speed: float) -> float:
        """Rate of the state of the hysteresis [1/s] at a rate of contraction [1/s]."""
        return (-speed - strain * abs(speed)) / self.way

    def pressure_rate(self, P: float, eps: float, speed: float, inflow: float) -> float:
        """Rate of pressure [Pa/s] for gauge pressure [Pa], contraction [1], its rate [1/s] and inflow [kg/s]."""
        power = math.pow(1 - eps, self.alpha)
        steep, flat = self.steep * power / 3, self.flat
        volume = self.length * (flat - steep) * (1 - eps)
        slope = self.length * ((self.alpha + 1) * steep - flat)
        return self.polytropic / volume * (R_T * inflow - (P + self.atmosphere) * slope * speed)


G = 9.81
STEP = 1e-3
"""Longest step of the integration [s]."""


@dataclass(frozen=True)
class Joint:
    """Parameters of the joint [SI]."""

    muscle: Braided = field(default_factory=Braided)
    pulley: float = 0.025
    """Radius of the pulley [m]."""
    preload: float = 0.10
    """Contraction of both muscles at angle 0 [1]."""
    inertia: float = 0.02
    """Moment of inertia [kg m2]."""
    damping: float = 0.02
    """Damping of the bearing [N m s]."""
    hanging: float = 0.0
    """Weight times its distance from the axis [N m]; it hangs below the axis at angle 0."""
    regulator: Regulator = field(default_factory=lambda: Regulator(dead_time=0.04, lag=0.0955))

    def torque(self, angle: float, turn: float, pressures: Sequence[float], strains: Sequence[float]) -> float:
        """Torque of both muscles [N m] at an angle [rad] and rate [rad/s], pressures [Pa], states of the hysteresis."""
        m, way, rate = self.muscle, self.pulley * angle / self.muscle.length, self.pulley * turn / self.muscle.length
        first = m.force(pressures[0], self.preload + way, rate, strains[0])
        return self.pulley * (first - m.force(pressures[1], self.preload - way, -rate, strains[1]))


def braided(numbers: Mapping[str, float]) -> Braided:
    """The muscle with these dimensions [SI], by the names of a bench file; missing ones are assumed."""
    return Braided(**{n: numbers[n] for n in ("diameter", "length", "braid_angle", "atmosphere") if n in numbers})


def described(numbers: Mapping[str, float]) -> Joint:
    """The joint with these dimensions [SI], by the names of a bench file; missing ones are assumed."""
    usual = Joint()
    pulley, preload = numbers.get("pulley", usual.pulley), numbers.get("contraction", usual.preload)
    return Joint(braided(numbers), pulley, preload)


class Turns(NamedTuple):
    """Motion of a joint, one value per time: angle [rad], rate [rad/s], torque [N m], gauge pressures [Pa]."""

    angle: Array
    turn: Array
    torque: Array
    pressure_1: Array
    pressure_2: Array


class JointPlant:
    """Simulation of a joint; `time` [s], `angle` [rad], `turn` [rad/s].

    With a course (`drive`) its angle follows that, and the drive has to hold against `torque`; without one it moves
    freely.
    """

    def __init__(self, joint: Joint, pressures: tuple[float, float] = (0.0, 0.0), start: float = 0.0) -> None:
        self.joint = joint
        self.supplies = tuple(Regulated(joint.regulator, P, start) for P in pressures)
        self.time, self.angle, self.turn = start, 0.0, 0.0
        self.strains = (0.0, 0.0)
        self._course: tuple[Wave, ...] = ()

    def command(self, muscle: int, waves: tuple[Wave, ...]) -> None:
        """Command pressures of muscle 0 or 1 [Pa] by `waves`, the first of which starts now or later."""
        self.supplies[muscle].command(waves)

    def drive(self, waves: tuple[Wave, ...]) -> None:
        """Drive the angle along `waves` [rad] from now on; without waves it is free."""
        self._course = waves

    def snapshot(self) -> dict[str, Any]:
        """The complete state, for `restore`."""
        return {**self.__dict__, "supplies": tuple(map(copy.copy, self.supplies))}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to the state of a snapshot, which can be used again."""
        self.__dict__.update(snapshot)
        self.supplies = tuple(map(copy.copy, self.supplies))

    def torque(self) -> float:
        """Present torque of both muscles [N m]."""
        return self.joint.torque(self.angle, self.turn, self._pressures(self.time), self.strains)

    def advance(self, until: float, times: Sequence[float] = ()) -> Turns:
        """Simulate to `until` [s]; returns the motion at increasing `times` [s] between now and `until`."""
        rows = []
        for moment in times:
            self._reach(moment)
            rows.append((self.angle, self.turn, self.torque(), *self._pressures(self.time)))
        self._reach(until)
        return Turns(*np.array(rows, dtype=np.float64).reshape(-1, 5).T)

    def _pressures(self, t: float) -> tuple[float, ...]:
        return tuple(supply.value(t) for supply in self.supplies)

    def _reach(self, until: float) -> None:
        if until <= self.time:
            return
        steps = math.ceil((until - self.time) / STEP - 1e-9)
        begin, h = self.time, (until - self.time) / steps
        for number in range(1, steps + 1):
            self._step(h)
            self.time = begin + number * h

    def _step(self, h: float) -> None:
        """One step of the midpoint rule."""
        if self._course:
            ahead = commanded(self._course, self.time + h)
            rate = (ahead - self.angle) / h
            middle = self._strained(self.strains, rate, 0.5 * h, self.strains)
            self.strains = self._strained(self.strains, rate, h, middle)
            self.angle, self.turn = ahead, rate
            return
        slope = self._acceleration(self.angle, self.turn, self.time, self.strains)
        angle, turn = self.angle + 0.5 * h * self.turn, self.turn + 0.5 * h * slope
        middle = self._strained(self.strains, self.turn, 0.5 * h, self.strains)
        slope = self._acceleration(angle, turn, self.time + 0.5 * h, middle)
        self.strains = self._strained(self.strains, turn, h, middle)
        self.angle, self.turn = self.angle + h * turn, self.turn + h * slope

    def _strained(
        self, begin: tuple[float, float], turn: float, h: float, at: tuple[float, float]
    ) -> tuple[float, float]:
        """States of the hysteresis after `h` [s] at a rate of the angle [rad/s]; their rates are evaluated at `at`."""
        m, speed = self.joint.muscle, self.joint.pulley * turn / self.joint.muscle.length
        return begin[0] + h * m.strain_rate(at[0], speed), begin[1] + h * m.strain_rate(at[1], -speed)

    def _acceleration(self, angle: float, turn: float, t: float, strains: tuple[float, float]) -> float:
        j = self.joint
        torque = j.torque(angle, turn, self._pressures(t), strains)
        return (torque - j.damping * turn - j.hanging * math.sin(angle)) / j.inertia
