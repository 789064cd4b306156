"""Single samples that stand out from all their neighbours as nothing else in a channel does."""

from __future__ import annotations

from math import sqrt

import numpy as np

from pmabench.store.records import Array

MANY = 0.1
"""Share of the samples that may be spikes or bursts; what is more frequent is the signal."""
FEW = 50
"""With fewer samples scatter cannot be distinguished from spikes."""
AROUND = 12
"""Neighbours on either side with which a spike is compared ..."""
ALONE = 3
"""... without those nearer than this, since a spike may be three samples long."""
SPIKE = 4.0
"""A spike lies so many times further out than all but the most scattered samples."""
SMALLEST = 0.02
"""Share of the span of a channel below which nothing is a spike."""
SCATTERED = 0.005
"""Share of the samples that are the most scattered; at least six."""
ENDS = (SCATTERED, 1.0 - SCATTERED)
RARE = 6.5
"""Standard deviations of the noise from sample to sample within which nothing is a spike."""
ENOUGH = 100_000
"""Samples that show in which steps a channel reads."""


def beyond_neighbours(values: Array, swings: bool = True) -> Array:
    """How far each value stands out alone, shape (n,): the lesser of two distances, none below 0.

    Beyond all of its neighbours, the 3rd to the 12th on either side; from the running median of seven, which three in
    a row do not move. Of what `swings`, as no command does, the difference of the levels before and after is taken off,
    since what swings over after a step is no spike. Steps, ramps and waves stay near 0. At the ends, where neighbours
    are on one side only, so much is taken off as these move.
    """
    low, high = _extremes(values)
    beyond = np.fmax(values - high, low - values)
    out = np.zeros(len(values))
    padded = np.pad(values, AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
    outside = np.flatnonzero(beyond > 0)  # all others lie among their neighbours: 0
    for begin in range(0, len(outside), 100_000):
        rows = outside[begin : begin + 100_000]
        around = windows[rows]
        near = around[:, AROUND - ALONE : AROUND + ALONE + 1]
        median = np.partition(near, ALONE, axis=1)[:, ALONE]
        cut = np.isnan(near).any(axis=1)
        median[cut] = np.nanmedian(near[cut], axis=1)
        before = np.median(around[:, AROUND - ALONE - 2 : AROUND - ALONE + 1], axis=1)
        after = np.median(around[:, AROUND + ALONE : AROUND + ALONE + 3], axis=1)
        end = np.isnan(before - after)
        step = np.where(end, high[rows] - low[rows], np.abs(before - after))
        off = step if swings else np.where(end, step, 0.0)
        out[rows] = np.minimum(beyond[rows], np.abs(values[rows] - median)) - off
    return np.maximum(out, 0.0)


def _extremes(values: Array) -> tuple[Array, Array]:
    """The lowest and the highest of the neighbours of each value, the 3rd to the 12th on either side."""
    wide, ends = AROUND - ALONE + 1, []
    for least, nothing in ((np.fmin, np.inf), (np.fmax, -np.inf)):
        run = np.pad(values, AROUND, constant_values=nothing)
        done = 1
        while done < wide:  # the extreme of so many values in a row, from that of fewer
            more = min(done, wide - done)
            run, done = least(run[:-more], run[more:]), done + more
        ends.append(least(run[: len(values)], run[AROUND + ALONE :][: len(values)]))
    return ends[0], ends[1]


def spike_limit(values: Array, apart: Array) -> float:
    """Distance from which on a sample counts as a spike: far beyond scatter, resolution and 2 % of the channel's span.

    Frequent spikes would pass for scatter. The gap below them shows them: the largest lie
    `SPIKE` times further out than all that follow.
    """
    most = max(6, int(MANY * len(apart)))
    above = apart[apart > 0]
    top = np.sort(np.partition(above, -most - 1)[-most - 1 :] if len(above) > most else above)[::-1]
    largest = np.zeros(most + 1)
    largest[: len(top)] = top
    count = max(6, int(SCATTERED * len(apart)))
    some = some_of(values)
    fine, few = resolution(values), len(np.unique(some)) <= 20
    low, high = (float(end) for end in np.quantile(some[some_of(apart) <= largest[-1]], ENDS))
    noise = float(np.median(np.abs(np.diff(values[:ENOUGH], n=3)))) / (0.6745 * sqrt(20.0))
    least = max(0.0 if few else SPIKE * fine, SMALLEST * (high - low), RARE * noise)
    least += 1e-9 * float(np.abs(values).max())
    usual = 2.0 * SPIKE * max(fine, float(np.quantile(np.abs(np.diff(values[:ENOUGH])), 0.75)))
    apart_from = np.maximum(largest[count + 1 :], max(least, usual) / SPIKE)
    gaps = count + np.flatnonzero(largest[count:-1] > SPIKE * apart_from)
    last = int(gaps[-1]) + 1 if len(gaps) else count - 1
    return max(SPIKE * float(largest[last]), least)


def some_of(values: Array) -> Array:
    """Some of many values, evenly spread, so that their quantiles cost little."""
    return values[:: 1 + len(values) // ENOUGH]


def resolution(values: Array) -> float:
    """The smallest difference between two different readings among the first `ENOUGH`; 0 if all are equal."""
    marks = np.unique(values[:ENOUGH])
    return float(np.diff(marks).min()) if len(marks) > 1 else 0.0
