"""An identified muscle behind a regulator over time, with a load on its free end, or with a driven end.

The muscle has a memory of its path. Within a step pressure and contraction are linear. A stop of half width r:
S <- min(1, max(-1, S + change / r)). A lag: T y' = u - y, exact for linear inputs.

With g the force without damping minus the load, M x'' = g - B x' is solved exactly for a g that is linear within a
step; its value at the end depends on x there, which Newton's method finds. The support is at x = 0.

`pressures` is the inverse for a feed-forward: the muscle's memory follows the wanted contraction, so that each minor
loop has its own pressure. At each time it solves F(P, x, past) - B(P) x' = F_L, whose left side increases with P,
inside the range of the command by the Illinois method.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from pmabench.model.curve import Array
from pmabench.model.driven import Actuator
from pmabench.model.identified.muscle import IdentifiedMuscle, Inflated, Weights
from pmabench.model.motion import Motion, Stepped, shares
from pmabench.model.regulator import Regulated, Regulator, Wave


class Path:
    """Memory of a muscle that was rested, vented and at nominal length, and then came to `P` [Pa] and `x` [m].

    Examples
    --------
    >>> from pmabench.model.identified.muscle import IdentifiedMuscle
    >>> rod = {"sizes": [1e-3], "low": [0.0], "high": [0.0]}
    >>> muscle = IdentifiedMuscle.of({
    ...     "schema": "pmabench.identified-muscle/1", "name": "constant pull with 5 N of friction",
    ...     "pressure_knots": [0.0], "contraction_knots": [0.0], "heights": [[100.0]],
    ...     "stops_x": {"sizes": [1e-3], "low": [5.0], "high": [5.0]}, "stops_P": rod, "creep_x": rod, "creep_P": rod,
    ...     "B_c": [0.0, 0.0], "B_r": [0.0, 0.0], "fast": 5.0, "settled": 5.0})
    >>> path = Path(muscle)
    >>> [round(path.go(1.0, 0.0, x), 1) for x in (5e-3, 4.5e-3, 3e-3)]
    [95.0, 97.5, 105.0]
    """

    def __init__(self, muscle: IdentifiedMuscle, P: float = 0.0, x: float = 0.0) -> None:
        self.muscle, self.P, self.x = muscle, P, x
        self.stops_x = np.clip(x / muscle.stops_x.sizes, -1.0, 1.0)
        self.stops_P = np.clip(P / muscle.stops_P.sizes - 1.0, -1.0, 1.0)
        self.lag_x = x * (1.0 - np.exp(-muscle.settled / muscle.creep_x.sizes))
        self.lag_P = P * (1.0 - np.exp(-muscle.settled / muscle.creep_P.sizes))

    def step(self, h: float, P: float) -> Ahead:
        """The muscle after the next `h` [s], in which the pressure goes to `P` [Pa], as a function of contraction."""
        muscle = self.muscle
        stops_P = np.clip(self.stops_P + (P - self.P) / muscle.stops_P.sizes, -1.0, 1.0)
        keep_P, begin_P, rise_P, fast_P = lag_shares(muscle.creep_P, h, muscle.fast)
        lag_P = keep_P * self.lag_P + begin_P * self.P + rise_P * P
        behind = lag_P - fast_P * P
        low, high = (
            float(creep @ behind - held @ stops_P)
            for creep, held in (
                (muscle.creep_P.low, muscle.stops_P.low),
                (muscle.creep_P.high, muscle.stops_P.high),
            )
        )
        keep, begin, rise, fast = lag_shares(muscle.creep_x, h, muscle.fast)
        lag_x = keep * self.lag_x + begin * self.x
        shares = muscle.creep_x.low
        return Ahead(
            self, Inflated(muscle, P), stops_P, lag_P, lag_x, rise, (low, high),
            float(shares @ lag_x), float(shares @ (rise - fast)),
        )  # fmt: skip

    def go(self, h: float, P: float, x: float) -> float:
        """Advance by `h` [s] to `P` [Pa] and `x` [m]; returns the force there, without damping [N]."""
        ahead = self.step(h, P)
        self.arrive(ahead, x)
        return ahead.pull(x)[0]

    def arrive(self, ahead: Ahead, x: float) -> None:
        """Complete a step that ends at `x` [m]."""
        self.stops_x = ahead.stops_x(x)
        self.stops_P, self.lag_P = ahead.stops_P, ahead.lag_P
        self.lag_x = ahead.lag_x + ahead.rise_x * x
        self.P, self.x = ahead.inflated.P, x

    def copy(self) -> Path:
        """An independent copy."""
        made = object.__new__(Path)
        made.__dict__.update(self.__dict__)  # arrays are replaced, never changed in place
        return made


@dataclass(frozen=True, eq=False)
class Ahead:
    """One step of a path at its final pressure, with the final contraction still open."""

    path: Path
    inflated: Inflated
    stops_P: Array
    lag_P: Array
    lag_x: Array
    """Lags of contraction at the end of the step, without the part from the final contraction [m]."""
    rise_x: Array
    """Weight of the final contraction in each lag [1]."""
    ends: tuple[float, float]
    """Force of hysteresis and creep of pressure at the lowest and highest contraction [N]."""
    crept: float
    """Creep of contraction, without the part from the final contraction [m]."""
    follows: float
    """Weight of the final contraction in the creep [1]."""

    def stops_x(self, x: float) -> Array:
        """Stops on contraction if the step ends at `x` [m]."""
        path = self.path
        return np.clip(path.stops_x + (x - path.x) / path.muscle.stops_x.sizes, -1.0, 1.0)

    def pull(self, x: float) -> tuple[float, float]:
        """Force without damping [N] if the step ends at `x` [m], and approximately minus its slope there [N/m]."""
        muscle, weights = self.path.muscle, self.inflated.stops_x
        force, slope = self.inflated.surface(x)
        stiffness = max(-slope, 0.0)
        stops = self.stops_x(x)
        low, high = self.ends
        held = low + muscle.over_x.share(x) * (high - low)
        force += stiffness * (self.crept + self.follows * x) - float(weights @ stops) + held
        sliding = float((weights / muscle.stops_x.sizes)[np.abs(stops) < 1.0].sum())
        return force, stiffness * (1.0 - self.follows) + sliding


@lru_cache(maxsize=64)
def lag_shares(lags: Weights, h: float, fast: float) -> tuple[Array, Array, Array, Array]:
    """Weights [1] of each lag's old value, of the input at begin and end, after `h` [s]; and 1 for fast lags."""
    T = lags.sizes
    keep = np.exp(-h / T)
    rise = 1.0 + np.expm1(-h / T) * T / h
    return keep, 1.0 - keep - rise, rise, (fast > T).astype(np.float64)


def force_along(muscle: IdentifiedMuscle, t: Array, P: Array, x: Array, v: Array) -> Array:
    """Force of a driven muscle [N], shape (n,), at increasing times t [s], with P [Pa], x [m] and its rate v [m/s].

    It reached the first point from rest; the force is not below 0.
    """
    path = Path(muscle, float(P[0]), float(x[0]))
    found = np.empty(len(t))
    before = float(t[0]) - 1e-3
    for row, (now, pressure, place, speed) in enumerate(zip(*(one.tolist() for one in (t, P, x, v)), strict=True)):
        force = path.go(max(now - before, 1e-9), pressure, place)
        found[row] = force - muscle.damping(pressure, speed > 0) * speed
        before = now
    return np.maximum(found, 0.0)


STEP, LONG = 2.5e-3, 20e-3
"""Longest step in motion (error below 2 um compared with much shorter ones), and at rest [s]."""
AT_REST = 2e-5
"""Speed below which a muscle at constant pressure only creeps [m/s]."""
SETTLED_PRESSURE = 1.0
"""Remaining change of pressure below which it counts as constant [Pa]."""
LEAST_DAMPING = 1.0
"""Lower bound of damping in simulations [N.s/m]."""
NEAR = 1e-9
"""Newton's method ends when its correction is below this [m]."""


class FreeEnd:
    """An identified muscle that moves a load under a given pressure: `x` [m], `v` [m/s].

    Before, it was rested and vented; it starts at rest at `x` with the pressure `P` [Pa].
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
        """Advance by `h` [s], while the pressure changes linearly to `P` [Pa]."""
        x, v, g = self.path.x, self.v, self._pull - self.force
        ahead = self.path.step(h, P)
        if (x <= 0.0 and v <= 0.0) or (x >= self.muscle.stop and v >= 0.0):
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


class IdentifiedPlant(Stepped):
    """An identified muscle behind its regulator, with a load F_L = `force` [N] and moving `mass` [kg] on its free end.

    `time` [s], contraction `x` [m], speed `v` [m/s]; starts at rest at `x`.
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
    def v(self) -> float:  # type: ignore[override]
        """Its rate [m/s]."""
        return self._end.v

    def _state(self) -> tuple[float, float, float]:
        return self.x, self._end.path.P, self._end.reading

    def _steps(self, until: float) -> Iterator[None]:
        while self.time < until - 1e-12:
            trace, end = self.supply.piece(self.time)
            steady = trace.settled(self.time, SETTLED_PRESSURE) and abs(self._end.v) < AT_REST
            left = min(end, until) - self.time
            then = self.time + left / max(1, math.ceil(left / (LONG if steady else STEP) * (1 - 1e-9)))
            self._end.step(then - self.time, trace.value(then))
            self.time = then
            yield


class IdentifiedDrivenPlant:
    """An identified muscle behind its regulator, its end driven by an actuator, which starts at `position` [m]."""

    def __init__(
        self, muscle: IdentifiedMuscle, regulator: Regulator, actuator: Actuator, *, position: float = 0.0
    ) -> None:
        self.muscle, self.actuator = muscle, actuator
        self.supply = Regulated(regulator)
        self._drive = Regulated(Regulator(dead_time=0.0, lag=actuator.lag), position)

    def command(self, waves: tuple[Wave, ...]) -> None:
        """Command pressures [Pa] by `waves`."""
        self.supply.command(waves)

    def move(self, waves: tuple[Wave, ...]) -> None:
        """Command positions [m] by `waves`; ValueError outside the actuator's limits."""
        self._drive.command(self.actuator.approach(waves, self._drive.setpoint(0.0), 0.0))

    def advance(self, until: float, times: Sequence[float] | Array) -> Motion:
        """Simulate from 0 to `until` [s]; returns the motion at increasing `times` [s]."""
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
    """Contraction [m] and force at the cell [N], shape (n,), for pressures P [Pa] at increasing times t [s].

    Starts at rest at `x` [m]; the pressure is linear between samples.
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


NEAR_ENOUGH = 0.1
"""Tolerance of the pressure [Pa]."""


def pressures(muscle: IdentifiedMuscle, t: Array, x: Array, v: Array, load: float, ends: tuple[float, float]) -> Array:
    """Pressure [Pa], shape (n,), within `ends` [Pa], for contractions x [m] with rates v [m/s] at increasing t [s].

    For a load F_L [N] and a muscle that was rested and vented before. If no pressure in the range suffices, the
    nearest.
    """
    path = Path(muscle, 0.0, float(x[0]))
    found = np.empty(len(t))
    before = float(t[0]) - 1.0
    for row, (now, place, speed) in enumerate(zip(t.tolist(), x.tolist(), v.tolist(), strict=True)):
        span = now - before

        def left(P: float, span: float = span, place: float = place, speed: float = speed) -> float:
            return path.step(span, P).pull(place)[0] - muscle.damping(P, speed > 0) * speed - load

        P = found[row] = rising_root(left, *ends)
        path.arrive(path.step(span, P), place)
        before = now
    return found


def rising_root(of: Callable[[float], float], low: float, high: float) -> float:
    """Root of an increasing function between two ends, or the nearest end."""
    if of(low) >= 0:
        return low
    return high if of(high) <= 0 else float(brentq(of, low, high, xtol=NEAR_ENOUGH))


def led(t: Array, P: Array, regulator: Regulator, ends: tuple[float, float]) -> Array:
    """Command for P(t) [Pa] after a regulator: P + lag P', advanced by the dead time, limited to `ends` [Pa]."""
    early = t + regulator.dead_time
    wanted = np.interp(early, t, P) + regulator.lag * np.interp(early, t, np.gradient(P, t))
    return np.clip(wanted, *ends)
