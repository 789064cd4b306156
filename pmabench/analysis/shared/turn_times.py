"""Delay of the force behind the motion, from the times at which both turn.

Hysteresis and damping change the force at the moment at which the motion turns, however slowly it approaches the other
branch. A filter of the force cell, another clock or backlash of the displacement sensor separate the two moments; on
the branches each of them looks like hysteresis or damping.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.analysis.shared.lines import left_by
from pmabench.store.records import Array

FEWEST = 6
"""Fewest samples on either side of a turn."""
TRIED = 41
"""Number of delays tried in each direction, including 0."""
REACH = 0.6
"""Longest tried delay over the time span on either side of a turn."""
REACHED = 0.8
"""Share of the longest delay above which the search is repeated over a longer span."""
WIDER = 3.0
"""Spans before and after its command within which the turn of the motion is searched."""
ORDER = 3
ALIKE = 1e-9
"""Relative difference below which sums of squares count as equal, as for delays between the same two samples."""
OF_FILTER = 4.0
"""Span on either side of a turn, in time constants of the filter."""
SURE = 4.0
"""Standard deviations by which a filter must fit better than a delay, to be taken in its place."""


@dataclass(frozen=True)
class Behind:
    """Delay of the force behind the motion [s], its half width [s], and whether it is within the tried range."""

    time: float
    half: float
    within: bool


def behind(t: Array, moved: Array, pulls: Array, turns: Sequence[float], span: float) -> Behind | None:
    """Delay of `pulls` behind `moved`; None where too few samples are near a turn.

    `t` [s], `moved`, `pulls` have shape (n,), `turns` are the commanded times [s]. Within half of `span` [s] about each
    turn the force is a straight line before, and after it a jump and a cubic polynomial, delayed or through a
    first-order filter. The result for the whole `span` shows the effect of this form, and is in the half width. Delays
    near the limit of half the span are searched within `span` and twice that. The interval is by profile likelihood,
    with Student's t corrected for the number of distinguishable delays, because the residual is not smooth.
    """
    near, wide = (_of_turns(t, moved, pulls, turns, share * span) for share in (0.5, 1.0))
    if wide is not None and abs(wide.time) > REACHED * REACH * 0.5 * span:
        near, wide = wide, _of_turns(t, moved, pulls, turns, 2 * span) or wide
    if near is None or wide is None:
        return wide
    return replace(near, half=float(np.hypot(near.half, abs(near.time - wide.time))))


def through_filter(t: Array, moved: Array, pulls: Array, turns: Sequence[float], constant: float) -> bool:
    """Whether the turns agree with `pulls` being filtered by a first-order filter of time `constant` [s]."""
    span = OF_FILTER * constant
    windows = _windows(t, moved, pulls, turns, span)
    if not windows:
        return False
    _, least, variance = min((_best(windows, REACH * span, of) for of in (_delayed, _filtered)), key=lambda one: one[1])
    period, one = max(float(np.median(np.diff(t))) for t, _ in windows), np.array([constant])
    near = [[(t - by, y) for t, y in windows] for by in period * np.linspace(-0.5, 0.5, 3)]  # between samples
    return min(float(_left(those, _filtered, one)[0]) for those in near) <= least + SURE**2 * variance


def _windows(t: Array, moved: Array, pulls: Array, turns: Sequence[float], span: float) -> list[tuple[Array, Array]]:
    return [window for turn in turns if (window := _window(t, moved, pulls, turn, span)) is not None]


def _of_turns(t: Array, moved: Array, pulls: Array, turns: Sequence[float], span: float) -> Behind | None:
    windows = _windows(t, moved, pulls, turns, span)
    if not windows:
        return None
    (delayed, by_delay, _), (filtered, by_filter, variance) = (
        _best(windows, REACH * span, of) for of in (_delayed, _filtered)
    )
    return filtered if by_delay - by_filter > SURE**2 * variance else delayed


def _window(t: Array, moved: Array, pulls: Array, turn: float, span: float) -> tuple[Array, Array] | None:
    """Times relative to the turn of the motion [s] and `pulls` there; None with too few samples or without a turn."""
    wide = _about(t, turn, WIDER * span)
    begin = None if wide is None else corner(t[wide] - turn, moved[wide])
    near = None if begin is None else _about(t, turn + begin, span)
    return None if near is None or begin is None else (t[near] - turn - begin, pulls[near])


def _about(t: Array, moment: float, span: float) -> NDArray[np.intp] | None:
    rows = np.flatnonzero(np.abs(t - moment) <= span)
    before = int(np.count_nonzero(t[rows] < moment))
    return rows if min(before, len(rows) - before) >= FEWEST else None


def corner(t: Array, y: Array) -> float | None:
    """Time [s] at which y(t) changes from one straight line to another; None where that is at an end."""
    tried = np.linspace(0.7 * float(t[0]), 0.7 * float(t[-1]), 2 * TRIED)
    left = left_by(np.stack([np.ones_like(t), t]), np.maximum(t - tried[:, None], 0.0)[:, None], y)
    place = int(np.argmin(left))
    if place in (0, len(tried) - 1):
        return None
    low, mid, high = left[place - 1 : place + 2]
    bend = low - 2 * mid + high
    vertex = float(0.5 * (low - high) / bend) if bend > 0 else 0.0  # of the parabola through these, in steps
    return float(tried[place] + vertex * (tried[1] - tried[0]))


def _delayed(t: Array, late: Array) -> Array:
    """1, s, s^2, s^3 of the time s since each of `late`, 0 before, shape (k, 4, n)."""
    since = np.maximum(t - late[:, None], 0.0)
    return np.stack([np.where(t >= late[:, None], 1.0, 0.0), since, since * since, since * since * since], axis=1)


def _filtered(t: Array, constant: Array) -> Array:
    """1, t, t^2, t^3 from t = 0, filtered by first-order filters of each time constant, shape (k, 4, n).

    A constant of 0 or below is a delay.
    """
    early = constant <= 0
    tau = np.where(early, 1.0, constant)[:, None]
    since = np.maximum(t, 0.0)
    found = [1 - np.exp(-since / tau)]
    for n in range(1, ORDER + 1):
        found.append(since**n - n * tau * found[-1])
    columns = np.stack(found, axis=1)
    columns[early] = _delayed(t, constant[early])
    return columns


def _left(windows: Sequence[tuple[Array, Array]], of: Callable[[Array, Array], Array], tried: Array) -> Array:
    """Residual sum of squares for each of `tried` [square of what pulls], shape (k,)."""
    every = [left_by(np.stack([np.ones_like(t), t]), of(t, tried), y) for t, y in windows]
    return np.asarray(np.sum(every, axis=0))


def _best(
    windows: Sequence[tuple[Array, Array]], reach: float, of: Callable[[Array, Array], Array]
) -> tuple[Behind, float, float]:
    """Best delay of one form, its residual sum of squares [square of what pulls], and the variance per sample."""
    tried = np.linspace(-reach, reach, 2 * TRIED - 1)
    left = _left(windows, of, tried)
    least = float(left.min())
    freedom = max(1, sum(len(t) for t, _ in windows) - len(windows) * (ORDER + 3) - 1)
    variance = least / freedom
    best = tried[left <= least * (1 + ALIKE)]
    period = max(float(np.median(np.diff(t))) for t, _ in windows)
    apart = min(2 * TRIED - 1, 1 + 2 * reach / period)
    sure = float(student.ppf(1 - 0.025 / apart, freedom))
    held = tried[left <= least * (1 + ALIKE) + sure**2 * variance]
    time, step = 0.5 * float(best[0] + best[-1]), float(tried[1] - tried[0])
    half = max(time - float(held[0]), float(held[-1]) - time) + step
    return Behind(time, min(half, reach), bool(-reach < best[0] and best[-1] < reach)), least, variance
