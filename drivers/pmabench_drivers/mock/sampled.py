"""A plant in bench time, sampled on channels; can go back in time; uses no clock and no link.

The channels have noise, counts, and errors of their sensors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, ChannelRecord, DeviceRecord, Scale, Segment
from pmabench.model.motion import NoiseSource
from pmabench.model.regulator import Wave, constant, ramp, sine
from pmabench_drivers.mock import options as o
from pmabench_drivers.mock.options import ACCELERATIONS, INPUTS, SENSORS, Faults, Options, SensorError

GAP = 0.02
NO_FAULTS = Faults()
Column = list[float] | NDArray[Any]


class Channel:
    """One channel: its noise, and the conversion from SI to device units."""

    def __init__(self, record: ChannelRecord, sigma: float, seed: int) -> None:
        self.record = record
        self.counts = record.raw_type == "int32"
        self._sigma = sigma
        self._noise = NoiseSource(seed, INPUTS.index(record.input))
        self.scale = record.calibrated
        self.ends = float(self.scale.to_raw(record.low)), float(self.scale.to_raw(record.high))
        self.low, self.high = round(min(self.ends)), round(max(self.ends))

    def raw(self, si: NDArray[np.float64], first: int) -> Column:
        """Device units of consecutive samples in SI, the first of which has the number `first`."""
        raw = self._noise.samples(first, len(si)) if self._sigma else np.zeros(len(si))
        raw *= self._sigma
        raw += si
        raw -= self.scale.offset
        raw /= self.scale.slope
        return self._given(raw)

    def raw_one(self, si: float, number: int) -> float:
        """The same for one sample."""
        if self._sigma:
            si += self._sigma * self._noise.one(number)
        raw = self.scale.to_raw(si)
        return min(max(round(raw), self.low), self.high) if self.counts else float(raw)

    def wrong(self, raw: NDArray[Any], error: SensorError) -> NDArray[Any]:
        """Device units instead of `raw` if its sensor has that error."""
        if error.end:
            return np.full(raw.shape, self._given(np.array(self.ends[error.end == "high"])), dtype=raw.dtype)
        scale = self.scale
        return self._given(scale.to_raw(error.factor * scale.to_si(raw) + error.offset))

    def _given(self, raw: Any) -> NDArray[Any]:
        if not self.counts:
            return np.asarray(raw, dtype=np.float64)
        whole = np.asarray(np.rint(raw))
        np.minimum(np.maximum(whole, self.low, out=whole), self.high, out=whole)  # half the time of `np.clip`
        return np.asarray(whole, dtype=np.int32)


class Damage:
    """Damage to blocks of the channels: wrong readings, lost samples.

    `pressure` is the input that gets stuck.
    `stuck` has the values that stuck channels repeat [device units], by input; a new dictionary for each addition.
    """

    def __init__(self, channels: Sequence[Channel], pressure: str = "pressure") -> None:
        self._channels, self._pressure = channels, pressure
        self._by_input = {channel.record.input: channel for channel in channels}
        self.stuck: dict[str, float] = {}
        self._seen, self._none = NO_FAULTS, True

    def done(self, block: Block, faults: Faults, errors: Mapping[str, SensorError]) -> Block:
        """The block as it arrives; `faults` and `errors` are the present ones."""
        if faults is not self._seen:
            self._seen, self._none = faults, faults == NO_FAULTS
        if self._none and not errors:
            return block
        time = np.asarray(block.time, dtype=np.int64)
        columns = {name: np.array(column) for name, column in block.columns.items()}
        seconds = time / 1e9
        self._errors(columns, seconds, errors)
        for channel in self._channels:
            column = columns[channel.record.name]
            since = self._stuck_since(channel.record.input, faults)
            if since is not None and (stuck := seconds >= since).any():
                self.stuck = {channel.record.input: float(column[stuck.argmax()])} | self.stuck
                column[stuck] = self.stuck[channel.record.input]
            if faults.nan_at is not None and channel.record.input in SENSORS:
                column[seconds >= faults.nan_at] = channel.low if channel.counts else np.nan
        if faults.gap_at is not None:
            kept = (seconds < faults.gap_at) | (seconds >= faults.gap_at + GAP)
            time, columns = time[kept], {name: column[kept] for name, column in columns.items()}
        return as_block(time, columns)

    def _stuck_since(self, name: str, faults: Faults) -> float | None:
        return faults.accelerometer_frozen_at if name in ACCELERATIONS else (
            faults.pressure_stuck_at if name == self._pressure else None
        )  # fmt: skip

    def _errors(
        self, columns: dict[str, NDArray[Any]], seconds: NDArray[np.float64], errors: Mapping[str, SensorError]
    ) -> None:
        own = dict(columns)
        for channel in self._channels:
            if (error := errors.get(channel.record.input)) is None:
                continue
            raw = own[channel.record.name]
            if error.reads:
                raw = np.asarray(own[self._by_input[error.reads].record.name])
            name = channel.record.name
            columns[name] = np.where(seconds >= error.at, channel.wrong(raw, error), own[name])


def as_block(time: Any, columns: Mapping[str, Any]) -> Block:
    """A block of lists or arrays."""
    return Block(time, columns)


MEMORY = 2.5
"""How far the plant can be taken back [s]; a block of virtual time is at most 1 s."""
OF_THE_PLANT = (
    "burst_at", "supply_lost_at", "regulator_stuck_at", "dump_stuck_at", "leak_at", "fill_stuck_open_at",
    "fill_stuck_shut_at", "exhaust_stuck_open_at", "exhaust_stuck_shut_at", "accelerometer_level_at",
)  # fmt: skip
"""Faults for which a simulation updates its plant."""
BUFFER = 20_000
"""Number of blocks of samples kept until they are collected; older ones are lost, as in any device."""


@dataclass(frozen=True)
class Air:
    """State of the air of one muscle with a regulator."""

    open: bool
    """The dump valve empties it."""
    held: float | None = None
    """The pressure that a stuck regulator or a shut isolation valve holds [Pa]."""
    forced: tuple[float, float] | None = None
    """Pressure that is approached whatever is commanded [Pa], and its lag [s]."""


@dataclass(frozen=True)
class Valves:
    """Energised valves, by outputs, and their effect on the air of each muscle that has a regulator."""

    energised: frozenset[str] = frozenset()
    each: tuple[Air, ...] = ()


@dataclass(frozen=True)
class _Moment:
    """The plant as it was at a time [s], before it advanced."""

    time: float
    plant: dict[str, Any]
    due: int
    valves: Valves
    stuck: dict[str, float]


class Sampled(ABC):
    """Common part of all simulated benches: time, memory, channels, faults of sensors.

    A bench based on it has a `_plant`, returns the quantity at each input (`_at`, `_along`), and updates valves and
    faults of the plant (`_settle`). `memory` is how far it can be taken back [s].
    """

    AHEAD = 0.0
    """Longest computation ahead of its time if nothing will be commanded [s]."""
    _plant: Any
    _valves: Valves
    """State of valves and of faults of the plant."""

    def __init__(self, device: DeviceRecord, options: Options, sigma: Mapping[str, float], memory: float) -> None:
        self._name, self._options, self._keep_for = device.name, options, memory
        self.faults, self.errors = options.faults, dict(options.errors)
        self._channels = [Channel(record, sigma.get(record.input, 0.0), options.seed) for record in device.channels]
        self._damage = Damage(self._channels, o.pressure_of(options))
        self._memory: deque[_Moment] = deque()
        self._rate, self._start_ns, self._due = 0.0, 0, 0
        self._given = 0
        """Samples up to this moment were collected [ns]."""
        self._pending: deque[Block] = deque(maxlen=BUFFER)
        self._valves = Valves()
        for error in self.errors.values():
            self._check_error(error)

    def _check_error(self, error: SensorError) -> None:
        if error.reads and error.reads not in {channel.record.input for channel in self._channels}:
            raise DeviceError(self._name, f'errors: no channel has the input "{error.reads}"')

    @property
    def time(self) -> float:
        """The time that the plant has reached [s]."""
        return float(self._plant.time)

    def pulse(self, output: str, seconds: float) -> None:
        """Open a valve for a time [s]; raises ValueError if none opens in pulses."""
        raise ValueError("no valve of this plant opens in pulses")

    def switch(self, output: str, *, on: bool) -> None:
        """Energise a valve, which closes a dump and opens any other, or not."""
        energised = self._valves.energised
        self._valves = replace(self._valves, energised=energised | {output} if on else energised - {output})
        self._settle()

    def is_on(self, output: str) -> bool:
        """Whether a valve is energised by `switch`; a pulse ends by itself."""
        return output in self._valves.energised

    @abstractmethod
    def _settle(self) -> None:
        """Update the air for the present state of valves and faults."""

    def _at(self, time: float) -> dict[str, float]:
        """Quantity at each input at `time` [s], to which the plant is advanced."""
        return {name: float(values[0]) for name, values in self._along(time, np.array([time])).items()}

    @abstractmethod
    def _along(self, until: float, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """The same at increasing `times` [s] on the way to `until` [s]."""

    # -- faults ---------------------------------------------------------------------------------------------------

    def e_stop_high(self) -> bool:
        """Whether the emergency stop's contact is closed."""
        return not self._is_due(self.faults.e_stop_at)

    def fail(self, fault: str, at: float | None) -> None:
        """Let a fault (field of `Faults`) happen at `at` [s]; None: it is over."""
        self.faults = replace(self.faults, **{fault: at})
        self._settle()

    def disturb(self, channel: str, error: SensorError | None) -> None:
        """Give a channel input an error from now on; None: remove its error."""
        self.errors.pop(channel, None)
        if error is not None:
            self._check_error(error)
            self.errors[channel] = error

    def _is_due(self, at: float | None) -> bool:
        return at is not None and at <= self._plant.time

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> None:
        """Start sampling: take sample 0 now."""
        self._rate, self._start_ns, self._due = rate, round(self._plant.time * 1e9), 0
        self._given = self._start_ns - 1
        self._pending.clear()

    def stop(self) -> None:
        """Stop sampling."""
        self._rate = 0.0

    def collect(self, now: float, quiet_until: float) -> Block:
        """Samples up to `now` [s] and not yet collected; nothing is commanded before `quiet_until` [s].

        Many seconds at once cost much less than the same time in parts.
        """
        now_ns = round(now * 1e9)
        if now_ns < self._given or now > self._plant.time:
            self.catch_up(now, quiet_until)
        self._sample(self._plant.time)
        self._given = now_ns
        blocks = []
        while self._pending and self._pending[0].time[0] <= now_ns:
            due, later = _parted(self._pending.popleft(), now_ns)
            blocks.append(due)
            if later is not None:
                self._pending.appendleft(later)
        if len(blocks) == 1:
            return blocks[0]
        if not blocks:
            return Block([], {channel.record.name: [] for channel in self._channels})
        return as_block(
            np.concatenate([block.time for block in blocks]),
            {name: np.concatenate([block.columns[name] for block in blocks]) for name in blocks[0].columns},
        )

    # -- time -----------------------------------------------------------------------------------------------------

    def catch_up(self, now: float, quiet_until: float = 0.0) -> None:
        """Advance plant and samples to bench time `now` [s], or further: nothing is commanded before `quiet_until` [s].

        Goes back if the clock was set back, or for a command before the computed time.
        """
        if now < self._plant.time:
            self._go_back(now)
        if now > self._plant.time:
            if self._keep_for:
                self._remember()
                now = max(now, min(quiet_until, now + self.AHEAD))
            self._run(now)

    def skip(self, until: float) -> None:
        """Advance to `until` [s] without samples, and take the next one at its time: a long rest costs little."""
        if until <= self._plant.time:
            return
        rate, self._rate = self._rate, 0.0
        self._run(until)
        self._rate = rate
        if rate:
            self._due = max(self._due, int((round(until * 1e9) - self._start_ns) * rate / 1e9) + 1)

    def _remember(self) -> None:
        time = self._plant.time
        self._memory.append(_Moment(time, self._plant.snapshot(), self._due, self._valves, self._damage.stuck))
        while len(self._memory) > 1 and self._memory[1].time < time - self._keep_for:
            self._memory.popleft()

    def _go_back(self, now: float) -> None:
        """Restore the last moment before `now` and run up to it again; collected samples are not returned again."""
        while self._memory and self._memory[-1].time > now:
            self._memory.pop()
        if not self._memory:
            raise DeviceError(self._name, f"cannot go back to {now} s")
        moment = self._memory[-1]
        self._plant.restore(moment.plant)
        self._due, self._valves, self._damage.stuck = moment.due, moment.valves, moment.stuck
        self._pending.clear()
        self._run(now)
        again, given = list(self._pending), self._given
        self._pending.clear()
        self._pending.extend(later for block in again if (later := _parted(block, given)[1]) is not None)
        self._given = min(given, round(now * 1e9))

    def _run(self, until: float) -> None:
        """Advance to `until`, stopping where a fault of the plant begins; makes and keeps the samples up to there."""
        faults = self.faults
        for at in sorted(
            at
            for at in (getattr(faults, name) for name in OF_THE_PLANT)
            if at is not None and self._plant.time < at <= until
        ):
            self._sample(at)
            self._settle()
        self._sample(until)

    def _sample(self, until: float) -> None:
        """Advance to `until`, and put the samples up to then, one at `until` included, on the channels."""
        first, last = self._due, self._due
        until_ns = round(until * 1e9)
        if self._rate:
            last = max(first, int((until_ns - self._start_ns) * self._rate / 1e9) + 1)
            while last > first and self._time_ns(last - 1) > until_ns:
                last -= 1
        self._due = last
        if last - first > 2:
            self._many(first, last, until)
            return
        for number in range(first, last):
            self._one(number)
        if until > self._plant.time:
            self._plant.advance(until)

    def _time_ns(self, number: int) -> int:
        return self._start_ns + round(number * 1e9 / self._rate)

    def _many(self, first: int, last: int, until: float) -> None:
        time_ns = self._start_ns + np.rint(np.arange(first, last) * (1e9 / self._rate)).astype(np.int64)
        values = self._along(until, time_ns / 1e9)
        number = self._number(int(time_ns[0]))
        columns = {c.record.name: c.raw(values[c.record.input], number) for c in self._channels}
        self._keep(time_ns, columns)

    def _one(self, number: int) -> None:
        time_ns = self._time_ns(number)
        values = self.quantities(time_ns / 1e9)
        noise = self._number(time_ns)
        columns: dict[str, Column] = {c.record.name: [c.raw_one(values[c.record.input], noise)] for c in self._channels}
        self._keep([time_ns], columns)

    def quantities(self, time: float | None = None) -> dict[str, float]:
        """Quantity at each input [SI], without any sensor; advances the plant to `time` [s] first."""
        return self._at(self.time if time is None else time)

    def _number(self, time_ns: int) -> int:
        """Number of a sample counted from bench time 0: the noise depends on the moment."""
        return round(time_ns * self._rate / 1e9)

    def _supply(self) -> float:
        return 0.0 if self._is_due(self.faults.supply_lost_at) else self._options.supply

    def _keep(self, time_ns: list[int] | NDArray[np.int64], columns: dict[str, Column]) -> None:
        block = self._damage.done(as_block(time_ns, columns), self.faults, self.errors)
        if len(block.time):
            self._pending.append(block)


def _parted(block: Block, moment: int) -> tuple[Block, Block | None]:
    """The samples of a block up to a moment [ns], and those after it; None if there are none."""
    if block.time[-1] <= moment:
        return block, None
    count = int(np.searchsorted(block.time, moment, side="right"))
    due, later = (
        as_block(block.time[part], {name: column[part] for name, column in block.columns.items()})
        for part in (slice(count), slice(count, None))
    )
    return due, later


def waves_of(segment: Segment, scale: Scale, now: float, limits: tuple[float, float]) -> tuple[Wave, ...]:
    """A segment in device units as waves in SI within `limits`; it begins now if its start has passed."""
    start, origin = max(segment.start, now), _inside(float(scale.to_si(segment.origin)), limits)
    if segment.kind == "ramp":
        target = _inside(float(scale.to_si(segment.target)), limits)
        return ramp(start, origin, target, abs(segment.rate * scale.slope))
    if segment.kind == "sine":
        amplitude = segment.amplitude * scale.slope
        low, high = origin - abs(amplitude), origin + abs(amplitude)
        slack = 1e-4 * (limits[1] - limits[0])
        if low < limits[0] - slack or high > limits[1] + slack:
            raise ValueError(f"a sine from {low:.6g} to {high:.6g} is outside of what can be set")
        return sine(start, origin, amplitude, segment.frequency, segment.cycles)
    return constant(start, origin)


def _inside(value: float, limits: tuple[float, float]) -> float:
    return min(max(value, limits[0]), limits[1])
