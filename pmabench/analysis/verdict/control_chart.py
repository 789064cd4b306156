"""A control chart of single values: centre, limits and what lies outside; knows no specimen and no file.

Individuals chart (Shewhart; ISO 7870-2): limits are 2.66 times the mean moving range from the mean of the first values,
2.66 = 3 / d2 with d2 = 1.128 for ranges of two. Eight values in a row on one side of the centre are a shift, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FACTOR = 2.66
FEWEST = 5
"""Fewest values for limits."""
FIRST = 12
"""Most values from the beginning that make the limits; those that come later are judged by them."""
ROW = 8
"""So many in a row on one side of the centre are a shift."""


@dataclass(frozen=True)
class Chart:
    """Limits from the first `base` values, and which values break them."""

    values: tuple[float, ...]
    centre: float
    low: float
    high: float
    base: int
    beyond: tuple[int, ...]
    """Places of values outside the limits."""
    shifted: int | None
    """Place at which the first row on one side is complete."""

    @property
    def first_alarm(self) -> int | None:
        """Place of the first value that says that something changed."""
        alarms = [*self.beyond[:1], *([self.shifted] if self.shifted is not None else [])]
        return min(alarms, default=None)


def chart(values: Sequence[float]) -> Chart | None:
    """The chart of values in order of time, shape (n,); None with fewer than `FEWEST`."""
    if len(values) < FEWEST:
        return None
    v = np.asarray(values, dtype=np.float64)
    first = v[:FIRST]
    centre = float(first.mean())
    reach = FACTOR * float(np.abs(np.diff(first)).mean())
    beyond = tuple(int(i) for i in np.flatnonzero(np.abs(v - centre) > reach))
    side, row, shifted = 0.0, 0, None
    for place, way in enumerate(np.sign(v - centre)):
        row = row + 1 if way == side and way != 0 else 1
        side = float(way)
        if row >= ROW and shifted is None and way != 0:
            shifted = place
    return Chart(tuple(float(x) for x in v), centre, centre - reach, centre + reach, len(first), beyond, shifted)
