"""A free-end plant whose pressure depends on motion: the regulator has to move air into and out of the muscle.

The chamber equation of paper 3 with P_abs = P + P_atm and the volume V(x) of the muscle,

    V P' = k r T C (u - P) - c P - k P_abs V_x x',

with the regulator's pressure u, its conductance C for filling (u > P) or venting, and the leak c. The rest of the
plant is unchanged.

* At rest V is constant and P is a first-order lag behind u, in closed form, restarted whenever u - P changes its sign.
* While sliding, P is a further state for LSODA.
* Fixed steps use for P a straight line to its value at rest, and treat the effect of motion on P as an additional
spring, which stays stable for long steps; at the end P follows from P_abs V^k, exact for V at the middle of the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import odeint
from scipy.optimize import brentq

from pmabench.model.air import Air
from pmabench.model.curve import Array
from pmabench.model.motion import Course, Record
from pmabench.model.muscle import Muscle
from pmabench.model.plant import ABSOLUTE, RELATIVE, REST, SETTLED_PRESSURE, TIME, Plant, State
from pmabench.model.regulator import Regulator, Trace, answer, to_nanosecond

METRE = 1.5e-7
"""Scale of pressures as contractions, so that LSODA's tolerance suits both [m/Pa]."""
LOOK = 0.01
"""Interval of checks at rest for a change of sign of the pressure difference [s]."""
PER_SWING = 16
"""Least number of these checks per period of an oscillation [1]."""
CLOSE, SOON = 0.01, 1e-3
"""Pressure difference that counts as zero [Pa]; its sign is then taken this much later [s]."""
FAR, BRIEF = 200.0, 1e-6
"""If the pressure differs more than this from the regulator's [Pa], steps are limited to its lag, but not below the
second [s]."""


class Passed(NamedTuple):
    """Calculated pressures P [Pa] at times t [s], linearly interpolated."""

    t: Array
    P: Array

    def value(self, t: float) -> float:
        """Pressure at time t [s]."""
        return float(np.interp(t, self.t, self.P))

    def values(self, t: Array) -> Array:
        """Pressures at times t [s]."""
        return np.asarray(np.interp(t, self.t, self.P), dtype=np.float64)


class Tube:
    """Volume [m3] of one muscle over contraction x [m] and its slope, as plain numbers; constant beyond the ends."""

    def __init__(self, muscle: Muscle) -> None:
        size, self.round, self.long = muscle.sizes
        self.size, self.length, self.stop = size, muscle.length, muscle.stop

    def at(self, x: float) -> tuple[float, float]:
        """Volume V [m3] and dV/dx [m2] at x [m]."""
        left = 1 - min(max(x, 0.0), self.stop) / self.length
        shape = self.long * left * left
        slope = self.size / self.length * (3 * shape - self.round) if 0 <= x <= self.stop else 0.0
        return self.size * left * (self.round - shape), slope


class AirPlant(Plant):
    """A free-end plant with the air flow between regulator and muscle."""

    def __init__(self, muscle: Muscle, regulator: Regulator, air: Air, *, pressure: float = 0.0, **rest: float) -> None:
        super().__init__(muscle, regulator, pressure=pressure, **rest)
        self.air, self._tube = air, Tube(muscle)
        self._leak = air.leak * self._tube.at(0.0)[0]
        self._shut = False
        self._flows = self._paces()
        self._u = self.supply.piece(self.time)[0]
        self._still = Trace(self.time, pressure)
        self._known: Trace | Passed = self._still
        self._resting: tuple[tuple[Trace, float, bool], float] | None = None
        self._made: tuple[list[float], list[float]] | None = None
        self._begun = pressure, pressure, self._tube.at(0.0)[0], (0.0, 1.0)
        self._ended = pressure, pressure

    @property
    def pressure(self) -> float:
        """Present gauge pressure in the muscle [Pa]."""
        return self._known.value(self.time)

    def shut(self, *, shut: bool) -> None:
        """Shut or open the valve between regulator and muscle."""
        self._shut = shut
        self._flows = self._paces()

    def _paces(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """V / lag [m3/s] and fraction of the regulator's step that is reached [1], for venting and for filling."""
        paces = [0.0 if self._shut else self.air.polytropic * self.air.rT * C for C in (self.air.vent, self.air.fill)]
        venting, filling = ((pace + self._leak, pace / (pace + self._leak) if pace else 0.0) for pace in paces)
        return venting, filling

    def _course(self, trace: Trace) -> Course:
        """The calculated pressure in the muscle."""
        return self._known if self._made is None else Passed(*map(np.asarray, self._made))

    # -- at rest -------------------------------------------------------------------------------------------------

    def _piece(self) -> tuple[Trace, float]:
        """The present piece of the regulator's pressure, and its end [s]."""
        self._u, end = super()._piece()
        return self._u, end

    def _rest(self, trace: Trace, end: float, record: Record) -> None:
        """Stay at rest until break-away, `end` [s], or a change of sign of the pressure difference."""
        state = self._u, self.x, self._shut
        if self._resting is None or self._resting[0] != state or self.time >= self._resting[1]:
            self._still, until = self._rest_of(to_nanosecond(self.time + REST))
            self._known, self._resting = self._still, (state, until)
        super()._rest(self._still, min(end, self._resting[1]), record)

    def _rest_of(self, end: float) -> tuple[Trace, float]:
        """Course of the pressure at rest from now on, and until when it is valid [s].

        Where filling and venting differ this is the next change of sign of the pressure difference, at most `end` [s].
        """
        u, t, P = self._u, self.time, self._known.value(self.time)
        gap = u.value(t) - P
        if abs(gap) < CLOSE:
            gap = u.value(t + SOON) - P
        fills = gap > 0
        total, share = self._flows[fills]
        if total == 0:
            return Trace(t, P), math.inf
        if u.settled(t, SETTLED_PRESSURE):
            u = Trace(t, u.level)
        found = answer(u, t, P, self._tube.at(self.x)[0] / total, share)
        if self._shut or self.air.fill == self.air.vent or (u.settled(t, CLOSE) and not self._leak):
            return found, math.inf
        fastest = max((mode[1] for mode in u.modes), default=0.0)
        look = min(LOOK, 2 * math.pi / PER_SWING / fastest) if fastest else LOOK
        grid = np.linspace(t, end, int((end - t) / look) + 2)
        beyond = np.flatnonzero((u.values(grid) - found.values(grid)) * (1 if fills else -1) < -CLOSE)
        if beyond.size == 0:
            return found, end
        low, high = float(grid[max(beyond[0] - 1, 0)]), float(grid[beyond[0]])

        def apart(at: float) -> float:
            return u.value(at) - found.value(at)

        if apart(low) * apart(high) < 0:
            high = float(brentq(apart, low, high, xtol=1e-10))
        return found, max(to_nanosecond(high), to_nanosecond(t + 1e-6))

    # -- sliding -------------------------------------------------------------------------------------------------

    def _slide(self, trace: Trace, end: float, record: Record) -> None:
        super()._slide(trace, end, record)
        self._known, self._resting = Trace(self.time, self._known.value(self.time)), None

    def _integrate(self, trace: Trace, state: tuple[float, float], t: Array) -> tuple[Array, Array, Course]:
        begin = float(t[0])
        start = state[0], state[1] * TIME, self._known.value(begin) * METRE
        rates = self._equation(trace, begin)
        y = odeint(rates, start, t - trace.start, rtol=RELATIVE, atol=ABSOLUTE, mxstep=100000)
        self._known, self._resting = Passed(t, y[:, 2] / METRE), None
        return y[:, 0], y[:, 1] / TIME, self._known

    def _equation(self, trace: Trace, t: float) -> Callable[[State, float], State]:
        """Right-hand side over (x [m], x' TIME [m], P METRE [m]) and s = t - trace.start [s]; as `plant.equation`."""
        muscle, way, air = self.muscle, self.way, self.air
        f_ce, stiffness = muscle.F_ce.function(), muscle.K.function()
        damping = (muscle.B_c if way > 0 else muscle.B_r).function()
        hold = self.force + way * muscle.friction.F_c
        wanted = (Trace(t, trace.level) if trace.settled(t, SETTLED_PRESSURE) else trace).function()
        per_gap = 0.0 if self._shut else air.polytropic * air.rT
        fill, vent, leak = per_gap * air.fill, per_gap * air.vent, self._leak
        k, room, speed = air.polytropic, air.atmosphere, 1 / TIME
        size, round_, long, length, stop = muscle.sizes[0], *muscle.sizes[1:], muscle.length, muscle.stop
        per_length, scale, pascal = 1 / length, TIME / self.mass, METRE
        result = np.empty(3)

        def rates(y: State, since: float) -> State:
            x, w, z = y.tolist()
            v, P = w * speed, z / pascal
            gap = wanted(since) - P
            flow = (fill if gap > 0 else vent) * gap - leak * P
            if 0 <= x <= stop:
                left = 1 - x * per_length
                shape = long * left * left
                V = size * left * (round_ - shape)
                flow -= k * (P + room) * size * per_length * (3 * shape - round_) * v
            else:
                left = 1 - stop * per_length if x > stop else 1.0
                V = size * left * (round_ - long * left * left)
            result[0] = v
            result[1] = (f_ce(P) - stiffness(P) * x - damping(P) * v - hold) * scale
            result[2] = flow / V * pascal
            return result

        return rates

    # -- stepping ------------------------------------------------------------------------------------------------

    def _stepwise(self, trace: Trace, end: float, record: Record, longest: float, speed: float) -> None:
        self._made = [self.time], [self._known.value(self.time)]
        super()._stepwise(trace, end, record, longest, speed)
        self._made = None

    def _ends(self, trace: Trace, until: float) -> tuple[float, float, float, float]:
        (P, u, V, flows), x, span, u_end = self._begun, self.x, until - self.time, self._u.value(until)
        P_end, kept = self._next(P, flows, (u, u_end), span, (V, V, V))
        gained = self._f_ce(P + 1) - self._f_ce(P) - (self._stiffness(P + 1) - self._stiffness(P)) * x
        lost = self.air.polytropic * (P + self.air.atmosphere) * self._tube.at(x)[1] / V * kept
        self._ended = P_end, u_end
        return P, P_end, P_end - lost * self.v * span, max(gained * lost, 0.0)

    def _step(self, trace: Trace, until: float) -> None:
        while self.time < until:
            P, u, V = self._known.value(self.time), self._u.value(self.time), self._tube.at(self.x)[0]
            flows = self._flows[u > P]
            self._begun = P, u, V, flows
            lag = max(V / flows[0], BRIEF) if flows[0] else math.inf
            quick = abs(u - P) > FAR and self.time + 1.5 * lag < until
            self._one_step(trace, to_nanosecond(self.time + lag) if quick else until)

    def _one_step(self, trace: Trace, until: float) -> None:
        begin, place, (P, u, V, flows) = self.time, self.x, self._begun
        super()._step(trace, until)
        P_end, u_end = self._ended
        if self.x != place:
            volumes = V, self._tube.at(0.5 * (place + self.x))[0], self._tube.at(self.x)[0]
            P_end, _ = self._next(P, flows, (u, u_end), until - begin, volumes)
        self._known, self._resting = Trace(until, P_end), None
        if self._made is not None:
            self._made[0].append(until)
            self._made[1].append(P_end)

    def _next(
        self,
        P: float,
        flows: tuple[float, float],
        wanted: tuple[float, float],
        span: float,
        volumes: tuple[float, float, float],
    ) -> tuple[float, float]:
        """Pressure [Pa] after a `span` [s] from P, and remaining share of the effect of a change of volume [1].

        The regulator's pressure goes linearly between the two values `wanted` [Pa]; `volumes`: at begin, middle and end
        [m3]. As in `pmabench.model.air`.
        """
        room, (total, share), (u, u_end), (V, middle, V_end) = self.air.atmosphere, flows, wanted, volumes
        z = total * span / middle
        fade = math.exp(-z)
        mean = -math.expm1(-z) / z if z else 1.0
        grown = (V / V_end) ** self.air.polytropic if V_end != V else 1.0
        towards = (mean - fade) * (share * u + room) * grown + (1 - mean) * (share * u_end + room)
        return float(fade * (P + room) * grown + towards - room), mean
