"""Which channel moves first at a step of pressure: a muscle that moves before its pressure has late stamps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pmabench.store.importers import motion
from pmabench.store.importers.found import Found
from pmabench.store.records import Array, Flag, Flags

SHARE = 0.1
"""A step is at least so large a share of the pressure's span."""
FAST = 0.5
"""A step is over in this time [s]; at the turns of a slow wave nothing is reported."""
BEFORE, AFTER = 0.5, 0.5
"""Looked at around a step [s]."""
REST = 0.15
"""The last so many seconds before the step are no rest: the motion may have begun."""
GONE, NOISE = 0.05, 5.0
"""A channel moves once it has left its rest by this share of its way and so many standard deviations."""
FEWEST = 5


def pressure_late(t: Array, values: Mapping[str, Array], flags: Flags) -> Found | None:
    """A doubt where displacement moves at least a sample before the measured pressure, at any step.

    `t` [s], `values` [SI] by channel and `flags` have shape (n,). Polled channels are older than their stamps by
    different times; then a delay comes out too short, or negative.
    """
    good = (flags & np.uint16(Flag.DROPOUT | Flag.TIME_JUMP | Flag.SUSPECT | Flag.OVERRANGE)) == 0
    good &= motion.later(t)
    pressure = values["pressure"][good]
    if good.sum() < 50 or "displacement" not in values:
        return None
    low, high = (float(end) for end in np.quantile(pressure, [0.005, 0.995]))
    rows, times = np.flatnonzero(good), t[good]
    worst: tuple[float, int] | None = None
    for step in motion.levels(times, pressure, SHARE * (high - low)) if high > low else []:
        if step.settled - step.t > FAST:
            continue
        first = _moves(times, values["displacement"][good], step.t)
        lead = 0.0 if first is None else step.t - float(times[first])
        if first is not None and lead >= step.within and (worst is None or lead > worst[0]):
            worst = (lead, int(rows[first]))
    if worst is None:
        return None
    lead, row = worst
    text = (
        f"pressure: displacement moves {lead * 1e3:.3g} ms before it at {float(t[row]):.3f} s: pressure is late, as "
        'where channels are polled one after the other; say "late_by"'
    )
    return Found("doubt", "late", text, "pressure", 1, row, float(t[row]))


def _moves(t: Array, values: Array, step: float) -> int | None:
    """The first sample at which a channel has left its rest before a step; None where it does not."""
    rest = (t > step - BEFORE) & (t < step - REST)
    then = (t > step + AFTER) & (t < step + 2 * AFTER)
    if rest.sum() < FEWEST or then.sum() < FEWEST:
        return None
    level, scatter = float(np.median(values[rest])), float(np.std(values[rest]))
    way = float(np.median(values[then])) - level
    if abs(way) < 2 * NOISE * scatter or way == 0:
        return None
    gone = (values - level) * np.sign(way) > max(GONE * abs(way), NOISE * scatter)
    near = np.flatnonzero(gone & (t >= step - REST) & (t < step + AFTER))
    return int(near[0]) if len(near) else None
