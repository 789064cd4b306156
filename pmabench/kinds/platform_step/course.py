"""One step of attitude from the record: the attitude without what the accelerometer's height adds, and the valves.

And what an accelerometer says about itself: at rest it shows g whatever the attitude, and in motion nearly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.samples import NotUsable, count_of, lag_open, noise_of, on_time, settings_of
from pmabench.analysis.shared.skew import off
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

GRAVITY = 0.003
"""Share by which gravity departs from 9.81 m/s2 between the equator and the poles."""
SURE = 5.0
MOVES = 1.0
"""The motion is looked at for so long from the step on [s]."""
LATE = 15e-3
"""Times between axes that are shorter [s] are left to the interval: a sound accelerometer looks like up to 12 ms."""


@dataclass(frozen=True)
class Seen:
    """Half widths that the accelerometer leaves open."""

    attitude: Doubt
    """Error of the attitude at rest [rad]."""
    time: Doubt
    """Time between an axis and the others, or all of them and the valves [s]."""
    wobble: float
    """What shakes it at level, and half a count [rad]."""


def seen_in(courses: Sequence[Course]) -> Seen:
    """Of all courses together: they have one accelerometer."""
    return Seen(_attitude(courses), _time(courses), max(_wobble(one) for one in courses))


def _wobble(one: Course) -> float:
    """Amplitude of what is not noise in the last second at level, without a drift, and half a count [rad]."""
    level, _ = _rests(one)
    t, power = one.t[level], 0.0
    for angle in (one.phi[level], one.psi[level]):
        power += float(np.var(angle - np.polyval(np.polyfit(t, angle, 1), t)))
    count = 0.5 * max(count_of(one.run, name) for name in ACCELERATIONS) / G
    return math.hypot(math.sqrt(2 * max(0.0, power - 2 * one.noise**2)), count)


def _norm(one: Course) -> Array:
    return np.asarray(np.sqrt(sum(np.asarray(one.trial.channels[name]) ** 2 for name in ACCELERATIONS)))


def _rests(one: Course) -> tuple[Array, Array]:
    """Samples of the last second at level, and of the hold."""
    return np.asarray((one.t > -LAST) & (one.t <= 0)), np.asarray((one.t > one.hold - LAST) & (one.t <= one.hold))


def _attitude(courses: Sequence[Course]) -> Doubt:
    """By an offset or a scale of one axis: |f| is another one when tilted than when level, or is not g at all."""
    rows = []
    for one in courses:
        norm, (level, held) = _norm(one), _rests(one)
        more = abs(float(norm[held].mean() - norm[level].mean()) / math.sin(one.size))
        error = noise_of(norm) * math.sqrt(1 / level.sum() + 1 / held.sum()) / math.sin(one.size)
        rows.append((more, error, float(norm[level].mean()) / G - 1))
    more, error, _ = max(rows, key=lambda row: row[0])
    off_level = float(np.mean([row[2] for row in rows]))
    scale = max(abs(off_level) - GRAVITY, 0.0)
    half = (more + 2 * error) / G + scale * max(one.size for one in courses)
    seen = more > SURE * error or scale > 0
    size, whole = show(more, "acceleration", 2), show(G * (1 + off_level), "acceleration", 4)
    reason = (
        f"the accelerometer shows {whole} at level, and tilted as if an axis were off by {size}: an axis has an offset "
        "or another scale. Calibrate it, each axis upwards and downwards"
    )
    return Doubt("offset of the accelerometer", "method", half, seen, reason)


def _time(courses: Sequence[Course]) -> Doubt:
    """By a filter on one axis: while it tilts, |f| departs from g by how far the horizontal axis is behind.

    f is g sin(q) across and g cos(q) - h q'^2 along, and h q'' across: columns of a least squares for delay and height.
    """
    rows, columns = [], []
    for one in courses:
        way = (one.phi * one.goal[0] + one.psi * one.goal[1]) / one.size
        rate = np.gradient(way, one.t)
        turning = (one.t > 0) & (one.t <= MOVES)
        norm = _norm(one)
        behind = -G * np.sin(way) * np.cos(way) * rate
        above = -np.sin(way) * np.gradient(rate, one.t) - rate**2
        rows.append(norm[turning] - norm[_rests(one)[0]].mean())
        columns.append(np.column_stack([behind, above, np.sin(way) ** 2])[turning])
    design, target = np.concatenate(columns), np.concatenate(rows)
    inverse = np.linalg.pinv(design.T @ design)
    terms = inverse @ design.T @ target
    error = float(np.sqrt(np.mean((target - design @ terms) ** 2) * inverse[0, 0]))
    run = courses[0].run
    open_ = max(lag_open(run, name) for name in ACCELERATIONS) + max(off([run], name) for name in ACCELERATIONS)
    late = abs(float(terms[0]))
    seen = late > SURE * error and late > LATE
    reason = f"while it tilts, one axis of the accelerometer is {1e3 * late:.2g} ms behind another: look for a filter"
    return Doubt("time between the axes", "method", max(open_, 1.5 * late), seen, reason)


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
    x, y, z = (on_time(run, trial, name) for name in ACCELERATIONS)
    angles = np.arctan2(y, np.hypot(x, z)), np.arctan2(-x, z)
    lag = max(LEAST_LAG, math.sqrt(heights * max(0.0, float(settings.get("height", 0.0))) / G))
    noise = max(noise_of(angle) for angle in angles) * math.sqrt(1 / run.rate / (4 * lag))
    phi, psi = (both_ways(angle, lag, run.rate) for angle in angles)
    goal = trial.point["phi"], trial.point["psi"]
    steered = [pulse for data in _steered(run, trial) for pulse in data["pulses"]]
    pulses = tuple((float(t) - begin, str(valve), float(seconds)) for t, valve, seconds in steered)
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


def wanted(course: Course) -> dict[str, Array]:
    """Pressures that the law wanted at each sample [Pa]; NaN before the first."""
    rows = [row for data in _steered(course.run, course.trial) for row in data["aims"]]
    if not rows:
        return {name: np.full(len(course.t), np.nan) for name in MUSCLES}
    table = np.array(rows, dtype=np.float64)
    place = np.searchsorted(table[:, 0], course.trial.t + 1e-9, side="right") - 1
    return {name: np.where(place >= 0, table[np.maximum(place, 0), 1 + i], np.nan) for i, name in enumerate(MUSCLES)}
