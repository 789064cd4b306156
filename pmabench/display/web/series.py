"""Data for the curves of the page: buckets of every channel over time, and the loop of the current trial.

A bucket holds the minimum and maximum of its samples, not a mean or every n-th sample: a spike of 4 ms is visible at
any zoom. Samples that a fit would exclude count as missing, not as zero. Buckets without samples are not kept.
A loop is pressure, displacement and force, thinned for drawing.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import CHANNEL_QUANTITY
from pmabench.display.state import RunState, Trial
from pmabench.display.wording import quantity
from pmabench.store.records import UNUSABLE, Array, Flags

WIDTHS = (0.02, 0.1, 0.4, 1.6, 6.4, 25.6)
"""Widths of buckets [s]; each is a whole multiple of the one before."""
FINE = 180.0
"""How long the narrowest buckets are kept [s]: they are for curves in progress."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Buckets of one stream: `k`, shape (n,), is start time / width; `low` and `high` [SI] have shape (n, channels)."""

    names: tuple[str, ...]
    k: NDArray[np.int64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]


class _Level:
    """Buckets of one width, in order of time."""

    def __init__(self, channels: int) -> None:
        self.count = 0
        ends = np.float32, (channels,)
        self._rows = np.empty(256, np.dtype([("k", np.int64), ("low", *ends), ("high", *ends)]))

    def add(self, k: NDArray[np.int64], low: Array, high: Array) -> None:
        """Append buckets; the first is merged with the present last one if it has the same number."""
        last = self._rows[max(self.count - 1, 0)]
        if self.count and k[0] <= last["k"]:
            last["low"], last["high"] = np.fmin(last["low"], low[0]), np.fmax(last["high"], high[0])
            k, low, high = k[1:], low[1:], high[1:]
        needed, there = self.count + len(k), len(self._rows)
        if needed > there:
            self._rows = np.concatenate([self._rows, np.empty(max(needed, 2 * there) - there, self._rows.dtype)])
        new = self._rows[self.count : needed]
        new["k"], new["low"], new["high"] = k, low, high
        self.count = needed

    def forget(self, before: int) -> None:
        """Drop buckets before number `before`, once they are more than half of all."""
        first = int(np.searchsorted(self._rows["k"][: self.count], before))
        if 2 * first > self.count > 1024:
            left = self.count - first
            self._rows[:left] = self._rows[first : self.count].copy()
            self.count = left

    def between(self, first: int, last: int) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
        """Copies of the buckets from number `first` to number `last`."""
        k = self._rows["k"][: self.count]
        cut = self._rows[int(np.searchsorted(k, first)) : int(np.searchsorted(k, last, side="right"))].copy()
        return cut["k"], cut["low"], cut["high"]

    @property
    def ends(self) -> tuple[int, int]:
        """Numbers of the first and the last bucket."""
        return int(self._rows["k"][0]), int(self._rows["k"][self.count - 1])


class Buckets:
    """Buckets of all streams of a run. One thread adds, others read."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._levels: dict[str, tuple[tuple[str, ...], tuple[_Level, ...]]] = {}

    def add(self, stream: str, t: Array, values: Mapping[str, Array], flags: Flags) -> None:
        """Add samples of a stream in order: `t` [s], `flags` and each of `values` [SI] of shape (n,)."""
        names = tuple(values)
        y = np.column_stack([np.asarray(values[name], float) for name in names]) if names else np.empty((len(t), 0))
        y[(flags & np.uint16(UNUSABLE)) != 0] = np.nan
        known = np.isfinite(t)
        t, y = t[known], y[known]
        if not len(t) or not names:
            return
        numbers = np.floor(np.maximum.accumulate(t) / WIDTHS[0] + 1e-6).astype(np.int64)
        low, high = y, y
        with self._lock:
            levels = self._levels.setdefault(stream, (names, tuple(_Level(len(names)) for _ in WIDTHS)))[1]
            for n, level in enumerate(levels):
                if n:
                    numbers //= round(WIDTHS[n] / WIDTHS[n - 1])
                starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
                numbers = numbers[starts]
                low, high = np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)
                level.add(numbers, low, high)
            levels[0].forget(levels[0].ends[1] - round(FINE / WIDTHS[0]))

    @property
    def span(self) -> tuple[float, float]:
        """Time of the first and the last sample [s], with the resolution of a bucket; (0, 0) without samples."""
        with self._lock:
            ends = [levels[1].ends for _, levels in self._levels.values() if levels[1].count]
        if not ends:
            return 0.0, 0.0
        return min(end[0] for end in ends) * WIDTHS[1], (max(end[1] for end in ends) + 1) * WIDTHS[1]

    def between(self, begin: float, end: float, level: int) -> dict[str, Piece]:
        """Buckets of a level that overlap a time range [s], by stream."""
        width = WIDTHS[level]
        with self._lock:
            return {
                stream: Piece(names, *levels[level].between(int(begin // width), int(end // width)))
                for stream, (names, levels) in self._levels.items()
            }

    def newest(self, since: Mapping[str, int]) -> dict[str, Piece]:
        """Narrowest buckets of each stream from number `since` on, which may have been incomplete; else the last."""
        with self._lock:
            found = {}
            for stream, (names, levels) in self._levels.items():
                last = levels[0].ends[1]
                found[stream] = Piece(names, *levels[0].between(since.get(stream, last), last))
        return found


def level_for(span: float, most: int) -> int:
    """The narrowest level with at most `most` buckets in a time range [s]; the widest if none has."""
    return next((n for n, width in enumerate(WIDTHS) if span / width <= most), len(WIDTHS) - 1)


MOST_POINTS = 400
"""Most points of a loop."""
FINEST = 0.004
"""Smallest distance of points, as a fraction of an axis's range so far [1]; increased when there are too many."""
LEAST = {"pressure": 2.0, "displacement": 0.2, "angle": 1.0, "force": 2.0}
"""Smallest ranges that count, in display units, so that noise at rest makes no points."""
AXES = (("pressure",), ("displacement", "angle"), ("force",))
"""Channels of a point: of each group the first that is measured."""
BEFORE = 2
"""Number of loops of earlier trials that are kept."""


def axes_of(state: RunState) -> list[str]:
    """Names of the channels of a point."""
    return [found for names in AXES if (found := next((n for n in names if n in state.channels), ""))]


@dataclass
class Loop:
    """One trial: its number from 1, and points of shape (n, axes) in display units."""

    number: int
    begin: float
    axes: list[str]
    points: list[list[float]] = field(default_factory=list)
    share: float = FINEST
    version: int = 0
    """Changes whenever existing points are thinned."""

    def __post_init__(self) -> None:
        self._low = np.full(len(self.axes), np.inf)
        self._high = np.full(len(self.axes), -np.inf)

    def add(self, rows: Array) -> None:
        """Add points of shape (n, axes); kept are those far enough from the one before, which preserves corners."""
        self._low, self._high = np.fmin(self._low, rows.min(axis=0)), np.fmax(self._high, rows.max(axis=0))
        self._thin([[round(float(v), 3) for v in row] for row in rows])
        while len(self.points) > MOST_POINTS:
            self.share *= 1.5
            self.version += 1
            before, self.points = self.points, []
            self._thin(before)

    def _thin(self, rows: list[list[float]]) -> None:
        least = [LEAST.get(name, 0.0) for name in self.axes]
        steps = [self.share * max(v, s) for v, s in zip((self._high - self._low).tolist(), least, strict=True)]
        for row in rows:
            last = self.points[-1] if self.points else None
            if last is None or any(abs(v - w) > step for v, w, step in zip(row, last, steps, strict=True)):
                self.points.append(row)


class Loops:
    """The loop of the current trial and those of the trials before it."""

    def __init__(self) -> None:
        self.now: Loop | None = None
        self.before: list[Loop] = []
        self._trial: Trial | None = None
        self._reached = 0.0

    def update(self, state: RunState) -> None:
        """Add what was read since the last call."""
        axes = axes_of(state)
        if len(axes) < 2:
            return
        if self._trial is not None and self._trial is not state.trial:
            self._take(state, axes, self._trial)
            self._trial = None
        if state.trial is not None:
            if self._trial is None:
                self._trial = state.trial
                self.before = [*self.before, *([self.now] if self.now is not None else [])][-BEFORE:]
                self.now = Loop(state.trial.index + 1, state.trial.begin, axes)
                self._reached = state.trial.begin
            self._take(state, axes, state.trial)

    def _take(self, state: RunState, axes: list[str], trial: Trial) -> None:
        end = min(state.samples.reached, np.inf if trial.end is None else trial.end)
        if self.now is None or not end > self._reached:
            return
        t, channels, flags, _ = state.between(self._reached, end)
        if not len(t) or any(name not in channels for name in axes):
            return
        scales = [quantity(CHANNEL_QUANTITY.get(name, "")).scale for name in axes]
        rows = np.column_stack([channels[name] / scale for name, scale in zip(axes, scales, strict=True)])
        new = (t >= self._reached) & (t < end) & ((flags & np.uint16(UNUSABLE)) == 0) & np.isfinite(rows).all(axis=1)
        if new.any():
            self.now.add(rows[new])
        self._reached = end
