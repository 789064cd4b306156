"""How far what pulls comes behind what is moved, by the moments at which both turn.

Hysteresis and damping change the force at the moment at which the motion turns, however slowly its branches go over
into each other. A filter of the force cell, another clock or backlash of the displacement sensor part the two moments;
on the branches each of them looks like hysteresis or damping.

Knows samples and moments; no test.
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
"""Samples that are needed on either side of a turn."""
TRIED = 41
"""Delays that are tried either way, with none."""
REACH = 0.6
"""Longest delay that is tried, as a share of the time that is looked at on either side of a turn."""
REACHED = 0.8
"""A longer share of that is looked for over twice the time."""
WIDER = 3.0
"""The motion may turn so many of these times before or after its command."""
ORDER = 3
ALIKE = 1e-9
"""Sums of squares that differ by less than this share of theirs are the same: delays between the same two samples."""
OF_FILTER = 4.0
"""Time constants of a filter that are looked at on either side of a turn."""
SURE = 4.0
"""A filter is taken for a delay that leaves so many standard deviations more."""


@dataclass(frozen=True)
class Behind:
    """Time by which the force comes behind the motion [s], its half width, whether it lies within what was tried."""

    time: float
    half: float
    within: bool


def behind(t: Array, moved: Array, pulls: Array, turns: Sequence[float], span: float) -> Behind | None:
    """The time by which `pulls` is behind `moved`; None where too few samples show a turn.

    `t`, `moved`, `pulls` have shape (n,), `turns` are the commanded ones [s]. Half of `span` [s] before and after each
    turn is looked at: before it a straight line, after it a polynomial of third order from a jump on, late by a delay
    or through a filter of first order. What the whole of `span` gives says how much that form matters; a time that half
    of it hardly reaches is looked for in the whole of it and in twice that. The interval is that of the
    profile likelihood, by Student's t for as many delays as there are samples to tell them apart: what is left jumps
    from sample to sample, and its curvature says nothing.
    """
    near, wide = (_of_turns(t, moved, pulls, turns, share * span) for share in (0.5, 1.0))
    if wide is not None and abs(wide.time) > REACHED * REACH * 0.5 * span:
        near, wide = wide, _of_turns(t, moved, pulls, turns, 2 * span) or wide
    if near is None or wide is None:
        return wide
    return replace(near, half=float(np.hypot(near.half, abs(near.time - wide.time))))


def through_filter(t: Array, moved: Array, pulls: Array, turns: Sequence[float], constant: float) -> bool:
    """Whether `pulls` comes through a filter of first order with a time `constant` [s], as far as its turns show."""
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
    """Times from the turn of the motion on [s], and what pulls."""
    wide = _about(t, turn, WIDER * span)
    begin = None if wide is None else corner(t[wide] - turn, moved[wide])
    near = None if begin is None else _about(t, turn + begin, span)
    return None if near is None or begin is None else (t[near] - turn - begin, pulls[near])


def _about(t: Array, moment: float, span: float) -> NDArray[np.intp] | None:
    rows = np.flatnonzero(np.abs(t - moment) <= span)
    before = int(np.count_nonzero(t[rows] < moment))
    return rows if min(before, len(rows) - before) >= FEWEST else None


def corner(t: Array, y: Array) -> float | None:
    """When y(t) goes over from one straight line to another [s], shape (n,) each; None where that is at an end."""
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
    """1, t, t2, t3 from each of `late` on, shape (k, 4, n)."""
    since = np.maximum(t - late[:, None], 0.0)
    return np.stack([np.where(t >= late[:, None], 1.0, 0.0), since, since * since, since * since * since], axis=1)


def _filtered(t: Array, constant: Array) -> Array:
    """1, t, t2, t3 from 0 on through a filter of first order with each time constant, shape (k, 4, n).

    A constant that is not above 0 is a delay.
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
    """What each time that is `tried` leaves [square of what pulls], shape (k,)."""
    every = [left_by(np.stack([np.ones_like(t), t]), of(t, tried), y) for t, y in windows]
    return np.asarray(np.sum(every, axis=0))


def _best(
    windows: Sequence[tuple[Array, Array]], reach: float, of: Callable[[Array, Array], Array]
) -> tuple[Behind, float, float]:
    """The best of one way to be late; what it leaves [square of what pulls], and the variance of that by sample."""
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
