"""A measured channel against its limits, and what an output is set to; plain values, no samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any


@dataclass
class Channel:
    """A measured channel and what it must not reach [SI]."""

    name: str
    quantity: str
    low: float
    high: float
    """Ends of its range."""
    trip_low: float | None = None
    trip_high: float | None = None
    command_low: float | None = None
    command_high: float | None = None
    value: float | None = None
    least: float | None = None
    most: float | None = None
    """Lowest and highest value seen."""
    age: float | None = None
    """Of the newest value [s]."""
    stream: str = ""

    @property
    def alarm(self) -> int:
        """0: far from a trip limit; 1: within a tenth of it, or beyond what may be commanded; 2: at or beyond it."""
        value = self.value
        if value is None or not isfinite(value):
            return 0
        low, high = self.trip_low, self.trip_high
        if (high is not None and value >= high) or (low is not None and value <= low):
            return 2
        rest = max(0.0, low) if low is not None else 0.0
        near = high is not None and high > rest and value > high - 0.1 * (high - rest)
        near |= low is not None and low < 0 and value < 0.9 * low
        near |= low is not None and high is not None and low > 0 and value < low + 0.1 * (high - low)
        slip = 0.005 * abs(self.command_high or 0.0)
        return 1 if near or (self.command_high is not None and value > self.command_high + slip) else 0

    @property
    def span(self) -> float:
        """The largest value that is expected [SI], for the number of decimals."""
        return max((abs(v) for v in self.axis() if isfinite(v)), default=1.0)

    def axis(self) -> tuple[float, float]:
        """Ends of the bar [SI]: its trip limits, a little beyond; else limits of the command or of the range."""
        low = self.trip_low if self.trip_low is not None else min(0.0, self.command_low or 0.0)
        high = self.trip_high if self.trip_high is not None else self.command_high
        if high is None or not high > low:
            high = self.high if isfinite(self.high) and self.high > low else low + 1.0
        edge = 0.04 * (high - low)
        return low - edge, high + edge


@dataclass(frozen=True)
class Setting:
    """What an output is commanded to [SI]."""

    output: str
    quantity: str
    how: str
    value: float
    data: Mapping[str, Any]
