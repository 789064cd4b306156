"""Puts the channels of one stream on the times of another; fills no hole, and flags where there is none to give."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pmabench.store.records import UNUSABLE, Array, Flag, Flags

REACH = 1.5
"""Neighbours farther apart than so many periods of their stream have a hole between them."""
_SAME = 1e-9
"""Times closer than this [s] are the same."""


def onto(
    t: Array, flags: Flags, other_t: Array, other_flags: Flags, channels: Mapping[str, Array], rate: float
) -> tuple[dict[str, Array], Flags, str]:
    """`channels` of a stream with times `other_t` [s] and `rate` [Hz, 0: none], at the times `t` [s] of `flags`.

    Streams with the same times are taken as they are, with the flags of both. Else values are interpolated linearly
    between two neighbours that can be used and are closer than REACH periods; elsewhere they are NaN and the sample is
    flagged GAP. Returns channels and flags, both of the length of `t`, and what was done (empty: nothing).
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
    moved = {}
    for name, values in channels.items():
        given = values[usable]
        moved[name] = np.where(reached, given[left] + share * (given[right] - given[left]), np.nan)
    told = np.where(reached, kept_flags[left] | kept_flags[right], np.uint16(Flag.GAP)).astype(np.uint16)
    return moved, flags | told, "interpolated from"
