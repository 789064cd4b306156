"""Finds spikes: single samples that differ from all their neighbours much more than others in the channel."""

from __future__ import annotations

from math import sqrt

import numpy as np

from pmabench.store.records import Array

MANY = 0.1
"""Largest share of samples that may be spikes or bursts; anything more frequent is signal."""
FEW = 50
"""Least number of samples to distinguish spikes from scatter."""
AROUND = 12
"""Number of neighbours on either side with which a sample is compared ..."""
ALONE = 3
"""... without those nearer than this, since a spike may be three samples long."""
SPIKE = 4.0
"""A spike is this many times further out than all but the most scattered samples."""
SMALLEST = 0.02
"""Smallest spike, as a share of the channel's span."""
SCATTERED = 0.005
"""Share of samples that count as the most scattered; at least six samples."""
ENDS = (SCATTERED, 1.0 - SCATTERED)
RARE = 6.5
"""Smallest spike, in standard deviations of the noise."""
ENOUGH = 100_000
"""Number of samples that suffices for statistics of a channel."""


def beyond_neighbours(values: Array, swings: bool = True) -> Array:
    """Isolated deviation of each value, shape (n,): the smaller of two distances, at least 0.

    The distances are those beyond all neighbours from the 3rd to the 12th on either side, and from the running median
    of seven, which three outliers do not move. For channels with overshoot (`swings`; commands have none) the
    difference of the levels before and after is subtracted, since overshoot after a step is not a spike. Steps, ramps
    and waves give values near 0. At the ends, with neighbours on one side only, their range is subtracted.
    """
    low, high = _extremes(values)
    beyond = np.fmax(values - high, low - values)
    out = np.zeros(len(values))
    padded = np.pad(values, AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
    outside = np.flatnonzero(beyond > 0)  # all others are within the range of their neighbours: 0
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
    """Lowest and highest neighbour of each value, from the 3rd to the 12th on either side; shape (n,) each."""
    wide, ends = AROUND - ALONE + 1, []
    for least, nothing in ((np.fmin, np.inf), (np.fmax, -np.inf)):
        run = np.pad(values, AROUND, constant_values=nothing)
        done = 1
        while done < wide:  # extreme of a longer window from that of shorter ones
            more = min(done, wide - done)
            run, done = least(run[:-more], run[more:]), done + more
        ends.append(least(run[: len(values)], run[AROUND + ALONE :][: len(values)]))
    return ends[0], ends[1]


def spike_limit(values: Array, apart: Array) -> float:
    """Deviation above which a sample is a spike: far beyond scatter, resolution and 2 % of the channel's span.

    Frequent spikes could be taken for scatter. A gap reveals them: the largest deviations are `SPIKE` times larger than
    all that follow.
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
    """About `ENOUGH` of the values, evenly spread, for fast quantiles."""
    return values[:: 1 + len(values) // ENOUGH]


def resolution(values: Array) -> float:
    """The smallest difference between two different readings among the first `ENOUGH`; 0 if all are equal."""
    marks = np.unique(values[:ENOUGH])
    return float(np.diff(marks).min()) if len(marks) > 1 else 0.0
