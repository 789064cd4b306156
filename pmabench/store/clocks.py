"""Offset and drift of a device's clock against the host's, from when its samples came in; pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pmabench.store.records import Array, ClockInfo

PRIOR_DRIFT = 100e-6
"""A quartz clock is not farther off than this [1]: what holds where the arrivals do not show drift better."""
WINDOWS = 10
"""Stretches of time whose shortest delays are held against the fit."""


def fit_clock(device_ns: Sequence[int], host_ns: Sequence[int]) -> ClockInfo:
    """The clock of a device from pairs of its own time and the host's time of arrival [ns].

    A delay is never negative, so the line lies below all points and as close to them as it can: that of least mean
    delay, an edge of the lower convex hull (Moon, Skelly, Towsley: Estimation and removal of clock skew from network
    delay measurements, INFOCOM 1999; hull: Zhang, Liu, Xia, INFOCOM 2002). The uncertainty comes from the shortest
    delays in each of `WINDOWS` stretches: how far they lie above the line, and how far apart the shortest two are. A
    delay that is the same for all samples cannot be seen from here and stays in the offset.
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
    """The clock of a stream that the computer itself stamps, halfway between question and answer [ns].

    It is the time of the run. When in a poll the device measured is not known, so the mean time from stamp to arrival,
    half of a poll, bounds the mean error.
    """
    late = np.asarray(host_ns, dtype=np.int64) - np.asarray(device_ns, dtype=np.int64)
    return ClockInfo(uncertainty=float(np.mean(np.maximum(late, 0))) / 1e9, how="stamped by the computer")


def _below(x: Array, delay: Array) -> tuple[float, float]:
    """Slope and value at 0 of the line below all points whose mean distance to them is least; shapes (n,)."""
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
    """Of each stretch of time with points: the shortest delay, and how much longer the next is; shape (m, 2)."""
    edges = np.linspace(float(x.min()), float(x.max()), WINDOWS + 1)[1:-1]
    which = np.searchsorted(edges, x)
    found = []
    for number in range(WINDOWS):
        inside = np.sort(delay[which == number])
        if len(inside) > 1:
            found.append((inside[0], inside[1] - inside[0]))
    return np.array(found).reshape(-1, 2)
