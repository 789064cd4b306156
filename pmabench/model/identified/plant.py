"""An identified muscle with a load on its free end, and at a driven end, behind a regulator; in time.

With g the force without damping less the load, M x'' = g - B x' is solved exactly for a g that goes on a straight line
within a step; where the step ends, g depends on x there, which Newton's method finds. The support is at x = 0.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.driven import Actuator
from pmabench.model.identified.muscle import IdentifiedMuscle
from pmabench.model.identified.path import Path, force_along
from pmabench.model.motion import NOTHING, Motion
from pmabench.model.regulator import Regulated, Regulator, Wave

STEP, LONG = 2.5e-3, 20e-3
"""Longest step while something moves (which is within 2 um of much shorter ones), and while nothing does [s]."""
AT_REST = 2e-5
"""Speed below which a muscle under a steady pressure only creeps [m/s]."""
SETTLED_PRESSURE = 1.0
"""Change of pressure that is left, below which it is steady [Pa]."""
LEAST_DAMPING = 1.0
"""Damping with which a muscle moves where a fit found less [N.s/m]."""
NEAR = 1e-9
"""Newton's method ends where it moves less than this [m]."""
SERIES = 1e-2
"""Below it the shares of a step are taken from their power series."""


class FreeEnd:
    """An identified muscle that moves a load: `x` [m], `v` [m/s], `P` [Pa] along a given pressure.

    Rested and vented before; at rest at `x`, and with the pressure `P`.
    """

    def __init__(self, muscle: IdentifiedMuscle, *, force: float, mass: float, P: float = 0.0, x: float = 0.0) -> None:
        self.muscle, self.force, self.mass = muscle, force, mass
        self.path, self.v = Path(muscle, P, x), 0.0
        self._pull = self.path.step(STEP, P).pull(x)[0]

    @property
    def x(self) -> float:
        """Contraction [m]."""
        return self.path.x

    @property
    def reading(self) -> float:
        """Force at the fixed end [N]."""
        return max(self._pull - self._damping(self.path.P, self.v > 0) * self.v, 0.0)

    def _damping(self, P: float, contracting: bool) -> float:
        return max(self.muscle.damping(P, contracting), LEAST_DAMPING)

    def step(self, h: float, P: float) -> None:
        """Go on by `h` [s], while the pressure goes on a straight line to `P` [Pa]."""
        x, v, g = self.path.x, self.v, self._pull - self.force
        ahead = self.path.step(h, P)
        at_end = (x <= 0.0 and v <= 0.0) or (x >= self.muscle.stop and v >= 0.0)
        if at_end:
            pull, _ = ahead.pull(x)
            if (pull - self.force) * (1 if x <= 0.0 else -1) <= 0:
                self.path.arrive(ahead, x)
                self.v, self._pull = 0.0, pull
                return
            g = max(g, 0.0) if x <= 0.0 else min(g, 0.0)
        B = self._damping(0.5 * (self.path.P + P), (v or g) > 0)
        per_mass = h / self.mass
        first, second, third = shares(B * per_mass)
        base = h * (first * v + per_mass * (second - third) * g)
        gain = h * per_mass * third
        way = base + gain * g
        for _ in range(30):
            pull, stiffness = ahead.pull(x + way)
            more = (base + gain * (pull - self.force) - way) / (1 + gain * stiffness)
            way += more
            if abs(more) < NEAR:
                break
        pull, _ = ahead.pull(x + way)
        speed = v + per_mass * (first * (g - B * v) + second * (pull - self.force - g))
        end = min(max(x + way, 0.0), self.muscle.stop)
        if end != x + way:
            pull, speed = ahead.pull(end)[0], 0.0
        self.path.arrive(ahead, end)
        self.v, self._pull = speed, pull


def shares(z: float) -> tuple[float, float, float]:
    """What a speed, a force and a change of force do within a step, for z = B h / M >= 0 [1].

    phi_1 = (1 - exp(-z)) / z, phi_2 = (1 - phi_1) / z, phi_3 = (1 / 2 - phi_2) / z: the functions of exponential
    integrators (Hochbruck and Ostermann 2010) at -z.
    """
    if z < SERIES:
        return tuple(sum((-z) ** n / math.factorial(n + k) for n in range(5)) for k in (1, 2, 3))  # type: ignore[return-value]
    first = -math.expm1(-z) / z
    second = (1.0 - first) / z
    return first, second, (0.5 - second) / z


class IdentifiedPlant:
    """An identified muscle behind its regulator, with a load F_L = `force` [N] of moving `mass` [kg] on its free end.

    `time` [s], contraction `x` [m], speed `v` [m/s]; from rest at `x`.
    """

    def __init__(
        self,
        muscle: IdentifiedMuscle,
        regulator: Regulator,
        *,
        force: float = 0.0,
        mass: float = 0.5,
        pressure: float = 0.0,
        x: float = 0.0,
    ) -> None:
        self.muscle, self.time = muscle, 0.0
        self.supply = Regulated(regulator, pressure)
        self._end = FreeEnd(muscle, force=force, mass=mass, P=pressure, x=min(max(x, 0.0), muscle.stop))

    @property
    def x(self) -> float:
        """Contraction [m]."""
        return self._end.x

    @property
    def v(self) -> float:
        """Its rate [m/s]."""
        return self._end.v

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Command pressure [Pa] along `waves`, the first of which starts now or later."""
        self.supply.command(waves)

    def reach(self, until: float) -> None:
        """Go on to `until` [s]."""
        while self.time < until - 1e-12:
            trace, end = self.supply.piece(self.time)
            steady = trace.settled(self.time, SETTLED_PRESSURE) and abs(self._end.v) < AT_REST
            left = min(end, until) - self.time
            then = self.time + left / max(1, math.ceil(left / (LONG if steady else STEP) * (1 - 1e-9)))
            self._end.step(then - self.time, trace.value(then))
            self.time = then

    def advance(self, until: float, times: Sequence[float] | Array = ()) -> Motion:
        """Go on to `until` [s] and return what happened at `times` [s], rising, between now and `until`."""
        if len(times) == 0:
            self.reach(until)
            return NOTHING
        t = np.asarray(times, dtype=np.float64)
        P_set = self.supply.setpoints(t)
        rows = []
        for moment in t.tolist():
            self.reach(moment)
            rows.append((self.x, self.v, self._end.path.P, self._end.reading))
        self.reach(until)
        x, v, P, F = np.array(rows).T
        return Motion(t, x, v, P, F, P_set, np.zeros(t.shape))


class IdentifiedDrivenPlant:
    """An identified muscle behind its regulator, its free end held by an actuator, from `position` [m] on."""

    def __init__(
        self, muscle: IdentifiedMuscle, regulator: Regulator, actuator: Actuator, *, position: float = 0.0
    ) -> None:
        self.muscle, self.actuator = muscle, actuator
        self.supply = Regulated(regulator)
        self._drive = Regulated(Regulator(dead_time=0.0, lag=actuator.lag), position)

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Command pressure [Pa] along `waves`."""
        self.supply.command(waves)

    def move(self, waves: tuple[Wave, ...]) -> None:
        """Command the position [m] along `waves`; ValueError where the actuator cannot go."""
        self._drive.command(self.actuator.approach(waves, self._drive.setpoint(0.0), 0.0))

    def advance(self, until: float, times: Sequence[float] | Array) -> Motion:
        """What happens from 0 to `until` [s], at `times` [s], rising."""
        asked = np.asarray(times, dtype=np.float64)
        t = np.union1d(asked, np.arange(0.0, until, LONG))
        drive, supply = copy.copy(self._drive), copy.copy(self.supply)
        (x, v), (P, _) = drive.values(t), supply.values(t)
        kept = np.searchsorted(t, asked)
        F = force_along(self.muscle, t, P, x, v)
        return Motion(
            asked, x[kept], v[kept], P[kept], F[kept], self.supply.setpoints(asked), self._drive.setpoints(asked)
        )


def free_run(
    muscle: IdentifiedMuscle, t: Array, P: Array, load: float, mass: float, x: float = 0.0
) -> tuple[Array, Array]:
    """Contraction [m] and force at the cell [N], shape (n,), under pressures P [Pa] at rising times t [s].

    From rest at `x` [m]; the pressure is a straight line between samples.
    """
    end = FreeEnd(muscle, force=load, mass=mass, P=float(P[0]), x=min(max(x, 0.0), muscle.stop))
    found, force = np.empty(len(t)), np.empty(len(t))
    before, pressure = float(t[0]), float(P[0])
    for row, (now, wanted) in enumerate(zip(t.tolist(), P.tolist(), strict=True)):
        parts = max(1, math.ceil((now - before) / STEP * (1 - 1e-9))) if now > before else 0
        for part in range(1, parts + 1):
            end.step((now - before) / parts, pressure + (wanted - pressure) * part / parts)
        found[row], force[row] = end.x, end.reading
        before, pressure = now, wanted
    return found, force
