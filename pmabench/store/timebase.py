"""Times of samples: clocks of device and host, streams on one time base, regularity of the sampling.

Pure functions. Interpolation does not bridge gaps: where another stream has no value near a time, the sample is
flagged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import UNUSABLE, Array, ClockInfo, Flag, Flags, TrialData

REACH = 1.5
"""Longest interval between neighbours without a gap [periods of the stream]."""
_SAME = 1e-9
"""Times closer than this [s] count as equal."""


def onto(
    t: Array, flags: Flags, other_t: Array, other_flags: Flags, channels: Mapping[str, Array], rate: float
) -> tuple[dict[str, Array], Flags, str]:
    """`channels` of a stream with times `other_t` [s] and `rate` [Hz, 0: irregular], interpolated to the times `t` [s].

    Streams with equal times are combined unchanged, with the flags of both. Otherwise values are interpolated between
    two usable neighbours less than REACH periods apart, by a monotone cubic with one-sided slopes next to a gap;
    elsewhere they are NaN and the sample is flagged GAP. Returns channels and flags, both of the length of `t`, and a
    phrase that states what was done (empty: nothing).
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
    """Slopes at both ends of the intervals from `left` to `right`, for a cubic that is monotone between samples.

    `steps` [s] between the samples, inf over a gap. Fritsch, Butland: A method for constructing local monotone
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


PRIOR_DRIFT = 100e-6
"""Largest drift of a quartz clock [1], used where the arrivals do not determine the drift better."""
WINDOWS = 10
"""Number of time windows whose shortest delays are compared with the fit."""


def fit_clock(device_ns: Sequence[int], host_ns: Sequence[int]) -> ClockInfo:
    """The clock of a device from pairs of the device's time and the host's time of arrival [ns].

    A delay is never negative, so the line is below all points, with the least mean delay: an edge of the lower convex
    hull (Moon, Skelly, Towsley: Estimation and removal of clock skew from network delay measurements, INFOCOM 1999;
    hull: Zhang, Liu, Xia, INFOCOM 2002). The uncertainty comes from the shortest delays in each of `WINDOWS` time
    windows: their distance above the line, and the difference of the shortest two. A constant delay cannot be observed
    and stays in the offset.
    """
    device, host = np.asarray(device_ns, dtype=np.int64), np.asarray(host_ns, dtype=np.int64)
    middle = int(device[0]) + int(np.int64(device[-1]) - device[0]) // 2
    x = (device - middle) / 1e9
    y = host / 1e9
    span = float(x.max() - x.min())
    drift, at = _below(x, y - x)
    low = _shortest(x, y - x - at - drift * x)
    spread = float(np.max(low[:, 0]) + np.mean(low[:, 1])) if len(low) else 0.0
    unsure = 4.0 * spread / span if span > 0 and len(low) >= WINDOWS // 2 else np.inf
    if unsure > PRIOR_DRIFT and abs(drift) <= unsure:
        drift, at = 0.0, float(np.min(y - x))
        spread = float(np.ptp(np.sort(y - x)[: max(2, len(x) // 10)])) + PRIOR_DRIFT * span
    return ClockInfo(middle, at, drift, spread, "host arrivals")


def stamped(device_ns: Sequence[int], host_ns: Sequence[int]) -> ClockInfo:
    """The clock of a stream that the computer stamps itself, halfway between request and answer [ns].

    It is the time of the run. The time of measurement within a poll is unknown, so the mean time from stamp to arrival,
    half a poll, bounds the mean error.
    """
    late = np.asarray(host_ns, dtype=np.int64) - np.asarray(device_ns, dtype=np.int64)
    return ClockInfo(uncertainty=float(np.mean(np.maximum(late, 0))) / 1e9, how="stamped by the computer")


def _below(x: Array, delay: Array) -> tuple[float, float]:
    """Slope and value at 0 of the line below all points with the least mean distance; `x`, `delay`: shape (n,)."""
    order = np.lexsort((delay, x))
    hull: list[tuple[float, float]] = []
    for point in zip(x[order].tolist(), delay[order].tolist(), strict=True):
        if hull and hull[-1][0] == point[0]:
            continue  # a higher point at the same time
        while len(hull) > 1 and _turn(hull[-2], hull[-1], point) <= 0:
            hull.pop()
        hull.append(point)
    mean = float(np.mean(x))
    for (x0, d0), (x1, d1) in pairwise(hull):
        if x0 <= mean <= x1:
            slope = (d1 - d0) / (x1 - x0)
            return slope, d0 - slope * x0
    return 0.0, min(d for _, d in hull)


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _shortest(x: Array, delay: Array) -> Array:
    """Shortest delay of each window with at least two points, and how much longer the next is; shape (m, 2)."""
    which = np.searchsorted(np.linspace(float(x.min()), float(x.max()), WINDOWS + 1)[1:-1], x)
    windows = (np.sort(delay[which == number]) for number in range(WINDOWS))
    return np.array([(inside[0], inside[1] - inside[0]) for inside in windows if len(inside) > 1]).reshape(-1, 2)


@dataclass(frozen=True)
class Sampling:
    """Regularity of a run's sampling: statistics of the intervals between samples of all trials."""

    rows: int
    rate: float
    """Number of intervals divided by their total duration [Hz]."""
    interval: float
    """Median interval [s]."""
    jitter: float
    """Rms deviation from the median, of intervals without missing samples [s]."""
    longest: float
    """Longest interval [s]."""
    late: int
    """Number of samples that were taken late."""
    gaps: int
    """Number of samples before which others are missing."""


def sampling(trials: Sequence[TrialData]) -> Sampling | None:
    """Rate, jitter and gaps over all trials; None where no trial has two samples."""
    trials = [trial for trial in trials if len(trial.t) > 1]
    if not trials:
        return None
    steps = np.concatenate([np.diff(trial.t) for trial in trials])
    flags = np.concatenate([trial.flags[1:] for trial in trials])
    whole = steps[(flags & np.uint16(Flag.GAP)) == 0]
    middle = float(np.median(steps))
    return Sampling(
        rows=sum(len(trial.t) for trial in trials),
        rate=len(steps) / float(steps.sum()),
        interval=middle,
        jitter=float(np.sqrt(np.mean((whole - middle) ** 2))) if len(whole) else 0.0,
        longest=float(steps.max()),
        late=int(np.count_nonzero(flags & np.uint16(Flag.LATE))),
        gaps=int(np.count_nonzero(flags & np.uint16(Flag.GAP))),
    )
