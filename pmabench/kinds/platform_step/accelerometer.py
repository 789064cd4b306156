"""What an accelerometer says about itself: at rest it shows g whatever the attitude, and in motion nearly.

Knows steps of attitude, no estimates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.samples import count_of, lag_open, noise_of
from pmabench.analysis.shared.skew import off
from pmabench.base.quantities import show
from pmabench.kinds.platform_step.course import ACCELERATIONS, LAST, Course, G
from pmabench.store.records import Array

GRAVITY = 0.003
"""Share by which gravity departs from 9.81 m/s2 between the equator and the poles."""
SURE = 5.0
MOVES = 1.0
"""The motion is looked at for so long from the step on [s]."""
LATE = 8e-3
"""Times between axes that are shorter [s] are left to the interval: heights that are off look like half of that."""


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
    return Seen(_attitude(courses), _time(courses), max(math.hypot(_wobble(one), _count(one)) for one in courses))


def _norm(one: Course) -> Array:
    return np.asarray(np.sqrt(sum(np.asarray(one.trial.channels[name]) ** 2 for name in ACCELERATIONS)))


def _rests(one: Course) -> tuple[Array, Array]:
    """Samples of the last second at level, and of the hold."""
    return np.asarray((one.t > -LAST) & (one.t <= 0)), np.asarray((one.t > one.hold - LAST) & (one.t <= one.hold))


def _attitude(courses: Sequence[Course]) -> Doubt:
    """By an offset or a scale of one axis: |f| is another one when tilted than when level, or is not g at all."""
    more, errors, levels = [], [], []
    for one in courses:
        norm, (level, held) = _norm(one), _rests(one)
        more.append((float(norm[held].mean() - norm[level].mean())) / math.sin(one.size))
        errors.append(noise_of(norm) * math.sqrt(1 / level.sum() + 1 / held.sum()) / math.sin(one.size))
        levels.append(float(norm[level].mean()) / G - 1)
    worst = int(np.argmax(np.abs(more)))
    scale = max(abs(float(np.mean(levels))) - GRAVITY, 0.0)
    half = (abs(more[worst]) + 2 * errors[worst]) / G + scale * max(one.size for one in courses)
    seen = abs(more[worst]) > SURE * errors[worst] or scale > 0
    size, whole = show(abs(more[worst]), "acceleration", 2), show(G * (1 + float(np.mean(levels))), "acceleration", 4)
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


def _wobble(one: Course) -> float:
    """Amplitude of what is not noise in the last second at level, without a drift [rad]."""
    level, _ = _rests(one)
    t, power = one.t[level], 0.0
    for angle in (one.phi[level], one.psi[level]):
        power += float(np.var(angle - np.polyval(np.polyfit(t, angle, 1), t)))
    return math.sqrt(2 * max(0.0, power - 2 * one.noise**2))


def _count(one: Course) -> float:
    return 0.5 * max(count_of(one.run, name) for name in ACCELERATIONS) / G
