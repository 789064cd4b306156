"""Acquisition: collects blocks from the streams, scales, flags, watches and records them; knows no steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import floor
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, LimitTripped, RecordError
from pmabench.bench.interface import Block, ChannelRecord, CompiledBench, Device, Stream
from pmabench.engine.watch import Trip, Watch
from pmabench.store.records import Flag

Array = NDArray[np.float64]

GAP, OVERRANGE, SLACK = (np.uint16(flag) for flag in (Flag.GAP, Flag.OVERRANGE, Flag.SLACK))

VIRTUAL_BLOCK = 1.0
REAL_BLOCK = 0.05
SILENCE = 1.0
"""A stream that gives nothing for so long [s] has failed."""


class Recorder(Protocol):
    """Where samples and events go: a run folder, or nowhere when a plan is only tried."""

    def append(
        self, stream: str, time_ns: NDArray[np.int64], columns: Mapping[str, Any], flags: NDArray[np.uint16]
    ) -> None:
        """Samples as the device gave them."""
        ...

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Something that happened at bench time `t` [s]."""
        ...


class NoRecord:
    """A recorder that keeps nothing but the events."""

    def __init__(self) -> None:
        self.events: list[tuple[str, float, dict[str, Any]]] = []

    def append(self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any) -> None:
        """Nothing is kept."""

    def event(self, kind: str, t: float, **data: Any) -> None:
        """Kept in memory."""
        self.events.append((kind, t, data))


class Forgiving:
    """A recorder in front of another one, whose failure is noted once and stops nothing."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.lost: RecordError | None = None

    def append(self, stream: str, time_ns: Any, columns: Mapping[str, Any], flags: Any) -> None:
        """As the other one, while it can."""
        self._attempt(lambda: self._recorder.append(stream, time_ns, columns, flags))

    def event(self, kind: str, t: float, **data: Any) -> None:
        """As the other one, while it can."""
        self._attempt(lambda: self._recorder.event(kind, t, **data))

    def _attempt(self, write: Callable[[], None]) -> None:
        try:
            write()
        except RecordError as error:
            self.lost = self.lost or error


@dataclass(frozen=True)
class Samples:
    """A block in SI: `t` [s] and each of `values` have shape (n,)."""

    t: Array
    values: Mapping[str, Array]


Stop = Callable[[Samples], int | None]
"""Index of the sample at which to stop, or None to go on."""


class _Source:
    """One stream with its channels."""

    def __init__(self, name: str, stream: Stream, channels: Sequence[ChannelRecord], recorded: Sequence[str]) -> None:
        self.name = name
        self.stream = stream
        self.channels = {channel.name: channel for channel in channels}
        self.recorded = [channel.name for channel in channels if channel.name in recorded]
        self.rate = 0.0
        self.last: int | None = None
        self.heard = 0.0
        self.scales = [(channel.name, channel.scale.slope, channel.scale.offset) for channel in channels]
        self.rows: list[tuple[int, Mapping[str, Sequence[float]], int]] = []
        """Single samples that are not handed to the recorder yet: time [ns], raw columns of length 1, flags."""


class Acquisition:
    """Samples all streams of a bench at one rate."""

    def __init__(
        self,
        bench: CompiledBench,
        devices: Mapping[str, Device],
        clock: Clock,
        rate: float,
        record: Sequence[str],
        recorder: Recorder,
    ) -> None:
        self.clock = clock
        self.rate = rate
        self._recording = False
        self.latest: dict[str, float] = {}
        self.counts = {"rows": 0, "gaps": 0, "overrange": 0, "slack": 0}
        self.extremes: dict[str, tuple[float, float]] = {}
        self.check: Callable[[], None] = lambda: None
        self._recorder = recorder
        self._watch: Watch | None = Watch(bench.trips)
        self._slack_below = bench.slack_below
        self._block = REAL_BLOCK if bench.realtime else VIRTUAL_BLOCK
        self._sources: list[_Source] = []
        for device in bench.devices:
            opened = devices[device.name]
            if isinstance(opened, Stream) and device.channels:
                self._sources.append(_Source(device.name, opened, device.channels, record))

    def start(self) -> None:
        """Begin to sample every stream."""
        for source in self._sources:
            source.rate = source.stream.start(self.rate)
            source.heard = self.clock.now()

    def stop(self) -> None:
        """End sampling; harmless when repeated."""
        self.record(on=False)
        for source in self._sources:
            source.stream.stop()

    @property
    def recording(self) -> bool:
        """Whether samples are recorded."""
        return self._recording

    def record(self, *, on: bool) -> None:
        """Record samples from now on, or no longer."""
        for source in self._sources:
            self._flush(source)
        self._recording = on

    def begin_safe_state(self) -> None:
        """No more trips, and a record that fails stops nothing any more: nothing may cancel the safe state."""
        self.check = lambda: None
        self._watch = None
        self._recorder = Forgiving(self._recorder)

    @property
    def lost(self) -> RecordError | None:
        """Why samples of the safe state were not recorded."""
        return self._recorder.lost if isinstance(self._recorder, Forgiving) else None

    def pass_time(self, duration: float, stop: Stop | None = None) -> float | None:
        """Let bench time pass; see `until`."""
        return self.until(self.clock.now() + duration, stop)

    def until(self, deadline: float, stop: Stop | None = None) -> float | None:
        """Sample until `deadline` [s], or until `stop` says so; the time of the stop [s], or None.

        Raises LimitTripped when a measured limit is crossed; time then stands at that sample where it can.
        """
        while True:
            self.check()
            self.clock.wait_until(min(self.clock.now() + self._block, deadline))
            stopped = self._collect(stop)
            if stopped is not None:
                return stopped
            if self.clock.now() >= deadline - 1e-9:
                return None

    def sample(self) -> tuple[float, Mapping[str, float]]:
        """Wait for the next sample of all channels; its time [s] and the values [SI]."""
        period = 1.0 / self.rate
        self.clock.wait_until((floor(self.clock.now() / period + 1e-6) + 1.0) * period)
        self.check()
        for source in self._sources:
            block = source.stream.collect()
            if len(block.time) == 1 and source.last is not None:
                self._single(source, block)
            else:
                self._take(source, block, None)
        return self.clock.now(), self.latest

    def measure(self) -> Mapping[str, float]:
        """A tenth of a second of samples; the latest of them [SI], nothing older. For confirming the safe state."""
        self.latest.clear()
        self.clock.wait_until(self.clock.now() + max(0.1, 1.5 / self.rate))
        self._collect(None)
        return self.latest

    def _collect(self, stop: Stop | None) -> float | None:
        stopped: float | None = None
        for source in self._sources:
            at = self._take(source, source.stream.collect(), stop)
            stopped = at if stopped is None else stopped
        return stopped

    def _take(self, source: _Source, block: Block, stop: Stop | None) -> float | None:
        """Scale, watch, flag and record a block; the time at which `stop` ended it. Raises Tripped."""
        time_ns = np.asarray(block.time, dtype=np.int64)
        count = len(time_ns)
        if count == 0:
            if self.clock.now() - source.heard > SILENCE + 1.5 / self.rate:
                raise DeviceError(source.name, f"has sent no sample for {SILENCE:g} s")
            return None
        source.heard = self.clock.now()
        raw = {name: np.asarray(block.columns[name]) for name in source.channels}
        t = np.asarray(time_ns * 1e-9, dtype=np.float64)
        values = {name: source.channels[name].scale.to_si(raw[name]) for name in raw}
        stopped: float | None = None
        trip = self._watch.look(t, values) if self._watch is not None else None
        index = trip.index if trip is not None else None
        at = stop(Samples(t, values)) if stop is not None else None
        if at is not None and (index is None or at < index):
            index, stopped = at, float(t[at])
        if index is not None and index < count - 1 and self.clock.back_to(float(t[index])):
            trip = trip if trip is not None and trip.index <= index else None  # later ones did not happen
            source.stream.collect()  # nothing new; lets the device see that time went back before it goes on
            count = index + 1
            time_ns = time_ns[:count]
            raw = {name: column[:count] for name, column in raw.items()}
            values = {name: column[:count] for name, column in values.items()}
        self._keep(source, time_ns, raw, values)
        if trip is not None:
            raise Tripped(trip)
        return stopped

    def _single(self, source: _Source, block: Block) -> None:
        """As `_take` for one sample, in plain numbers: a loop closed at 500 Hz has 2 ms for everything."""
        time_ns, columns = int(block.time[0]), block.columns
        source.heard = self.clock.now()
        flags = 0
        for name, slope, offset in source.scales:
            value = columns[name][0] * slope + offset
            self.latest[name] = value
            low, high = self.extremes.get(name, (value, value))
            if value < low or value > high:
                self.extremes[name] = (min(low, value), max(high, value))
            channel = source.channels[name]
            if not channel.low < value < channel.high and (
                channel.raw_type == "int32" or not channel.low <= value <= channel.high
            ):
                flags |= int(Flag.OVERRANGE)
                self.counts["overrange"] += 1
        if time_ns - (source.last or time_ns) > 1.5e9 / source.rate:
            flags |= int(Flag.GAP)
            self.counts["gaps"] += 1
        source.last = time_ns
        if self._slack_below > 0 and self.latest.get("force", self._slack_below) < self._slack_below:
            flags |= int(Flag.SLACK)
            self.counts["slack"] += self._recording
        if self._recording:
            source.rows.append((time_ns, columns, flags))
            if len(source.rows) >= self.rate * self._block:
                self._flush(source)
        trip = self._watch.look_once(time_ns * 1e-9, self.latest) if self._watch is not None else None
        if trip is not None:
            raise Tripped(trip)

    def _flush(self, source: _Source) -> None:
        """Hand single samples to the recorder."""
        if source.rows:
            rows, source.rows = source.rows, []
            self.counts["rows"] += len(rows)
            self._recorder.append(
                source.name,
                np.array([row[0] for row in rows], dtype=np.int64),
                {name: np.array([row[1][name][0] for row in rows]) for name in source.recorded},
                np.array([row[2] for row in rows], dtype=np.uint16),
            )

    def _keep(
        self, source: _Source, time_ns: NDArray[np.int64], raw: Mapping[str, Any], values: Mapping[str, Array]
    ) -> None:
        flags = np.zeros(len(time_ns), dtype=np.uint16)
        if len(time_ns) > 1 or source.last is not None:
            before = time_ns[0] if source.last is None else source.last
            gaps = np.diff(time_ns, prepend=before) > 1.5e9 / source.rate
            if gaps.any():
                flags[gaps] |= GAP
                self.counts["gaps"] += int(gaps.sum())
        source.last = int(time_ns[-1])
        for name, value in values.items():
            channel = source.channels[name]
            low, high = float(value.min()), float(value.max())
            if low == low and high == high:
                seen = self.extremes.get(name, (low, high))
                self.extremes[name] = (min(seen[0], low), max(seen[1], high))
            if not (low > channel.low and high < channel.high):  # also where one is no number
                inside = (value > channel.low) & (value < channel.high)
                if channel.raw_type != "int32":
                    inside = (value >= channel.low) & (value <= channel.high)
                over = ~inside
                flags[over] |= OVERRANGE
                self.counts["overrange"] += int(over.sum())
            self.latest[name] = float(value[-1])
        force = values.get("force")
        if self._slack_below > 0 and force is not None:
            slack = force < self._slack_below
            flags[slack] |= SLACK
            self.counts["slack"] += int(slack.sum()) if self._recording else 0
        if self._recording:
            self._flush(source)
            self.counts["rows"] += len(time_ns)
            self._recorder.append(source.name, time_ns, {name: raw[name] for name in source.recorded}, flags)


class Tripped(LimitTripped):
    """A measured limit was crossed."""

    def __init__(self, trip: Trip) -> None:
        self.trip = trip
        super().__init__(str(trip))
