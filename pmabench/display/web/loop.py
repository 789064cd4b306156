"""Pressure, displacement and force of the trial under way, thinned to what a loop needs; knows nothing of a browser."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pmabench.base.quantities import CHANNEL_QUANTITY
from pmabench.display.state import RunState, Trial
from pmabench.display.wording import quantity
from pmabench.store.records import UNUSABLE, Array

MOST = 400
"""Points of a loop that is drawn."""
FINEST = 0.004
"""A point is kept where an axis has moved by this share of its range so far [1]; more, whenever there are too many."""
LEAST = {"pressure": 2.0, "displacement": 0.2, "angle": 1.0, "force": 2.0}
"""Ranges that count at least, in the units that people read: so noise at rest makes no points."""
AXES = (("pressure",), ("displacement", "angle"), ("force",))
"""Channels of a point: the first of each that is measured."""
BEFORE = 2
"""Loops of earlier trials that are kept."""


def axes_of(state: RunState) -> list[str]:
    """Names of the channels that a point has."""
    return [found for names in AXES if (found := next((n for n in names if n in state.channels), ""))]


@dataclass
class Loop:
    """One trial: its number from 1, and points of shape (n, axes) in the units that people read."""

    number: int
    begin: float
    axes: list[str]
    points: list[list[float]] = field(default_factory=list)
    share: float = FINEST
    version: int = 0
    """Changes whenever points that were there are thinned."""

    def __post_init__(self) -> None:
        self._low = np.full(len(self.axes), np.inf)
        self._high = np.full(len(self.axes), -np.inf)

    def add(self, rows: Array) -> None:
        """Points of shape (n, axes); kept are those that are far enough from the one before, so corners are seen."""
        self._low, self._high = np.fmin(self._low, rows.min(axis=0)), np.fmax(self._high, rows.max(axis=0))
        self._thin([[round(float(v), 3) for v in row] for row in rows])
        while len(self.points) > MOST:
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
    """The loop of the trial under way and those of the trials before it."""

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
        rates = {name: stream.rate for name, stream in state.files.streams.items()}
        t, channels, flags, _ = state.samples.between(self._reached, end, rates)
        if not len(t) or any(name not in channels for name in axes):
            return
        scales = [quantity(CHANNEL_QUANTITY.get(name, "")).scale for name in axes]
        rows = np.column_stack([channels[name] / scale for name, scale in zip(axes, scales, strict=True)])
        new = (t >= self._reached) & (t < end) & ((flags & np.uint16(UNUSABLE)) == 0) & np.isfinite(rows).all(axis=1)
        if new.any():
            self.now.add(rows[new])
        self._reached = end
