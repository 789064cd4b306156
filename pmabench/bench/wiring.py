"""What is really wired to the devices of a rig, as plain records for emulators; standard library only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pmabench.bench.records import DeviceRecord, Scale


@dataclass(frozen=True)
class Plug:
    """What is plugged into one terminal: a sensor or an actuator with its signal, and how the terminal shows that."""

    sensor: Scale
    """Signal to SI."""
    digits: Scale = field(default_factory=Scale)
    """What the device gives or takes to the signal."""
    unit: str = ""
    """Of the signal: only plugs with the same one fit into each other's terminals."""
    low: float = 0.0
    """Where the range of the sensor begins [SI]."""

    @property
    def scale(self) -> Scale:
        """What the device gives or takes to SI."""
        return Scale(self.sensor.slope * self.digits.slope, float(self.sensor.to_si(self.digits.offset)))


@dataclass(frozen=True)
class Wired:
    """One device as it is really wired: a record for its emulator, and the plugs by terminal."""

    record: DeviceRecord
    """Channels, outputs, valves and interlocks have the names of what they are in the plant, and the plugs' scales."""
    inputs: Mapping[str, Plug]
    outputs: Mapping[str, Plug]


@dataclass(frozen=True)
class Truth:
    """A rig as its truth file says, by the names of its devices; without addresses."""

    path: str
    devices: Mapping[str, Wired]
