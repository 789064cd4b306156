"""A muscle with nonlinear force, hysteresis and creep: with a load on its free end, in steps, and with a driven end.

The force F of `pmabench.model.real.muscle` moves a load, M x'' = F - F_L + N, where N >= 0 only on the support at
x = 0, and likewise at the muscle's own stop; it lands there without rebound. The cell does not read a push, but in the
equation of motion F may be negative: a muscle without load and pressure is extended by its rubber.

One step
--------
With g = F + B x' - F_L, the unbalanced force without damping, M x'' = g - B x' is solved exactly for a g that is linear
within the step. Its final value depends on the final x through surface, stops and creep, and decreases with it: one
equation for one unknown, solved by Newton's method. So damping makes no step unstable, however small the mass. Stops
move monotonically within a step; creep is exact for a linear x. Steps are short where the speed changes.

At a driven end the force follows in closed form along the paths of x and P.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.driven import PARTS, Actuator, DrivenPlant
from pmabench.model.hysteresis import CreepAlong, Memory
from pmabench.model.motion import Loaded, Stepped, shares
from pmabench.model.real.muscle import RealMuscle, Stops
from pmabench.model.regulator import Regulated, Regulator, Trace

BEND = 1e-6
"""Limit of the change of speed times the step, which determines the step length [m]."""
SHORTEST, LOOK, LONGEST = 2.5e-4, 2e-3, 1.0
"""Shortest step, longest step while the pressure changes fast, longest of all [s]."""
CHORD = 2.0
"""Largest error of the linear pressure within a step longer than `LOOK` [Pa]."""
SETTLED_PRESSURE = 1e-3
"""Remaining change of pressure that counts as none [Pa]: below 1 nm of contraction."""
NEAR = 2e-8
"""Newton's method ends when its correction is below this [m]; the force is then corrected linearly."""
ON_TIME = 0.01
"""If a load lifts off within this first share of a step, it counts as at the begin [1]."""
AT_ITS_END = 0.999
"""If a stop is reached after this share of a step, it counts as at the end [1]."""


class AtPressure(NamedTuple):
    """Coefficients at one pressure of the force bent exp(-s u / length) + straight u + constant - height sum w S / r.

    Units: [N], [N/m], [N], [N].
    """

    bent: float
    straight: float
    constant: float
    height: float


class RealPlant(Loaded, Stepped):
    """A muscle with hysteresis and creep behind its regulator, with a load F_L = `force` [N] and moving `mass` [kg].

    `time` [s], contraction `x` [m], speed `v` [m/s].

    Examples
    --------
    >>> import numpy as np
    >>> from pmabench.model.real.muscle import reference
    >>> from pmabench.model.regulator import constant
    >>> plant = RealPlant(reference(), Regulator(dead_time=0.02, lag=0.0955), force=200.0, mass=22.4)
    >>> plant.command(constant(0.0, 300e3))
    >>> (plant.advance(30.0, np.array([0.02, 3.0, 30.0])).x * 1e3).round(1).tolist()
    [0.0, 31.5, 31.8]
    """

    def __init__(
        self,
        muscle: RealMuscle,
        regulator: Regulator,
        *,
        force: float = 0.0,
        mass: float = 0.5,
        pressure: float = 0.0,
        start: float = 0.0,
    ) -> None:
        self.muscle = muscle
        self._curves = {1: muscle.B_c.function(), -1: muscle.B_r.function()}
        self.supply = Regulated(regulator, pressure, start)
        self.time, self.x, self.v = start, 0.0, 0.0
        self._trace: Trace | None = None
        over_x = zip(muscle.over_x.widths, muscle.over_x.weights, strict=True)
        self._springs = [(i, width, weight, weight / width) for i, (width, weight) in enumerate(over_x)]
        self._over_x: tuple[float, ...] = tuple(0.0 for _ in muscle.over_x.widths)
        self._over_P: tuple[float, ...] = tuple(-width for width in muscle.over_P.widths)
        self._crept: tuple[float, ...] = tuple(0.0 for _ in muscle.creep.times)
        self._span, self._last = 0.0, 0.0
        self._fading: tuple[tuple[float, float, float], ...] = ()
        self._gone, self._rested = 0.0, 1 + muscle.over_x.extra
        self._longest, self._trend = SHORTEST, 0.0
        self._P, self._pull = 0.0, 0.0
        self._breathe(pressure)
        self.load(force, mass)

    def load(self, force: float, mass: float) -> None:
        """Change the load of the free end: F_L = `force` [N >= 0] and moving `mass` [kg > 0]."""
        super().load(force, mass)
        self._longest, self._trend = SHORTEST, 0.0

    def reading(self) -> tuple[float, float, float]:
        """Present contraction [m], gauge pressure [Pa] and force at the fixed end [N]."""
        trace, _ = self.supply.piece(self.time)
        if trace != self._trace:
            self._begin(trace)
        return self._state()

    def _state(self) -> tuple[float, float, float]:
        force = self._pull
        if self.v:
            force -= self._curves[1 if self.v > 0 else -1](self._P) * self.v
        return self.x, self._P, max(force, 0.0)

    def _steps(self, until: float) -> Iterator[None]:
        """Simulate to `until` [s]; within a step x deviates from a straight line by less than an eighth of `BEND`."""
        while self.time < until:
            trace, end = self.supply.piece(self.time)
            if trace != self._trace:
                self._begin(trace)
                yield
            end = min(end, until)
            settled = trace.settled(self.time, SETTLED_PRESSURE)
            pressure, start, most = trace.function(), trace.start, LONGEST if settled else LOOK
            lag = 0.0 if settled else trace.lag
            while self.time < end:
                if lag:  # error of the chord of an exponential: less than |P - level| (h / lag)^2 / 8
                    most = max(LOOK, lag * math.sqrt(8 * CHORD / max(abs(self._P - trace.level), CHORD)))
                left = end - self.time
                parts = math.ceil(left / min(self._longest, most) * (1 - 1e-9))
                then = end if parts <= 1 else self.time + left / parts
                share = self._step(then - self.time, trace.level if settled else pressure(then - start))
                self.time = then if share == 1 else self.time + share * (then - self.time)
                yield
                if self.v and not 0 < self.x < self.muscle.stop:  # it has landed, without rebound
                    self.v = 0.0
                    yield

    def _begin(self, trace: Trace) -> None:
        """Follow another piece of the regulator's pressure; without a lag the pressure jumps."""
        self._trace = trace
        self._longest = SHORTEST
        self._breathe(trace.value(self.time))
        self._pull = self._at(0.0, self.x - sum(self._crept), 1.0)[0]

    # -- force -----------------------------------------------------------------------------------------------------

    def _breathe(self, P: float) -> None:
        """Change the pressure to P [Pa] at the present contraction."""
        muscle, surface = self.muscle, self.muscle.surface
        stops, over_x, way = muscle.over_P, muscle.over_x, P - self._P
        places = zip(self._over_P, stops.widths, strict=True)
        self._over_P = tuple([min(max(S + way, -width), width) for S, width in places])
        parts = zip(self._over_P, stops.weights, stops.widths, strict=True)
        held = (stops.height + stops.per_pressure * P) * sum(q * S / width for S, q, width in parts)
        rubber = surface.A + surface.A_P * P
        plain = (1 - surface.bend) * rubber
        self._inflated = AtPressure(
            bent=surface.bend * rubber,
            straight=(surface.C * P - plain * surface.line) / muscle.length,
            constant=plain + surface.D * P + surface.E - held,
            height=over_x.height + over_x.per_pressure * P,
        )
        self._P = P

    def _at(self, way: float, u: float, follows: float) -> tuple[float, float]:
        """Force of the muscle without damping [N] after a displacement of `way` [m], and its stiffness there [N/m].

        u = x - x_c [m] is the contraction of the surface, and `follows` its derivative with respect to x [1].
        """
        air, muscle = self._inflated, self.muscle
        fall = muscle.surface.s / muscle.length
        exponential = air.bent * math.exp(-fall * u)
        held = slope = 0.0
        for S, width, weight, share in self._springs:
            place = self._over_x[S] + way
            if place > width:
                held += weight
            elif place < -width:
                held -= weight
            else:
                held += share * place
                slope += share
        height = air.height * self._rested
        stiffness = (fall * exponential - air.straight) * follows + height * slope
        return exponential + air.straight * u + air.constant - height * held, stiffness

    # -- one step --------------------------------------------------------------------------------------------------

    def _step(self, h: float, P: float) -> float:
        """Advance by h [s], while the pressure changes linearly to P [Pa]; returns the completed share of the step.

        It is below 1 if the end leaves its support or reaches a stop within the step.
        """
        x, v, g, P_before = self.x, self.v, self._pull - self.force, self._P
        fading = self._fading_of(h)
        crept = [left * c + before * x for c, (left, before, _) in zip(self._crept, fading, strict=True)]
        kept, over_P = sum(crept), self._over_P
        if P_before != P:
            self._breathe(P)
        side = 0 if v else -1 if x <= 0 else 1 if x >= self.muscle.stop else 0
        if side:
            pull, _ = self._at(0.0, x - kept - x * self._last, 1.0)
            left = side * (pull - self.force)
            if left < 0 and side * g > -ON_TIME * left:  # it lifts off within the step
                rest = side * g / (side * g - left)
                self._over_P, self._P = over_P, P_before
                self._step(h * rest, P_before + (P - P_before) * rest)
                self._pull, self._longest = self.force, SHORTEST
                return rest
            if left >= 0:
                self._arrive(x, 0.0, crept, pull)
                self._longest, self._trend = LONGEST, 0.0
                return 1.0
        damping = self._curves[1 if (v or g) > 0 else -1]
        B = damping(P) if P == P_before else 0.5 * (damping(P_before) + damping(P))
        end, speed, pull = self._solved(h, g, B, kept)
        if not 0 <= end <= self.muscle.stop:
            stop = 0.0 if end < 0 else self.muscle.stop
            share = (stop - x) / (end - x)
            if share < AT_ITS_END:
                self._over_P, self._P = over_P, P_before
                self._breathe(P_before)
                share *= self._step(share * h, P_before + (P - P_before) * share)
                self.x = stop  # else it would approach in ever shorter steps
                return share
            end = stop
            pull, _ = self._at(end - x, end - kept - end * self._last, 1.0)
        self._arrive(end, speed, crept, pull)
        bend = abs(speed - v) / h
        self._longest = min(max(math.sqrt(BEND / bend), SHORTEST), LONGEST) if bend else LONGEST
        return 1.0

    def _solved(self, h: float, g: float, B: float, kept: float) -> tuple[float, float, float]:
        """Final x [m], v [m/s] and pull [N] after h [s], from g [N], with the damping B [N.s/m]."""
        begin, v, per_mass = self.x, self.v, h / self.mass
        first, second, third = shares(B * per_mass)
        gain, follows = h * per_mass * third, 1 - self._last
        base = h * (first * v + per_mass * (second - third) * g)
        way = base + gain * (g + self._trend * h)
        for _ in range(20):
            pull, stiffness = self._at(way, follows * (begin + way) - kept, follows)
            more = (base + gain * (pull - self.force) - way) / (1 + gain * stiffness)
            way += more
            if abs(more) < NEAR:
                break
        pull -= stiffness * more
        after = pull - self.force
        self._trend = (after - g) / h
        return begin + way, v + per_mass * (first * (g - B * v) + second * (after - g)), pull

    def _arrive(self, x: float, v: float, crept: list[float], pull: float) -> None:
        """Complete a step that ends at x [m] and v [m/s], with the pull without damping `pull` [N]."""
        way, over_x = x - self.x, self.muscle.over_x
        if way:
            places = zip(self._over_x, over_x.widths, strict=True)
            self._over_x = tuple([min(max(S + way, -width), width) for S, width in places])
            if over_x.extra:
                self._gone += abs(way)
                self._rested = 1 + over_x.extra * math.exp(-self._gone / over_x.way)
        self._crept = tuple([c + last * x for c, (_, _, last) in zip(crept, self._fading, strict=True)])
        self.x, self.v, self._pull = x, v, pull

    def _fading_of(self, h: float) -> tuple[tuple[float, float, float], ...]:
        """Weights for each creeping length after h [s]: of its old value, and of x at begin and end [1]."""
        if abs(h - self._span) > 1e-9 * h:
            share, found = self.muscle.creep.share, []
            for lag in self.muscle.creep.times:
                left = math.exp(-h / lag)
                mean = -math.expm1(-h / lag) * lag / h
                found.append((left, share * (mean - left), share * (1 - mean)))
            self._span, self._fading, self._last = h, tuple(found), sum(last for _, _, last in found)
        return self._fading


class StopsAlong(Memory):
    """Relative force of stops along a path: the sum of w S / r, between -1 and 1.

    At `start` [s] the path is at `x`, with every stop in its middle; or with `low`, as after a travel from there to `x`
    that began with every stop at its lower end.
    """

    def __init__(self, stops: Stops, x: float, start: float, low: float | None = None) -> None:
        super().__init__(x, start)
        self._widths = np.array(stops.widths)[:, None]
        self._shares = np.array(stops.weights) / stops.widths
        self._extra, self._way = stops.extra, stops.way
        self._x, self._gone = x, 0.0
        self._stops = 0.0 * self._widths if low is None else np.clip(x - low - self._widths, None, self._widths)

    def at(self, x: Array) -> Array:
        """Relative force [1] at positions x between the last reversal and the next."""
        force = self._shares @ np.clip(self._stops + (x - self._x), -self._widths, self._widths)
        if self._extra:
            force *= 1 + self._extra * np.exp(-(self._gone + np.abs(x - self._x)) / self._way)
        return np.asarray(force, dtype=np.float64)

    def turn(self, x: float) -> None:
        """Note that the path reverses at position x."""
        self._stops = np.clip(self._stops + (x - self._x), -self._widths, self._widths)
        self._gone += abs(x - self._x)
        self._x = x


class RealDrivenPlant(DrivenPlant):
    """A muscle with hysteresis and creep behind its regulator, its end driven by an actuator; `time` [s].

    Stops and creep follow the closed forms of position and pressure between reversals: the result at one time does not
    depend on the other requested times, nor on how the time is divided into calls.

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
