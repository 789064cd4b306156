"""Listening to channels over a stretch of bench time: series, mean, noise, drift; commands nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pmabench.base.errors import VerdictFailed
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.engine.acquire import Acquisition, Array, Samples, Stop

OTHER_CLOCK = 0.5
"""A stream whose samples seem to come this much [s] before or after now has another clock."""


@dataclass(frozen=True)
class Series:
    """A channel over time: `t` [s, bench time] and `y` [SI], both of shape (n,)."""

    t: Array
    y: Array

    def mean(self, last: float | None = None) -> float:
        """Mean of all, or of the last `last` seconds."""
        y = self.y if last is None else self.y[self.t > self.t[-1] - last]
        return float(y.mean())

    def reading(self) -> Reading:
        """Mean, noise and drift."""
        t, y = self.t - self.t.mean(), self.y
        mean = float(y.mean())
        spread = float(t @ t)
        slope = float(t @ (y - mean)) / spread if spread > 0 else 0.0
        return Reading(mean, float(np.std(y - mean - slope * t)), slope * float(self.t[-1] - self.t[0]), len(y))


@dataclass(frozen=True)
class Reading:
    """A channel at rest [SI]."""

    mean: float
    noise: float
    """Rms about a straight line."""
    drift: float
    """What that line rises over the stretch."""
    count: int


def listen(acquisition: Acquisition, seconds: float, until: Stop = lambda _block: None) -> Mapping[str, Series]:
    """Samples of every channel over the next `seconds` [s]; silent channels are left out."""
    kept: dict[str, list[tuple[Array, Array]]] = {}

    def keep(block: Samples) -> int | None:
        late = acquisition.clock.now() - float(block.t[-1])
        t = block.t + (late if abs(late) > OTHER_CLOCK + 1.5 / acquisition.rate else 0.0)
        for name, values in block.values.items():
            kept.setdefault(name, []).append((t, values))
        return until(block)

    acquisition.pass_time(seconds, keep)
    return {
        name: Series(np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]))
        for name, parts in kept.items()
    }


def steady(acquisition: Acquisition, name: str, most: float, *, seconds: float = 1.0, within: float = 30.0) -> Reading:
    """The channel over `seconds` [s] in which it drifted by less than `most` [SI].

    Raises VerdictFailed when it has not come to rest `within` [s].
    """
    deadline = acquisition.clock.now() + within
    while True:
        series = listen(acquisition, seconds).get(name)
        if series is None:
            raise VerdictFailed(f"{name} gives no samples")
        reading = series.reading()
        if not np.isfinite(reading.mean):
            raise VerdictFailed(f"{name} gives no numbers; look at its plug")
        if abs(reading.drift) <= max(most, 4 * reading.noise / np.sqrt(reading.count)):
            return reading
        if acquisition.clock.now() > deadline:
            quantity = CHANNEL_QUANTITY[name]
            raise VerdictFailed(
                f"{name} does not come to rest: it still drifts by {show(reading.drift, quantity, 3)} in {seconds:g} s "
                f"after {within:g} s, at most {show(most, quantity, 3)} is allowed"
            )
