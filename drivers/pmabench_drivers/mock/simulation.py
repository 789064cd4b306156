"""One muscle on a bench in bench time: its plant, its valves and what fails of them; knows no clock and no link."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Load, Scale, Segment
from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.plant import Plant
from pmabench.model.presets import Arm, changed, preset, setup_of
from pmabench.model.real.plants import RealPlant
from pmabench.model.regulator import Regulated, constant
from pmabench_drivers.mock import options as o
from pmabench_drivers.mock.options import Options
from pmabench_drivers.mock.sampled import MEMORY, Sampled, refuse_unknown, waves_of

LEAST_MASS = 0.01
"""Moving mass of a free end without anything on it [kg]."""
SETPOINTS = (0.0, 1e6)
"""What the pressure regulator can be set to [Pa]; it takes anything beyond as the nearest of these.

For a plant of a file, up to its own highest pressure."""
BURST_LAG = 0.01
SUPPLY_LAG = 0.5
FLOW_NOISE = 1e-7
"""Of a mass flow meter for 5 l/min (ANR): a thousandth of its range [kg/s]."""


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


class Simulation(Sampled):
    """The plant of one mock bench from bench time `start` [s] on; `memory` says how far it can be taken back [s].

    It has a dump valve when the device has a valve on the output `dump_valve`: not energised it is open.
    """

    AHEAD = 10.0

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
        noise = setup.noise
        sigma = {"pressure": noise.pressure, "displacement": noise.displacement, "force": noise.force}
        self._radius = setup.muscle.radius if isinstance(setup.muscle, Arm) else math.inf
        sigma[o.ANGLE] = noise.displacement / self._radius
        sigma[o.FLOW] = FLOW_NOISE * (noise.pressure > 0)
        self._metered = any(record.input == o.FLOW for record in device.channels)
        super().__init__(device, options, sigma, memory)
        self._plant: Plant | RealPlant | DrivenPlant
        self._valve: _Valve
        if options.free_end == "actuator":
            actuator = Actuator(
                options.actuator_low, options.actuator_high, options.actuator_speed, options.actuator_force
            )
            self._plant = setup.driven(actuator, start=start)
        else:
            self._plant = setup.free(mass=options.carriage, start=start)
        refuse_unknown(device.name, "output", [valve.output for valve in device.valves], o.VALVES)
        self._regulator = setup.regulator
        self._has_valve = any(valve.output == o.DUMP_VALVE for valve in device.valves)
        self._isolated = any(valve.output == o.ISOLATION_VALVE for valve in device.valves)
        self._valve = _Valve(open=self._has_valve)
        self._settle()

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
        waves = waves_of(segment, scale, self._plant.time, limits)
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

    # -- the air --------------------------------------------------------------------------------------------------

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

    def _along(self, until: float, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        supply, regulator = self._supply(), self._regulator_before()
        motion = self._plant.advance(until, times)
        return {
            "pressure": motion.P,
            "displacement": motion.x,
            "force": motion.F,
            "supply": np.full(len(times), supply),
            "pressure_set": motion.P_set,
            "displacement_set": motion.x_set,
            o.ANGLE: motion.x / self._radius,
            o.FLOW: self._inflow(regulator, motion.t, motion.P),
        }

    def _at(self, time: float) -> dict[str, float]:
        plant, regulator = self._plant, self._regulator_before()
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
            o.FLOW: float(self._inflow(regulator, np.array([plant.time]), np.array([P]))[0]),
        }

    def _regulator_before(self) -> Regulated:
        """The regulator as it is now, to look at again after the plant has gone on; a copy only for a meter."""
        return copy.copy(self._plant.supply) if self._metered else self._plant.supply

    def _inflow(self, regulator: Regulated, t: NDArray[np.float64], P: NDArray[np.float64]) -> NDArray[np.float64]:
        """What a meter between regulator and muscle sees [kg/s]; what leaves by the dump valve is not seen."""
        if not self._metered or not isinstance(self._plant, DrivenPlant) or self._valve.forced is not None:
            return np.zeros(t.shape)
        return self._plant.inflow(regulator, t, P)
