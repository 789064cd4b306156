"""A muscle with hysteresis and creep at a driven end: the force in closed form along the paths of x and P."""

from __future__ import annotations

import copy

import numpy as np

from pmabench.model.creep import CreepAlong
from pmabench.model.curve import Array
from pmabench.model.driven import PARTS, Actuator, DrivenPlant
from pmabench.model.hysteresis import Memory
from pmabench.model.real.muscle import RealMuscle, Stops
from pmabench.model.regulator import Regulator


class StopsAlong(Memory):
    """The force of stops by its most, sum of w S / r between -1 and 1, along a path.

    From `start` [s] on at `x`, with every stop in its middle; or where `low` is given, as after a way from there to
    `x` that began with every stop at its lower end.
    """

    def __init__(self, stops: Stops, x: float, start: float, low: float | None = None) -> None:
        super().__init__(x, start)
        self._widths = np.array(stops.widths)[:, None]
        self._shares = np.array(stops.weights) / stops.widths
        self._extra, self._way = stops.extra, stops.way
        self._x, self._gone = x, 0.0
        self._stops = 0.0 * self._widths if low is None else np.clip(x - low - self._widths, None, self._widths)

    def at(self, x: Array) -> Array:
        """The force by its most at places x between the last turn and the next one [1]."""
        force = self._shares @ np.clip(self._stops + (x - self._x), -self._widths, self._widths)
        if self._extra:
            force *= 1 + self._extra * np.exp(-(self._gone + np.abs(x - self._x)) / self._way)
        return np.asarray(force, dtype=np.float64)

    def turn(self, x: float) -> None:
        """From place x on the path goes the other way."""
        self._stops = np.clip(self._stops + (x - self._x), -self._widths, self._widths)
        self._gone += abs(x - self._x)
        self._x = x


class RealDrivenPlant(DrivenPlant):
    """A muscle with hysteresis and creep behind its regulator, its free end held by an actuator; `time` [s].

    Stops and creep go along the closed forms of position and pressure from turn to turn: what comes out at a moment
    depends neither on which other moments are looked at, nor on how time is cut.

    Examples
    --------
    >>> import numpy as np
    >>> from pmabench.model.real.muscle import reference
    >>> plant = RealDrivenPlant(reference(), Regulator(dead_time=0.0), Actuator())
    >>> plant.advance(1.0, np.array([1.0])).F.round(2).tolist()
    [13.3]
    """

    parts = (*PARTS, "_over_x", "_over_P", "_creep")

    def __init__(
        self,
        muscle: RealMuscle,
        regulator: Regulator,
        actuator: Actuator,
        *,
        pressure: float = 0.0,
        position: float = 0.0,
        start: float = 0.0,
    ) -> None:
        super().__init__(muscle, regulator, actuator, pressure=pressure, position=position, start=start)
        self.real = muscle
        self._over_x = StopsAlong(muscle.over_x, position, start)
        self._over_P = StopsAlong(muscle.over_P, pressure, start, low=0.0)
        self._creep = CreepAlong(muscle.creep, start)

    def _evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        place, air, muscle = copy.copy(self._drive), copy.copy(self.supply), self.real
        x, v = self._drive.values(t)
        P, _ = self.supply.values(t)
        F = muscle.pull(P, x - self._creep.along(copy.copy(place), t)) - muscle.damping(P, v) * v
        F -= muscle.over_x.most(P) * self._over_x.along(place, t, x)
        F -= muscle.over_P.most(P) * self._over_P.along(air, t, P)
        return x, v, P, np.maximum(F, 0.0)
