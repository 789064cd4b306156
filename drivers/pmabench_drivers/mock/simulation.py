"""Simulated benches in bench time: one muscle, a joint of two, a platform of three, with their faults.

They use no clock and no link.

The joint's channel inputs: `pressure_1`, `pressure_2`, their set-points `pressure_1_set` and `pressure_2_set`, `angle`,
`torque`, `supply`, and with a drive `angle_set`. Outputs: `pressure_1`, `pressure_2`, and with a drive `angle`; the
valve `dump_valve` empties both muscles, `dump_valve_1` and `dump_valve_2` one each; `supply_valve`, present if the
bench names it, lets air to the regulators while it is energised. A drive holds the joint at its set-point, at any
torque; without one it is free.

The platform's channel inputs: `pressure_1` to `pressure_3`, `acceleration_x` to `_z`, `turn_x` and `turn_y` of a
gyroscope, `supply`. Valves: `fill_1` to `exhaust_3` open in pulses; `supply_valve` lets air to the fill valves while it
is energised; `dump_valve` is one valve at each muscle, open unless energised; `dump_valve_1` and so on belong to one
muscle.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Load, Scale, Segment
from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.many import joint, platform
from pmabench.model.many.joint import JointPlant
from pmabench.model.many.platform import MUSCLES, PlatformPlant
from pmabench.model.plant import Plant
from pmabench.model.presets import Arm, changed, preset, setup_of
from pmabench.model.real.plants import RealPlant
from pmabench.model.regulator import Regulated, Regulator, constant, ramp
from pmabench_drivers.mock import options as o
from pmabench_drivers.mock.options import Options
from pmabench_drivers.mock.sampled import MEMORY, Air, Sampled, Valves, waves_of

Q = TypeVar("Q", float, NDArray[np.float64])
LEAST_MASS = 0.01
"""Moving mass of a free end without load [kg]."""
SETPOINTS = (0.0, 1e6)
"""Range of the pressure regulator [Pa]; set-points beyond it are limited to it.

For a plant from a file, up to its own highest pressure.
"""
BURST_LAG = 0.01
SUPPLY_LAG = 0.5
FLOW_NOISE = 1e-7
"""Noise of a mass flow meter for 5 l/min (ANR): a thousandth of its range [kg/s]."""


def _press(
    supply: Regulated, time: float, before: tuple[float, float] | None, forced: tuple[float, float] | None
) -> None:
    """Force the pressure to a value [Pa] with a lag [s], or return it to the regulator, if that is new."""
    if forced is None and before is not None:
        supply.release(time)
    elif forced is not None and forced != before:
        supply.force(time, *forced)


class Simulation(Sampled):
    """The plant of one mock bench from bench time `start` [s] on; `memory` is how far it can be taken back [s].

    It has a dump valve if the device has a valve on the output `dump_valve`, open unless energised.
    """

    AHEAD = 10.0

    def __init__(self, device: DeviceRecord, options: Options, start: float, memory: float = MEMORY) -> None:
        if options.numbers is None:
            setup = preset(options.plant, options.preset, options.overrides)
        else:
            setup = changed(setup_of(options.numbers), options.preset, options.overrides)
        highest = SETPOINTS[1] if options.numbers is None else float(options.numbers["highest_pressure"])
        self._setpoints = (SETPOINTS[0], highest)
        vent_ratio = setup.regulator.vent_ratio * options.slow_vent
        setup = replace(setup, regulator=replace(setup.regulator, vent_ratio=vent_ratio))
        if setup.air is not None:
            setup = replace(setup, air=replace(setup.air, vent=setup.air.vent / options.slow_vent))
        noise = setup.noise
        sigma = {"pressure": noise.pressure, "displacement": noise.displacement, "force": noise.force}
        self._radius = setup.muscle.radius if isinstance(setup.muscle, Arm) else math.inf
        sigma[o.ANGLE] = noise.displacement / self._radius
        sigma[o.FLOW] = FLOW_NOISE * (noise.pressure > 0)
        self._metered = any(record.input == o.FLOW for record in device.channels)
        super().__init__(device, options, sigma, memory)
        self._plant: Plant | RealPlant | DrivenPlant
        if options.free_end == "actuator":
            ends = options.actuator_low, options.actuator_high
            actuator = Actuator(*ends, options.actuator_speed, options.actuator_force)
            self._plant = setup.driven(actuator, start=start)
        else:
            self._plant = setup.free(mass=options.carriage, start=start)
        self._regulator = setup.regulator
        self._has_valve = any(valve.output == o.DUMP_VALVE for valve in device.valves)
        self._isolated = any(valve.output == o.ISOLATION_VALVE for valve in device.valves)
        self._valves = Valves(each=(Air(open=self._has_valve),))
        self._settle()

    @property
    def pressure(self) -> float:
        """Gauge pressure in the muscle [Pa], without any error of a sensor."""
        return self._plant.pressure

    # -- commands, at the plant's time ----------------------------------------------------------------------------

    def command(self, output: str, segment: Segment, scale: Scale) -> None:
        """Follow a segment in device units; `constant` goes to its origin at once.

        The pressure set-point is limited to the regulator's range; raises ValueError for a sine beyond it.
        """
        limits = self._setpoints if output == "pressure" else (-math.inf, math.inf)
        waves = waves_of(segment, scale, self._plant.time, limits)
        if output == "displacement" and isinstance(self._plant, DrivenPlant):
            self._plant.move(waves)
        elif output == "pressure":
            self._plant.command(waves)
        else:
            raise DeviceError(self._name, f'no output "{output}" with a free end of {self._options.free_end}')

    def setpoint(self, output: str) -> float:
        """Present set-point [SI]."""
        plant = self._plant
        held = plant.wanted if output == "displacement" and isinstance(plant, DrivenPlant) else plant.supply
        return held.setpoint(plant.time)

    def halt(self, output: str) -> None:
        """Stop: an actuator at its present place, the regulator at its present set-point."""
        if output == "displacement" and isinstance(self._plant, DrivenPlant):
            self._plant.halt()
        else:
            self._plant.command(constant(self._plant.time, self.setpoint(output)))

    @property
    def energised(self) -> bool:
        """Whether the dump valve is commanded closed."""
        return self.is_on(o.DUMP_VALVE)

    @property
    def dump_open(self) -> bool:
        """Whether the dump valve empties the muscle."""
        return self._valves.each[0].open

    # -- the air --------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Update the muscle's air for the present state of valve and faults; the strongest one counts."""
        faults, [air], supply, time = self.faults, self._valves.each, self._plant.supply, self._plant.time
        held = None
        shut = self._isolated and not self.is_on(o.ISOLATION_VALVE)
        if shut or self._is_due(faults.regulator_stuck_at):
            held = supply.value(time) if air.held is None or (shut and air.open) else air.held
        may_open = self._has_valve and not self._is_due(faults.dump_stuck_at)
        opens = not self.energised and (air.open or may_open)
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
        _press(supply, time, air.forced, forced)
        self._valves = replace(self._valves, each=(Air(opens, held, forced),))

    def place(self, load: Load) -> None:
        """Change the load on the free end, unless an actuator holds it."""
        if not isinstance(self._plant, DrivenPlant):
            try:
                self._plant.load(load.force, max(load.mass, LEAST_MASS))
            except ValueError as error:
                raise DeviceError(self._name, str(error)) from error

    def _along(self, until: float, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        supply, regulator = self._supply(), self._regulator_before()
        motion = self._plant.advance(until, times)
        flow, supplies = self._inflow(regulator, motion.t, motion.P), np.full(len(times), supply)
        return self._inputs(motion.P, motion.x, motion.F, supplies, motion.P_set, motion.x_set, flow)

    def _at(self, time: float) -> dict[str, float]:
        plant, regulator = self._plant, self._regulator_before()
        if isinstance(plant, DrivenPlant):
            motion = plant.advance(time, (time,))
            x, P, F = float(motion.x[0]), float(motion.P[0]), float(motion.F[0])
        else:
            plant.advance(time)
            x, P, F = plant.reading()
        x_set = self.setpoint("displacement") if isinstance(plant, DrivenPlant) else 0.0
        flow = float(self._inflow(regulator, np.array([plant.time]), np.array([P]))[0])
        return self._inputs(P, x, F, self._supply(), plant.supply.setpoint(plant.time), x_set, flow)

    def _inputs(self, P: Q, x: Q, F: Q, supply: Q, P_set: Q, x_set: Q, flow: Q) -> dict[str, Q]:
        """What the channels are exposed to, by input."""
        moved = {
            "pressure": P,
            "displacement": x,
            "force": F,
            "supply": supply,
            o.ANGLE: x / self._radius,
            o.FLOW: flow,
        }
        return {**moved, "pressure_set": P_set, "displacement_set": x_set}

    def _regulator_before(self) -> Regulated:
        """The regulator before the plant advances; copied only if there is a flow meter."""
        return copy.copy(self._plant.supply) if self._metered else self._plant.supply

    def _inflow(self, regulator: Regulated, t: NDArray[np.float64], P: NDArray[np.float64]) -> NDArray[np.float64]:
        """Flow through a meter between regulator and muscle [kg/s]; excludes flow through the dump valve."""
        if not self._metered or not isinstance(self._plant, DrivenPlant) or self._valves.each[0].forced is not None:
            return np.zeros(t.shape)
        return self._plant.inflow(regulator, t, P)


JOINT_NOISE = {**dict.fromkeys(o.PRESSURES, 500.0), o.ANGLE: math.radians(0.02), o.TORQUE: 0.01}
"""Noise of the sensors of preset `bench` [Pa, rad, N m]; assumed."""


LEAK_LAG = 20.0
"""Lag with which a leaking muscle empties behind its isolation valve [s]."""
DRIVE_SPEED = math.radians(60)
"""Speed of the drive towards an angle commanded at once [rad/s]."""


class JointSimulation(Sampled):
    """The joint from bench time `start` [s] on, without pressure, at angle 0; `memory` as in `Sampled`."""

    def __init__(self, device: DeviceRecord, options: Options, start: float, memory: float = MEMORY) -> None:
        super().__init__(device, options, JOINT_NOISE if options.preset == "bench" else {}, memory)
        named = [valve.output for valve in device.valves]
        built = joint.described(options.built)
        if options.preset != "bench":
            built = replace(built, regulator=Regulator(dead_time=0.04))
        vent_ratio = built.regulator.vent_ratio * options.slow_vent
        self._plant = JointPlant(replace(built, regulator=replace(built.regulator, vent_ratio=vent_ratio)), start=start)
        self._wanted = Regulated(Regulator(), start=start)
        """Set-point of the drive [rad]."""
        if options.free_end == "actuator":
            self._plant.drive(constant(start, 0.0))
        self._dumps = tuple([n for n in named if n in (o.DUMP_VALVE, f"{o.DUMP_VALVE}_{i}")] for i in (1, 2))
        self._isolated = o.ISOLATION_VALVE in named
        self._shut_off = o.SUPPLY_VALVE in named
        self._valves = Valves(each=tuple(Air(bool(dumps)) for dumps in self._dumps))
        self._settle()

    @property
    def pressure(self) -> float:
        """The higher one of the two gauge pressures [Pa], without any error of a sensor."""
        return float(max(supply.value(self.time) for supply in self._plant.supplies))

    @property
    def energised(self) -> bool:
        """Whether every dump valve is commanded closed."""
        return any(self._dumps) and all(self._valves.energised.issuperset(dumps) for dumps in self._dumps)

    @property
    def dump_open(self) -> bool:
        """Whether the dump valves empty both muscles."""
        return all(air.open for air in self._valves.each)

    # -- commands, at the plant's time ----------------------------------------------------------------------------

    def command(self, output: str, segment: Segment, scale: Scale) -> None:
        """Follow a segment in device units; `constant` goes to its origin at once.

        A pressure set-point is limited to the regulator's range; raises ValueError for a sine beyond it.
        """
        if output in o.PRESSURES:
            self._plant.command(self._muscle(output), waves_of(segment, scale, self.time, SETPOINTS))
        elif output == o.ANGLE and self._options.free_end == "actuator":
            waves = waves_of(segment, scale, self.time, (-math.inf, math.inf))
            self._wanted.command(waves)
            if segment.kind == "constant":
                waves = ramp(self.time, self._plant.angle, waves[0].level, DRIVE_SPEED)
            self._plant.drive(waves)
        else:
            raise DeviceError(self._name, f'no output "{output}" with a free end of {self._options.free_end}')

    def _muscle(self, output: str) -> int:
        """Muscle that the hose of an output leads to, from 0."""
        index = o.PRESSURES.index(output)
        return 1 - index if self._options.hoses == "crossed" else index

    def setpoint(self, output: str) -> float:
        """Present set-point [SI]."""
        held = self._wanted if output == o.ANGLE else self._plant.supplies[self._muscle(output)]
        return held.setpoint(self.time)

    def halt(self, output: str) -> None:
        """Stop: the drive at its present angle, a regulator at its present set-point."""
        here = constant(self.time, self._plant.angle if output == o.ANGLE else self.setpoint(output))
        if output == o.ANGLE:
            self._wanted.command(here)
            self._plant.drive(here)
        else:
            self._plant.command(self._muscle(output), here)

    def place(self, load: Load) -> None:
        """No effect: a joint carries no weights."""

    # -- the air --------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Update the air of each muscle for the present state of valves and faults."""
        airs = enumerate(zip(self._valves.each, self._plant.supplies, strict=True), start=1)
        each = tuple(
            self._settled(air, supply, self._dumps[number - 1], failing=number == self._options.faulty)
            for number, (air, supply) in airs
        )
        self._valves = replace(self._valves, each=each)

    def _settled(self, air: Air, supply: Regulated, dumps: Sequence[str], *, failing: bool) -> Air:
        """The air of one muscle, which may be the `failing` one; the strongest effect counts."""
        faults, time, energised = self.faults, self.time, self._valves.energised
        shut = energised.issuperset(dumps)
        opens = not shut and (air.open or not (failing and self._is_due(faults.dump_stuck_at)))
        held = None
        if failing and self._is_due(faults.regulator_stuck_at):
            held = supply.value(time) if air.held is None else air.held
        forced: tuple[float, float] | None = None
        if failing and self._is_due(faults.burst_at):
            forced = 0.0, BURST_LAG
        elif opens:
            forced = 0.0, self._options.dump_lag * self._options.slow_vent
        elif self._is_due(faults.supply_lost_at) or (self._shut_off and o.SUPPLY_VALVE not in energised):
            forced = 0.0, SUPPLY_LAG
        elif held is not None:
            forced = held, supply.regulator.lag
        elif self._isolated and o.ISOLATION_VALVE not in energised:
            leaks = failing and self._is_due(faults.leak_at)
            forced = (0.0, LEAK_LAG) if leaks else air.forced or (supply.value(time), supply.regulator.lag)
        _press(supply, time, air.forced, forced)
        return Air(opens, held, forced)

    # -- what the channels are exposed to --------------------------------------------------------------------------

    def _along(self, until: float, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        supply = self._supply()
        supplies = self._plant.supplies
        wanted = {f"{name}_set": supplies[self._muscle(name)].setpoints(times) for name in o.PRESSURES}
        # before the plant advances: old commands are dropped
        wanted["angle_set"] = self._wanted.setpoints(times)
        moved = self._plant.advance(until, times.tolist())
        self._wanted.value(until)
        return {
            **wanted,
            "pressure_1": moved.pressure_1,
            "pressure_2": moved.pressure_2,
            o.ANGLE: moved.angle,
            o.TORQUE: moved.torque,
            "supply": np.full(len(times), supply),
        }


PLATFORM_NOISE = {
    **dict.fromkeys(o.OF_THREE, 300.0),
    **dict.fromkeys(o.ACCELERATIONS, 0.02),
    **dict.fromkeys(o.TURNS, math.radians(0.1)),
}
"""Noise of the sensors [Pa, m/s2, rad/s]; assumed."""
HEIGHT = 0.02
"""Default height of the accelerometer above the joint [m]."""
BURST, LEAK = 10.0, 0.5
"""Width of a hole relative to an exhaust valve."""


class PlatformSimulation(Sampled):
    """The platform from bench time `start` [s] on, without pressure, upright; `memory` as in `Sampled`."""

    def __init__(self, device: DeviceRecord, options: Options, start: float, memory: float = MEMORY) -> None:
        super().__init__(device, options, PLATFORM_NOISE, memory)
        height = options.built.get("accelerometer", HEIGHT)
        self._plant = PlatformPlant(platform.described(options.built), state=(0.0,) * 10, height=height)
        self._dumps = [valve.output for valve in device.valves if valve.output in o.DUMPS] or [o.DUMP_VALVE]
        self._plant.time = start
        self._settle()

    @property
    def pressure(self) -> float:
        """The highest of the three gauge pressures [Pa], without any error of a sensor."""
        return float(max(self._plant.state[4:7]))

    @property
    def energised(self) -> bool:
        """Whether the dumps are commanded shut."""
        return self._valves.energised.issuperset(self._dumps)

    @property
    def dump_open(self) -> bool:
        """Whether the dumps empty all muscles."""
        return self._plant.dump and not self._plant.blocked

    # -- commands, at the plant's time ----------------------------------------------------------------------------

    def pulse(self, output: str, seconds: float) -> None:
        """Open a valve for a time [s] from now."""
        kind, _, number = output.partition("_")
        if output not in (*o.FILLS, *o.EXHAUSTS):
            raise ValueError(f'"{output}" is switched and stays')
        self._plant.pulse(kind, int(number) - 1, seconds)

    def switch(self, output: str, *, on: bool) -> None:
        """Switch shut-off and dumps; for a valve that opens in pulses, end the pulse, or open it until it is shut."""
        if output in (*o.FILLS, *o.EXHAUSTS):
            kind, _, number = output.partition("_")
            self._plant.shut(kind, int(number) - 1)
            if on:
                self._plant.pulse(kind, int(number) - 1, math.inf)
        super().switch(output, on=on)

    def command(self, output: str, segment: Segment, scale: Scale) -> None:
        """Refuse: no output takes a value."""
        raise DeviceError(self._name, f'no output "{output}": a platform has valves only')

    def setpoint(self, output: str) -> float:
        """Refuse: no output takes a value."""
        raise DeviceError(self._name, f'no output "{output}": a platform has valves only')

    def halt(self, output: str) -> None:
        """No effect: nothing moves by itself."""

    def place(self, load: Load) -> None:
        """No effect: a platform carries no weights."""

    # -- faults ---------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Update valves and sensors for the present commands and faults."""
        plant, faults, i = self._plant, self.faults, self._options.faulty - 1
        plant.supply = self.is_on(o.SUPPLY_VALVE) and not self._is_due(faults.supply_lost_at)
        plant.dump = not self.energised
        plant.blocked = tuple(m for m in MUSCLES if self._shut(m) or (m == i and self._is_due(faults.dump_stuck_at)))
        stuck = {
            ("fill", True): faults.fill_stuck_open_at,
            ("fill", False): faults.fill_stuck_shut_at,
            ("exhaust", True): faults.exhaust_stuck_open_at,
            ("exhaust", False): faults.exhaust_stuck_shut_at,
        }
        plant.stuck = {(kind, i): is_open for (kind, is_open), at in stuck.items() if self._is_due(at)}
        plant.holes[i] = BURST * self._is_due(faults.burst_at) + LEAK * self._is_due(faults.leak_at)
        plant.shows_level = self._is_due(faults.accelerometer_level_at)

    def _shut(self, muscle: int) -> bool:
        """Whether the dump of a muscle, from 0, is commanded closed."""
        return not {o.DUMP_VALVE, f"{o.DUMP_VALVE}_{muscle + 1}"}.intersection(self._dumps) - self._valves.energised

    # -- what the channels are exposed to --------------------------------------------------------------------------

    def _at(self, time: float) -> dict[str, float]:
        self._plant.advance(time)
        turns = dict(zip(o.TURNS, self._plant.turns(), strict=True))
        return {**self._plant.measure(), **turns, "supply": self._supply()}

    def _along(self, until: float, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        rows = [self._at(t) for t in times.tolist()]
        self._plant.advance(until)
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}
