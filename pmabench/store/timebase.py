"""Puts the channels of one stream on the times of another; fills no hole, and flags where there is none to give."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import UNUSABLE, Array, Flag, Flags

REACH = 1.5
"""Neighbours farther apart than so many periods of their stream have a hole between them."""
_SAME = 1e-9
"""Times closer than this [s] are the same."""


def onto(
    t: Array, flags: Flags, other_t: Array, other_flags: Flags, channels: Mapping[str, Array], rate: float
) -> tuple[dict[str, Array], Flags, str]:
    """`channels` of a stream with times `other_t` [s] and `rate` [Hz, 0: none], at the times `t` [s] of `flags`.

    Streams with the same times are taken as they are, with the flags of both. Else values are interpolated between two
    neighbours that can be used and are closer than REACH periods, by a cubic that stays between their values and is
    straight where a neighbour's neighbour is missing; elsewhere they are NaN and the sample is flagged GAP. Returns
    channels and flags, both of the length of `t`, and what was done (empty: nothing).
    """
    if np.array_equal(t, other_t):
        return dict(channels), flags | other_flags, ""
    usable = (other_flags & np.uint16(UNUSABLE)) == 0
    usable &= other_t > np.maximum.accumulate(np.concatenate(([-np.inf], other_t)))[:-1]
    kept, kept_flags = other_t[usable], other_flags[usable]
    if not len(kept):
        none = {name: np.full(len(t), np.nan) for name in channels}
        return none, flags | np.uint16(Flag.GAP), "missing everywhere in"
    period = 1.0 / rate if rate > 0 else float(np.median(np.diff(kept))) if len(kept) > 1 else 0.0
    right = np.clip(np.searchsorted(kept, t - _SAME), 0, len(kept) - 1)
    left = np.where((right > 0) & (kept[right] > t + _SAME), right - 1, right)
    width = kept[right] - kept[left]
    reached = np.where(left == right, np.abs(kept[right] - t) <= _SAME, width <= REACH * period)
    share = np.where(width > 0, (t - kept[left]) / np.where(width > 0, width, 1.0), 0.0)
    steps = np.diff(kept)
    joined = np.where(steps <= REACH * period, steps, np.inf)
    moved = {}
    for name, values in channels.items():
        given = values[usable]
        rise, begin, end = given[right] - given[left], *(width * slope for slope in _slopes(joined, given, left, right))
        bent = share * (1 - share) * ((1 - share) * (begin - rise) - share * (end - rise))
        moved[name] = np.where(reached, given[left] + share * rise + bent, np.nan)
    found = np.where(reached, kept_flags[left] | kept_flags[right], np.uint16(Flag.GAP)).astype(np.uint16)
    return moved, flags | found, "interpolated from"


def _slopes(steps: Array, values: Array, left: NDArray[np.intp], right: NDArray[np.intp]) -> tuple[Array, Array]:
    """Slopes at both ends of the stretches from `left` to `right`, so that the cubic is monotone between samples.

    `steps` [s] between the samples, inf over a hole. Fritsch, Butland: A method for constructing local monotone
    piecewise cubic interpolants, SIAM J. Sci. Stat. Comput. 5 (1984), 300-304.
    """
    slope = np.where(np.isfinite(steps), np.diff(values) / steps, np.nan)
    before, after = np.append(np.nan, slope), np.append(slope, np.nan)
    wide, broad = np.append(np.nan, steps), np.append(steps, np.nan)
    first, second = 2 * broad + wide, broad + 2 * wide
    same_way = before * after > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (first + second) / (first / before + second / after)
    inner = np.where(same_way, mean, 0.0)
    at_left = np.where(np.isnan(before), after, inner)[left]
    at_right = np.where(np.isnan(after), before, inner)[right]
    return np.nan_to_num(at_left), np.nan_to_num(at_right)
