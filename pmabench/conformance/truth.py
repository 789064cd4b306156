"""Actual state of plant and device, without the driver under test: from the emulator, or from the simulation itself.

Three sources with the same methods. An emulated device has the plant of its emulator behind it; a driver that is a
simulation has `simulation()`, and one whose simulation is another process has `control(do)`. Uses no connection.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Segment, ValveRecord

DUMP_VALVE = "dump_valve"
SPEED = 0.2
"""Speed of an actuator on its way to another position [m/s]."""
MASS = 5.0
"""Mass that moves with a load [kg]."""


@dataclass(frozen=True)
class State:
    """A state of the plant that is set independently of the driver."""

    pressure: float
    """Pressure [Pa]."""
    position: float
    """Contraction set by an actuator [m]."""
    force: float
    """Load on a free end [N]."""
    supply: bool = True


class Emulated:
    """The emulator's plant and the log of the emulated device; quantities are SI, by channel name."""

    history = True
    """Whether `at` also returns past values."""

    def __init__(self, record: DeviceRecord, emulator: Any, rescue: Callable[[], Any]) -> None:
        self._record, self._emulator, self._rescue = record, emulator, rescue

    @property
    def _plant(self) -> Any:
        return self._emulator().plant

    def now(self) -> Mapping[str, float]:
        """Present value of the quantity of each channel [SI]."""
        return dict(self._plant.quantities())

    def at(self, moment: float) -> Mapping[str, float]:
        """The same at a moment [s, monotonic]."""
        return dict(self._plant.at(moment))

    def coil(self, valve: ValveRecord) -> bool | None:
        """Last command to a valve: True if energised; None without one."""
        entries = [e for e in self._emulator().log.of("switch", self._record.name) if e.get("valve") == valve.name]
        return bool(entries[-1]["on"]) if entries else None

    def dump_open(self) -> bool:
        """Whether the dump valve is open in the plant."""
        return bool(self._plant.dump_open())

    def bring(self, state: State) -> None:
        """Bring the plant to a state."""
        plant = self._plant
        if self._record.valves:
            plant.switch(on=True)
        plant.fail("supply_lost_at", over=state.supply)
        plant.command(state.pressure)
        if any(output.quantity == "length" for output in self._record.outputs):
            return  # the device's own drive moves the end, and would trip if it were moved otherwise
        if "displacement_command" in self.now():
            plant.drive(state.position, SPEED)
        else:
            plant.load(state.force, MASS)

    def e_stop(self, *, pressed: bool) -> None:
        """Press or release the emergency stop."""
        self._plant.fail("e_stop_at", over=not pressed)

    def by_hand(self, output: str, value: float) -> bool:
        """Change an output without the driver; whether that is possible."""
        own = getattr(self._emulator().devices[self._record.name], "by_hand", None)
        if own is None:
            return rescued(self._rescue(), output, value)
        own(output, value)
        return True


class Inside:
    """The same for a driver that is a simulation."""

    history = False

    def __init__(self, record: DeviceRecord, device: Callable[[], Any]) -> None:
        self._record, self._device = record, device

    @property
    def _simulation(self) -> Any:
        return self._device().simulation()

    @property
    def _state(self) -> Mapping[str, Any]:
        """Quantities by input, valves by output, and whether the dump valve is open."""
        now = self._simulation
        valves = {valve.output: now.is_on(valve.output) for valve in self._record.valves}
        return {"quantities": now.quantities(), "valves": valves, "dump_open": now.dump_open}

    def now(self) -> Mapping[str, float]:
        """Present value of the quantity of each channel [SI]; inputs of the simulation under the names of channels."""
        return {name.replace("_set", "_command"): float(value) for name, value in self._state["quantities"].items()}

    def at(self, _moment: float) -> Mapping[str, float]:
        """As `now`: the past is not known."""
        return self.now()

    def coil(self, valve: ValveRecord) -> bool | None:
        """Whether a valve is energised."""
        return bool(self._state["valves"][valve.output])

    def dump_open(self) -> bool:
        """Whether the dump valve is open in the plant."""
        return bool(self._state["dump_open"])

    def bring(self, state: State) -> None:
        """Bring the plant to a state."""
        for valve in self._record.valves:
            self.by_hand(valve.output, 1.0)
        for output in self._record.outputs:
            wanted = state.pressure if output.quantity == "pressure" else state.position
            self.by_hand(output.output, float(output.scale.to_raw(min(max(wanted, output.low), output.high))))

    def e_stop(self, *, pressed: bool) -> None:
        """Press or release the emergency stop."""
        simulation = self._simulation
        simulation.fail("e_stop_at", simulation.time if pressed else None)

    def by_hand(self, output: str, value: float) -> bool:
        """Change an output without the driver; whether that is possible."""
        simulation = self._simulation
        for record in self._record.outputs:
            if record.output == output:
                simulation.command(output, Segment("constant", simulation.time, value), record.scale)
                return True
        simulation.switch(output, on=bool(value))
        return True


class Behind(Inside):
    """The same for a driver whose simulation is another process."""

    def __init__(self, record: DeviceRecord, device: Callable[[], Any], rescue: Callable[[], Any]) -> None:
        super().__init__(record, device)
        self._rescue = rescue

    @property
    def _state(self) -> Any:
        return self._device().control("state")

    def e_stop(self, *, pressed: bool) -> None:
        """Press or release the emergency stop."""
        self._device().control("inject", fault="e_stop", after=0.0 if pressed else None)

    def by_hand(self, output: str, value: float) -> bool:
        """Change an output without the driver; whether that is possible."""
        return rescued(self._rescue(), output, value)


Truth = Emulated | Inside


def rescued(another: Any, output: str, value: float) -> bool:
    """Change an output by a second driver that is not open, unnoticed by the first; whether that was possible."""
    if another is None:
        return False
    try:
        another.rescue(output, value)
    except DeviceError:
        return False
    return True
