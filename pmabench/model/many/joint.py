"""Two muscles that pull on a pulley against each other, each behind its own regulator: free, or turned by a drive.

Muscle 1 shortens with a positive angle. Statics are those of `model.library.joint`; hysteresis and damping of the
muscles, inertia and gravity of what hangs on the pulley are added. Numbers are assumed: no paper prints a pair.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.many.muscle import Braided
from pmabench.model.regulator import Regulated, Regulator, Wave

G = 9.81
STEP = 1e-3
"""Longest step of the integration [s]."""


@dataclass(frozen=True)
class Joint:
    """What the joint is made of [SI]."""

    muscle: Braided = field(default_factory=Braided)
    pulley: float = 0.025
    """Radius of the pulley [m]."""
    preload: float = 0.10
    """Contraction of both muscles at angle 0 [1]."""
    inertia: float = 0.02
    """[kg m2]."""
    damping: float = 0.02
    """Of the bearing [N m s]."""
    hanging: float = 0.0
    """Weight times its distance from the axis [N m], below the axis at angle 0."""
    regulator: Regulator = field(default_factory=lambda: Regulator(dead_time=0.04, lag=0.0955))

    def torque(self, angle: float, turn: float, pressures: Sequence[float], strains: Sequence[float]) -> float:
        """Torque of both muscles [N m] at an angle [rad] and its rate [rad/s], pressures [Pa], shares of hysteresis."""
        m, way, rate = self.muscle, self.pulley * angle / self.muscle.length, self.pulley * turn / self.muscle.length
        first = m.force(pressures[0], self.preload + way, rate, strains[0])
        return self.pulley * (first - m.force(pressures[1], self.preload - way, -rate, strains[1]))


class Turns(NamedTuple):
    """What a joint did, one value a moment: angle [rad], rate [rad/s], torque [N m], gauge pressures [Pa]."""

    angle: Array
    turn: Array
    torque: Array
    pressure_1: Array
    pressure_2: Array


class JointPlant:
    """A joint in time; `time` [s], `angle` [rad], `turn` [rad/s].

    With a course (`drive`) its angle is what that says and `torque` what the drive has to hold against; without one it
    moves freely, with `external` [N m] pulling towards positive angles.
    """

    def __init__(self, joint: Joint, pressures: tuple[float, float] = (0.0, 0.0), start: float = 0.0) -> None:
        self.joint = joint
        self.supplies = tuple(Regulated(joint.regulator, P, start) for P in pressures)
        self.time, self.angle, self.turn, self.external = start, 0.0, 0.0, 0.0
        self.strains = (0.0, 0.0)
        self._course: tuple[Wave, ...] = ()

    def command(self, muscle: int, waves: tuple[Wave, ...]) -> None:
        """Command the pressure of muscle 0 or 1 [Pa] along `waves`, the first of which starts now or later."""
        self.supplies[muscle].command(waves)

    def drive(self, waves: tuple[Wave, ...]) -> None:
        """Turn it along `waves` [rad] from now on; with none it is free."""
        self._course = waves

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to come back to this moment."""
        return {**self.__dict__, "supplies": tuple(map(copy.copy, self.supplies))}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to the moment of a snapshot; it can be used again."""
        self.__dict__.update(snapshot)
        self.supplies = tuple(map(copy.copy, self.supplies))

    def torque(self) -> float:
        """Torque of both muscles at this moment [N m]."""
        return self.joint.torque(self.angle, self.turn, self._pressures(self.time), self.strains)

    def advance(self, until: float, times: Sequence[float] = ()) -> Turns:
        """Go on to `until` [s] and return what happened at `times` [s], rising, between now and `until`."""
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
            ahead = _place(self._course, self.time + h)
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
        """Shares of the hysteresis after `h` [s] at a rate of the angle [rad/s]; `at` is where the slope is taken."""
        m, speed = self.joint.muscle, self.joint.pulley * turn / self.joint.muscle.length
        return begin[0] + h * m.strain_rate(at[0], speed), begin[1] + h * m.strain_rate(at[1], -speed)

    def _acceleration(self, angle: float, turn: float, t: float, strains: tuple[float, float]) -> float:
        j = self.joint
        torque = j.torque(angle, turn, self._pressures(t), strains) + self.external
        return (torque - j.damping * turn - j.hanging * math.sin(angle)) / j.inertia


def _place(course: Sequence[Wave], t: float) -> float:
    """Value of a course at a time [s]: that of the wave that began last."""
    at = course[0]
    for wave in course[1:]:
        if wave.start > t:
            break
        at = wave
    return at.value(max(t, at.start))
