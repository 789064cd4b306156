"""What every driver implements, and the compiled bench as plain records; standard library only.

A driver is a class that is built as `Driver(device, clock)` from a `DeviceRecord` and a clock, imports nothing heavy
before `open`, and implements `Device` and those of the small capabilities below that its device has.
Values that cross this interface are in the device's own units (counts, volts, pascal ...); the scaling to SI stands
beside them in the records and is done above the driver. Raises only `pmabench.base.errors.DeviceError`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol, runtime_checkable


@dataclass(frozen=True)
class Scale:
    """A straight line between device units and SI: `si = slope * raw + offset`."""

    slope: float = 1.0
    offset: float = 0.0

    def to_si(self, raw: Any) -> Any:
        """Device units to SI; works on numbers and arrays."""
        return raw * self.slope + self.offset

    def to_raw(self, si: Any) -> Any:
        """SI to device units; works on numbers and arrays."""
        return (si - self.offset) / self.slope


@dataclass(frozen=True)
class CalibrationRecord:
    """Where a channel's scale comes from, and how well it is known (95 %, k = 2)."""

    id: str = ""
    reference: str = ""
    date: str = ""
    valid_until: str = ""
    offset_uncertainty: float = 0.0
    """Expanded uncertainty that is the same at every reading [SI unit of the channel]."""
    gain_uncertainty: float = 0.0
    """Expanded uncertainty in proportion to the reading [1]."""
    sensor_lag: float = 0.0
    """First-order lag of the sensor [s]."""
    sha256: str = ""


@dataclass(frozen=True)
class ChannelRecord:
    """One measured quantity."""

    name: str
    quantity: str
    """Key of `pmabench.base.quantities.QUANTITIES`."""
    device: str
    input: str
    raw_type: str
    """`int32` where the device gives counts, else `float64`."""
    raw_unit: str
    scale: Scale
    low: float
    """Lowest value that the channel can tell [SI]."""
    high: float
    """Highest value that the channel can tell [SI]."""
    reference: str = "gauge"
    calibration: CalibrationRecord = field(default_factory=CalibrationRecord)


@dataclass(frozen=True)
class OutputRecord:
    """One commanded quantity; `low` and `high` are the active command limits [SI].

    `low_from` and `high_from` say who set them, as file:line:column.
    """

    name: str
    quantity: str
    device: str
    output: str
    scale: Scale
    resolution: float
    """Smallest step of the device [device units]; 0 for none."""
    safe: float
    """Value in the safe state [SI]."""
    low: float
    high: float
    low_from: str = ""
    high_from: str = ""
    rate: float = 0.0
    """Highest rate of change [SI/s]; 0 for none."""


@dataclass(frozen=True)
class TripRecord:
    """A limit on what is measured."""

    channel: str
    low: float | None
    high: float | None
    delay: float
    """How long the value must stay outside before the action [s]."""
    action: str
    """What happens then: `vent`."""
    source: str = ""
    """file:line:column of the limit."""


@dataclass(frozen=True)
class SafeAction:
    """One action of the safe state: `set` an output, or `confirm` that a channel falls below a value."""

    do: str
    target: str
    value: float
    within: float
    """Deadline [s]."""


@dataclass(frozen=True)
class DeviceRecord:
    """One device: its driver as `module:Class`, its address and options as the bench file gives them."""

    name: str
    driver: str
    address: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    channels: tuple[ChannelRecord, ...] = ()
    outputs: tuple[OutputRecord, ...] = ()


@dataclass(frozen=True)
class CompiledBench:
    """A bench with a specimen mounted, checked and flattened; all the guard needs to keep it safe."""

    name: str
    simulated: bool
    realtime: bool
    free_end: str
    """`weights`, `actuator`, `fixed` or `free`."""
    devices: tuple[DeviceRecord, ...]
    trips: tuple[TripRecord, ...]
    safe_state: tuple[SafeAction, ...]
    hands_below: float
    """Measured gauge pressure under which hands may go in [Pa]."""
    hands_at_pressure: float = 0.0
    """Highest pressure at which a protocol may ask for hands at pressure [Pa]; 0: never."""
    gravity: float = 9.81
    carriage: float = 0.0
    """Mass that moves with every load: table, cable, rod [kg]."""
    hanging: bool = True
    """Whether a load in kg moves with the muscle (weights) or acts as a pure force (constant-force device)."""
    slack_below: float = 0.0
    """Force under which the specimen counts as slack [N]."""
    length: float = 0.0
    """Mounted length of the specimen [m]."""

    @property
    def channels(self) -> tuple[ChannelRecord, ...]:
        """Every channel of every device."""
        return tuple(channel for device in self.devices for channel in device.channels)

    @property
    def outputs(self) -> tuple[OutputRecord, ...]:
        """Every output of every device."""
        return tuple(output for device in self.devices for output in device.outputs)

    def to_json(self) -> str:
        """The bench as JSON, for the guard and for the run's snapshot."""
        return json.dumps(asdict(self), indent=1, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> CompiledBench:
        """The inverse of `to_json`."""
        data = json.loads(text)
        data["devices"] = tuple(_device(item) for item in data["devices"])
        data["trips"] = tuple(TripRecord(**item) for item in data["trips"])
        data["safe_state"] = tuple(SafeAction(**item) for item in data["safe_state"])
        return cls(**data)


def _device(data: dict[str, Any]) -> DeviceRecord:
    channels = tuple(
        ChannelRecord(
            **{
                **item,
                "scale": Scale(**item["scale"]),
                "calibration": CalibrationRecord(**item["calibration"]),
            }
        )
        for item in data["channels"]
    )
    outputs = tuple(OutputRecord(**{**item, "scale": Scale(**item["scale"])}) for item in data["outputs"])
    return DeviceRecord(**{**data, "channels": channels, "outputs": outputs})


@dataclass(frozen=True)
class Identity:
    """Who answered when the device was opened."""

    maker: str
    model: str
    serial: str
    firmware: str
    simulated: bool = False


@dataclass(frozen=True)
class Load:
    """What the operator's hands put on the free end."""

    force: float
    """Dead load F_L [N]."""
    mass: float
    """Mass that moves with it [kg]."""


@dataclass(frozen=True)
class Segment:
    """A command over a stretch of time, as data, so that a device can follow it by itself.

    From `start` [s, bench time] on: `ramp`: from `origin` to `target` at `rate` (then constant); `sine`:
    `origin + amplitude * sin(2 pi frequency (t - start))` for `cycles` whole cycles (then constant at `origin`).
    All values in device units (`rate` per second).
    """

    kind: str
    start: float
    origin: float
    target: float = 0.0
    rate: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    cycles: float = 0.0


@dataclass(frozen=True)
class Block:
    """Consecutive samples of one stream, all channels of one device, on the device's clock.

    `time` [ns, device clock] and each of `columns` (raw device units, keyed by channel name) have the same length and
    are arrays or lists.
    """

    time: Sequence[int]
    columns: Mapping[str, Sequence[float]]


@runtime_checkable
class Device(Protocol):
    """What every driver can do."""

    def open(self) -> Identity:
        """Connect and identify; nothing moves and nothing is commanded."""
        ...

    def close(self) -> None:
        """Let go of the link; harmless when repeated."""
        ...


@runtime_checkable
class Stream(Protocol):
    """Samples its channels together on one clock."""

    def start(self, rate: float) -> float:
        """Begin to sample at `rate` [Hz]; returns the rate that the device will really use."""
        ...

    def collect(self) -> Block:
        """Every sample taken since the last call, oldest first; at once, and may be empty."""
        ...

    def stop(self) -> None:
        """End sampling; harmless when repeated."""
        ...


@runtime_checkable
class SetPoint(Protocol):
    """Takes commanded values."""

    def write(self, output: str, value: float) -> None:
        """Command `value` [device units] at once, ending a segment under way; never retried."""
        ...

    def read_back(self, output: str) -> float:
        """The value that the device holds now [device units]."""
        ...


@runtime_checkable
class Follower(Protocol):
    """Follows ramps and sines by itself."""

    def follow(self, output: str, segment: Segment) -> None:
        """Begin the segment; the next `write` or `follow` ends it."""
        ...


@runtime_checkable
class Hands(Protocol):
    """A bench whose operator is part of the device: it is told what hands did, as answered at the prompt."""

    def place(self, load: Load) -> None:
        """The free end now carries `load`."""
        ...
