"""Air that a regulator moves into and out of a driven muscle, so that pressure depends on motion.

With w = (P + P_atm) V^k the chamber equation of paper 3 is w' = (k r T C / V) (g - w), g = (u + P_atm) V^k, for a flow
C (u - P) towards the regulator's pressure u: a first-order lag with a time-varying rate, for any V(t). A step uses as
its variable the integral of k r T C / V (Simpson's rule) and for g the parabola through its begin, middle and end, and
is then exact; a share between 0 and 1 of the former w remains, so no step and no conductance can make it diverge. Where
filling and venting differ and the flow reverses within a step, the step is split there. Without flow P_abs V^k is
constant to the last digits.

Steps start where a command or the motion changes, never at a sample, so the results do not depend on how the time is
divided into calls.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.regulator import Regulated, Trace

STEP = 4e-3
"""Time between two nodes [s]."""
EARLY, QUICK = 8, 4
"""Number of shorter first steps of a piece, while lags fade, and their divisor [1]."""
AT_ONCE = 20_000
"""Largest number of nodes calculated at once [1]."""
NEAR = 1e-9
"""A node closer than this share of a step counts as reached; also the relative tolerance for reversed flow [1]."""
SLIGHT = 1e-6
"""Steps shorter than this many time constants use a series [1]."""

Values = Any
"""Numbers or arrays of one shape."""
Three = tuple[Values, ...]
"""Values at the begin, the middle and the end of steps."""


class Step(NamedTuple):
    """Steps in time: the quantities that drive the pressure, and the `duration` [s]."""

    ends: tuple[Three, ...]
    """1 / V [1/m3]; g, the target of w without a leak [Pa m^3k]; u V^k [Pa m^3k]."""
    duration: Values

    def one(self, which: int) -> Step:
        """One of the steps."""
        ends = tuple(tuple(float(end[which]) for end in three) for three in self.ends)
        return Step(ends, float(self.duration[which]))

    def cut(self, share: float) -> tuple[Step, Step]:
        """Split one step at a share of its duration, with parabolas for the drives."""
        first, second = [], []
        for begin, middle, end in self.ends:
            rise, bow = 4.0 * middle - 3.0 * begin - end, 2.0 * (begin + end - 2.0 * middle)
            near, at, far = (begin + s * (rise + s * bow) for s in (0.5 * share, share, 0.5 * (1.0 + share)))
            first.append((begin, near, at))
            second.append((at, far, end))
        return Step(tuple(first), share * self.duration), Step(tuple(second), (1.0 - share) * self.duration)


@dataclass(frozen=True)
class Air:
    """Properties of the air flow: conductances of the regulator [kg/(s Pa)], and constants of the gas law."""

    fill: float
    vent: float
    polytropic: float
    """k: 1 isothermal, 1.4 adiabatic [1]."""
    rT: float
    """Gas constant times temperature [J/kg]."""
    atmosphere: float
    """Absolute atmospheric pressure [Pa]."""
    leak: float = 0.0
    """Relative loss of gauge pressure by a leak at zero contraction [1/s]."""

    def __post_init__(self) -> None:
        if min(self.fill, self.vent, self.leak) < 0 or min(self.polytropic, self.rT, self.atmosphere) <= 0:
            raise ValueError(f"conductances and a leak cannot be negative, the rest must be above 0: {self}")


class Chamber:
    """Gauge pressure in a muscle with the volume `volume`(x) [m3], from `start` [s] on, at first `pressure` [Pa].

    `shut`: whether a valve separates the muscle from the regulator. Time can only advance. A copy by `copy.copy` is
    independent.
    """

    def __init__(self, air: Air, volume: Callable[[Array], Array], pressure: float, start: float) -> None:
        self.air, self.volume, self.shut = air, volume, False
        self.pressure = pressure
        """Gauge pressure at the time reached so far [Pa]."""
        self._time = start
        self._leak = air.leak * float(volume(np.zeros(1))[0])
        self._under: tuple[Trace, Trace, bool] | None = None
        self._begin, self._node, self._w = start, 0, 0.0

    def __copy__(self) -> Chamber:
        made = object.__new__(Chamber)
        made.__dict__.update(self.__dict__)
        return made

    def pressures(self, supply: Regulated, path: Regulated, t: Array) -> Array:
        """Gauge pressure [Pa] at increasing times t [s], for the contraction `path` and the regulator's `supply`."""
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
        """Gauge pressure [Pa] at times t [s] within one piece; advances and keeps the nodes up to there."""
        node = np.maximum(_node_at((t - self._begin) / STEP + NEAR) - self._node, 0)
        steps, room = int(node[-1]), self.air.atmosphere
        grid = self._begin + STEP * _moment(np.arange(self._node, self._node + steps + 1))
        since = grid[node]
        moments = np.concatenate((grid, t, 0.5 * (grid[:-1] + grid[1:]), 0.5 * (since + t)))
        V, u = self.volume(place.values(moments)), level.values(moments)
        size = V**self.air.polytropic
        drive = (1.0 / V, (u + room) * size, u * size)
        middle, last = steps + 1 + len(t), len(moments) - len(t)
        course = np.array([self._w])
        if steps:
            ends = tuple((part[:steps], part[middle:last], part[1 : steps + 1]) for part in drive)
            course = self._course(Step(ends, grid[1:] - grid[:-1]))
        self._node, self._w = self._node + steps, float(course[-1])
        ends = tuple((part[node], part[last:], part[steps + 1 : middle]) for part in drive)
        w = self._after(Step(ends, np.maximum(t - since, 0.0)), course[node])
        return np.asarray(w / size[steps + 1 : middle] - room)

    def _course(self, step: Step) -> Array:
        """Values of w [Pa m^3k] before each of successive steps, and after the last."""
        w, count = self._w, len(step.duration)
        if not self._two:
            keep, gain = self._answer(step, self._pace(True))
            return np.array([w, *(w := k * w + g for k, g in zip(keep.tolist(), gain.tolist(), strict=True))])
        if count == 1:
            return np.concatenate(([w], self._after(step, np.array([w]))))
        columns = np.concatenate(self._answer(step, np.array([[self._pace(True)], [self._pace(False)]]))).tolist()
        begins, _, ends = (part.tolist() for part in step.ends[1])
        course = [w]
        for i, (begin, end, k_fill, k_vent, g_fill, g_vent) in enumerate(zip(begins, ends, *columns, strict=True)):
            fills = begin > w
            after = k_fill * w + g_fill if fills else k_vent * w + g_vent
            if (after - end if fills else end - after) > NEAR * end:
                after = self._turned(step.one(i), w, after, fills=fills)
            w = after
            course.append(w)
        return np.array(course)

    def _after(self, step: Step, w: Array) -> Array:
        """Values after independent steps, each from its own w [Pa m^3k]."""
        begin, _, end = step.ends[1]
        fills = begin > w
        if len(w) == 1:
            keep, gain = self._answer(step.one(0), self._pace(bool(fills[0])))
        else:
            keep, gain = self._answer(step, np.where(fills, self._pace(True), self._pace(False)))
        after = np.asarray(keep * w + gain)
        if self._two:
            turned = np.where(fills, after - end, end - after) > NEAR * end
            for i in np.flatnonzero(turned).tolist():
                after[i] = self._turned(step.one(i), float(w[i]), float(after[i]), fills=bool(fills[i]))
        return after

    @property
    def _two(self) -> bool:
        """Whether the direction of the flow matters."""
        return not self.shut and self.air.fill != self.air.vent

    def _pace(self, fills: bool) -> float:
        """Rate of the lag times V: k r T C [m3/s]; 0 while shut."""
        air = self.air
        return 0.0 if self.shut else air.polytropic * air.rT * (air.fill if fills else air.vent)

    def _answer(self, step: Step, pace: Values) -> tuple[Values, Values]:
        """The share of w that remains after steps [1], and what they add [Pa m^3k]."""
        (early, now, late), aims, pushes = step.ends
        if self._leak:
            pace = pace + self._leak
            lost = self._leak / pace
            aims = tuple(g - lost * push for g, push in zip(aims, pushes, strict=True))
        begin, middle, end = aims
        six = early + 4.0 * now + late
        half = (1.25 * early + 2.0 * now - 0.25 * late) / six
        gone, mean, bend = _fading(pace * (step.duration * six / 6.0))
        bow = (middle - begin - half * (end - begin)) / (half * (half - 1.0))
        return 1.0 + gone, (mean - 1.0 - gone) * begin + (1.0 - mean) * end + bend * bow

    def _turned(self, step: Step, w: float, after: float, *, fills: bool) -> float:
        """Return w after one step with reversed flow [Pa m^3k]; `after`: the result if the flow did not reverse."""
        (_, room, _), (begin, _, end), _ = step.ends
        error, left = begin - w, end - after
        z = max(self._pace(fills) * step.duration * room, SLIGHT)
        drift = (error * math.exp(-z) - left) / math.expm1(-z)
        first, second = step.cut(min(max(math.log1p(-error / drift) / z, 0.0), 1.0))
        for part, way in ((first, fills), (second, not fills)):
            keep, gain = self._answer(part, self._pace(way))
            w = keep * w + gain
        return w


def _fading(z: Values) -> Three:
    """For steps of z time constants [1]: exp(-z) - 1, the mean of exp(-s) over 0 to z, and the weight of curvature."""
    if isinstance(z, float):
        gone = math.expm1(-z)
        mean = -gone / z if z > SLIGHT else 1.0 - 0.5 * z
        return gone, mean, (2.0 * mean - 2.0 - gone) / z if z > SLIGHT else -z / 6.0
    gone, many, some = np.expm1(-z), z > SLIGHT, np.maximum(z, SLIGHT)
    mean = np.where(many, -gone / some, 1.0 - 0.5 * z)
    return gone, mean, np.where(many, (2.0 * mean - 2.0 - gone) / some, -z / 6.0)


def _moment(node: Values) -> Array:
    """Times of nodes after the begin of their piece [steps]."""
    return np.asarray(np.where(node < EARLY, node / QUICK, node - EARLY + EARLY / QUICK))


def _node_at(moment: Array) -> Array:
    """Number of the last node at or before a time after the begin of the piece [steps]."""
    late = moment - EARLY / QUICK
    return np.asarray(np.where(late < 0, QUICK * moment, late + EARLY).astype(np.intp))
