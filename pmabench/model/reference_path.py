"""A path of places to follow, as a function of time: cosine moves from place to place, each with a rest after it.

Standard library only: a law calls it at every sample. Knows no muscle and no controller.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise


class ReferencePath:
    """From `places[0]` over all `places` [m] at no more than `speed` [m/s], with a rest of `rest` [s] at each.

    A move of d takes pi d / (2 speed), x = from + d (1 - cos(pi t / T)) / 2: speed begins and ends with 0.

    Examples
    --------
    >>> path = ReferencePath([0.0, 0.02], speed=0.01, rest=1.0)
    >>> round(path.duration, 4), round(path.place(1.0 + 3.1416 / 2), 6), round(path.speed(1.0 + 3.1416 / 2), 6)
    (5.1416, 0.01, 0.01)
    """

    def __init__(self, places: Sequence[float], speed: float, rest: float) -> None:
        if len(places) < 2 or not all(map(math.isfinite, places)) or not speed > 0 or not rest >= 0:
            raise ValueError(f"a path needs two places, a speed above 0 and a rest, not {places}, {speed:g}, {rest:g}")
        self.places, self.rest = tuple(places), rest
        self.starts, now = [], rest
        """When each move begins [s]."""
        self.times = [0.5 * math.pi * abs(b - a) / speed for a, b in pairwise(self.places)]
        """How long each takes [s]."""
        for time in self.times:
            self.starts.append(now)
            now += time + rest
        self.duration = now

    def _move(self, t: float) -> tuple[int, float]:
        """Number of the move that has begun at a time, -1 for none, and the share of it that is done [1]."""
        number = bisect_right(self.starts, t) - 1
        if number < 0:
            return -1, 0.0
        time = self.times[number]
        return number, min((t - self.starts[number]) / time, 1.0) if time > 0 else 1.0

    def place(self, t: float) -> float:
        """Place at a time [m]; the last one after the end."""
        number, share = self._move(t)
        if number < 0:
            return self.places[0]
        way = self.places[number + 1] - self.places[number]
        return self.places[number] + way * 0.5 * (1.0 - math.cos(math.pi * share))

    def speed(self, t: float) -> float:
        """Rate of the place at a time [m/s]."""
        number, share = self._move(t)
        if number < 0 or share >= 1.0:
            return 0.0
        way = self.places[number + 1] - self.places[number]
        return way * 0.5 * math.pi / self.times[number] * math.sin(math.pi * share)
