"""Checks every measured sample against the limits; independent of steps and devices."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.interface import ChannelRecord, TripRecord
from pmabench.engine.commanded import Commanded

Array = NDArray[np.float64]

RATE_WINDOW = 0.02
"""Window of a rate where the limit does not give one [s]."""
FALLS, LEAST = 0.1, 0.5
"""A value counts as falling if it fell by the first share of the allowed deviation [1] within the limit's delay, but
not less than the second [s]."""
ENDS = ("stop", "vent")
"""Actions that end the run."""


@dataclass(frozen=True)
class Trip:
    """A limit that was exceeded: index of the sample in its block, time [s], and value [SI]."""

    limit: TripRecord
    index: int
    t: float
    value: float
    over: bool = False
    """Whether the value came back inside the limit."""
    late: float = 0.0
    """Age of samples that arrive too late to count [s]."""

    def too_high(self, commanded: Commanded) -> bool:
        """Whether a pressure is above its limit or command, or its line burst: then vent without ramp or hold."""
        limit = self.limit
        asked = commanded.at(limit.channel, self.t) if limit.kind == "following" else limit.high
        above = limit.kind in {"range", "following"} and asked is not None and self.value >= asked
        return CHANNEL_QUANTITY[limit.channel] == "pressure" and (above or limit.kind in {"above", "burst"})

    def __str__(self) -> str:
        """The sentence for operator and record."""
        limit, name = self.limit, self.limit.channel
        quantity = CHANNEL_QUANTITY[name]
        where = f"at {self.t:.3f} s ({limit.source})"
        if self.over:
            return f"{name} is inside its limit again {where}"
        if limit.kind == "stale":
            late = f" but old ones, which come {self.late:.2f} s late," if self.late else ""
            return f"{name} has given no sample for {self.value:.3f} s{late} {where}"
        if not np.isfinite(self.value):
            return f"{name} reads {self.value} {where}: no valid value"
        shown = show(self.value, quantity)
        high = show(limit.high, quantity) if limit.high is not None else ""
        sentences = {
            "rate": f"changes by {shown} per second, faster than {high} per second",
            "frozen": f"has not changed from {shown} for {limit.delay:g} s",
            "off-range": f"{shown} is at the end of what the channel can measure",
            "following": f"{shown} is further than {high} from what is commanded",
            "above": f"{shown} is more than {high} above what is commanded and does not fall",
            "burst": f"fell by {shown} within {limit.window:g} s, more than {high}: burst or broken line",
            "slack": f"{shown} is under {show(limit.low or 0.0, quantity)}: slack",
        }
        if limit.kind in sentences:
            return f"{name} {sentences[limit.kind]} {where}"
        bound = limit.high if limit.high is not None and self.value >= limit.high else limit.low
        side = "above" if bound is limit.high else "below"
        end = show(bound if bound is not None else 0.0, quantity)
        return f"{name} {shown} at {self.t:.3f} s is {side} its limit {end} ({limit.source})"


def extremes_of(values: Mapping[str, Array]) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each channel with samples; NaN where one is NaN."""
    least, most = np.minimum.reduce, np.maximum.reduce  # the methods of arrays take twice as long
    return {name: (float(least(value)), float(most(value))) for name, value in values.items() if len(value)}


class _Watched:
    """One limit, from block to block."""

    def __init__(self, limit: TripRecord) -> None:
        self.limit = limit
        self.since: float | None = None
        """Since when the value is outside [s]; None while inside."""
        self.active = False
        """Whether the limit is exceeded and was reported, with an action that does not end the run."""
        self.heard: float | None = None
        self.old: float | None = None
        """Time of the newest sample [s], where it was too old to count; else None."""
        self.t: Array = np.zeros(0)
        self.kept: Array = np.zeros(0)
        """Samples of earlier blocks (`t`, `kept`) within the limit's window."""
        self.last: float | None = None
        self.changed = 0.0
        self.high: tuple[float, float] | None = None
        """Since when the value is too far above its command without falling [s], and its value then."""


class Watch:
    """Checks blocks of samples against the limits, and keeps their state between blocks."""

    def __init__(
        self,
        limits: Sequence[TripRecord],
        channels: Sequence[ChannelRecord] = (),
        commanded: Commanded | None = None,
    ) -> None:
        self._watched = [_Watched(limit) for limit in limits]
        self._channels = {channel.name: channel for channel in channels}
        self._commanded = commanded or Commanded()

    def look(
        self,
        t: Array,
        values: Mapping[str, Array],
        now: float | None = None,
        extremes: Mapping[str, tuple[float, float]] | None = None,
    ) -> list[Trip]:
        """Limits exceeded in this block for longer than their delay, and those that are met again, in order of time.

        `t` [s] and each of `values` [SI] have shape (n,); `now` [s] is the arrival of the last sample that was not old.
        NaN counts as outside. Nothing is reported after the first trip that ends the run. `extremes` are those of
        `values`, where they are known.
        """
        extremes = extremes_of(values) if extremes is None else extremes
        found: list[Trip] = []
        for watched in self._watched:
            samples = values.get(watched.limit.channel)
            if samples is None or len(samples) == 0:
                continue
            heard = float(t[-1]) if now is None else now
            watched.old = float(t[-1]) if heard == watched.heard else None
            watched.heard = heard
            if watched.limit.kind == "stale":
                self._over(watched, 0, float(t[0]), float(samples[0]), found)
                continue
            if watched.limit.kind == "range" and not watched.active and self._inside(watched, extremes):
                continue
            found += self._one(watched, t, samples)
            if watched.limit.kind == "following" and watched.limit.action == "hold":
                found += self._not_falling(watched, t, samples)
        found.sort(key=lambda trip: trip.index)
        return found[: next((n + 1 for n, trip in enumerate(found) if trip.limit.action in ENDS), None)]

    def look_once(self, t: float, values: Mapping[str, float], now: float | None = None) -> list[Trip]:
        """As `look`, for a single sample in plain numbers: faster, for loops that are closed at every sample."""
        if not all(
            watched.limit.kind == "range" and not watched.active and self._inside_once(watched, values)
            for watched in self._watched
        ):
            return self.look(np.array([t]), {name: np.array([value]) for name, value in values.items()}, now)
        return []

    def silent(self, now: float) -> list[Trip]:
        """Trips of `stale` limits of channels that are silent for too long at `now` [s]."""
        found = []
        for watched in self._watched:
            limit = watched.limit
            if limit.kind == "stale" and not watched.active:
                watched.heard = now if watched.heard is None else watched.heard
                if now - watched.heard >= limit.delay:
                    watched.active = True
                    late = 0.0 if watched.old is None else now - watched.old
                    found.append(Trip(limit, 0, now, now - watched.heard, late=late))
        return found

    def listen_anew(self) -> None:
        """Restart the measurement of silence."""
        for watched in self._watched:
            watched.heard = watched.old = None

    @staticmethod
    def _inside_once(watched: _Watched, values: Mapping[str, float]) -> bool:
        value, limit = values.get(watched.limit.channel), watched.limit
        if value is None:
            return True
        # Written so that NaN, which compares false with everything, counts as outside.
        inside = (limit.high is None or value < limit.high) and (limit.low is None or value > limit.low)
        if inside:
            watched.since = None
        return inside and value - value == 0.0

    @staticmethod
    def _inside(watched: _Watched, extremes: Mapping[str, tuple[float, float]]) -> bool:
        limit = watched.limit
        low, high = extremes[limit.channel]
        inside = (limit.high is None or high < limit.high) and (limit.low is None or low > limit.low)
        if inside and math.isfinite(low) and math.isfinite(high):
            watched.since = None
            return True
        return False

    def _one(self, watched: _Watched, t: Array, samples: Array) -> list[Trip]:
        outside, shown = self._outside(watched, t, samples)
        found: list[Trip] = []
        since, limit = watched.since, watched.limit
        instant = limit.kind == "frozen"  # its delay is already part of the test
        for index in np.flatnonzero(outside | np.concatenate(([True], outside[:-1]))):
            if not outside[index]:
                since = None
                self._over(watched, int(index), float(t[index]), float(samples[index]), found)
                continue
            since = t[index] if since is None else since
            if (instant or t[index] - since >= limit.delay) and not watched.active:
                found.append(Trip(limit, int(index), float(t[index]), float(shown[index])))
                if limit.action in ENDS:
                    return found
                watched.active = True
        watched.since = float(since) if since is not None and outside[-1] else None
        return found

    def _not_falling(self, watched: _Watched, t: Array, samples: Array) -> list[Trip]:
        """A vent, if a value above its command does not fall while the bench is held.

        Nothing is sent during a hold, so a stuck valve or another program's command is not corrected.
        """
        limit = watched.limit
        most = limit.high or 0.0
        for index in range(len(t)):
            moment, value = float(t[index]), float(samples[index])
            if not value - self._asked(limit.channel, moment) > most:
                watched.high = None
            elif watched.high is None or value < watched.high[1] - FALLS * most:
                watched.high = moment, value
            elif moment - watched.high[0] >= max(limit.delay, LEAST):
                return [Trip(replace(limit, kind="above", action="vent"), index, moment, value)]
        return []

    @staticmethod
    def _over(watched: _Watched, index: int, t: float, value: float, found: list[Trip]) -> None:
        if watched.active:
            watched.active = False
            found.append(Trip(watched.limit, index, t, value, over=True))

    def _outside(self, watched: _Watched, t: Array, samples: Array) -> tuple[NDArray[np.bool_], Array]:
        """Mask of samples outside the limit, and the value to report for each, both of shape (n,)."""
        limit = watched.limit
        if limit.kind in {"rate", "burst"}:
            return self._falls(watched, t, samples)
        if limit.kind == "frozen":
            return self._frozen(watched, t, samples)
        if limit.kind == "following":
            asked = np.array([self._asked(limit.channel, moment) for moment in t])
            return np.abs(samples - asked) > (limit.high or 0.0), samples
        if limit.kind == "off-range":
            channel = self._channels[limit.channel]
            return ~((samples > channel.low) & (samples < channel.high)), samples
        outside = ~np.isfinite(samples)
        if limit.high is not None:
            outside |= samples >= limit.high
        if limit.low is not None:
            outside |= samples <= limit.low
        return outside, samples

    def _asked(self, output: str, t: float) -> float:
        """The commanded value [SI]; NaN without a command, from which no deviation is found."""
        value = self._commanded.at(output, t)
        return float("nan") if value is None else value

    def _falls(self, watched: _Watched, t: Array, samples: Array) -> tuple[NDArray[np.bool_], Array]:
        """Check the change over the window before each sample: the size of its rate, or a fall as in a burst."""
        limit = watched.limit
        window = limit.window or RATE_WINDOW
        times, values = np.concatenate((watched.t, t)), np.concatenate((watched.kept, samples))
        first = len(times) - len(t)
        before = np.minimum(np.searchsorted(times, times[first:] - window - 1e-9), np.arange(first, len(times)))
        change = values[first:] - values[before]
        enough = times[first:] - times[before] >= 0.5 * window
        keep = int(np.searchsorted(times, times[-1] - 1.5 * window))
        watched.t, watched.kept = times[keep:], values[keep:]
        if limit.kind == "rate":
            rate = np.abs(change) / np.maximum(times[first:] - times[before], 1e-9)
            return enough & (rate > (limit.high or 0.0)), rate
        # Commands explain a fall as fast as they were, and no deeper than the lowest of them.
        allowed = self._commanded.falling(limit.channel, t) * window
        if allowed.any():
            deep = np.maximum(0.0, values[before] - self._commanded.lowest(limit.channel, t))
            allowed = np.minimum(allowed, deep)
        return -change - allowed > (limit.high or 0.0), -change

    @staticmethod
    def _frozen(watched: _Watched, t: Array, samples: Array) -> tuple[NDArray[np.bool_], Array]:
        changed = np.diff(samples, prepend=samples[0] if watched.last is None else watched.last) != 0
        first = float(t[0]) if watched.last is None else watched.changed
        since = np.array(list(itertools.accumulate(np.where(changed, t, -np.inf), max, initial=first))[1:])
        watched.last, watched.changed = float(samples[-1]), float(since[-1])
        return t - since >= watched.limit.delay, samples
