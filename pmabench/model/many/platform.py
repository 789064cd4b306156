"""A platform that three muscles with two valves each tilt about two axes: its motion from the valves' openings.

Geometry and signs are those of `model.library.platform`. Numbers are assumed; paper 3 prints the arrangement only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from pmabench.model.many.muscle import Braided, Valve

G = 9.81
STEP = 0.5e-3
"""Longest step of the integration [s]; halving it changes angles of a few degrees by less than 0.0005 deg."""
State = tuple[float, ...]
"""phi, psi [rad], their rates [rad/s], three gauge pressures [Pa], three shares of the hysteresis [1]."""
LEVEL: State = (0.0,) * 4 + (2.5e5,) * 3 + (0.0,) * 3
"""At rest, level, at 2.5 bar."""


@dataclass(frozen=True)
class Opening:
    """When a valve is open: `kind` is fill or exhaust, `muscle` counts from 0, from `begin` to `end` [s]."""

    kind: str
    muscle: int
    begin: float
    end: float


@dataclass(frozen=True)
class Platform:
    """What the platform is made of [SI]."""

    muscle: Braided = field(default_factory=Braided)
    fill: Valve = field(default_factory=Valve)
    exhaust: Valve = field(default_factory=Valve)
    supply: float = 7e5
    """Gauge pressure before the fill valves [Pa]."""
    circle: float = 0.055
    """Radius of the circle of anchors [m]."""
    preload: float = 0.10
    """Contraction while it is level [1]."""
    mass: float = 2.0
    height: float = 0.050
    """Of the centre of mass above the joint [m]."""
    inertia: tuple[float, float, float] = (0.020, 0.020, 0.012)
    """About its own axes [kg m2]."""
    damping: float = 0.05
    """Of the joint [N m s]."""
    stop: float = 24 * math.pi / 180
    """Angle of either axis at which a stop holds it [rad]."""

    def rates(self, state: State, filled: Sequence[float], emptied: Sequence[float]) -> State:
        """Derivative of the state; how wide each muscle is open to the supply and to the air, 1 for its valve."""
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
        """The state after a time [s] with the openings as they are (midpoint rule, steps of at most `STEP`)."""
        steps = max(1, math.ceil(seconds / STEP - 1e-9))
        h = seconds / steps
        for _ in range(steps):
            slope = self.rates(state, filled, emptied)
            middle = tuple(a + 0.5 * h * b for a, b in zip(state, slope, strict=True))
            slope = self.rates(middle, filled, emptied)
            state = self._stopped(tuple(a + h * b for a, b in zip(state, slope, strict=True)))
        return state

    def _stopped(self, state: State) -> State:
        """Held by the stops, against which it comes to rest."""
        angles, rates = list(state[:2]), list(state[2:4])
        if max(map(abs, angles)) <= self.stop:
            return state
        for k in (0, 1):
            if abs(angles[k]) > self.stop:
                angles[k] = math.copysign(self.stop, angles[k])
                rates[k] = min(rates[k], 0.0) if angles[k] > 0 else max(rates[k], 0.0)
        return (*angles, *rates, *state[4:])

    def simulate(self, openings: Sequence[Opening], at: Sequence[float], state: State = LEVEL) -> list[State]:
        """States at rising times `at` [s] from `state` at 0 on, with these openings of valves."""
        cuts = sorted({0.0, *at, *(t for one in openings for t in (one.begin, one.end))})
        wanted, found = set(at), []
        if 0.0 in wanted:
            found.append(state)
        for begin, end in pairwise(cuts):
            if len(found) == len(wanted):
                break
            middle = 0.5 * (begin + end)
            now = [one for one in openings if one.begin <= middle < one.end]
            filled, emptied = (
                [any(one.kind == kind and one.muscle == i for one in now) for i in range(3)]
                for kind in ("fill", "exhaust")
            )
            state = self.advance(state, end - begin, filled, emptied)
            if end in wanted:
                found.append(state)
        return found


def described(numbers: Mapping[str, float]) -> Platform:
    """The platform that a bench file describes [SI], by the names there; what it leaves out is assumed as above."""
    own = {"contraction": "preload", "stops": "stop"}
    names = ("supply", "circle", "contraction", "mass", "height", "stops")
    muscle = Braided(**{n: numbers[n] for n in ("diameter", "length", "braid_angle", "atmosphere") if n in numbers})
    changes: dict[str, Any] = {own.get(name, name): numbers[name] for name in names if name in numbers}
    return Platform(muscle, **changes)


_COSINES = tuple(math.cos(g) for g in (math.pi / 2, 7 * math.pi / 6, 11 * math.pi / 6))
_SINES = tuple(math.sin(g) for g in (math.pi / 2, 7 * math.pi / 6, 11 * math.pi / 6))
