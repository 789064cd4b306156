"""Channels that stop telling: frozen while others move, or clipped at the end of their range; pure functions of arrays.

A channel that always scatters and then repeats one value exactly is frozen. One that rests on whole counts is frozen
only where it should have moved, by what it does elsewhere at the same pressures.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers.effect import slope
from pmabench.store.importers.found import Bools, Checked, Report
from pmabench.store.records import Array, Flag

SCATTERS = 0.3
"""A channel of which less than this share of samples repeats the one before scatters always."""
SAMPLES, LONGER = 25, 10.0
"""It is frozen where it repeats one value for so many samples, and so many times longer than it does otherwise."""
SECONDS = 0.1
"""Shorter than this [s] nothing is called frozen."""
SLOW = 0.5
"""The same [s] for a channel that rests on counts: friction holds what follows slowly."""
SHOULD = 0.25
"""Share of its span by which a channel that rests on counts should have moved meanwhile."""
LEAP = 0.05
"""The same where it then leaps to where it should be."""
BINS = 40
"""Classes of pressure by which the usual reading is known."""
LOOKED_AT = 200
"""Longest stretches that are looked at."""
CLIPPED = 10
"""Samples at the very end of what a channel reads, from which on it may be clipped."""
PILED = 0.04
"""Share of its span by which a channel should have gone on beyond the end."""


def usual(pressure: Array, other: Array) -> tuple[Array, Array]:
    """What a channel usually reads at a pressure: middles of classes and medians, both shape (k,), k <= 40."""
    low, high = float(pressure.min()), float(pressure.max())
    place = np.minimum((BINS * (pressure - low) / ((high - low) or 1.0)).astype(np.intp), BINS - 1)
    order = np.argsort(place, kind="stable")
    cuts = np.searchsorted(place[order], np.arange(BINS + 1))
    at, reads = [], []
    for begin, end in pairwise(cuts.tolist()):
        if end > begin:
            rows = order[begin:end]
            at.append(float(np.median(pressure[rows])))
            reads.append(float(np.median(other[rows])))
    return np.array(at), np.array(reads)


def frozen(report: Report, channel: Checked, other: Checked, good: Bools, follows: bool) -> None:
    """Flag the samples, of those that are `good`, shape (n,), in which a channel repeats itself while `other` moves.

    `follows`: one of the two follows the other at once, so that it is known what a channel should read.
    """
    rows = np.flatnonzero(good)
    role = channel.rule.role
    if len(rows) < 4 * SAMPLES:
        return
    t, raw, si, ref = report.t[rows], channel.raw[rows], channel.si[rows], other.si[rows]
    changes = np.flatnonzero(np.diff(raw) != 0) + 1
    begins, ends = np.concatenate([[0], changes]), np.concatenate([changes, [len(raw)]])
    lengths = ends - begins
    if len(changes) < 10:
        return
    seconds = t[ends - 1] - t[begins]
    scatters = 1.0 - len(changes) / len(raw) < SCATTERS
    longest = max(SAMPLES, LONGER * float(np.quantile(lengths, 0.99)))
    pause = 5.0 * float(np.median(np.diff(t[changes])))
    likely = np.flatnonzero((seconds > max(SECONDS, pause)) & (lengths >= CLIPPED))
    likely = likely[np.argsort(-lengths[likely], kind="stable")][:LOOKED_AT]
    low, high = float(si.min()), float(si.max())
    where = np.zeros(len(good), dtype=bool)
    moved = 0.0
    for run in likely.tolist():
        begin, end = int(begins[run]), int(ends[run])
        sure = scatters and lengths[run] >= longest and si[begin] not in (low, high, 0.0)
        if sure or (follows and seconds[run] > SLOW and _should_move(si, ref, begin, end)):
            where[rows[begin:end]] = True
            moved = max(moved, float(np.ptp(ref[begin:end])))
    if where.any():
        longest_time = float(seconds[likely].max())
        by = show(moved, other.rule.quantity, 3)
        text = f"repeats one reading exactly for up to {longest_time:.3g} s while {other.rule.role} moves by {by}"
        report.mark(where, Flag.STALE, "doubt", "frozen", f"{text}: it was frozen", role)


def _should_move(si: Array, ref: Array, begin: int, end: int) -> bool:
    """Whether a channel moves elsewhere at the values that `ref` goes through from `begin` to `end`."""
    rest = np.ones(len(si), dtype=bool)
    rest[begin:end] = False
    if rest.sum() < 2 * BINS or np.ptp(ref[begin:end]) <= 0.02 * np.ptp(ref):
        return False
    at, reads = usual(ref[rest], si[rest])
    expected = np.interp(ref[begin:end], at, reads)
    span = float(np.ptp(np.quantile(si, [0.002, 0.998])))
    should = float(np.ptp(np.quantile(expected, [0.025, 0.975])))
    if should > SHOULD * span:
        return True
    after, before = si[end : end + 3], si[max(0, begin - 3) : begin]
    if len(after) == 0 or should <= LEAP * span:
        return False
    leap = float(abs(np.median(after) - si[begin]))
    steps = np.abs(np.diff(si[rest]))
    nearby = max(float(np.quantile(steps, 0.995)), float(abs(si[begin] - before[-1])) if len(before) else 0.0)
    return leap > max(0.5 * should, LEAP * span, 3.0 * nearby)


def clipped(report: Report, channel: Checked, other: Checked, good: Bools) -> None:
    """Flag samples that stay at the very top of what a channel reads while `other` goes on."""
    rows = np.flatnonzero(good)
    if len(rows) < 4 * SAMPLES:
        return
    raw, si, ref = channel.raw[rows], channel.si[rows], other.si[rows]
    top = float(si.max())
    at_top = si == top
    below = ~at_top
    if at_top.sum() < CLIPPED or below.sum() < 4 * SAMPLES or len(np.unique(raw[:10_000])) < 5:
        return
    run = np.diff(np.flatnonzero(np.diff(np.concatenate([[False], at_top, [False]]).astype(np.int8))))[::2].max()
    span, moves = float(top - np.quantile(si, 0.002)), float(np.ptp(np.quantile(ref[at_top], [0.02, 0.98])))
    if run < CLIPPED or span <= 0 or moves <= 0.05 * float(np.ptp(ref)):
        return
    near = below & (si > top - 0.15 * span)
    if near.sum() < SAMPLES:
        near = below & (si > top - 0.4 * span)
    if near.sum() < SAMPLES or np.ptp(ref[near]) == 0:
        return
    onward = (slope(ref[near], si[near]) or 0.0) * moves
    marks = np.unique(si)
    if onward <= max(PILED * span, 3.0 * float(np.diff(marks[-3:]).max())):
        return
    where = np.zeros(len(good), dtype=bool)
    where[rows[at_top]] = True
    end, by = show(top, channel.rule.quantity, 4), show(moves, other.rule.quantity, 3)
    text = f"stays at its highest reading, {end}, while {other.rule.role} moves by {by}: it is clipped, or at a stop"
    report.mark(where, Flag.OVERRANGE, "doubt", "clipped", text, channel.rule.role)
