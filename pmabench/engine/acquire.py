"""Acquisition: collects blocks from the streams, scales them, checks them against limits and records them.

Knows no steps.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import floor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, LimitRefused, LimitTripped, PmaError, RecordError
from pmabench.base.quantities import CHANNEL_QUANTITY
from pmabench.bench.interface import Block, CompiledBench, Stream
from pmabench.engine.commanded import Commanded
from pmabench.engine.recorder import Forgiving, Recorder
from pmabench.engine.source import Piece, Ranges, Source, Spacing
from pmabench.engine.watch import ENDS, Trip, Watch, extremes_of
from pmabench.store.records import Flag

Array = NDArray[np.float64]

VIRTUAL_BLOCK = 1.0
"""Longest bench time between two reads of the streams in virtual time [s]: a crash loses no more than this."""
REAL_BLOCK = 0.05
SILENCE = 1.0
"""A stream that delivers nothing for longer than this [s], and longer than a block, has failed."""
OLD = 0.25
"""A sample that is older than this [s] on arrival does not count as a sign of life of its stream (see `SILENCE`).

Its age is relative to the shortest delay of its stream. The guard tolerates an engine that is silent for as long;
a computer that is busy for a moment delivers newer samples within a second.
"""
CATCHES_UP = 0.01
"""Interval at which samples still in transit are collected at the end of a recording [s]."""
HUNG = 2.0
"""An executor that asks for no sample for longer than this [s] has failed; real time only."""


@dataclass(frozen=True)
class Samples:
    """A block in SI: `t` [s] and each of `values` have shape (n,)."""

    t: Array
    values: Mapping[str, Array]


COUNTED = {"gaps": Flag.GAP, "late": Flag.LATE, "overrange": Flag.OVERRANGE, "slack": Flag.SLACK}
"""Name of each count of recorded samples -> the flag that it counts."""
Stop = Callable[[Samples], int | None]
"""Index of the sample at which to stop, or None to go on."""


class Acquisition:
    """Samples all streams of a bench at one rate."""

    def __init__(
        self,
        bench: CompiledBench,
        devices: Mapping[str, object],
        clock: Clock,
        rate: float,
        record: Sequence[str],
        recorder: Recorder,
    ) -> None:
        self.clock = clock
        self.rate = rate
        self.recording = False
        """Whether samples are recorded."""
        self.latest: dict[str, float] = {}
        self.counts = {"rows": 0, **dict.fromkeys(COUNTED, 0)}
        self._ranges = Ranges(bench.slack_below)
        self.rates: dict[str, float] = {}
        """Actual sampling rate of each device [Hz]."""
        self.check: Callable[[], None] = lambda: None
        self._recorder = recorder
        self.commanded = Commanded()
        self.on_trip: Callable[[str, bool, bool], None] = lambda _why, _latches, _hurry: None
        """Begins the safe state; may be called from any thread. Arguments: cause, latching, skip the ramps."""
        self.question: Callable[[float], None] = lambda _now: None
        """Starts to check at a bench time [s] whether devices are as they were when armed; never waits."""
        self.beat: Callable[[], None] = lambda: None
        """Reports to the guard that this program is alive, at times when it does not ask the guard for samples."""
        self.holding: set[str] = set()
        """Limits with the action `hold` that are exceeded now."""
        self._watch: Watch | None = Watch(bench.trips, bench.channels, self.commanded, bench.hands_below)
        self._bench = bench
        self._tripped: Exception | None = None
        self.doubted = set[str]()
        """Pressures that read low, and do not follow their command or do not change: they confirm no vent."""
        self._lock = threading.RLock()
        self._stop: Stop | None = None
        self._stopped: float | None = None
        self._collected = self._asked = self._beaten = 0.0
        guarded = {device.name for device in bench.devices if device.guarded and device.channels}
        self._mute = bench.realtime and not guarded
        """Whether the guard serves no stream: `beat` must replace the requests for samples as a sign of life."""
        self._changed = ""
        """A device that was exchanged or restarted: its values cannot confirm the safe state."""
        self._supervisors: list[threading.Thread] = []
        self._ending = threading.Event()
        self._realtime = bench.realtime
        self._block = REAL_BLOCK if bench.realtime else VIRTUAL_BLOCK
        self._sources: list[Source] = []
        for device in bench.devices:
            opened = devices[device.name]
            if isinstance(opened, Stream) and device.channels:
                self._sources.append(Source(device.name, opened, device.channels, record, device.drift))

    def switched(self, name: str, *, safe: bool) -> None:
        """Record that a valve is switched now: to its safe position, or to the opposite one."""
        at_rest = next(valve.safe for valve in self._bench.valves if valve.name == name)
        position = at_rest if safe else "closed" if at_rest == "open" else "open"
        self._recorder.event("valve", self.clock.now(), valve=name, position=position, text=f"{name} {position}")

    def start(self) -> None:
        """Begin to sample every stream."""
        for source in self._sources:
            rate = self.rates[source.name] = source.stream.start(self.rate)
            source.spacing = Spacing(rate)
            source.heard = self.clock.now()
        self._collected = self._asked = self.clock.now()

    def listen_anew(self) -> None:
        """Restart the measurement of silence: no samples were collected while the bench was being armed."""
        with self._lock:
            for source in self._sources:
                source.heard = self.clock.now()
            if self._watch is not None:
                self._watch.listen_anew()

    @property
    def extremes(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value [SI] of each channel."""
        return self._ranges.extremes

    def supervise(self) -> None:
        """Start two threads that check the samples whenever the executor does not, so that limits act even if it hangs.

        While one of them waits for a device, the other one reports to the guard that the program is alive.
        """
        self._supervisors = [threading.Thread(target=self._supervise, name="pmabench-watch", daemon=True) for _ in "12"]
        for supervisor in self._supervisors:
            supervisor.start()

    def stop(self) -> None:
        """End sampling; may be called again."""
        self._ending.set()
        for supervisor in self._supervisors:
            supervisor.join()
        self._supervisors = []
        self.record(on=False)
        for source in self._sources:
            source.stream.stop()

    @property
    def goes_back(self) -> bool:
        """Whether bench time can be set back to a sample: only virtual time with all channels in one stream can."""
        return not self._realtime and len(self._sources) == 1

    def record(self, *, on: bool) -> None:
        """Start or stop recording."""
        with self._lock:
            for source in self._sources:
                source.flag(source.spacing.settle())
                self._hand_over(source, source.kept())
            self.recording = on

    def begin_controlled_stop(self) -> None:
        """From now on act only on limits that vent at once: the others would stop a run that is already stopping."""
        with self._lock:
            limits = [limit for limit in self._bench.trips if limit.action == "vent"]
            self._watch = Watch(limits, self._bench.channels, self.commanded, self._bench.hands_below)
            self._tripped = None
            self.holding.clear()

    def begin_safe_state(self) -> None:
        """From now on raise no trips and ignore failures of the record: nothing may cancel the safe state."""
        self.check = lambda: None
        with self._lock:
            self._watch = None
            self._recorder = Forgiving(self._recorder)

    @property
    def lost(self) -> RecordError | None:
        """Why samples of the safe state were not recorded; None if they were."""
        return self._recorder.lost if isinstance(self._recorder, Forgiving) else None

    def pass_time(self, duration: float, stop: Stop | None = None, *, looks_only: bool = False) -> float | None:
        """Let `duration` [s] of bench time pass; see `until`."""
        return self.until(self.clock.now() + duration, stop, looks_only=looks_only)

    def until(self, deadline: float, stop: Stop | None = None, *, looks_only: bool = False) -> float | None:
        """Sample until `deadline` [s] or until `stop` ends it; returns the time of that stop [s], or None.

        `looks_only`: `stop` sees every sample, but never stops. Raises LimitTripped when a measured limit is exceeded;
        bench time is set back to that sample where possible.
        """
        with self._lock:
            self._stop, self._stopped = stop, None
        if stop is None or looks_only:
            self.clock.set_quiet_until(deadline)
        try:
            while True:
                self.check()
                self._asked = self.clock.now()
                self.clock.wait_until(min(self._asked + self._block, deadline))
                self._collect()
                if self._stopped is not None:
                    return self._stopped
                if self.clock.now() >= deadline - 1e-9:
                    return None
        finally:
            self.clock.set_quiet_until(self.clock.now())
            with self._lock:
                self._stop = None

    def sample(self) -> tuple[float, Mapping[str, float]]:
        """Wait for the next sample of all channels; its time [s] and the values [SI]."""
        period = 1.0 / self.rate
        self._asked = self.clock.now()
        self.clock.wait_until((floor(self._asked / period + 1e-6) + 1.0) * period)
        self.check()
        self._collect(single=True)
        return self.clock.now(), self.latest

    def measure(self) -> Mapping[str, float]:
        """Sample for at least 0.1 s and return the latest values [SI], none older: they confirm the safe state."""
        self.latest.clear()
        begun = self.clock.now()
        self.clock.wait_until(begun + max(0.1, 1.5 / self.rate))
        self._collect()
        late = {
            name
            for source in self._sources
            if source.newest < begun or source.name == self._changed
            for name in source.channels
        }
        return {name: value for name, value in self.latest.items() if name not in late}

    def catch_up(self) -> float:
        """Wait until all samples taken up to now have arrived; returns that time [s]. No wait in virtual time."""
        now = self.clock.now()
        while self._realtime and any(
            source.recorded and source.newest + 1.0 / self.rates[source.name] <= now for source in self._sources
        ):
            self.pass_time(CATCHES_UP)
        return now

    def _collect(self, *, single: bool = False) -> None:
        """Take the new samples of every stream; with `single`, a lone sample is handled as plain numbers (faster)."""
        with self._lock:
            self._raise_trip()  # before a device is asked: the guard may have closed its line
            paused, self._collected = self.clock.now() - self._collected, self.clock.now()
            if self._realtime and paused > SILENCE:  # this program stopped, not its devices: the guard says so
                for source in self._sources:
                    source.heard = self._collected
            if self._mute and self._collected - self._beaten > self._block:
                self._beaten = self._collected
                self.beat()
            for source in self._sources:
                try:
                    block = source.stream.collect()
                    if single and len(block.time) == 1 and source.last is not None:
                        self._single(source, block)
                    else:
                        self._take(source, block)
                    self._refuse_silence(source)
                except PmaError:
                    if self._watch is not None:
                        raise  # in the safe state the other streams are still read
            if self._watch is not None:
                self._act(self._watch.silent(self.clock.now()))
                self._question()
            self._raise_trip()

    def _question(self) -> None:
        """End the run like a limit if a device was exchanged or restarted: its values may be wrong."""
        try:
            self.question(self.clock.now())
        except LimitRefused as error:
            self._changed = str(error).partition(":")[0]
            self.trip(str(error))

    def _raise_trip(self) -> None:
        """Raise the trip that another thread has found."""
        if self._tripped is not None and self._watch is not None:
            raise self._tripped

    def _supervise(self) -> None:
        """Thread body: collects if nobody did for longer than a block, and checks that the executor is alive."""
        while not self._ending.wait(self._block / 2):
            now = self.clock.now()
            if now - self._collected <= 1.2 * self._block:
                continue
            try:
                if not self._lock.acquire(timeout=self._block / 2):
                    # another thread waits for a device or the disk; both have deadlines
                    if now - self._collected < HUNG:
                        self.beat()
                    continue
                try:
                    self._collect()  # first: a guard that has taken over reports why
                except Exception as error:
                    self._end_by(error)  # before the lock is released, so that no other thread collects first
                finally:
                    self._lock.release()
                if now - self._asked > HUNG and self._watch is not None:
                    raise LimitTripped(f"the program has not asked for samples for {now - self._asked:.1f} s")
            except Exception as error:  # an error in the program ends the run like a lost device
                self._end_by(error)

    def trip(self, why: str) -> None:
        """End the run because of a fault seen only in several channels together: start the safe state and raise."""
        with self._lock:
            self._raise_trip()
            self._end_by(LimitTripped(why))
            self._raise_trip()

    def _end_by(self, error: Exception) -> None:
        """Store the error for the executor to raise, and let the guard begin the safe state; only the first counts."""
        if self._tripped is None:
            self._tripped = error
            why = str(error) if isinstance(error, PmaError) else f"{type(error).__name__}: {error}"
            self.on_trip(why, isinstance(error, LimitTripped), False)

    def _take(self, source: Source, block: Block) -> None:
        """Scale, check, flag and record a block; notes the time at which the stop rule applies. Raises Tripped."""
        time_ns = np.asarray(block.time, dtype=np.int64)
        count = len(time_ns)
        if count == 0:
            return
        raw = {name: np.asarray(block.columns[name]) for name in source.channels}
        t = np.asarray(time_ns * 1e-9, dtype=np.float64) + self._hear(source, int(time_ns[-1]), block.host)
        values = {name: source.channels[name].scale.to_si(raw[name]) for name in raw}
        at = self._stop(Samples(t, values)) if self._stop is not None and self._stopped is None else None
        if at is not None:
            self._stopped = float(t[at])
            if self._rewound(source, t, at):
                count = at + 1
        seen = values if count == len(t) else {name: column[:count] for name, column in values.items()}
        extremes = extremes_of(seen)
        trips = self._watch.look(t[:count], seen, source.heard, extremes) if self._watch is not None else []
        ends = next((trip for trip in trips if trip.limit.action in ENDS), None)
        if ends is not None and ends.index < count - 1 and self._rewound(source, t, ends.index):
            count = ends.index + 1
            seen = {name: column[:count] for name, column in values.items()}
            extremes = extremes_of(seen)
        if count < len(time_ns):
            time_ns = time_ns[:count]
            raw = {name: column[:count] for name, column in raw.items()}
        self._keep(source, time_ns, raw, seen, extremes, block.host)
        self._act(trips)

    def _hear(self, source: Source, newest: int, host: int) -> float:
        """Offset from the device's clock to bench time [s]; 0 in virtual time.

        Also notes when the newest sample was taken, and its arrival unless it is old.
        """
        now, ahead = self.clock.now(), 0.0
        if self._realtime:
            ahead = source.clock.ahead(newest, host * 1e-9 if host >= 0 else now)
        source.newest = newest * 1e-9 + ahead
        source.is_old = self._realtime and now - source.newest > OLD
        if not source.is_old:
            source.heard = now
        return ahead

    def _refuse_silence(self, source: Source) -> None:
        """Raise DeviceError where a stream has delivered nothing, or only old samples, for too long."""
        now, longest = self.clock.now(), max(SILENCE, self._block)
        if now - source.heard <= longest + 1.5 / self.rate:
            return
        if source.is_old:
            late = f"its samples come {now - source.newest:.1f} s late, for {longest:g} s none was from now"
            look = "look at its connection (network, hub, USB), at how busy this computer is, and at the device's clock"
            raise DeviceError(source.name, f"{late}: {look}")
        raise DeviceError(source.name, f"has sent no sample for {longest:g} s")

    def _rewound(self, source: Source, t: Array, index: int) -> bool:
        """Set time back to a sample inside the block where the clock can; later samples are then discarded."""
        if index >= len(t) - 1 or not self.clock.back_to(float(t[index])):
            return False
        source.stream.collect()  # gives nothing new, but the device notices that time went back
        return True

    def _doubt(self, trips: Sequence[Trip]) -> None:
        """Note which pressures may read low although they are not."""
        for trip in trips:
            if trip.limit.kind in {"following", "frozen"} and CHANNEL_QUANTITY[trip.limit.channel] == "pressure":
                if trip.value < self._bench.hands_below and not trip.over:
                    self.doubted.add(trip.limit.channel)
                else:
                    self.doubted.discard(trip.limit.channel)

    def _act(self, trips: Sequence[Trip]) -> None:
        """Carry out the actions of the limits: warn, hold, or end the run."""
        self._doubt(trips)  # of all, before the first one may end the run
        for trip in trips:
            if trip.limit.action in ENDS:
                self._tripped = Tripped(trip)
                if trip.limit.action == "vent":
                    self.on_trip(str(trip), True, trip.too_high(self.commanded))
                limit = trip.limit
                about = {"limit": limit.kind, "channel": limit.channel, "value": trip.value, "low": limit.low}
                about |= {"high": limit.high, "action": limit.action, "source": limit.source}
                reacted_in = self.clock.now() - trip.t
                self._recorder.event("trip", trip.t, reason=str(trip), **about, reacted_in=reacted_in)
                raise self._tripped
            name = f"{trip.limit.kind} {trip.limit.channel}"
            if trip.limit.action == "hold":
                (self.holding.discard if trip.over else self.holding.add)(name)
            what = "over" if trip.over else trip.limit.action
            self._recorder.event("warning", trip.t, reason=str(trip), limit=name, action=what, value=trip.value)

    def _single(self, source: Source, block: Block) -> None:
        """As `_take` for one sample, in plain numbers: a loop closed at 500 Hz has 2 ms for everything."""
        time_ns, columns = int(block.time[0]), block.columns
        t = time_ns * 1e-9 + self._hear(source, time_ns, block.host)
        values = {channel.name: columns[channel.name][0] * slope + offset for channel, slope, offset in source.scales}
        self.latest.update(values)
        before, _ = source.spacing.look((time_ns,))
        source.last = time_ns
        source.flag(before)
        flags = self._ranges.one(source.channels.values(), values)
        if self.recording and source.recorded:
            count = source.keep(time_ns, columns, flags, self._arrival(block.host))
            if count >= self.rate * self._block:
                self._hand_over(source, source.kept())
        if self._watch is not None:
            self._act(self._watch.look_once(t, values, source.heard))

    def _hand_over(self, source: Source, pieces: Iterable[Piece]) -> None:
        for piece in pieces:
            self.counts["rows"] += len(piece.time_ns)
            for name, flag in COUNTED.items() if np.count_nonzero(piece.flags) else ():
                self.counts[name] += int(np.count_nonzero(piece.flags & np.uint16(flag)))
            self._recorder.append(source.name, piece.time_ns, piece.columns, piece.flags, piece.host)

    def _keep(
        self,
        source: Source,
        time_ns: NDArray[np.int64],
        raw: Mapping[str, Any],
        values: Mapping[str, Array],
        extremes: Mapping[str, tuple[float, float]],
        host: int,
    ) -> None:
        before, apart = source.spacing.look(time_ns)
        source.last = int(time_ns[-1])
        source.flag(before)
        for name, value in values.items():
            self.latest[name] = float(value[-1])
        flags = self._ranges.block(source.channels, values, extremes, len(time_ns))
        if apart:
            flags |= np.array(apart, dtype=np.uint16)
        if self.recording and source.recorded:
            self._hand_over(source, source.pieces(time_ns, raw, flags, self._arrival(host)))

    def _arrival(self, host: int) -> int | None:
        """Arrival of the newest sample [ns, bench time]: as the driver noted it, else now; None in virtual time."""
        if not self._realtime:
            return None
        return host if host >= 0 else round(self.clock.now() * 1e9)


class Tripped(LimitTripped):
    """A measured limit was crossed."""

    def __init__(self, trip: Trip) -> None:
        self.trip = trip
        super().__init__(str(trip))
