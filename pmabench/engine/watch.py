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
not less than the second [s].

It counts as moving if it went that share of the deviation within the same share of the delay: a regulator with a lag
below the delay is faster than that wherever it is too far from its command.
"""
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
            return f"{name} has no valid value {where}: out of its range, unplugged, or its sensor failed"
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
        self.outside = self.seen = 0.0
        """For the watch list: time outside minus the time inside after it, not below 0 [s], and time of the sample up
        to which it counts. A value that is inside for a moment again and again is outside all the same."""
        self.mark = 0.0, 0.0
        """When and where the value last moved [s, SI], for `following`."""
        self.moves = 0.0
        """Direction in which it moves: 1, -1, or 0."""
        self.under = self.nears = False
        """For `following`, at the last sample: whether a pressure was commanded, and whether the value came nearer."""
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
        self.every = 0.0
        """Shortest time between two new values [s], 0 while unknown; a slow gauge's is above `LEAST`."""
        self.high: tuple[float, float] | None = None
        """Since when the value is too far above its command without falling [s], and its value then."""


class Watch:
    """Checks blocks of samples against the limits, and keeps their state between blocks."""

    def __init__(
        self,
        limits: Sequence[TripRecord],
        channels: Sequence[ChannelRecord] = (),
        commanded: Commanded | None = None,
        rest: float = 0.0,
    ) -> None:
        """`rest` is the highest pressure that counts as vented [Pa]."""
        self._rest = rest
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
        NaN counts as outside. Nothing is reported after the sample that ends the run. `extremes` are those of
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
            if watched.limit.kind == "following":
                found += self._not_falling(watched, t, samples)
        found.sort(key=lambda trip: trip.index)
        end = next((trip.index for trip in found if trip.limit.action in ENDS), len(t))
        return [trip for trip in found if trip.index <= end]

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
        if not (outside.any() or watched.active or watched.outside or watched.since is not None):
            return found
        limit = watched.limit
        instant = limit.kind == "frozen"  # its delay is already part of the test
        for index, (moment, value) in enumerate(zip(t.tolist(), samples.tolist(), strict=True)):
            passed, watched.seen = moment - watched.seen, moment
            if limit.kind == "following" and self._ended_short(watched, moment):
                action = "stop" if limit.action == "hold" else limit.action  # a hold would be over at once
                found.append(Trip(replace(limit, action=action), index, moment, watched.mark[1]))
                if action in ENDS:
                    return found
                watched.active = True
            if not outside[index]:
                watched.since, watched.outside = None, max(0.0, watched.outside - passed)
                self._over(watched, index, moment, value, found)
                continue
            begins = watched.since is None
            watched.since = since = moment if watched.since is None else watched.since
            if limit.kind == "following" and self._comes_nearer(watched, moment, value, begins=begins):
                watched.outside = max(0.0, watched.outside - passed)
            elif not begins and limit.kind != "range":  # the delay of a limit begins anew
                watched.outside += passed
            lasts = max(moment - since, watched.outside) >= limit.delay
            if (instant or lasts) and not watched.active:
                found.append(Trip(limit, index, moment, float(shown[index])))
                if limit.action in ENDS:
                    return found
                watched.active = True
        return found

    def _comes_nearer(self, watched: _Watched, moment: float, value: float, *, begins: bool) -> bool:
        """Whether a value that is too far from its command moves towards it: then it only lags, as every regulator."""
        limit = watched.limit
        if begins:
            watched.mark, watched.moves = (moment, value), 0.0
        way = value - watched.mark[1]
        if abs(way) >= FALLS * (limit.high or 0.0) > 0:
            watched.mark, watched.moves = (moment, value), math.copysign(1.0, way)
        elif moment - watched.mark[0] > FALLS * limit.delay:
            watched.moves = 0.0
        watched.nears = watched.moves * (self._asked(limit.channel, moment) - value) > 0
        return watched.nears

    def _not_falling(self, watched: _Watched, t: Array, samples: Array) -> list[Trip]:
        """A vent, if a value above its command does not fall: a pressure where a vented muscle is commanded, or any
        while the bench is held.

        Nothing is sent during a hold, so a stuck valve or another program's command is not corrected. At rest nobody
        expects pressure.
        """
        limit, most = watched.limit, watched.limit.high or 0.0
        for index in range(len(t)):
            moment, value = float(t[index]), float(samples[index])
            asked = self._asked(limit.channel, moment)
            if value == value != watched.last:
                first = watched.last is None
                watched.every = 0.0 if first else min(watched.every or math.inf, moment - watched.changed)
                watched.last, watched.changed = value, moment
            at_rest = limit.action != "warn" and self._at_rest(limit, moment)
            if not value - asked > most or not (at_rest or limit.action == "hold"):
                watched.high = None
            elif watched.high is None or value < watched.high[1] - FALLS * most:
                watched.high = moment, value
            elif moment - watched.high[0] >= max(LEAST, min(limit.delay, 2 * watched.every if at_rest else math.inf)):
                return [Trip(replace(limit, kind="above", action="vent"), index, moment, value)]
        return []

    def _at_rest(self, limit: TripRecord, t: float) -> bool:
        """Whether a vented muscle is commanded where a pressure is watched."""
        return CHANNEL_QUANTITY[limit.channel] == "pressure" and self._asked(limit.channel, t) <= self._rest

    def _ended_short(self, watched: _Watched, moment: float) -> bool:
        """Whether a vent follows on a pressure that was too far from its command for `LEAST` and came no nearer.

        At zero every gauge follows, also one in another unit: without this, holds shorter than the limit's time would
        pressurise the muscle again and again.
        """
        under, watched.under = watched.under, not self._at_rest(watched.limit, moment)
        short = watched.since is not None and watched.outside >= LEAST and not watched.nears
        return under and not watched.under and short and not watched.active

    @staticmethod
    def _over(watched: _Watched, index: int, t: float, value: float, found: list[Trip]) -> None:
        if watched.active:
            watched.active, watched.outside = False, 0.0
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
