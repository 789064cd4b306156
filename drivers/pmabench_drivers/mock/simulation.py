"""The plant in bench time, sampled and put on channels; goes back in time when asked; knows no clock and no link."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.bench.interface import Block, ChannelRecord, DeviceRecord, Load, Scale, Segment
from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.plant import Plant
from pmabench.model.presets import Arm, changed, preset, setup_of
from pmabench.model.real.free import RealPlant
from pmabench.model.regulator import Wave, constant, ramp, sine
from pmabench_drivers.mock import options as o
from pmabench_drivers.mock.channels import Channel, Column, Damage, as_block
from pmabench_drivers.mock.options import Options, SensorError

MEMORY = 2.5
"""How far the plant can be taken back [s]; a block of virtual time is at most 1 s."""
BUFFER = 20_000
"""Blocks of samples kept for whoever collects; older ones are lost, as in any device."""
LEAST_MASS = 0.01
"""Moving mass of a free end without anything on it [kg]."""
SETPOINTS = (0.0, 1e6)
"""What the pressure regulator can be set to [Pa]; it takes anything beyond as the nearest of these.

For a plant of a file, up to its own highest pressure."""
BURST_LAG = 0.01
SUPPLY_LAG = 0.5


@dataclass(frozen=True)
class _Valve:
    """The dump valve and what else keeps the regulator from the muscle."""

    energised: bool = False
    open: bool = False
    through: bool = False
    """The isolation valve is energised: regulator and muscle are connected."""
    held: float | None = None
    """The pressure that a stuck regulator or a shut isolation valve holds [Pa]."""
    forced: tuple[float, float] | None = None
    """Where the pressure goes whatever is commanded [Pa], and with which lag [s]."""


@dataclass(frozen=True)
class _Moment:
    """The plant as it was at a time [s], before it went on from there."""

    time: float
    plant: dict[str, Any]
    due: int
    valve: _Valve
    stuck: float | None


class Simulation:
    """The plant of one mock bench from bench time `start` [s] on; `memory` says how far it can be taken back [s].

    It has a dump valve when the device has a valve on the output `dump_valve`: not energised it is open.
    """

    def __init__(self, device: DeviceRecord, options: Options, start: float, memory: float = MEMORY) -> None:
        if options.numbers is None:
            setup = preset(options.plant, options.preset, options.overrides)
        else:
            setup = changed(setup_of(options.numbers), options.preset, options.overrides)
        highest = SETPOINTS[1] if options.numbers is None else float(options.numbers["highest_pressure"])
        self._setpoints = (SETPOINTS[0], highest)
        setup = replace(
            setup, regulator=replace(setup.regulator, vent_ratio=setup.regulator.vent_ratio * options.slow_vent)
        )
        if setup.air is not None:
            setup = replace(setup, air=replace(setup.air, vent=setup.air.vent / options.slow_vent))
        self._name, self._options, self._keep_for = device.name, options, memory
        self.faults, self.errors = options.faults, dict(options.errors)
        self._plant: Plant | RealPlant | DrivenPlant
        if options.free_end == "actuator":
            actuator = Actuator(
                options.actuator_low, options.actuator_high, options.actuator_speed, options.actuator_force
            )
            self._plant = setup.driven(actuator, start=start)
        else:
            self._plant = setup.free(mass=options.carriage, start=start)
        noise = setup.noise
        sigma = {"pressure": noise.pressure, "displacement": noise.displacement, "force": noise.force}
        self._radius = setup.muscle.radius if isinstance(setup.muscle, Arm) else math.inf
        sigma[o.ANGLE] = noise.displacement / self._radius
        self._channels = [
            Channel(record, sigma.get(self._input(record), 0.0), options.seed) for record in device.channels
        ]
        self._damage = Damage(self._channels)
        self._memory: deque[_Moment] = deque()
        self._rate, self._start_ns, self._due = 0.0, 0, 0
        self._pending: deque[Block] = deque(maxlen=BUFFER)
        _known(device.name, "output", [valve.output for valve in device.valves], o.VALVES)
        _known(device.name, "digital input", [item.input for item in device.interlocks], (o.E_STOP,))
        for error in self.errors.values():
            self._check_error(error)
        self._regulator = setup.regulator
        self._has_valve = any(valve.output == o.DUMP_VALVE for valve in device.valves)
        self._isolated = any(valve.output == o.ISOLATION_VALVE for valve in device.valves)
        self._valve = _Valve(open=self._has_valve)
        self._settle()

    def _input(self, record: ChannelRecord) -> str:
        known = o.inputs_of(self._options.free_end, self._options.plant)
        if record.input not in known:
            raise DeviceError(self._name, f'no input "{record.input}"{did_you_mean(record.input, known)}', record.name)
        return record.input

    def _check_error(self, error: SensorError) -> None:
        if error.reads and error.reads not in {channel.record.input for channel in self._channels}:
            raise DeviceError(self._name, f'errors: no channel has the input "{error.reads}"')

    @property
    def time(self) -> float:
        """The time that the plant has reached [s]."""
        return self._plant.time

    @property
    def pressure(self) -> float:
        """Gauge pressure in the muscle [Pa], without any error of a sensor."""
        return self._plant.pressure

    # -- commands, at the plant's time ----------------------------------------------------------------------------

    def command(self, output: str, segment: Segment, scale: Scale) -> None:
        """Follow a segment in device units; `constant` goes to its origin at once.

        The pressure set-point ends at the regulator's range; ValueError for a sine that goes beyond.
        """
        limits = self._setpoints if output == "pressure" else (-math.inf, math.inf)
        waves = _waves(segment, scale, self._plant.time, limits)
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

    def halt(self, output: str) -> None:
        """Stop where it is: an actuator at the place it has reached, the regulator at its set-point of now."""
        if output == "displacement" and isinstance(self._plant, DrivenPlant):
            self._plant.halt()
        else:
            self._plant.command(constant(self._plant.time, self.setpoint(output)))

    def switch(self, output: str, *, on: bool) -> None:
        """Energise the dump valve, which closes it, or the isolation valve, which opens it; or not."""
        self._valve = replace(self._valve, energised=on) if output == o.DUMP_VALVE else replace(self._valve, through=on)
        self._settle()

    def is_on(self, output: str) -> bool:
        """Whether a valve is energised."""
        return self._valve.energised if output == o.DUMP_VALVE else self._valve.through

    @property
    def energised(self) -> bool:
        """Whether the dump valve is commanded closed."""
        return self._valve.energised

    @property
    def dump_open(self) -> bool:
        """Whether the dump valve empties the muscle."""
        return self._valve.open

    def e_stop_high(self) -> bool:
        """Whether the emergency stop's contact is closed."""
        return not self._is_due(self.faults.e_stop_at)

    def fail(self, fault: str, at: float | None) -> None:
        """Let a fault (field of `Faults`) happen at `at` [s]; None: it is over."""
        self.faults = replace(self.faults, **{fault: at})
        self._settle()

    def disturb(self, channel: str, error: SensorError | None) -> None:
        """Give a channel input an error from now on; None: it is right again."""
        self.errors.pop(channel, None)
        if error is not None:
            self._check_error(error)
            self.errors[channel] = error

    def _is_due(self, at: float | None) -> bool:
        return at is not None and at <= self._plant.time

    def _settle(self) -> None:
        """Bring the muscle's air in line with valve and faults as they are at this moment; the strongest one counts."""
        faults, valve, supply, time = self.faults, self._valve, self._plant.supply, self._plant.time
        held = None
        shut = self._isolated and not valve.through
        if shut or self._is_due(faults.regulator_stuck_at):
            held = supply.value(time) if valve.held is None or (shut and valve.open) else valve.held
        opens = valve.open and not valve.energised
        if not valve.energised and self._has_valve and not self._is_due(faults.dump_stuck_at):
            opens = True
        self._plant.shut(shut=shut and not opens and not self._is_due(faults.burst_at))
        forced: tuple[float, float] | None = None
        if self._is_due(faults.burst_at):
            forced = 0.0, BURST_LAG
        elif opens:
            forced = 0.0, self._options.dump_lag * self._options.slow_vent
        elif self._is_due(faults.supply_lost_at) and not shut:
            forced = 0.0, SUPPLY_LAG
        elif shut and self._regulator.leak:
            forced = 0.0, 1.0 / self._regulator.leak
        elif held is not None:
            forced = held, self._regulator.lag
        if forced != valve.forced:
            if forced is None:
                supply.release(time)
            else:
                supply.force(time, *forced)
        self._valve = replace(valve, open=opens, held=held, forced=forced)

    def place(self, load: Load) -> None:
        """Change the load on the free end, unless an actuator holds it."""
        if not isinstance(self._plant, DrivenPlant):
            try:
                self._plant.load(load.force, max(load.mass, LEAST_MASS))
            except ValueError as error:
                raise DeviceError(self._name, str(error)) from error

    # -- samples --------------------------------------------------------------------------------------------------

    def start(self, rate: float) -> None:
        """Take sample 0 now."""
        self._rate, self._start_ns, self._due = rate, round(self._plant.time * 1e9), 0
        self._pending.clear()

    def stop(self) -> None:
        """Take no more samples."""
        self._rate = 0.0

    def collect(self) -> Block:
        """The samples taken since the last call."""
        self._sample(self._plant.time)
        blocks = list(self._pending)
        self._pending.clear()
        if len(blocks) == 1:
            return blocks[0]
        if not blocks:
            return Block([], {channel.record.name: [] for channel in self._channels})
        return as_block(
            np.concatenate([block.time for block in blocks]),
            {name: np.concatenate([block.columns[name] for block in blocks]) for name in blocks[0].columns},
        )

    # -- time -----------------------------------------------------------------------------------------------------

    def catch_up(self, now: float) -> None:
        """Bring plant and samples to bench time `now` [s]: forwards, or back when the clock was taken back."""
        if now < self._plant.time:
            self._go_back(now)
        if now > self._plant.time:
            if self._keep_for:
                self._remember()
            self._run(now)

    def skip(self, until: float) -> None:
        """Go on to `until` [s] without samples, and take the next one at its time: a long rest costs little."""
        if until <= self._plant.time:
            return
        rate, self._rate = self._rate, 0.0
        self._run(until)
        self._rate = rate
        if rate:
            self._due = max(self._due, int((round(until * 1e9) - self._start_ns) * rate / 1e9) + 1)

    def _remember(self) -> None:
        time = self._plant.time
        self._memory.append(_Moment(time, self._plant.snapshot(), self._due, self._valve, self._damage.stuck))
        while len(self._memory) > 1 and self._memory[1].time < time - self._keep_for:
            self._memory.popleft()

    def _go_back(self, now: float) -> None:
        """Restore the last moment before `now` and run up to it again; samples up to `now` have been delivered."""
        while self._memory and self._memory[-1].time > now:
            self._memory.pop()
        if not self._memory:
            raise DeviceError(self._name, f"cannot go back to {now} s")
        moment = self._memory[-1]
        self._plant.restore(moment.plant)
        self._due, self._valve, self._damage.stuck = moment.due, moment.valve, moment.stuck
        self._run(now)
        self._pending.clear()

    def _run(self, until: float) -> None:
        """Advance to `until`, stopping where a fault of the plant begins; samples up to there are made and kept."""
        faults = self.faults
        for at in sorted(
            at
            for at in (faults.burst_at, faults.supply_lost_at, faults.regulator_stuck_at, faults.dump_stuck_at)
            if at is not None and self._plant.time < at <= until
        ):
            self._sample(at)
            self._settle()
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
        if until > self._plant.time:
            self._plant.advance(until)

    def _time_ns(self, number: int) -> int:
        return self._start_ns + round(number * 1e9 / self._rate)

    def _many(self, first: int, last: int, until: float) -> None:
        time_ns = self._start_ns + np.rint(np.arange(first, last) * (1e9 / self._rate)).astype(np.int64)
        supply = self._supply()
        motion = self._plant.advance(until, time_ns / 1e9)
        values = {
            "pressure": motion.P,
            "displacement": motion.x,
            "force": motion.F,
            "supply": np.full(len(time_ns), supply),
            "pressure_set": motion.P_set,
            "displacement_set": motion.x_set,
            o.ANGLE: motion.x / self._radius,
        }
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
        """What each input is exposed to [SI], without any sensor; the plant is brought to `time` [s] first."""
        plant = self._plant
        time = plant.time if time is None else time
        if isinstance(plant, DrivenPlant):
            motion = plant.advance(time, (time,))
            x, P, F = float(motion.x[0]), float(motion.P[0]), float(motion.F[0])
        else:
            plant.advance(time)
            x, P, F = plant.reading()
        return {
            "pressure": P,
            "displacement": x,
            "force": F,
            "supply": self._supply(),
            "pressure_set": plant.supply.setpoint(plant.time),
            "displacement_set": self.setpoint("displacement") if isinstance(plant, DrivenPlant) else 0.0,
            o.ANGLE: x / self._radius,
        }

    def _number(self, time_ns: int) -> int:
        """Number of a sample counted from bench time 0: the noise belongs to the moment."""
        return round(time_ns * self._rate / 1e9)

    def _supply(self) -> float:
        return 0.0 if self._is_due(self.faults.supply_lost_at) else self._options.supply

    def _keep(self, time_ns: list[int] | NDArray[np.int64], columns: dict[str, Column]) -> None:
        self._pending.append(self._damage.done(as_block(time_ns, columns), self.faults, self.errors))


def _known(device: str, word: str, names: list[str], known: tuple[str, ...]) -> None:
    for name in names:
        if name not in known:
            raise DeviceError(device, f'no {word} "{name}" that can be switched or read{did_you_mean(name, known)}')


def _waves(segment: Segment, scale: Scale, now: float, limits: tuple[float, float]) -> tuple[Wave, ...]:
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
