"""Air that a regulator moves in and out of a driven muscle: the pressure depends on the motion; knows no muscle.

With w = (P + P_atm) V^k the chamber equation of paper 3 is w' = (k r T C / V) (g - w), g = (u + P_atm) V^k, for a flow
C (u - P) towards the regulator's pressure u: a first-order lag, whatever V(t) does. A step takes V of its middle and
g as a straight line, and is solved exactly; w comes out as a mean of w, g before and g after with weights between 0
and 1, so that no step and no conductance can make it diverge. Without flow P_abs V^k is kept to the last digits.

The nodes of the steps are counted from where a command or the motion changes, never from a sample, so the samples are
the same however the time is cut into stretches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.regulator import Regulated, Trace

STEP = 5e-4
"""Time between two nodes [s]."""
AT_ONCE = 20_000
"""Most nodes made at once [1]."""
NEAR = 1e-9
"""A node that is nearer than this share of a step counts as reached [1]."""


@dataclass(frozen=True)
class Air:
    """How air flows: conductances of the regulator [kg/(s Pa)], and what the gas law needs."""

    fill: float
    vent: float
    polytropic: float
    """k: 1 isothermal, 1.4 adiabatic [1]."""
    rT: float
    """Gas constant times temperature [J/kg]."""
    atmosphere: float
    """Absolute pressure of the room [Pa]."""
    leak: float = 0.0
    """Share of the gauge pressure that a leak takes away per second, at no contraction [1/s]."""

    def __post_init__(self) -> None:
        if min(self.fill, self.vent, self.leak) < 0 or min(self.polytropic, self.rT, self.atmosphere) <= 0:
            raise ValueError(f"conductances and a leak cannot be negative, the rest must be above 0: {self}")


class Chamber:
    """The gauge pressure in a muscle of `volume`(x) [m3], from `start` [s] on at `pressure` [Pa].

    `shut` is whether a valve before the muscle keeps the regulator away. Time only goes forward. A copy made with
    `copy.copy` is independent.
    """

    def __init__(self, air: Air, volume: Callable[[Array], Array], pressure: float, start: float) -> None:
        self.air, self.volume, self.shut = air, volume, False
        self.pressure = pressure
        """At the moment up to which it was brought [Pa]."""
        self._time = start
        self._leak = air.leak * float(volume(np.zeros(1))[0])
        self._under: tuple[Trace, Trace, bool] | None = None
        self._begin, self._node, self._w = start, 0, 0.0

    def __copy__(self) -> Chamber:
        made = object.__new__(Chamber)
        made.__dict__.update(self.__dict__)
        return made

    def pressures(self, supply: Regulated, path: Regulated, t: Array) -> Array:
        """Gauge pressure [Pa] at rising times t [s], with the free end on `path` and the regulator at `supply`."""
        P, last, done = np.empty(t.shape), float(t[-1]), 0
        while True:
            level, level_end = supply.piece(self._time)
            place, place_end = path.piece(self._time)
            if (level, place, self.shut) != self._under:
                self._under = level, place, self.shut
                self._begin, self._node = self._time, 0
                V = self.volume(place.values(np.array([self._time])))
                self._w = float((self.pressure + self.air.atmosphere) * V[0] ** self.air.polytropic)
            end = min(level_end, place_end)
            count = len(t) if end > last else int(np.searchsorted(t, end))
            while done < count:
                most = self._begin + (self._node + AT_ONCE) * STEP
                part = min(max(int(np.searchsorted(t, most)), done), count)
                if part == done:
                    self._reach(level, place, np.array([most]))
                    continue
                P[done:part] = self._reach(level, place, t[done:part])
                done = part
            if end > last:
                self._time = last
                self.pressure = float(P[-1])
                return P
            self.pressure = float(self._reach(level, place, np.array([end]))[0])
            self._time = end

    def _reach(self, level: Trace, place: Trace, t: Array) -> Array:
        """Gauge pressure [Pa] at times t [s] of one piece, after the nodes up to there; they are kept."""
        air, first = self.air, self._node
        nodes = np.maximum(((t - self._begin) / STEP + NEAR).astype(np.intp), first)
        grid = self._begin + STEP * np.arange(first, int(nodes[-1]) + 1)
        middle = np.concatenate((grid[:-1] + 0.5 * STEP, 0.5 * (grid[nodes - first] + t)))
        moments = np.concatenate((grid, t))
        V, room = np.split(self.volume(place.values(np.concatenate((moments, middle)))), [len(moments)])
        u = level.values(moments)
        size = V**air.polytropic
        g = (u + air.atmosphere) * size
        before = np.concatenate((np.arange(len(grid) - 1), nodes - first))
        after = np.concatenate((np.arange(1, len(grid)), np.arange(len(grid), len(moments))))
        slowness = np.maximum(moments[after] - moments[before], 0.0) / room
        keep, gain = [], []
        for flow in (air.vent, air.fill):
            pace = 0.0 if self.shut else air.polytropic * air.rT * flow
            total = pace + self._leak
            share = pace / total if total else 1.0
            towards = g if share == 1 else (share * u + air.atmosphere) * size
            z = total * slowness
            gone = np.expm1(-z)
            mean = np.divide(-gone, z, out=np.ones(z.shape), where=z > 0)
            fade = 1.0 + gone
            keep.append(fade)
            gain.append((mean - fade) * towards[before] + (1.0 - mean) * towards[after])
        w, steps = self._w, len(grid) - 1
        columns = (g[:steps], keep[0][:steps], gain[0][:steps], keep[1][:steps], gain[1][:steps])
        course = [w] + [
            w := keep_f * w + gain_f if aim > w else keep_v * w + gain_v
            for aim, keep_v, gain_v, keep_f, gain_f in zip(*(column.tolist() for column in columns), strict=True)
        ]
        self._node, self._w = int(nodes[-1]), w
        known = np.array(course)[nodes - first]
        fills = g[nodes - first] > known
        found = np.where(fills, keep[1][steps:] * known + gain[1][steps:], keep[0][steps:] * known + gain[0][steps:])
        return np.asarray(found / size[len(grid) :] - air.atmosphere)
