"""The plant in bench time, sampled and put on channels; goes back in time when asked; knows no clock and no link."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import Block, ChannelRecord, DeviceRecord, Load, Scale, Segment
from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.plant import Plant
from pmabench.model.presets import preset
from pmabench.model.sensors import NoiseSource
from pmabench.model.signal import Wave, constant, ramp, sine
from pmabench_drivers.mock.options import Options

MEMORY = 2.5
"""How far the plant can be taken back [s]; a block of virtual time is at most 1 s."""
LEAST_MASS = 0.01
"""Moving mass of a free end without anything on it [kg]."""
BURST_LAG = 0.01
GAP = 0.02
SENSORS = ("pressure", "displacement", "force")
INPUTS = (*SENSORS, "supply", "pressure_set", "displacement_set")
Column = list[float] | NDArray[Any]


@dataclass(frozen=True)
class _Moment:
    """The plant as it was at a time [s], before it went on from there."""

    time: float
    plant: dict[str, Any]
    due: int


class _Channel:
    """One channel: its noise, and the way from SI to what the device gives."""

    def __init__(self, record: ChannelRecord, sigma: float, seed: int) -> None:
        self.record = record
        self.counts = record.raw_type == "int32"
        self._sigma = sigma
        self._noise = NoiseSource(seed, INPUTS.index(record.input))
        ends = float(record.scale.to_raw(record.low)), float(record.scale.to_raw(record.high))
        self.low, self.high = round(min(ends)), round(max(ends))

    def raw(self, si: NDArray[np.float64], first: int) -> Column:
        """Device units of consecutive samples in SI, the first of which has the number `first`."""
        if self._sigma:
            si = si + self._sigma * self._noise.samples(first, len(si))
        raw = self.record.scale.to_raw(si)
        if not self.counts:
            return np.asarray(raw, dtype=np.float64)
        return np.asarray(np.clip(np.rint(raw), self.low, self.high), dtype=np.int32)

    def raw_one(self, si: float, number: int) -> float:
        """The same for one sample."""
        if self._sigma:
            si += self._sigma * self._noise.one(number)
        raw = self.record.scale.to_raw(si)
        return min(max(round(raw), self.low), self.high) if self.counts else float(raw)


class Simulation:
    """The plant of one mock bench from bench time `start` [s] on."""

    def __init__(self, device: DeviceRecord, options: Options, start: float) -> None:
        setup = preset(options.plant, options.preset, options.overrides)
        self._name, self._options = device.name, options
        self._plant: Plant | DrivenPlant = Plant(setup.muscle, setup.regulator, mass=options.carriage, start=start)
        if options.free_end == "actuator":
            actuator = Actuator(
                low=options.actuator_low,
                high=options.actuator_high,
                speed=options.actuator_speed,
                force=options.actuator_force,
                lag=setup.follow_lag,
            )
            self._plant = DrivenPlant(setup.muscle, setup.regulator, actuator, start=start)
        sigma = {"pressure": setup.noise.pressure, "displacement": setup.noise.displacement, "force": setup.noise.force}
        self._channels = [
            _Channel(record, sigma.get(self._input(record), 0.0), options.seed) for record in device.channels
        ]
        self._memory: deque[_Moment] = deque()
        self._rate, self._start_ns, self._due = 0.0, 0, 0
        self._pending: list[Block] = []
        self._stuck: float | None = None
        self._burst = False

    def _input(self, record: ChannelRecord) -> str:
        driven = self._options.free_end == "actuator"
        known = INPUTS if driven else INPUTS[:-1]
        if record.input not in known:
            raise DeviceError(self._name, f'no input "{record.input}"{did_you_mean(record.input, known)}', record.name)
        return record.input

    # -- commands, at the plant's time ----------------------------------------------------------------------------

    def command(self, output: str, segment: Segment, scale: Scale) -> None:
        """Follow a segment in device units; `constant` goes to its origin at once."""
        waves = _waves(segment, scale, self._plant.time)
        if output == "displacement" and isinstance(self._plant, DrivenPlant):
            self._plant.move(waves)
        elif output == "pressure":
            self._plant.command(waves)
        else:
            raise DeviceError(self._name, f'no output "{output}" with a free end of {self._options.free_end}')

    def setpoint(self, output: str) -> float:
        """The value commanded now [SI]."""
        plant = self._plant
        held = plant.wanted if output == "displacement" and isinstance(plant, DrivenPlant) else plant.supply
        return held.setpoint(plant.time)

    def place(self, load: Load) -> None:
        """Change the load on the free end, unless an actuator holds it."""
        if isinstance(self._plant, Plant):
            self._plant.load(load.force, max(load.mass, LEAST_MASS))

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> None:
        """Take sample 0 now."""
        self._rate, self._start_ns, self._due = rate, round(self._plant.time * 1e9), 0
        self._pending = []

    def stop(self) -> None:
        """Take no more samples."""
        self._rate = 0.0

    def collect(self) -> Block:
        """The samples taken since the last call."""
        self._sample(self._plant.time)
        blocks, self._pending = self._pending, []
        if len(blocks) == 1:
            return blocks[0]
        if not blocks:
            return Block([], {channel.record.name: [] for channel in self._channels})
        return _block(
            np.concatenate([block.time for block in blocks]),
            {name: np.concatenate([block.columns[name] for block in blocks]) for name in blocks[0].columns},
        )

    # -- time -----------------------------------------------------------------------------------------------------

    def catch_up(self, now: float) -> None:
        """Bring plant and samples to bench time `now` [s]: forwards, or back when the clock was taken back."""
        if now < self._plant.time:
            self._go_back(now)
        if now > self._plant.time:
            self._remember()
            self._run(now)

    def _remember(self) -> None:
        time = self._plant.time
        self._memory.append(_Moment(time, self._plant.snapshot(), self._due))
        while len(self._memory) > 1 and self._memory[1].time < time - MEMORY:
            self._memory.popleft()

    def _go_back(self, now: float) -> None:
        """Restore the last moment before `now` and run up to it again; samples up to `now` have been delivered."""
        while self._memory and self._memory[-1].time > now:
            self._memory.pop()
        if not self._memory:
            raise DeviceError(self._name, f"cannot go back to {now} s")
        moment = self._memory[-1]
        self._plant.restore(moment.plant)
        self._due = moment.due
        faults = self._options.faults
        if faults.burst_at is not None and moment.time < faults.burst_at:
            self._burst = False
        if faults.pressure_stuck_at is not None and now < faults.pressure_stuck_at:
            self._stuck = None
        self._run(now)
        self._pending = []

    def _run(self, until: float) -> None:
        """Advance to `until`, bursting on the way where that is due; samples up to there are made and kept."""
        burst_at = self._options.faults.burst_at
        if burst_at is not None and not self._burst and burst_at <= until:
            if burst_at > self._plant.time:
                self._sample(burst_at)
            self._plant.supply.fail(self._plant.time, BURST_LAG)
            self._burst = True
        self._sample(until)

    def _sample(self, until: float) -> None:
        """Advance to `until` and put the samples on the way on the channels; one at `until` sees what is done now."""
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
        self._plant.advance(until)

    def _time_ns(self, number: int) -> int:
        return self._start_ns + round(number * 1e9 / self._rate)

    def _many(self, first: int, last: int, until: float) -> None:
        time_ns = self._start_ns + np.rint(np.arange(first, last) * (1e9 / self._rate)).astype(np.int64)
        motion = self._plant.advance(until, time_ns / 1e9)
        values = {
            "pressure": motion.P,
            "displacement": motion.x,
            "force": motion.F,
            "supply": np.full(len(time_ns), self._options.supply),
            "pressure_set": motion.P_set,
            "displacement_set": motion.x_set,
        }
        number = self._number(int(time_ns[0]))
        columns = {c.record.name: c.raw(values[c.record.input], number) for c in self._channels}
        self._keep(time_ns, columns)

    def _one(self, number: int) -> None:
        time_ns = self._time_ns(number)
        plant = self._plant
        plant.advance(time_ns / 1e9)
        x, P, F = plant.reading()
        values = {
            "pressure": P,
            "displacement": x,
            "force": F,
            "supply": self._options.supply,
            "pressure_set": plant.supply.setpoint(plant.time),
            "displacement_set": self.setpoint("displacement") if isinstance(plant, DrivenPlant) else 0.0,
        }
        noise = self._number(time_ns)
        columns: dict[str, Column] = {c.record.name: [c.raw_one(values[c.record.input], noise)] for c in self._channels}
        self._keep([time_ns], columns)

    def _number(self, time_ns: int) -> int:
        """Number of a sample counted from bench time 0: the noise belongs to the moment."""
        return round(time_ns * self._rate / 1e9)

    def _keep(self, time_ns: list[int] | NDArray[np.int64], columns: dict[str, Column]) -> None:
        block = _block(time_ns, columns)
        if self._options.faults != _NO_FAULTS:
            block = self._with_faults(block)
        self._pending.append(block)

    # -- faults of the channels -----------------------------------------------------------------------------------

    def _with_faults(self, block: Block) -> Block:
        faults = self._options.faults
        time = np.asarray(block.time, dtype=np.int64)
        columns = {name: np.array(column) for name, column in block.columns.items()}
        seconds = time / 1e9
        for channel in self._channels:
            column = columns[channel.record.name]
            if faults.pressure_stuck_at is not None and channel.record.input == "pressure":
                stuck = seconds >= faults.pressure_stuck_at
                if stuck.any():
                    self._stuck = float(column[stuck.argmax()]) if self._stuck is None else self._stuck
                    column[stuck] = self._stuck
            if faults.nan_at is not None and channel.record.input in SENSORS:
                column[seconds >= faults.nan_at] = channel.low if channel.counts else np.nan
        if faults.gap_at is not None:
            kept = (seconds < faults.gap_at) | (seconds >= faults.gap_at + GAP)
            return _block(time[kept], {name: column[kept] for name, column in columns.items()})
        return _block(time, columns)


_NO_FAULTS = type(Options().faults)()


def _waves(segment: Segment, scale: Scale, now: float) -> tuple[Wave, ...]:
    """A segment in device units as waves in SI; it begins now if its start has passed."""
    start, origin = max(segment.start, now), float(scale.to_si(segment.origin))
    if segment.kind == "ramp":
        return ramp(start, origin, float(scale.to_si(segment.target)), abs(segment.rate * scale.slope))
    if segment.kind == "sine":
        return sine(start, origin, segment.amplitude * scale.slope, segment.frequency, segment.cycles)
    return constant(start, origin)


def _block(time: Any, columns: Mapping[str, Any]) -> Block:
    """A block of lists or arrays."""
    return Block(time, columns)
