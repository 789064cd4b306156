"""Air that a regulator moves in and out of a driven muscle: the pressure depends on the motion; knows no muscle.

With w = (P + P_atm) V^k the chamber equation of paper 3 is w' = (k r T C / V) (g - w), g = (u + P_atm) V^k, for a flow
C (u - P) towards the regulator's pressure u: a first-order lag, whatever V(t) does. Over the lag's own time, the
integral of k r T C / V (Simpson's rule), a step takes g as the parabola through its begin, middle and end, and is
solved exactly; of w before a share between 0 and 1 is left, so that no step and no conductance can make it diverge.
Where filling and venting differ and the flow turns within a step, the step is cut there. Without flow P_abs V^k is kept
to the last digits.

The nodes of the steps are counted from where a command or the motion changes, never from a sample, so the samples are
the same however the time is cut into stretches.
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
"""The first steps of a piece, while lags fade, are so many and so many times as short [1]."""
AT_ONCE = 20_000
"""Most nodes made at once [1]."""
NEAR = 1e-9
"""A node that is nearer than this share of a step counts as reached; so little is no flow [1]."""
SLIGHT = 1e-6
"""A step of fewer lags goes by the first terms of its series [1]."""

Values = Any
"""Numbers or arrays of one shape."""
Three = tuple[Values, ...]
"""At the begin, the middle and the end of steps."""


class Step(NamedTuple):
    """Steps by what drives the pressure, and by their `duration` [s]."""

    ends: tuple[Three, ...]
    """1 / V [1/m3]; g, where w goes to but for a leak [Pa m^3k]; u V^k [Pa m^3k]."""
    duration: Values

    def one(self, which: int) -> Step:
        """One of the steps."""
        ends = tuple(tuple(float(end[which]) for end in three) for three in self.ends)
        return Step(ends, float(self.duration[which]))

    def cut(self, share: float) -> tuple[Step, Step]:
        """One step up to a share of its duration and from there on, by parabolas."""
        first, second = [], []
        for begin, middle, end in self.ends:
            rise, bow = 4.0 * middle - 3.0 * begin - end, 2.0 * (begin + end - 2.0 * middle)
            near, at, far = (begin + s * (rise + s * bow) for s in (0.5 * share, share, 0.5 * (1.0 + share)))
            first.append((begin, near, at))
            second.append((at, far, end))
        return Step(tuple(first), share * self.duration), Step(tuple(second), (1.0 - share) * self.duration)


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
        """The values of w [Pa m^3k] before steps that follow each other, and after the last."""
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
        """The values after steps of their own from w [Pa m^3k]."""
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
        """Whether it makes a difference which way the air flows."""
        return not self.shut and self.air.fill != self.air.vent

    def _pace(self, fills: bool) -> float:
        """How fast the flow drives w, times V [m3/s]."""
        air = self.air
        return 0.0 if self.shut else air.polytropic * air.rT * (air.fill if fills else air.vent)

    def _answer(self, step: Step, pace: Values) -> tuple[Values, Values]:
        """The share of w that steps leave, and what they add [Pa m^3k]."""
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
        """What one step from w comes to, that would go to `after` if its flow did not turn [Pa m^3k]."""
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
    """For steps of z lags: what they take of w, less than 0; the mean of what is left; the weight of a bow [1]."""
    if isinstance(z, float):
        gone = math.expm1(-z)
        mean = -gone / z if z > SLIGHT else 1.0 - 0.5 * z
        return gone, mean, (2.0 * mean - 2.0 - gone) / z if z > SLIGHT else -z / 6.0
    gone, many, some = np.expm1(-z), z > SLIGHT, np.maximum(z, SLIGHT)
    mean = np.where(many, -gone / some, 1.0 - 0.5 * z)
    return gone, mean, np.where(many, (2.0 * mean - 2.0 - gone) / some, -z / 6.0)


def _moment(node: Values) -> Array:
    """When nodes are, in steps after the begin of their piece."""
    return np.asarray(np.where(node < EARLY, node / QUICK, node - EARLY + EARLY / QUICK))


def _node_at(moment: Array) -> Array:
    """The last node that is not later, by steps after the begin of the piece."""
    late = moment - EARLY / QUICK
    return np.asarray(np.where(late < 0, QUICK * moment, late + EARLY).astype(np.intp))
