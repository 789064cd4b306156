"""What plant and device really do, asked without the driver that is tried: the emulator, or the simulation itself.

Three sources with the same methods. An emulated device has the plant of its emulator behind it; a driver that is a
simulation has `simulation()`, and one whose simulation is another process has `control(do)`. Knows no wire.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Segment, ValveRecord

DUMP_VALVE = "dump_valve"
SPEED = 0.2
"""At which an actuator is sent to another place [m/s]."""
MASS = 5.0
"""That moves with a load [kg]."""


@dataclass(frozen=True)
class State:
    """Where the plant is brought, whatever the driver does."""

    pressure: float
    """[Pa]"""
    position: float
    """Of an actuator [m of contraction]."""
    force: float
    """Load on a free end [N]."""
    supply: bool = True


class Emulated:
    """The emulator's plant, and what the emulated device wrote down; quantities are SI, by the names of channels."""

    history = True
    """Whether `at` knows the last second."""

    def __init__(self, record: DeviceRecord, emulator: Any, rescue: Callable[[], Any]) -> None:
        self._record, self._emulator, self._rescue = record, emulator, rescue

    @property
    def _plant(self) -> Any:
        return self._emulator().plant

    def now(self) -> Mapping[str, float]:
        """What each channel is exposed to now [SI]."""
        return dict(self._plant.quantities())

    def at(self, moment: float) -> Mapping[str, float]:
        """The same at a moment [s, monotonic]."""
        return dict(self._plant.at(moment))

    def coil(self, valve: ValveRecord) -> bool | None:
        """What arrived for a valve."""
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
            return  # the device's own drive moves the end, and trips where it is moved otherwise
        if "displacement_command" in self.now():
            plant.drive(state.position, SPEED)
        else:
            plant.load(state.force, MASS)

    def e_stop(self, *, pressed: bool) -> None:
        """Press or release the emergency stop."""
        self._plant.fail("e_stop_at", over=not pressed)

    def by_hand(self, output: str, value: float) -> bool:
        """Change an output without the driver; whether that can be done."""
        own = getattr(self._emulator().devices[self._record.name], "by_hand", None)
        if own is None:
            return rescued(self._rescue(), output, value)
        own(output, value)
        return True


class Inside:
    """A driver that is a simulation, with the same face."""

    history = False

    def __init__(self, record: DeviceRecord, device: Callable[[], Any]) -> None:
        self._record, self._device = record, device

    @property
    def _simulation(self) -> Any:
        return self._device().simulation()

    @property
    def _state(self) -> Mapping[str, Any]:
        """Its quantities by inputs, its valves by outputs, and whether the dump is open."""
        now = self._simulation
        valves = {valve.output: now.is_on(valve.output) for valve in self._record.valves}
        return {"quantities": now.quantities(), "valves": valves, "dump_open": now.dump_open}

    def now(self) -> Mapping[str, float]:
        """What each channel is exposed to now [SI]; inputs of the simulation by the names of a bench's channels."""
        return {name.replace("_set", "_command"): float(value) for name, value in self._state["quantities"].items()}

    def at(self, _moment: float) -> Mapping[str, float]:
        """What each channel is exposed to now [SI]: the past is not known."""
        return self.now()

    def coil(self, valve: ValveRecord) -> bool | None:
        """What arrived for a valve."""
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
        """Change an output without the driver; whether that can be done."""
        simulation = self._simulation
        for record in self._record.outputs:
            if record.output == output:
                simulation.command(output, Segment("constant", simulation.time, value), record.scale)
                return True
        simulation.switch(output, on=bool(value))
        return True


class Behind(Inside):
    """A driver whose simulation is another process."""

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
        """Change an output without the driver; whether that can be done."""
        return rescued(self._rescue(), output, value)


Truth = Emulated | Inside


def rescued(another: Any, output: str, value: float) -> bool:
    """Change an output by a second driver, which needs no `open` for it and of which the first one knows nothing."""
    if another is None:
        return False
    try:
        another.rescue(output, value)
    except DeviceError:
        return False
    return True
