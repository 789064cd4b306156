"""One trial of a slow test as rows of pressure, contraction and force at an even, low rate; knows no kind of test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

RATE = 25.0
"""Rows a second [Hz]: stops and creep are computed at this rate, and slow tests have nothing faster."""
FEWEST = 4
"""Samples of a row from which its speed is the slope of a line through them; with fewer, of the rows around it."""


@dataclass(frozen=True, eq=False)
class Record:
    """Rows of one trial in the order of time; arrays of shape (n,), SI."""

    name: str
    group: str
    """What it shares with others that are left out together: `isobaric-ramp, pressure 300 kPa`."""
    t: Array
    P: Array
    x: Array
    F: Array
    v: Array
    """Speed of contraction [m/s]."""
    used: NDArray[np.bool_]
    """Rows that count; the others, where the muscle is slack, only pass on what it remembers."""
    by_hand: bool = False
    """The length was set by hand, so that the force of the whole trial is off by a constant."""
    goes_on: bool = False
    """Follows the record before it on the same muscle: what the muscle remembers then goes on."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of several records, one after the other; shape (n,), SI."""

    P: Array
    x: Array
    v: Array
    F: Array
    used: NDArray[np.bool_]
    of: NDArray[np.int64]
    """Which record each row is of."""

    @classmethod
    def of_records(cls, records: Sequence[Record]) -> Rows:
        """All rows of records in their order."""
        P, x, v, F = (np.concatenate([getattr(r, name) for r in records]) for name in ("P", "x", "v", "F"))
        used = np.concatenate([r.used for r in records])
        return cls(P, x, v, F, used, np.repeat(np.arange(len(records)), [len(r.t) for r in records]))


def rows_of(
    t: Array, P: Array, x: Array, F: Array, usable: NDArray[np.bool_], rate: float = RATE
) -> tuple[Array, Array, Array, Array, Array]:
    """Time, pressure, contraction, force and speed at `rate` [Hz], means over the samples of each row, shape (n,), SI.

    Of samples of shape (m,), of which only `usable` ones with finite values count; a row without one is left out.
    """
    good = usable & np.isfinite(t) & np.isfinite(P) & np.isfinite(x) & np.isfinite(F)
    t, P, x, F = t[good], P[good], x[good], F[good]
    if not len(t):
        return t, P, x, F, t
    row = np.floor((t - t[0]) * rate + 1e-6).astype(np.int64)
    _, starts, count = np.unique(row, return_index=True, return_counts=True)

    def mean(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, starts) / count)

    at = mean(t)
    places = mean(x)
    off = t - np.repeat(at, count)
    power = np.add.reduceat(off * off, starts)
    line = np.add.reduceat(off * x, starts) / np.maximum(power, 1e-300)
    around = np.gradient(places, at) if len(at) > 1 else np.zeros(len(at))
    return at, mean(P), places, mean(F), np.where(count >= FEWEST, line, around)
