"""Where samples come from: devices that the engine opens itself, and each stream with its clock, flags and samples.

Devices that only measure are opened by the engine, each called from its own thread with a deadline. Missing or late
samples are flagged by their times alone, overrange and slack by their values.
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
"""How long handing over samples may take [s]."""
SOON = 0.1
"""A stream that gives nothing for so long [s] may be that of another device now."""


class OwnLinks(Links):
    """Links whose calls may take as long as handing over samples does."""

    patience = hands_over = COLLECTS_WITHIN


class OwnSupervision(Supervision):
    """Questions of the engine."""

    def hasten(self, name: str) -> None:
        """Ask a device with the next look, whenever it was asked before."""
        self._since.pop(name + HELD[0], None)


class OwnStream:
    """The stream of a device that the engine calls itself; where it stops the device is asked at once what it is."""

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
        """Begin it at `rate` [Hz], without waiting for that, where nothing has come for too long."""
        now = self._clock.now()
        if now - self._came > max(SILENT, self._soon) and (self._again is None or self._again.done.is_set()):
            device = self._links.need(self._name, Stream, "takes no samples")
            self._came, self._again = now, self._links.submit(self._name, partial(device.start, rate))


class OwnDevices:
    """The devices of a bench that carry no output; none in virtual time, where the guard has all."""

    def __init__(self, bench: CompiledBench, clock: Clock) -> None:
        self._records = [record for record in bench.devices if bench.realtime and not record.guarded]
        self._clock, self._links = clock, OwnLinks(bench, clock, threads=True)
        self.identities: Mapping[str, Identity] = self._links.identities
        self.streams: dict[str, OwnStream] = {}
        self.channels = frozenset(channel.name for record in self._records for channel in record.channels)
        self.supervision = OwnSupervision(bench, self._links, clock, lambda output: step(output.safe), {})
        """Whether they are as they were when the bench was armed; they have no outputs."""

    def open(self) -> None:
        """Open all, at the same time; on failure those already open are closed."""
        self._links.open(self._records, lambda _name: [], forgiving=False)
        for name, device in self._links.devices.items():
            if isinstance(device, Stream):
                self.streams[name] = OwnStream(self._links, name, self._clock, self.supervision.hasten)

    def keep_measuring(self, rate: float) -> None:
        """Begin each stream at `rate` [Hz] that has failed: what confirms a vent may be measured by it."""
        for stream in self.streams.values():
            stream.keep_measuring(rate)

    def close(self) -> None:
        """Let go of all; harmless when repeated."""
        self._links.close(disarm=False)


Array = NDArray[np.float64]
Flags = NDArray[np.uint16]

APART = 1.5
"""A sample that comes more than so many periods after the one before is late or follows a missing one [1] ..."""
LATE_ONLY = 1.75
"""... up to here it is only late: with one missing before it, it would have come early."""
CARRIED = 0.25
"""A sample later than this shortens the step to the next one [periods]; less is jitter of the clock."""
MISSING = 0.75
"""A sample counts as missing, not late, where steps are longer than they should be by so many periods [1]."""
WAITING = 12
"""At most so many samples wait for later ones to decide their flag: made-up polls come a few at once or never."""


class Spacing:
    """Whether samples are missing before a sample (GAP), or it only came late (LATE), from block to block.

    Polls at absolute deadlines that are late by x periods make one step of 1 + x and, with those that are made up, the
    next ones shorter by x in all; where a sample is missing they stay longer. So where x is near 1 or more the samples
    after decide, and until they are there the last ones are `open`.
    """

    def __init__(self, rate: float) -> None:
        self._period = 1e9 / rate
        self._last: int | None = None
        self._late = 0.0
        self._open: list[float] = []
        """How late the samples that are open would be, if none were missing [periods]."""

    @property
    def open(self) -> int:
        """How many of the newest samples still wait for the next one to decide their flag."""
        return len(self._open)

    def look(self, time_ns: Sequence[int] | NDArray[np.int64]) -> tuple[list[int], list[int]]:
        """The flags of the samples that were open, oldest first, and those of the samples at `time_ns`.

        0 where a sample is open now.
        """
        were = self.open
        flags = [0] * were
        if isinstance(time_ns, np.ndarray) and self._even(time_ns):
            return flags, [0] * len(time_ns)
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
        """Whether no sample is late or missing, nor waits, so that nothing is carried over; they then count as seen."""
        if self._open or self._late or not len(time_ns):
            return False
        first = 0 if self._last is None else int(time_ns[0]) - self._last
        if (time_ns[1:] - time_ns[:-1]).max(initial=first) / self._period - 1.0 > CARRIED:
            return False
        self._last = int(time_ns[-1])
        return True

    def settle(self) -> list[int]:
        """The flags of the samples that still wait, at the end of the recording."""
        return self._decide(1.0)

    def _decide(self, step: float) -> list[int]:
        """The flags of the samples that wait, decided by the `step` [periods] to the next sample."""
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
    """Overrange and slack, and how far each channel has gone: `extremes` [SI], lowest and highest."""

    def __init__(self, slack_below: float) -> None:
        self._slack_below = slack_below
        self.extremes: dict[str, tuple[float, float]] = {}

    def block(self, channels: Mapping[str, ChannelRecord], values: Mapping[str, Array], count: int) -> Flags:
        """Flags of `count` samples, of shape (n,); `values` [SI] have that shape too."""
        flags = np.zeros(count, dtype=np.uint16)
        for name, value in values.items():
            channel = channels[name]
            low, high = float(value.min()), float(value.max())
            if low == low and high == high:
                seen = self.extremes.get(name, (low, high))
                self.extremes[name] = (min(seen[0], low), max(seen[1], high))
            if not (low > channel.low and high < channel.high):  # also where one is no number
                inside = (value > channel.low) & (value < channel.high)
                if channel.raw_type != "int32":
                    inside = (value >= channel.low) & (value <= channel.high)
                flags[~inside] |= np.uint16(Flag.OVERRANGE)
        force = values.get("force")
        if self._slack_below > 0 and force is not None:
            flags[force < self._slack_below] |= np.uint16(Flag.SLACK)
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
    """Samples as the recorder takes them: all of shape (n,); `host` is when the newest was here [ns, bench time]."""

    time_ns: NDArray[np.int64]
    columns: Mapping[str, Any]
    flags: NDArray[np.uint16]
    host: int | None


class Source:
    """A stream with its clock offset, and the samples that were not handed to the recorder yet."""

    def __init__(
        self, name: str, stream: Stream, channels: Sequence[ChannelRecord], recorded: Sequence[str], drift: float
    ) -> None:
        self.name = name
        self.stream = stream
        self.channels = {channel.name: channel for channel in channels}
        self.recorded = [channel.name for channel in channels if channel.name in recorded]
        self.spacing = Spacing(1.0)
        self.last: int | None = None
        """The newest sample, on the device's clock [ns]."""
        self.newest = -inf
        """When it was taken, by the shortest delay so far [s, bench time]."""
        self.is_old = False
        """Whether it was too old when it came to count as heard."""
        self.heard = 0.0
        """When one came last that was not too old [s]."""
        self.scales = [(channel, channel.scale.slope, channel.scale.offset) for channel in channels]
        self.clock = DeviceClock(drift)
        self._rows: list[tuple[int, Mapping[str, Sequence[float]], int, int | None]] = []
        """Single samples: time [ns], raw columns of length 1, flags, arrival [ns].

        The newest ones wait where only the next one shows whether they are late or samples are missing before them.
        """

    def flag(self, flags: Sequence[int]) -> None:
        """Set the flags of the samples that wait (the newest last), now that the next one has decided them."""
        for place, flag in enumerate(flags, len(self._rows) - len(flags)):
            if flag and place >= 0:  # what came before the recording began is not kept
                time_ns, columns, before, arrival = self._rows[place]
                self._rows[place] = time_ns, columns, before | flag, arrival

    def keep(self, time_ns: int, columns: Mapping[str, Sequence[float]], flags: int, host: int | None) -> int:
        """Keep a single sample; how many are kept and can be handed over, 0 while the newest wait."""
        self._rows.append((time_ns, columns, flags, host))
        return 0 if self.spacing.open else len(self._rows)

    def kept(self) -> Iterator[Piece]:
        """The single samples, which are let go; none where there are none."""
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
        """What was kept and then this block, but for the newest samples that wait for the next block."""
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
