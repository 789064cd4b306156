"""A platform in closed loop for tests: the plant, the law and the watch on faults, sample by sample at 500 Hz."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmabench.engine.laws import Orders
from pmabench.engine.laws.platform_loop import PlatformLoop
from pmabench.engine.platform_watch import PlatformWatch
from pmabench.model.many.platform import PlatformPlant

DEG, PERIOD = math.pi / 180, 0.002
STEP_AT = 1.0
NOISE = 0.02
"""Standard deviation of each axis of the accelerometer [m/s2]."""


@dataclass
class Course:
    """What happened: times from the step on [s], phi and psi [deg], openings as (time, valve), trip as (time, why)."""

    t: list[float] = field(default_factory=list)
    phi: list[float] = field(default_factory=list)
    psi: list[float] = field(default_factory=list)
    openings: list[tuple[float, str]] = field(default_factory=list)
    trip: tuple[float, str] | None = None
    law: PlatformLoop | None = None

    def judged(self, goal: float, axis: str = "phi") -> dict[str, float]:
        """Settling to 1 deg [s], overshoot and error over the last second [deg], switchings a second of one valve."""
        t, way = np.array(self.t), np.array(getattr(self, axis)) * math.copysign(1, goal)
        size, after = abs(goal), t > 0
        valves = {valve for _, valve in self.openings}
        return {
            "rise": float(t[after & (way > 0.9 * size)][0]),
            "settled": float(t[np.abs(way - size) > 1][-1]),
            "overshoot": float(way[after].max() - size),
            "end": float(abs(way[t > t[-1] - 1].mean() - size)),
            "switchings": max(sum(at > 0 and one == valve for at, one in self.openings) for valve in valves) / t[-1],
        }


def _noise(channel: str, chance: random.Random) -> float:
    return chance.gauss(0.0, NOISE) if channel.startswith("acceleration") else 0.0


def closed_loop(
    goals: list[tuple[float, float, float]], seed: int, *, lasts: float = 5.0, plant: PlatformPlant | None = None,
    **law: Any,
) -> Course:  # fmt: skip
    """From level at 2.5 bar to `goals` (time after the first step [s], phi, psi [deg])."""
    plant, chance = plant or PlatformPlant(), random.Random(seed)
    loop = PlatformLoop(
        goals=[(0.0, 0.0, 0.0), *((STEP_AT + t, phi * DEG, psi * DEG) for t, phi, psi in goals)],
        duration=STEP_AT + lasts, **law,
    )  # fmt: skip
    watch, course = PlatformWatch(), Course(law=loop)
    for number in range(1, round((STEP_AT + lasts) / PERIOD) + 1):
        plant.advance(number * PERIOD)
        t = plant.time - STEP_AT
        values = {name: value + _noise(name, chance) for name, value in plant.measure().items()}
        orders: Orders = loop.update(plant.time, values)
        why = watch.look(plant.time, values, orders)
        if why:
            course.trip = (t, why)
            return course
        for pulse in orders.pulses:
            kind, _, muscle = pulse.valve.partition("_")
            plant.pulse(kind, int(muscle) - 1, pulse.seconds)
            course.openings.append((t, pulse.valve))
        course.t.append(t)
        course.phi.append(plant.state[0] / DEG)
        course.psi.append(plant.state[1] / DEG)
    return course
