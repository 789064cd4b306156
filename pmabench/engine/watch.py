"""The watch on what is measured: looks at every sample of every block; knows limits, not steps or devices."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.bench.interface import ChannelRecord, TripRecord
from pmabench.engine.commanded import Commanded

Array = NDArray[np.float64]

RATE_WINDOW = 0.02
"""Over what time a rate is taken where the limit does not say [s]."""
FALLS, LEAST = 0.1, 0.5
"""A value falls that fell by this share of what is allowed [1] in the time of its limit, at least so long [s]."""
ENDS = ("stop", "vent")
"""Actions that end the run."""


@dataclass(frozen=True)
class Trip:
    """A limit that was crossed: at which sample of the block, when [s], with which value [SI]."""

    limit: TripRecord
    index: int
    t: float
    value: float
    over: bool = False
    """Whether this is the end of a crossing, not its beginning."""
    late: float = 0.0
    """Of samples that come, but too old to count: how late they are [s]."""

    def too_high(self, commanded: Commanded) -> bool:
        """Whether a pressure is above limit or command, or its line is open: no safe ramp or hold is for that."""
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


class _Watched:
    """One limit, from block to block."""

    def __init__(self, limit: TripRecord) -> None:
        self.limit = limit
        self.since: float | None = None
        """Since when the value is outside [s]."""
        self.active = False
        """Whether an action that does not end the run was reported."""
        self.heard: float | None = None
        self.old: float | None = None
        """When the newest sample was taken, where it was too old to be heard [s]."""
        self.t: Array = np.zeros(0)
        self.kept: Array = np.zeros(0)
        """Samples before this block, as far back as the limit looks."""
        self.last: float | None = None
        self.changed = 0.0
        self.high: tuple[float, float] | None = None
        """Since when a value is too far above its command, and is not falling [s], and the value then."""


class Watch:
    """Holds each limit's state from block to block."""

    def __init__(
        self,
        limits: Sequence[TripRecord],
        channels: Sequence[ChannelRecord] = (),
        commanded: Commanded | None = None,
    ) -> None:
        self._watched = [_Watched(limit) for limit in limits]
        self._channels = {channel.name: channel for channel in channels}
        self._commanded = commanded or Commanded()

    def look(self, t: Array, values: Mapping[str, Array], now: float | None = None) -> list[Trip]:
        """What is crossed for longer than its delay in this block, and what is over, in the order of time.

        `t` [s] has shape (n,), each of `values` [SI] too; one that was not old came last at `now` [s]. A value that is
        no number counts as a crossing. Ends with the first crossing that ends the run.
        """
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
            if watched.limit.kind == "range" and not watched.active and self._inside(watched, samples):
                continue
            found += self._one(watched, t, samples)
            if watched.limit.kind == "following" and watched.limit.action == "hold":
                found += self._not_falling(watched, t, samples)
        found.sort(key=lambda trip: trip.index)
        return found[: next((n + 1 for n, trip in enumerate(found) if trip.limit.action in ENDS), None)]

    def look_once(self, t: float, values: Mapping[str, float], now: float | None = None) -> list[Trip]:
        """As `look`, for a single sample in plain numbers: loops that are closed at every sample."""
        if not all(
            watched.limit.kind == "range" and not watched.active and self._inside_once(watched, values)
            for watched in self._watched
        ):
            return self.look(np.array([t]), {name: np.array([value]) for name, value in values.items()}, now)
        return []

    def silent(self, now: float) -> list[Trip]:
        """Channels that have given nothing for too long at `now` [s]."""
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
        """Silence counts from the next look on."""
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
    def _inside(watched: _Watched, samples: Array) -> bool:
        low, high, limit = samples.min(), samples.max(), watched.limit
        inside = (limit.high is None or high < limit.high) and (limit.low is None or low > limit.low)
        if inside and np.isfinite(low) and np.isfinite(high):
            watched.since = None
            return True
        return False

    def _one(self, watched: _Watched, t: Array, samples: Array) -> list[Trip]:
        outside, shown = self._outside(watched, t, samples)
        found: list[Trip] = []
        since, limit = watched.since, watched.limit
        instant = limit.kind == "frozen"  # its delay is in what counts as outside
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
        """Where a value that is held for has risen above its command and stays there.

        While the bench holds nothing is sent: what another program commanded, or a stuck valve, is not corrected.
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
        """Which samples are outside, and the value that is reported of each."""
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
        """What is commanded [SI], or NaN, which nothing is far from."""
        value = self._commanded.at(output, t)
        return float("nan") if value is None else value

    def _falls(self, watched: _Watched, t: Array, samples: Array) -> tuple[NDArray[np.bool_], Array]:
        """Change over the window before each sample: against a rate, or downwards as in a burst."""
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
        # What commands explain: a fall as fast as they were, and no deeper than the lowest of them.
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
