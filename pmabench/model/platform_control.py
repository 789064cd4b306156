"""What controls a platform of three muscles: attitude from accelerations, pressures that turn it, on-times of valves.

Knows no device, no plan and no time but its own. Geometry, muscle and valves are those of `model.many`; a real platform
brings its own numbers. The chain is paper 3's: angle errors, inverse kinematics, forces, inverse muscle, valves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from pmabench.model.library.daerden import rubber_force, section_factor
from pmabench.model.library.platform import AROUND, allocation, gravity, platform_moment, pose
from pmabench.model.many.platform import Platform

Pair = tuple[float, float]
Three = tuple[float, float, float]


def tilt(x: float, y: float, z: float) -> Pair:
    """Phi and psi [rad] of a platform at rest, from specific forces along its axes [m/s2]."""
    return math.atan2(y, math.hypot(x, z)), math.atan2(-x, z)


class Lags:
    """Two equal first-order lags in a row, of a pair of values.

    Parameters
    ----------
    time_constant : of each [s]
    start : where both begin
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
    """Three gauge pressures [Pa] and contractions [1]; `clipped` where limits forbid what the moment asks for."""

    pressures: Three
    contractions: Three
    clipped: bool


@dataclass(frozen=True)
class Inverse:
    """Statics of a platform, solved for the pressures: forces that make a moment, then each muscle's pressure."""

    platform: Platform = field(default_factory=Platform)
    low: float = 0.2e5
    high: float = 5.5e5
    """Least and greatest pressure [Pa]."""
    mean: float = 2.5e5
    """Of the three, where the limits allow it [Pa]."""

    def wanted(self, attitude: Pair, moment: Pair) -> Wanted:
        """Pressures for a moment [N.m] beyond holding the weight, at an attitude [rad].

        Where no three pressures within the limits make it, each is taken to its limit.
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
        """Attitude [rad] at which three gauge pressures [Pa] hold it, hysteresis left out; None where none is found.

        Newton's method from `start` with the moments' own slopes; the coupling of both axes is left out of them.
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
    """Of the three muscles [1] at an attitude [rad]; plain numbers, for a loop that asks at every sample."""
    (sin, cos), (turned, level) = ((math.sin(angle), math.cos(angle)) for angle in attitude)
    above, found = (1 - platform.preload) * platform.muscle.length, []
    for around in AROUND:
        ax, ay = platform.circle * math.cos(around), platform.circle * math.sin(around)
        x, y = ax * (level - 1), ay * (cos - 1) + ax * turned * sin
        found.append(1 - math.hypot(x, y, ay * sin - ax * turned * cos + above) / platform.muscle.length)
    return found[0], found[1], found[2]


def pressure_rate(platform: Platform, P: float, eps: float, *, fills: bool) -> float:
    """How fast one open valve changes a gauge pressure [Pa/s] at a contraction [1]; below 0 where it lets air out."""
    m = platform.muscle
    absolute = P + m.atmosphere
    if fills:
        return m.pressure_rate(P, eps, 0.0, platform.fill.flow(platform.supply + m.atmosphere, absolute))
    return m.pressure_rate(P, eps, 0.0, -platform.exhaust.flow(absolute, m.atmosphere))


def on_time(platform: Platform, P: float, wanted: float, eps: float) -> float:
    """How long to open a valve to bring a muscle from one gauge pressure [Pa] to another at a contraction [1].

    Above 0 the fill valve, below 0 the exhaust valve [s]: V dP / (k r T q), the flow at the present pressure.
    """
    rate = pressure_rate(platform, P, eps, fills=wanted > P)
    return abs((wanted - P) / rate) * (1 if wanted > P else -1) if rate else 0.0
