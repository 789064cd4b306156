"""A platform of three muscles in bench time: valves, a shut-off, dumps, what fails of them; knows no clock, no link.

Channel inputs: `pressure_1` to `pressure_3`, `acceleration_x` to `_z`, `turn_x` and `turn_y` of a gyroscope, `supply`.
Valves: `fill_1` to `exhaust_3` open in pulses; `supply_valve` lets air to the fill valves while it is energised;
`dump_valve` is one at each muscle, open while it is not; `dump_valve_1` and so on are those of one muscle.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Load, Scale, Segment
from pmabench.model.many.platform import MUSCLES, PlatformPlant, described
from pmabench_drivers.mock import options as o
from pmabench_drivers.mock.options import Options
from pmabench_drivers.mock.sampled import MEMORY, Sampled, refuse_unknown

NOISE = {
    **dict.fromkeys(o.OF_THREE, 300.0),
    **dict.fromkeys(o.ACCELERATIONS, 0.02),
    **dict.fromkeys(o.TURNS, math.radians(0.1)),
}
"""Of the sensors [Pa, m/s2, rad/s]; assumed."""
HEIGHT = 0.02
"""Of the accelerometer above the joint, where nothing says more [m]."""
BURST, LEAK = 10.0, 0.5
"""How wide a hole is, an exhaust valve being 1."""


class PlatformSimulation(Sampled):
    """The platform from bench time `start` [s] on, without pressure, upright; `memory` as in `Sampled`."""

    def __init__(self, device: DeviceRecord, options: Options, start: float, memory: float = MEMORY) -> None:
        super().__init__(device, options, NOISE, memory)
        refuse_unknown(device.name, "output", [valve.output for valve in device.valves], o.VALVES_OF[o.PLATFORM])
        height = options.built.get("accelerometer", HEIGHT)
        self._plant = PlatformPlant(described(options.built), state=(0.0,) * 10, height=height, noise=0.0)
        self._dumps = [valve.output for valve in device.valves if valve.output in o.DUMPS] or [o.DUMP_VALVE]
        self._plant.time = start
        self._plant.supply, self._plant.dump = False, True
        self._valve = frozenset[str]()
        """Valves that are energised."""
        self._settle()

    @property
    def pressure(self) -> float:
        """The highest of the three gauge pressures [Pa], without any error of a sensor."""
        return float(max(self._plant.state[4:7]))

    @property
    def energised(self) -> bool:
        """Whether the dumps are commanded shut."""
        return bool(self._valve.issuperset(self._dumps))

    @property
    def dump_open(self) -> bool:
        """Whether the dumps empty all muscles."""
        return self._plant.dump and not self._plant.blocked

    # -- commands, at the plant's time ----------------------------------------------------------------------------

    def pulse(self, output: str, seconds: float) -> None:
        """Open a valve from now on for so long."""
        kind, _, number = output.partition("_")
        if output not in (*o.FILLS, *o.EXHAUSTS):
            raise ValueError(f'"{output}" is switched and stays')
        self._plant.pulse(kind, int(number) - 1, seconds)

    def switch(self, output: str, *, on: bool) -> None:
        """Shut-off and dumps; of a valve that opens in pulses this ends the pulse, or opens it until it is shut."""
        self._valve = self._valve | {output} if on else self._valve - {output}
        if output in (*o.FILLS, *o.EXHAUSTS):
            kind, _, number = output.partition("_")
            self._plant.shut(kind, int(number) - 1)
            if on:
                self._plant.pulse(kind, int(number) - 1, math.inf)
        self._settle()

    def is_on(self, output: str) -> bool:
        """Whether a valve is energised by `switch`; a pulse is over by itself."""
        return output in self._valve

    def command(self, output: str, segment: Segment, scale: Scale) -> None:
        """Nothing takes a value."""
        raise DeviceError(self._name, f'no output "{output}": a platform has valves only')

    def setpoint(self, output: str) -> float:
        """Nothing takes a value."""
        raise DeviceError(self._name, f'no output "{output}": a platform has valves only')

    def halt(self, output: str) -> None:
        """Nothing moves by itself."""

    def place(self, load: Load) -> None:
        """Nothing: a platform carries no weights."""

    # -- faults ---------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Bring valves and sensors in line with commands and faults as they are at this moment."""
        plant, faults, i = self._plant, self.faults, self._options.faulty - 1
        plant.supply = o.SUPPLY_VALVE in self._valve and not self._is_due(faults.supply_lost_at)
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
        return not {o.DUMP_VALVE, f"{o.DUMP_VALVE}_{muscle + 1}"}.intersection(self._dumps) - self._valve

    # -- what the channels are exposed to --------------------------------------------------------------------------

    def _at(self, time: float) -> dict[str, float]:
        self._plant.advance(time)
        turns = dict(zip(o.TURNS, self._plant.turns(), strict=True))
        return {**self._plant.measure(), **turns, "supply": self._supply()}

    def _along(self, until: float, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        rows = [self._at(t) for t in times.tolist()]
        self._plant.advance(until)
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def attitude(self) -> tuple[float, float]:
        """Phi and psi [rad], without any sensor."""
        return self._plant.state[0], self._plant.state[1]
