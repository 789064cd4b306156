"""One step of attitude from the record: the attitude without what the accelerometer's height adds, and the valves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from pmabench.analysis.shared.samples import NotUsable, noise_of, on_time, settings_of
from pmabench.store.records import Array, RunData, TrialData

MUSCLES = ("pressure_1", "pressure_2", "pressure_3")
ACCELERATIONS = ("acceleration_x", "acceleration_y", "acceleration_z")
VALVES = tuple(f"{kind}_{i}" for i in (1, 2, 3) for kind in ("fill", "exhaust"))
G = 9.81
BAND = math.radians(1.0)
LAST = 1.0
"""The end error is that of the mean over so much of the end of the hold [s]."""
LEAST_LAG = 0.01
"""Noise is smoothed at least by this lag, both ways [s]."""
SAME = 1.5e-3
"""Pulses that follow each other within this time [s] are one opening."""


@dataclass(frozen=True, eq=False)
class Course:
    """A step: times from it on [s], attitude and its place along and across the step [rad], pulses."""

    run: RunData
    trial: TrialData
    t: Array
    phi: Array
    psi: Array
    goal: tuple[float, float]
    hold: float
    noise: float
    """Standard deviation of the smoothed attitude [rad]."""
    pulses: tuple[tuple[float, str, float], ...]
    """Begin from the step on [s], valve, seconds."""
    law: Mapping[str, Any]

    @property
    def size(self) -> float:
        """Of the step [rad]."""
        return math.hypot(*self.goal)

    @property
    def held(self) -> Array:
        """Which samples belong to the hold."""
        return np.asarray((self.t > 0) & (self.t <= self.hold + 1e-9))

    @property
    def away(self) -> Array:
        """Distance from the goal at each sample [rad]."""
        return np.hypot(self.phi - self.goal[0], self.psi - self.goal[1])

    def settled(self, band: float = BAND) -> float | None:
        """Time after which it stays within `band` [rad]; None where it is outside in the last half of the hold."""
        t, outside = self.t[self.held], self.away[self.held] > band
        last = float(t[outside][-1]) if outside.any() else 0.0
        return last if last < 0.5 * self.hold else None

    @property
    def overshoot(self) -> float:
        """Furthest way beyond the goal in its direction [rad]; 0 where it does not get there."""
        way = (self.phi * self.goal[0] + self.psi * self.goal[1]) / self.size
        return max(0.0, float(way[self.held].max()) - self.size)

    def ends(self, since: float = LAST, until: float = 0.0) -> tuple[float, float]:
        """Mean attitude minus the goal [rad], from so long before the end of the hold [s] on."""
        late = (self.t > self.hold - since) & (self.t <= self.hold - until)
        return float(self.phi[late].mean()) - self.goal[0], float(self.psi[late].mean()) - self.goal[1]

    def openings(self) -> dict[str, float]:
        """Openings a second of each valve [Hz] during the hold."""
        ends, found = dict.fromkeys(VALVES, -math.inf), dict.fromkeys(VALVES, 0)
        for begin, valve, seconds in self.pulses:
            if 0 < begin <= self.hold and begin > ends[valve] + SAME:
                found[valve] += 1
            ends[valve] = max(ends[valve], begin + seconds)
        return {valve: count / self.hold for valve, count in found.items()}


def course_of(run: RunData, trial: TrialData, heights: float = 1.0) -> Course:
    """The course of a trial; the accelerometer's height is taken `heights` times. Raises `NotUsable`."""
    law, settings = trial.found.get("step") or {}, settings_of(run)
    if law.get("ended") != "time":
        raise NotUsable(f"the loop did not reach its end: {law.get('reason') or law.get('ended') or 'it was cut off'}")
    if not trial.usable.all():
        raise NotUsable("samples are missing or off range, and an attitude cannot be followed over them")
    begin = float(law["t0"]) + float(settings["level"])
    if len(trial.t) < 2 or trial.t[-1] < begin + 0.98 * float(settings["hold"]):
        raise NotUsable("its samples end before the hold does")
    forces = [on_time(run, trial, name) for name in ACCELERATIONS]
    x, y, z = forces
    angles = np.arctan2(y, np.hypot(x, z)), np.arctan2(-x, z)
    lag = max(LEAST_LAG, math.sqrt(heights * max(0.0, float(settings.get("height", 0.0))) / G))
    noise = max(noise_of(angle) for angle in angles) * math.sqrt(1 / run.rate / (4 * lag))
    phi, psi = (both_ways(angle, lag, run.rate) for angle in angles)
    goal = trial.point["phi"], trial.point["psi"]
    pulses = tuple((t - begin, valve, seconds) for t, valve, seconds in _pulses(run, trial))
    return Course(run, trial, trial.t - begin, phi, psi, goal, float(settings["hold"]), noise, pulses, law)


def both_ways(values: Array, lag: float, rate: float) -> Array:
    """Through a first-order lag [s] forwards and backwards: 1 / (1 - lag^2 s^2), without delay.

    An accelerometer at height h shows the angle minus h/g times its second rate: 1 - (h/g) s^2. With lag^2 = h/g this
    takes that off.
    """
    keep = math.exp(-1 / (rate * lag))

    def once(one: Array) -> Array:
        return np.asarray(lfilter([1 - keep], [1, -keep], one, zi=[keep * one[0]])[0])

    return once(once(values)[::-1])[::-1]


def _steered(run: RunData, trial: TrialData) -> Iterator[Mapping[str, Any]]:
    for event in run.events:
        if event.kind == "steered" and trial.t[0] - 1e-6 <= event.t <= trial.t[-1] + 1e-2:
            yield event.data


def _pulses(run: RunData, trial: TrialData) -> Iterator[tuple[float, str, float]]:
    for data in _steered(run, trial):
        yield from ((float(t), str(valve), float(seconds)) for t, valve, seconds in data["pulses"])


def wanted(course: Course) -> dict[str, Array]:
    """Pressures that the law wanted at each sample [Pa]; NaN before the first."""
    rows = [row for data in _steered(course.run, course.trial) for row in data["aims"]]
    if not rows:
        return {name: np.full(len(course.t), np.nan) for name in MUSCLES}
    table = np.array(rows, dtype=np.float64)
    place = np.searchsorted(table[:, 0], course.trial.t + 1e-9, side="right") - 1
    return {name: np.where(place >= 0, table[np.maximum(place, 0), 1 + i], np.nan) for i, name in enumerate(MUSCLES)}
