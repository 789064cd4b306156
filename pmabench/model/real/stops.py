"""Stops along a path of contraction or pressure whose turns are known; knows no muscle."""

from __future__ import annotations

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.hysteresis import Memory
from pmabench.model.real.muscle import Stops


class StopsAlong(Memory):
    """The force of stops by its most, sum of w S / r between -1 and 1, along a path.

    From `start` [s] on at `x`, with every stop in its middle; or where `low` is given, as after a way from there to
    `x` that began with every stop at its lower end.
    """

    def __init__(self, stops: Stops, x: float, start: float, low: float | None = None) -> None:
        super().__init__(x, start)
        self._widths = np.array(stops.widths)[:, None]
        self._shares = np.array(stops.weights) / stops.widths
        self._extra, self._way = stops.extra, stops.way
        self._x, self._gone = x, 0.0
        self._stops = 0.0 * self._widths if low is None else np.clip(x - low - self._widths, None, self._widths)

    def at(self, x: Array) -> Array:
        """The force by its most at places x between the last turn and the next one [1]."""
        force = self._shares @ np.clip(self._stops + (x - self._x), -self._widths, self._widths)
        if self._extra:
            force *= 1 + self._extra * np.exp(-(self._gone + np.abs(x - self._x)) / self._way)
        return np.asarray(force, dtype=np.float64)

    def turn(self, x: float) -> None:
        """From place x on the path goes the other way."""
        self._stops = np.clip(self._stops + (x - self._x), -self._widths, self._widths)
        self._gone += abs(x - self._x)
        self._x = x
