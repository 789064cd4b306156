"""Sources of samples: devices that the engine opens itself, and for each stream its clock, flags and kept samples.

The engine opens the devices that only measure; each is called from its own thread with a deadline. Missing and late
samples are flagged from their times alone, overrange and slack from their values.
"""
# mypy: disable-error-code="type-abstract"

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from math import floor, inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmabench.base.clock import Clock, DeviceClock
from pmabench.bench.interface import Block, ChannelRecord, CompiledBench, Identity, Stream
from pmabench.guard.course import step
from pmabench.guard.guard import SILENT
from pmabench.guard.links import Links
from pmabench.guard.owner import Call
from pmabench.guard.supervision import HELD, Supervision
from pmabench.store.records import Flag

COLLECTS_WITHIN = 0.5
"""Longest time for a device to return its samples [s]."""
SOON = 0.1
"""A stream without samples for this long [s] may come from another device now, so its identity is checked."""


class OwnLinks(Links):
    """Links with the longer deadline that a read of samples needs."""

    patience = hands_over = COLLECTS_WITHIN


class OwnSupervision(Supervision):
    """Identity checks of the engine's own devices."""

    def hasten(self, name: str) -> None:
        """Check a device at the next opportunity, even if it was checked recently."""
        self._since.pop(name + HELD[0], None)


class OwnStream:
    """Stream of a device that the engine calls itself; if samples stop, the device's identity is checked at once."""

    def __init__(self, links: Links, name: str, clock: Clock, hasten: Callable[[str], None]) -> None:
        self._links, self._name, self._clock, self._hasten = links, name, clock, hasten
        self._heard = self._soon = self._came = 0.0
        self._again: Call | None = None

    def start(self, rate: float) -> float:
        """As `Stream.start`."""
        used = self._links.stream(self._name, rate)
        self._heard = self._came = self._clock.now()
        self._soon = max(SOON, 3.0 / used)
        return used

    def stop(self) -> None:
        """As `Stream.stop`."""
        self._links.stream(self._name, 0.0)

    def collect(self) -> Block:
        """As `Stream.collect`."""
        block = self._links.collect(self._name)
        now = self._clock.now()
        if len(block.time):
            self._heard = self._came = now
        elif now - self._heard > self._soon:
            self._heard = now
            self._hasten(self._name)
        return block

    def keep_measuring(self, rate: float) -> None:
        """Restart the stream at `rate` [Hz] where nothing has arrived for too long, without waiting for the restart."""
        now = self._clock.now()
        if now - self._came > max(SILENT, self._soon) and (self._again is None or self._again.done.is_set()):
            device = self._links.need(self._name, Stream, "takes no samples")
            self._came, self._again = now, self._links.submit(self._name, partial(device.start, rate))


class OwnDevices:
    """The devices of a bench without outputs; none in virtual time, where the guard has all devices."""

    def __init__(self, bench: CompiledBench, clock: Clock) -> None:
        self._records = [record for record in bench.devices if bench.realtime and not record.guarded]
        self._clock, self._links = clock, OwnLinks(bench, clock, threads=True)
        self.identities: Mapping[str, Identity] = self._links.identities
        self.streams: dict[str, OwnStream] = {}
        self.channels = frozenset(channel.name for record in self._records for channel in record.channels)
        self.supervision = OwnSupervision(bench, self._links, clock, lambda output: step(output.safe), {})
        """Checks whether the devices are as they were when the bench was armed."""

    def open(self) -> None:
        """Open all devices in parallel; on failure those already open are closed."""
        self._links.open(self._records, lambda _name: [], forgiving=False)
        for name, device in self._links.devices.items():
            if isinstance(device, Stream):
                self.streams[name] = OwnStream(self._links, name, self._clock, self.supervision.hasten)

    def keep_measuring(self, rate: float) -> None:
        """Restart each failed stream at `rate` [Hz], because it may measure what confirms a vent."""
        for stream in self.streams.values():
            stream.keep_measuring(rate)

    def close(self) -> None:
        """Close all devices; may be called again."""
        self._links.close(disarm=False)


Array = NDArray[np.float64]
Flags = NDArray[np.uint16]

APART = 1.5
"""A sample more than this many periods after the previous one is late, or follows a missing sample [1] ..."""
LATE_ONLY = 1.75
"""... up to this many it is only late: after a missing sample it would itself be early."""
CARRIED = 0.25
"""A delay longer than this shortens the step to the next sample [periods]; shorter ones are jitter of the clock."""
MISSING = 0.75
"""A sample counts as missing, not late, if the steps stay too long by this many periods [1]."""
WAITING = 12
"""Largest number of samples that wait for later ones to decide their flag [1]: polls are caught up soon or never."""


class Spacing:
    """Whether samples are missing before a sample (GAP), or it only came late (LATE), from block to block.

    A poll at an absolute deadline that is late by x periods makes one step of 1 + x; the next steps are shorter by x in
    total when the polls catch up, but not if a sample is missing. So for x near 1 or more the following samples decide,
    and until they arrive the newest samples are `open`.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1e9 / rate
        self._last: int | None = None
        self._late = 0.0
        self._open: list[float] = []
        """Delay of each open sample if none is missing [periods]."""

    @property
    def open(self) -> int:
        """Number of newest samples whose flags are not decided yet."""
        return len(self._open)

    def look(self, time_ns: Sequence[int] | NDArray[np.int64]) -> tuple[list[int], list[int]]:
        """Flags of the samples that were open, oldest first, and those of the samples at `time_ns`.

        0 where a sample is still open. Both are empty where no sample is late, missing or open.
        """
        if isinstance(time_ns, np.ndarray) and self._even(time_ns):
            return [], []
        were = self.open
        flags = [0] * were
        for time in time_ns:
            step = 1.0 if self._last is None else (time - self._last) / self._period
            self._last = time
            if self._open and step < MISSING <= self._open[-1] + step - 1.0 and self.open < WAITING:
                self._open.append(self._open[-1] + step - 1.0)
                flags.append(0)
                continue
            decided = self._decide(step)
            flags[len(flags) - len(decided) :] = decided
            step += self._late
            flags.append(int(Flag.LATE) if APART < step <= LATE_ONLY else 0)
            if step > LATE_ONLY:
                self._open, self._late = [step - 1.0], 0.0
            else:
                self._late = step - 1.0 if step - 1.0 > CARRIED else 0.0
        return flags[:were], flags[were:]

    def _even(self, time_ns: NDArray[np.int64]) -> bool:
        """Whether no sample is late, missing or open; if so the samples are marked as processed."""
        if self._open or self._late or not len(time_ns):
            return False
        first = 0 if self._last is None else int(time_ns[0]) - self._last
        if (time_ns[1:] - time_ns[:-1]).max(initial=first) / self._period - 1.0 > CARRIED:
            return False
        self._last = int(time_ns[-1])
        return True

    def settle(self) -> list[int]:
        """Flags of the samples that are still open at the end of the recording."""
        return self._decide(1.0)

    def _decide(self, step: float) -> list[int]:
        """Flags of the open samples, decided by the `step` [periods] to the next sample."""
        late, self._open = self._open, []
        if not late:
            return []
        beyond = late[-1] + step - 1.0
        lost = floor(beyond + 1.0 - MISSING) if beyond >= MISSING else 0
        self._late = late[-1] - lost if not lost or late[-1] - lost > CARRIED else 0.0
        found = [int(Flag.LATE) if x - lost > APART - 1.0 else 0 for x in late]
        if lost:
            found[0] = int(Flag.GAP)
        return found


class Ranges:
    """Flags overrange and slack, and keeps each channel's lowest and highest value [SI] in `extremes`."""

    def __init__(self, slack_below: float) -> None:
        self._slack_below = slack_below
        self.extremes: dict[str, tuple[float, float]] = {}

    def block(
        self,
        channels: Mapping[str, ChannelRecord],
        values: Mapping[str, Array],
        extremes: Mapping[str, tuple[float, float]],
        count: int,
    ) -> Flags:
        """Flags of `count` samples, of shape (n,); `values` [SI], with their `extremes`, have that shape too."""
        flags = np.zeros(count, dtype=np.uint16)
        for name, value in values.items():
            channel, (low, high) = channels[name], extremes[name]
            if low == low and high == high:
                seen = self.extremes.get(name, (low, high))
                self.extremes[name] = (min(seen[0], low), max(seen[1], high))
            if not (low > channel.low and high < channel.high):  # also true for NaN
                inside = (value > channel.low) & (value < channel.high)
                if channel.raw_type != "int32":
                    inside = (value >= channel.low) & (value <= channel.high)
                flags[~inside] |= np.uint16(Flag.OVERRANGE)
        if self._slack_below > 0 and "force" in values and not extremes["force"][0] >= self._slack_below:
            flags[values["force"] < self._slack_below] |= np.uint16(Flag.SLACK)
        return flags

    def one(self, channels: Iterable[ChannelRecord], values: Mapping[str, float]) -> int:
        """As `block` for a single sample, in plain numbers: a loop closed at 500 Hz has 2 ms for everything."""
        flags = 0
        for channel in channels:
            value = values[channel.name]
            low, high = self.extremes.get(channel.name, (value, value))
            if value < low or value > high:
                self.extremes[channel.name] = (min(low, value), max(high, value))
            if not channel.low < value < channel.high and (
                channel.raw_type == "int32" or not channel.low <= value <= channel.high
            ):
                flags |= int(Flag.OVERRANGE)
        if self._slack_below > 0 and values.get("force", self._slack_below) < self._slack_below:
            flags |= int(Flag.SLACK)
        return flags


class Piece(NamedTuple):
    """Samples for the recorder, arrays of shape (n,); `host` is the arrival of the newest [ns, bench time]."""

    time_ns: NDArray[np.int64]
    columns: Mapping[str, Any]
    flags: NDArray[np.uint16]
    host: int | None


class Source:
    """A stream with its clock offset, and the samples not yet passed to the recorder."""

    def __init__(
        self, name: str, stream: Stream, channels: Sequence[ChannelRecord], recorded: Sequence[str], drift: float
    ) -> None:
        self.name = name
        self.stream = stream
        self.channels = {channel.name: channel for channel in channels}
        self.recorded = [channel.name for channel in channels if channel.name in recorded]
        self.spacing = Spacing(1.0)
        self.last: int | None = None
        """Time of the newest sample on the device's clock [ns]."""
        self.newest = -inf
        """Time of the newest sample, from the shortest delay so far [s, bench time]."""
        self.is_old = False
        """Whether the newest sample was too old on arrival to count as a sign of life."""
        self.heard = 0.0
        """Arrival of the last sample that was not too old [s, bench time]."""
        self.scales = [(channel, channel.scale.slope, channel.scale.offset) for channel in channels]
        self.clock = DeviceClock(drift)
        self._rows: list[tuple[int, Mapping[str, Sequence[float]], int, int | None]] = []
        """Single samples: time [ns], raw columns of length 1, flags, arrival [ns].

        The newest may be open: only the next sample shows whether they are late or samples before them are missing.
        """

    def flag(self, flags: Sequence[int]) -> None:
        """Set the flags of the open samples (the newest last), now that they are decided."""
        for place, flag in enumerate(flags, len(self._rows) - len(flags)):
            if flag and place >= 0:  # samples before the recording are not kept
                time_ns, columns, before, arrival = self._rows[place]
                self._rows[place] = time_ns, columns, before | flag, arrival

    def keep(self, time_ns: int, columns: Mapping[str, Sequence[float]], flags: int, host: int | None) -> int:
        """Keep a single sample; returns how many can be passed on: all that are kept, 0 while one is open."""
        self._rows.append((time_ns, columns, flags, host))
        return 0 if self.spacing.open else len(self._rows)

    def kept(self) -> Iterator[Piece]:
        """The kept single samples as one piece, if any; they are no longer kept afterwards."""
        if self._rows:
            rows, self._rows = self._rows, []
            yield Piece(
                np.array([row[0] for row in rows], dtype=np.int64),
                {name: np.array([row[1][name][0] for row in rows]) for name in self.recorded},
                np.array([row[2] for row in rows], dtype=np.uint16),
                rows[-1][3],
            )

    def pieces(
        self, time_ns: NDArray[np.int64], raw: Mapping[str, Any], flags: NDArray[np.uint16], host: int | None
    ) -> Iterator[Piece]:
        """The kept samples and then this block, without its open samples, which are kept for the next block."""
        ready = max(0, len(time_ns) - self.spacing.open)
        columns = {name: raw[name] for name in self.recorded}
        if ready == len(time_ns):
            yield from self.kept()
            yield Piece(time_ns, columns, flags, host)
            return
        if ready:
            yield from self.kept()
            yield Piece(
                time_ns[:ready], {name: column[:ready] for name, column in columns.items()}, flags[:ready], None
            )
        for i in range(ready, len(time_ns)):
            one = {name: column[i : i + 1] for name, column in columns.items()}
            self.keep(int(time_ns[i]), one, int(flags[i]), host)
