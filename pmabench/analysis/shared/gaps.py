"""Missing samples: what a signal may have done meanwhile, and when it may have passed a level.

Uses arrays only; knows no channel and no kind of test.
"""

from __future__ import annotations

from math import inf

import numpy as np

from pmabench.analysis.shared.samples import noise_of
from pmabench.store.records import Array

GAP = 3.0
"""Time between samples, over the usual one, from which on samples are missing."""
SLOPE, PART = 3, 8
"""Fewest samples for the slope next to a gap; they last one part in so many of it, so that noise matters little."""
RISES = 3.0
"""Standard errors from which on a signal rises after a gap."""
UNSEEN = "samples are missing where it may lie: measure again without gaps"


def highest(t: Array, y: Array, period: float, since: int) -> Array:
    """Highest value that `y` may have had between each sample and the one before, shape (n,); -inf without a gap.

    From the sample `since` on a motion slows down, turns and comes back, so it stays below the lines with the slopes
    before and after the gap; only the one before where the record ends too soon for the other. A gap across that sample
    hides all: inf, unless `y` still rises after it. `period`: usual time between samples [s].
    """
    found = np.full(len(t), -inf)
    for k in np.flatnonzero(np.diff(t) > GAP * period):
        size = max(SLOPE, round((t[k + 1] - t[k]) / (PART * period)))
        after = slice(k + 1, k + 2 + size)
        if k + 1 < since:
            continue
        ends = len(t[after]) <= SLOPE
        down = -inf if ends else float(np.polyfit(t[after] - t[k], y[after], 1)[0])
        found[k + 1] = max(y[k], y[k + 1])
        if k < since:
            spread = float(np.sqrt(np.sum((t[after] - t[after].mean()) ** 2)))
            found[k + 1] = found[k + 1] if down * spread > RISES * noise_of(y) else inf
            continue
        before = slice(max(0, k - size), k + 1)
        up = float(np.polyfit(t[before] - t[k], y[before], 1)[0]) if k else 0.0
        if up > 0 > down:
            turned = t[k + 1] - t[k]
            if not ends:
                turned = (y[k + 1] - y[k] - down * turned) / (up - down)
            found[k + 1] = max(found[k + 1], y[k] + up * max(turned, 0.0))
    return found


def reached(t: Array, y: Array, top: Array, level: float, period: float) -> tuple[float, float, float]:
    """Earliest, likely and latest time [s] at which `y` first reaches a level, which it does.

    The motion starts from 0 at t = 0; `top` is `highest` of it. Without a gap there all three are the first sample.
    """
    before = np.append(0.0, t[:-1])
    first, early = (int(np.argmax(course >= level)) for course in (y, np.maximum(y, top)))
    begin, likely = (float(before[k] if t[k] - before[k] > GAP * period else t[k]) for k in (early, first))
    lower = float(y[first - 1]) if first else 0.0
    if likely < t[first] and lower < level:
        likely += float((t[first] - likely) * (level - lower) / (y[first] - lower))
    return begin, likely, float(t[first])
