"""What a second-order motion does under a pressure that is held between its changes, exactly and in linear time.

The answer to a change is the unit step response of w^2 / (s^2 + 2 D w s + w^2), so the answer at a time is the sum
over all changes before it. Of each pole p that sum is one decaying number, Z(t) = sum of dP_j exp(p (t - t_j)), which
goes on from sample to sample; it is found for all samples by cumulative sums over stretches short enough for exp(p t).
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

REACH = 200.0
"""exp(REACH) is far below the largest number, and its inverse far above the smallest."""
EQUAL = 1e-6
"""Damping ratios closer to 1 than this count as 1 + EQUAL: there the two poles are one, and the sum of them is none."""


def respond(t: Array, at: Array, jumps: Array, w: float, D: float) -> Array:
    """The answer at times `t` [s] to `jumps` at times `at` [s], both rising; shapes (n,), (m,), result (n,).

    `w` is the natural frequency [rad/s], `D` the damping ratio; the unit of the result is that of the jumps.
    """
    before = np.searchsorted(at, t, side="right")
    held = np.concatenate(([0.0], np.cumsum(jumps)))[before]
    if abs(D - 1.0) < EQUAL:
        D = 1.0 + EQUAL
    if D < 1:
        root = sqrt(1 - D * D)
        left = _decaying(t, at, jumps, before, complex(-D * w, w * root))
        return np.asarray(held - left.real - D / root * left.imag)
    root = sqrt(D * D - 1)
    slow, fast = w * (D - root), w * (D + root)
    parts = [_decaying(t, at, jumps, before, complex(-pole)).real for pole in (slow, fast)]
    return np.asarray(held - (fast * parts[0] - slow * parts[1]) / (fast - slow))


def _decaying(t: Array, at: Array, jumps: Array, before: NDArray[np.intp], pole: complex) -> NDArray[np.complex128]:
    """Z(t) = sum of jumps exp(pole (t - at)) over the `before` changes before each time; Re pole < 0."""
    if not len(at):
        return np.zeros(len(t), dtype=np.complex128)
    stretch = REACH / -pole.real
    number = np.floor((at - at[0]) / stretch).astype(np.intp)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    starts = at[first]
    since = np.exp(-pole * (at - np.repeat(starts, np.diff(first, append=len(at)))))
    sums = np.zeros(len(at), dtype=np.complex128)
    carried, last = 0j, 0.0
    for begin, end, start in zip(first, [*first[1:], len(at)], starts, strict=True):
        carried *= np.exp(pole * (start - last)) if begin else 0.0
        sums[begin:end] = carried + np.cumsum(jumps[begin:end] * since[begin:end])
        carried, last = complex(sums[end - 1]), start
    index = before - 1
    group = np.searchsorted(first, index, side="right") - 1
    result = np.zeros(len(t), dtype=np.complex128)
    seen = index >= 0
    result[seen] = sums[index[seen]] * np.exp(pole * (t[seen] - starts[group[seen]]))
    return result
