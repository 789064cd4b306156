"""A platform tilted about two axes by three muscles with two valves each: its motion for given valve openings.

Geometry and signs are those of `model.library.joint`. Numbers are assumed; paper 3 prints only the arrangement.

`PlatformPlant` adds the inputs and outputs of a control program: pulses, shut-off, dumps, an accelerometer, and faults.

For the control of a platform, `tilt` and `Lags` give the attitude from accelerations, `Inverse` the pressures for a
moment, and `on_time` the opening time of a valve. The chain is paper 3's: angle errors, inverse kinematics, forces,
inverse muscle, valves. A real platform has its own numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmabench.model.library.daerden import rubber_force, section_factor
from pmabench.model.library.joint import AROUND, allocation, gravity, platform_moment, pose
from pmabench.model.many.joint import Braided, Valve, braided

G = 9.81
STEP = 0.5e-3
"""Longest step of the integration [s]; halving it changes angles of a few degrees by less than 0.0005 deg."""
State = tuple[float, ...]
"""phi, psi [rad], their rates [rad/s], three gauge pressures [Pa], three states of the hysteresis [1]."""
LEVEL: State = (0.0,) * 4 + (2.5e5,) * 3 + (0.0,) * 3
"""At rest, level, at 2.5 bar."""


@dataclass(frozen=True)
class Platform:
    """Parameters of the platform [SI]."""

    muscle: Braided = field(default_factory=Braided)
    fill: Valve = field(default_factory=Valve)
    exhaust: Valve = field(default_factory=Valve)
    supply: float = 7e5
    """Supply pressure of the fill valves [Pa gauge]."""
    circle: float = 0.055
    """Radius of the circle of anchors [m]."""
    preload: float = 0.10
    """Contraction while it is level [1]."""
    mass: float = 2.0
    height: float = 0.050
    """Height of the centre of mass above the joint [m]."""
    inertia: tuple[float, float, float] = (0.020, 0.020, 0.012)
    """Moments of inertia about its own axes [kg m2]."""
    damping: float = 0.05
    """Damping of the joint [N m s]."""
    stop: float = 24 * math.pi / 180
    """Angle of the stops of either axis [rad]."""

    def rates(self, state: State, filled: Sequence[float], emptied: Sequence[float]) -> State:
        """Derivative of the state; `filled`, `emptied`: openings of each muscle to supply and atmosphere [valves]."""
        phi, psi, turn, tip = state[:4]
        m = self.muscle
        sin, cos, turned, level = math.sin(phi), math.cos(phi), math.sin(psi), math.cos(psi)
        moment_phi = self.mass * G * self.height * sin * level - self.damping * turn
        moment_psi = self.mass * G * self.height * cos * turned - self.damping * tip
        above = (1 - self.preload) * m.length
        pressures, strains = [], []
        for i in range(3):
            ax, ay = self.circle * _COSINES[i], self.circle * _SINES[i]
            x, y = ax * (level - 1), ay * (cos - 1) + ax * turned * sin
            z = ay * sin - ax * turned * cos + above
            length = math.sqrt(x * x + y * y + z * z)
            by_phi = (y * (ax * turned * cos - ay * sin) + z * (ay * cos + ax * turned * sin)) / length
            by_psi = (-x * ax * turned + y * ax * level * sin - z * ax * level * cos) / length
            eps, speed = 1 - length / m.length, -(by_phi * turn + by_psi * tip) / m.length
            P, strain = state[4 + i], state[7 + i]
            pull = m.force(P, eps, speed, strain)
            moment_phi -= by_phi * pull
            moment_psi -= by_psi * pull
            inflow = filled[i] * self.fill.flow(self.supply + m.atmosphere, P + m.atmosphere) if filled[i] else 0.0
            if emptied[i]:
                inflow -= emptied[i] * self.exhaust.flow(P + m.atmosphere, m.atmosphere)
            pressures.append(m.pressure_rate(P, eps, speed, inflow))
            strains.append(m.strain_rate(strain, speed))
        I_x, I_y, I_z = self.inertia
        cross = (I_z - I_x) * turned * level
        turning = (moment_phi - 2 * cross * turn * tip) / (I_x * level * level + I_z * turned * turned)
        tipping = (moment_psi + cross * turn * turn) / I_y
        return (turn, tip, turning, tipping, *pressures, *strains)

    def advance(self, state: State, seconds: float, filled: Sequence[float], emptied: Sequence[float]) -> State:
        """The state after a time [s] with constant openings (midpoint rule, steps of at most `STEP`)."""
        steps = max(1, math.ceil(seconds / STEP - 1e-9))
        h = seconds / steps
        for _ in range(steps):
            slope = self.rates(state, filled, emptied)
            middle = tuple(a + 0.5 * h * b for a, b in zip(state, slope, strict=True))
            slope = self.rates(middle, filled, emptied)
            state = self._stopped(tuple(a + h * b for a, b in zip(state, slope, strict=True)))
        return state

    def _stopped(self, state: State) -> State:
        """The state limited by the stops, without rebound."""
        angles, rates = list(state[:2]), list(state[2:4])
        if max(map(abs, angles)) <= self.stop:
            return state
        for k in (0, 1):
            if abs(angles[k]) > self.stop:
                angles[k] = math.copysign(self.stop, angles[k])
                rates[k] = min(rates[k], 0.0) if angles[k] > 0 else max(rates[k], 0.0)
        return (*angles, *rates, *state[4:])


def described(numbers: Mapping[str, float]) -> Platform:
    """The platform with these dimensions [SI], by the names of a bench file; missing ones are assumed as above."""
    own = {"contraction": "preload", "stops": "stop"}
    names = ("supply", "circle", "contraction", "mass", "height", "stops")
    changes: dict[str, Any] = {own.get(name, name): numbers[name] for name in names if name in numbers}
    return Platform(braided(numbers), **changes)


_COSINES = tuple(math.cos(g) for g in (math.pi / 2, 7 * math.pi / 6, 11 * math.pi / 6))
_SINES = tuple(math.sin(g) for g in (math.pi / 2, 7 * math.pi / 6, 11 * math.pi / 6))


DELAY = 2e-3
"""Delay of a valve on opening and on shutting [s]."""
DUMP = 4.0
"""Opening of a dump [exhaust valves]."""
MUSCLES = (0, 1, 2)


class PlatformPlant:
    """Simulated platform: three muscles, six valves, a shut-off in the supply and a dump at each muscle; SI.

    Parameters
    ----------
    height : height of the accelerometer above the joint [m]
    """

    def __init__(self, platform: Platform | None = None, *, state: State = LEVEL, height: float = 0.02) -> None:
        self.platform = platform or Platform()
        self.state, self.time = state, 0.0
        self.supply, self.dump = True, False
        """Whether the shut-off is open to the fill valves, and whether the dumps are open."""
        self.stuck: dict[tuple[str, int], bool] = {}
        """Stuck valves, (`fill` or `exhaust`, muscle from 0) -> whether they are open."""
        self.holes = [0.0] * 3
        """Size of a burst of each muscle [exhaust valves]."""
        self.shows_level = False
        """Fault: whether the accelerometer shows a level platform."""
        self.blocked: tuple[int, ...] = ()
        """Fault: muscles, from 0, whose dump does not open."""
        self._open: dict[tuple[str, int], list[tuple[float, float]]] = {
            (kind, i): [] for kind in ("fill", "exhaust") for i in MUSCLES
        }
        self._height = height

    def pulse(self, kind: str, muscle: int, seconds: float) -> None:
        """Open a valve now for `seconds` [s]; an open one stays open until the later end."""
        begin, end = self.time + DELAY, self.time + DELAY + seconds
        mine = self._open[kind, muscle] = [one for one in self._open[kind, muscle] if one[1] > self.time - 1e-9]
        if mine and mine[-1][1] >= begin - 1e-9:
            mine[-1] = (mine[-1][0], max(end, mine[-1][1]))
            return
        mine.append((begin, end))

    def shut(self, kind: str, muscle: int) -> None:
        """End the pulse of a valve; an open one shuts after its delay."""
        mine = self._open[kind, muscle]
        self._open[kind, muscle] = [(a, min(b, self.time + DELAY)) for a, b in mine if a < self.time + DELAY]

    def advance(self, until: float) -> None:
        """Simulate to `until` [s]."""
        while until - self.time > 1e-12:
            cuts = [t for mine in self._open.values() for one in mine for t in one if self.time + 1e-12 < t < until]
            end = min(cuts, default=until)
            middle = 0.5 * (self.time + end)
            filled = [float(self.supply and self._is_open("fill", i, middle)) for i in MUSCLES]
            dumps = [DUMP * (self.dump and i not in self.blocked) for i in MUSCLES]
            emptied = [self._is_open("exhaust", i, middle) + dumps[i] + self.holes[i] for i in MUSCLES]
            self.state = self.platform.advance(self.state, end - self.time, filled, emptied)
            self.time = end

    def _is_open(self, kind: str, muscle: int, t: float) -> bool:
        stuck = self.stuck.get((kind, muscle))
        return any(a <= t < b for a, b in self._open[kind, muscle]) if stuck is None else stuck

    def measure(self) -> dict[str, float]:
        """Present gauge pressures [Pa] and specific forces [m/s2] by channel name."""
        found = {f"pressure_{i + 1}": self.state[4 + i] for i in MUSCLES}
        felt = (0.0, 0.0, G) if self.shows_level else self._specific_force()
        return found | dict(zip(("acceleration_x", "acceleration_y", "acceleration_z"), felt, strict=True))

    def _specific_force(self) -> tuple[float, float, float]:
        """Specific force [m/s2] along the platform's own axes at a sensor on the z axis.

        Its acceleration is h (w' x e_z + w x (w x e_z)), from the angular speed w and its rate w'.
        """
        phi, psi, turn, tip = self.state[:4]
        _, _, turning, tipping = self.platform.rates(self.state, (0.0,) * 3, (0.0,) * 3)[:4]
        sin, cos = math.sin(psi), math.cos(psi)
        w = (turn * cos, tip, turn * sin)
        faster = (turning * cos - turn * tip * sin, tipping)
        h = self._height
        return (
            -G * math.cos(phi) * sin + h * (faster[1] + w[0] * w[2]),
            G * math.sin(phi) + h * (-faster[0] + w[1] * w[2]),
            G * math.cos(phi) * cos - h * (w[0] ** 2 + w[1] ** 2),
        )

    def turns(self) -> tuple[float, float]:
        """Angular speeds about the platform's own x and y axes [rad/s], as measured by a gyroscope."""
        return self.state[2] * math.cos(self.state[1]), self.state[3]

    def snapshot(self) -> dict[str, Any]:
        """The complete state, for `restore`."""
        opened = {key: tuple(mine) for key, mine in self._open.items()}
        kept = self.state, self.time, self.supply, self.dump, self.shows_level, self.blocked
        return {"kept": kept, "open": opened, "stuck": dict(self.stuck), "holes": list(self.holes)}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Return to the state of a snapshot, which can be used again."""
        self.state, self.time, self.supply, self.dump, self.shows_level, self.blocked = snapshot["kept"]
        self._open = {key: list(mine) for key, mine in snapshot["open"].items()}
        self.stuck, self.holes = dict(snapshot["stuck"]), list(snapshot["holes"])


Pair = tuple[float, float]
Three = tuple[float, float, float]


def tilt(x: float, y: float, z: float) -> Pair:
    """Phi and psi [rad] of a platform at rest, from specific forces along its axes [m/s2]."""
    return math.atan2(y, math.hypot(x, z)), math.atan2(-x, z)


class Lags:
    """Two equal first-order lags in series, for a pair of values.

    Parameters
    ----------
    time_constant : of each lag [s]
    start : initial value of both
    """

    def __init__(self, time_constant: float, start: Pair) -> None:
        self._time_constant = time_constant
        self._first = self.value = start

    def update(self, h: float, goal: Pair) -> Pair:
        """The pair `h` [s] later, while the input is `goal`."""
        keep = math.exp(-h / self._time_constant)
        self._first = _towards(self._first, goal, keep)
        self.value = _towards(self.value, self._first, keep)
        return self.value


def _towards(at: Pair, goal: Pair, keep: float) -> Pair:
    return goal[0] + (at[0] - goal[0]) * keep, goal[1] + (at[1] - goal[1]) * keep


@dataclass(frozen=True)
class Wanted:
    """Three gauge pressures [Pa] and contractions [1]; `clipped`: the moment is not possible within the limits."""

    pressures: Three
    contractions: Three
    clipped: bool


@dataclass(frozen=True)
class Inverse:
    """Inverse statics of a platform: forces for a moment, then the pressure of each muscle."""

    platform: Platform = field(default_factory=Platform)
    low: float = 0.2e5
    high: float = 5.5e5
    """Lowest and highest pressure [Pa]."""
    mean: float = 2.5e5
    """Mean of the three pressures, if the limits allow it [Pa]."""

    def wanted(self, attitude: Pair, moment: Pair) -> Wanted:
        """Pressures for a moment [N.m] in addition to holding the weight, at an attitude [rad].

        If it is not possible within the limits, each pressure is clipped.
        """
        p, m = self.platform, self.platform.muscle
        phi, psi = np.array(attitude[0]), np.array(attitude[1])
        lengths, arms, _ = pose(phi, psi, np.array(p.circle), np.array((1 - p.preload) * m.length))
        eps = 1 - lengths / m.length
        least, free = allocation(gravity(phi, psi, np.array(p.mass), np.array(p.height)) - np.array(moment), arms)
        section = section_factor(eps, *map(np.array, (m.diameter, m.braid_angle, m.alpha)))
        P = (least - rubber_force(eps, *map(np.array, (m.A, m.B1, m.B2)))) / section
        rise = free / section
        scale = float((3 * self.mean - P.sum()) / rise.sum())
        low, high = float(((self.low - P) / rise).max()), float(((self.high - P) / rise).min())
        P = P + rise * (min(max(scale, low), high) if low <= high else scale)
        one, two, three = np.clip(P, self.low, self.high).tolist()
        return Wanted((one, two, three), (float(eps[0]), float(eps[1]), float(eps[2])), low > high)

    def rest(self, pressures: Three, start: Pair) -> Pair | None:
        """Attitude of rest [rad] at three gauge pressures [Pa], without hysteresis; None where none is found.

        Newton's method from `start` with the stiffness of each axis, without the coupling of both axes.
        """
        p, m = self.platform, self.platform.muscle
        body = (p.circle, p.preload, m.length, m.diameter, m.braid_angle, m.alpha, m.A, m.B1, m.B2, p.mass, p.height)
        at = list(start)
        for _ in range(20):
            try:
                found = platform_moment(*map(np.array, (*at, *pressures, *body)))
            except ValueError:
                return None
            moments, slopes = ([float(found[f"{what}_{axis}"]) for axis in ("phi", "psi")]
                               for what in ("moment", "stiffness"))  # fmt: skip
            steps = [moment / max(slope, 1.0) for moment, slope in zip(moments, slopes, strict=True)]
            at = [
                min(max(now + max(-0.1, min(0.1, step)), -p.stop), p.stop) for now, step in zip(at, steps, strict=True)
            ]
            if max(map(abs, steps)) < 1e-4:
                return at[0], at[1]
        return None


def contractions(platform: Platform, attitude: Pair) -> Three:
    """Contractions of the three muscles [1] at an attitude [rad]; plain floats, for use at every sample."""
    (sin, cos), (turned, level) = ((math.sin(angle), math.cos(angle)) for angle in attitude)
    above, found = (1 - platform.preload) * platform.muscle.length, []
    for around in AROUND:
        ax, ay = platform.circle * math.cos(around), platform.circle * math.sin(around)
        x, y = ax * (level - 1), ay * (cos - 1) + ax * turned * sin
        found.append(1 - math.hypot(x, y, ay * sin - ax * turned * cos + above) / platform.muscle.length)
    return found[0], found[1], found[2]


def pressure_rate(platform: Platform, P: float, eps: float, *, fills: bool) -> float:
    """Rate of gauge pressure [Pa/s] with one open valve at a contraction [1]; negative for the exhaust valve."""
    m = platform.muscle
    absolute = P + m.atmosphere
    if fills:
        return m.pressure_rate(P, eps, 0.0, platform.fill.flow(platform.supply + m.atmosphere, absolute))
    return m.pressure_rate(P, eps, 0.0, -platform.exhaust.flow(absolute, m.atmosphere))


def on_time(platform: Platform, P: float, wanted: float, eps: float) -> float:
    """Opening time of a valve [s] to change the gauge pressure from `P` to `wanted` [Pa] at a contraction [1].

    Positive for the fill valve, negative for the exhaust valve: V dP / (k r T q), with the flow q at the present
    pressure.
    """
    rate = pressure_rate(platform, P, eps, fills=wanted > P)
    return abs((wanted - P) / rate) * (1 if wanted > P else -1) if rate else 0.0
