"""A joint of two muscles in bench time: regulators, a dump valve for both, what fails of them; knows no clock, no link.

Channel inputs: `pressure_1`, `pressure_2`, their set-points `pressure_1_set` and `pressure_2_set`, `angle`, `torque`,
`supply`, and with a drive `angle_set`. Outputs: `pressure_1`, `pressure_2`, and with a drive `angle`; the valve
`dump_valve` empties both muscles, `dump_valve_1` and `dump_valve_2` one each; `supply_valve` lets air to the regulators
while it is energised, and is there where the bench names it. A drive holds the joint wherever it was
sent, at any torque; without one it is free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Load, Scale, Segment
from pmabench.model.many.joint import JointPlant, described
from pmabench.model.regulator import Regulated, Regulator, constant, ramp
from pmabench_drivers.mock import options as o
from pmabench_drivers.mock.options import Options
from pmabench_drivers.mock.sampled import MEMORY, Sampled, refuse_unknown, waves_of
from pmabench_drivers.mock.simulation import BURST_LAG, SETPOINTS, SUPPLY_LAG

NOISE = {**dict.fromkeys(o.PRESSURES, 500.0), o.ANGLE: math.radians(0.02), o.TORQUE: 0.01}
"""Of the sensors of preset `bench` [Pa, rad, N m]; assumed."""


DRIVE_SPEED = math.radians(60)
"""At which the drive goes to an angle that it is sent to at once [rad/s]."""


@dataclass(frozen=True)
class _Air:
    """What keeps a regulator from its muscle."""

    open: bool
    """The dump valve empties it."""
    held: float | None = None
    """The pressure at which its regulator is stuck [Pa]."""
    forced: tuple[float, float] | None = None
    """Where the pressure goes whatever is commanded [Pa], and with which lag [s]."""


@dataclass(frozen=True)
class _Valves:
    energised: frozenset[str]
    each: tuple[_Air, ...]


class JointSimulation(Sampled):
    """The joint from bench time `start` [s] on, without pressure, at angle 0; `memory` as in `Sampled`."""

    def __init__(self, device: DeviceRecord, options: Options, start: float, memory: float = MEMORY) -> None:
        super().__init__(device, options, NOISE if options.preset == "bench" else {}, memory)
        named = [valve.output for valve in device.valves]
        refuse_unknown(device.name, "output", named, o.VALVES_OF[o.JOINT])
        joint = described(options.built)
        if options.preset != "bench":
            joint = replace(joint, regulator=Regulator(dead_time=0.04))
        vent_ratio = joint.regulator.vent_ratio * options.slow_vent
        self._plant = JointPlant(replace(joint, regulator=replace(joint.regulator, vent_ratio=vent_ratio)), start=start)
        self._wanted = Regulated(Regulator(), start=start)
        """Where the drive was sent [rad]."""
        if options.free_end == "actuator":
            self._plant.drive(constant(start, 0.0))
        self._dumps = tuple([n for n in named if n in (o.DUMP_VALVE, f"{o.DUMP_VALVE}_{i}")] for i in (1, 2))
        self._shut_off = o.SUPPLY_VALVE in named
        self._valve = _Valves(frozenset(), tuple(_Air(bool(dumps)) for dumps in self._dumps))
        self._settle()

    @property
    def pressure(self) -> float:
        """The higher one of the two gauge pressures [Pa], without any error of a sensor."""
        return float(max(supply.value(self.time) for supply in self._plant.supplies))

    @property
    def energised(self) -> bool:
        """Whether every dump valve is commanded closed."""
        return any(self._dumps) and all(self._valve.energised.issuperset(dumps) for dumps in self._dumps)

    @property
    def dump_open(self) -> bool:
        """Whether the dump valve empties both muscles."""
        return all(air.open for air in self._valve.each)

    # -- commands, at the plant's time ----------------------------------------------------------------------------

    def command(self, output: str, segment: Segment, scale: Scale) -> None:
        """Follow a segment in device units; `constant` goes to its origin at once.

        A pressure's set-point ends at the regulator's range; ValueError for a sine that goes beyond.
        """
        if output in o.PRESSURES:
            self._plant.command(o.PRESSURES.index(output), waves_of(segment, scale, self.time, SETPOINTS))
        elif output == o.ANGLE and self._options.free_end == "actuator":
            waves = waves_of(segment, scale, self.time, (-math.inf, math.inf))
            self._wanted.command(waves)
            if segment.kind == "constant":
                waves = ramp(self.time, self._plant.angle, waves[0].level, DRIVE_SPEED)
            self._plant.drive(waves)
        else:
            raise DeviceError(self._name, f'no output "{output}" with a free end of {self._options.free_end}')

    def setpoint(self, output: str) -> float:
        """The value commanded now [SI]."""
        held = self._wanted if output == o.ANGLE else self._plant.supplies[o.PRESSURES.index(output)]
        return held.setpoint(self.time)

    def halt(self, output: str) -> None:
        """Stop where it is: the drive at its angle, a regulator at its set-point of now."""
        here = constant(self.time, self._plant.angle if output == o.ANGLE else self.setpoint(output))
        if output == o.ANGLE:
            self._wanted.command(here)
            self._plant.drive(here)
        else:
            self._plant.command(o.PRESSURES.index(output), here)

    def switch(self, output: str, *, on: bool) -> None:
        """Energise a valve, which closes a dump and opens the supply, or not."""
        energised = self._valve.energised
        self._valve = replace(self._valve, energised=energised | {output} if on else energised - {output})
        self._settle()

    def is_on(self, output: str) -> bool:
        """Whether a valve is energised."""
        return output in self._valve.energised

    def place(self, load: Load) -> None:
        """Nothing: a joint carries no weights."""

    # -- the air --------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Bring the air of each muscle in line with valve and faults as they are at this moment."""
        airs = enumerate(zip(self._valve.each, self._plant.supplies, strict=True), start=1)
        each = tuple(
            self._settled(air, supply, self._dumps[number - 1], failing=number == self._options.faulty)
            for number, (air, supply) in airs
        )
        self._valve = replace(self._valve, each=each)

    def _settled(self, air: _Air, supply: Regulated, dumps: Sequence[str], *, failing: bool) -> _Air:
        """The air of one muscle, which may be the `failing` one; the strongest of what acts on it counts."""
        faults, time, energised = self.faults, self.time, self._valve.energised
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
        if forced != air.forced:
            if forced is None:
                supply.release(time)
            else:
                supply.force(time, *forced)
        return _Air(opens, held, forced)

    # -- what the channels are exposed to --------------------------------------------------------------------------

    def _at(self, time: float) -> dict[str, float]:
        self._plant.advance(time)
        self._wanted.value(time)
        values = {name: supply.value(time) for name, supply in zip(o.PRESSURES, self._plant.supplies, strict=True)}
        values |= {f"{name}_set": self.setpoint(name) for name in o.PRESSURES}
        values |= {o.ANGLE: self._plant.angle, o.TORQUE: self._plant.torque(), "angle_set": self.setpoint(o.ANGLE)}
        return values | {"supply": self._supply()}

    def _along(self, until: float, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        supply = self._supply()
        pressures = zip(o.PRESSURES, self._plant.supplies, strict=True)
        wanted = {f"{name}_set": held.setpoints(times) for name, held in pressures}  # before: old commands are dropped
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
