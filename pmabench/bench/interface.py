"""The interface of drivers, and the compiled bench as plain records; standard library only.

A driver is a class that is built as `Driver(device, clock)` from a `DeviceRecord` and a clock, imports nothing heavy
before `open`, and implements `Device` and those of the small capabilities below that its device has.
Values that cross this interface are in the device's own units (counts, volts, pascal ...); the scaling to SI is
next to them in the records and is done above the driver. Raises only `pmabench.base.errors.DeviceError`.

In real time each device has one thread that calls it. A call returns within 0.2 s (`open` within 2 s) or raises; no
write is retried but one that the device answered with "busy"; after a time-out the line is drained, so that no answer
is taken for that of a later question.
`collect` never waits for a sample: a polled device has its own polling thread. Optional class methods are called
before anything is opened (`pmabench.bench.driver_options`): `check(device)` yields mistakes in the options,
`fastest(device)` returns the highest sampling rate with them.
The records are all that guard, engine and drivers know of a bench file, and are sent to other processes as JSON. Values
are SI; a `Scale` converts device units. `Truth` is the actual wiring of the devices of a rig, for emulators.
"""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, is_dataclass
from typing import Any, Protocol, TypeVar, get_args, get_origin, get_type_hints, runtime_checkable

R = TypeVar("R")


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
    """Source of a channel's scale, and its uncertainty (95 %, k = 2)."""

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

    def uncertainty(self, value: float) -> float:
        """Expanded uncertainty of a reading of `value` [SI unit of the channel]."""
        return self.offset_uncertainty + self.gain_uncertainty * abs(value)


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
    """Lowest value that the channel can measure [SI]."""
    high: float
    """Highest value that the channel can measure [SI]."""
    reference: str = "gauge"
    calibration: CalibrationRecord = field(default_factory=CalibrationRecord)
    zero: float | None = None
    """Shift of `scale.offset` below the calibration's by the session's zero [SI]; None: no zero was taken."""

    @property
    def calibrated(self) -> Scale:
        """The scale of the calibration, without the zero: what the device knows."""
        return Scale(self.scale.slope, self.scale.offset + (self.zero or 0.0))


@dataclass(frozen=True)
class OutputRecord:
    """One commanded quantity; `low` and `high` are the active command limits [SI].

    `low_from` and `high_from` are the places that set them, as `file:line:column`.
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
    """Highest rate of change [SI/s]; 0: no limit."""


@dataclass(frozen=True)
class ValveRecord:
    """A valve that is switched; `energised` is its position while the output is on, `closed` or `open`."""

    name: str
    device: str
    output: str
    energised: str = "closed"
    safe: str = "open"
    """Position in the safe state; the other one during a run, unless it opens in pulses."""
    longest: float = 0.0
    """Longest pulse [s] of a valve that is shut between pulses; 0: it is switched and stays."""
    never_with: str = ""
    """Name of the valve that must not be open at the same time: the other one of the muscle."""


@dataclass(frozen=True)
class AimRecord:
    """A quantity that valves control without an output for it, such as a muscle's pressure or a tilt; limits in SI."""

    name: str
    quantity: str
    low: float
    high: float
    source: str = ""
    """`file:line:column` of the limit."""

    @property
    def low_from(self) -> str:
        """As for an output."""
        return self.source

    @property
    def high_from(self) -> str:
        """As for an output."""
        return self.source


@dataclass(frozen=True)
class InterlockRecord:
    """A digital input that must stay at its `safe` level, `high` or `low`; otherwise the guard vents and latches."""

    name: str
    device: str
    input: str
    safe: str = "high"


@dataclass(frozen=True)
class TripRecord:
    """A limit on a measured value.

    `kind` is the condition: `range` (outside `low` .. `high`), `rate` (changes faster than `high` [SI/s]),
    `stale` (no sample for `delay`), `frozen` (raw value unchanged for `delay`), `off-range` (at or beyond an end of the
    channel's range), `following` (deviates from its command by more than `high`), `burst` (falls by more than `high`
    within `window` while it is commanded to stay or rise), `slack` (under `low`).
    """

    channel: str
    low: float | None
    high: float | None
    delay: float
    """Time for which the condition must last before the action [s]."""
    action: str
    """Action: `warn`, `hold` (no new command until it is over), `stop` (controlled), `vent`."""
    source: str = ""
    """`file:line:column` of the limit."""
    kind: str = "range"
    window: float = 0.0
    """Time window of a burst [s]."""


@dataclass(frozen=True)
class SafeAction:
    """One action of the safe state, in the declared order.

    `set` an output to `value` [SI] at once; `ramp` an output to `value` at `rate` [SI/s] and wait until it is there;
    `stop` a motion where it is; `open` or `close` a valve; `hold` for `within`; `confirm` that a channel falls below
    `value`.
    """

    do: str
    target: str
    value: float
    within: float
    """Deadline [s], after which the next action starts in any case."""
    rate: float = 0.0


@dataclass(frozen=True)
class ProofTest:
    """Test of the vent path at arming: fill to `pressure` [Pa], vent; must be below `below` within `within` [s]."""

    pressure: float
    below: float
    within: float
    fill: float = 5.0
    """Longest time for filling [s]."""


def place(address: str, options: Mapping[str, Any], *, resolve: bool = True) -> str:
    """Address of a device in one spelling for all bench files; empty for a simulation without an address."""
    if not address or address.startswith("/"):
        return os.path.realpath(address) if address else ""  # target of a link in /dev/serial/by-id
    host, colon, port = address.rpartition(":")
    if not colon or not port.isdigit() or "/" in host:
        return " ".join(str(part) for part in (options.get("server", ""), address) if part)
    with suppress(OSError):
        host = socket.gethostbyname(host) if resolve else host
    map_ = options.get("map")
    unit = options.get("unit_id") or (map_.get("unit_id") if isinstance(map_, Mapping) else None) or 1
    return f"{host}:{port} unit {unit}"


@dataclass(frozen=True)
class DeviceRecord:
    """One device: its driver as `module:Class`, its address and options as the bench file gives them."""

    name: str
    driver: str
    address: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    channels: tuple[ChannelRecord, ...] = ()
    outputs: tuple[OutputRecord, ...] = ()
    valves: tuple[ValveRecord, ...] = ()
    interlocks: tuple[InterlockRecord, ...] = ()
    watchdog: float = 0.0
    """Time without communication after which the device vents by itself [s]; 0: it has no watchdog."""
    verified: str = ""
    """How its driver was verified: `hardware (who, date, firmware)`, `emulator only`, or in other words."""
    verified_firmware: str = ""
    """Firmware to which `verified` applies; empty: any."""
    drift: float = 2e-4
    """Largest drift of its clock against the computer's [1]; samples that arrive later than it explains are late."""
    fastest: float = 0.0
    """Highest sampling rate with these options [Hz]; 0: not stated by its driver."""
    fastest_from: str = ""
    """Place of the options that determine it, as `path:line:column`."""

    @property
    def guarded(self) -> bool:
        """Whether the guard opens it: it has outputs, valves, interlocks or a watchdog."""
        return bool(self.outputs or self.valves or self.interlocks or self.watchdog)


@dataclass(frozen=True)
class CompiledBench:
    """A bench with a specimen mounted, checked and flattened; all that the guard needs to keep it safe."""

    name: str
    simulated: bool
    realtime: bool
    free_end: str
    """`weights`, `actuator`, `fixed`, `free`, `joint` or `platform`."""
    devices: tuple[DeviceRecord, ...]
    trips: tuple[TripRecord, ...]
    safe_state: tuple[SafeAction, ...]
    hands_below: float
    """Measured gauge pressure below which hands may go in [Pa]."""
    hands_at_pressure: float = 0.0
    """Highest pressure at which a protocol may ask for hands at pressure [Pa]; 0: never."""
    gravity: float = 9.81
    carriage: float = 0.0
    """Mass that moves with every load: table, cable, rod [kg]."""
    hanging: bool = True
    """Whether a load in kg moves with the muscle (weights) or acts as a pure force (constant-force device)."""
    load_tolerance: float = 0.1
    """Allowed deviation of the force of a load at rest from its weight [1]."""
    load_action: str = "warn"
    """Action at a larger deviation: `warn` or `stop`."""
    slack_below: float = 0.0
    """Force below which the specimen counts as slack [N]."""
    length: float = 0.0
    """Mounted length of the specimen [m]."""
    setup_pressure: float = 100e3
    """Highest pressure that may be commanded before the bench is proven [Pa]."""
    stop_rate: float = 0.0
    """Rate at which a controlled stop lowers the pressure before the safe state [Pa/s]; 0: at once."""
    proof: ProofTest | None = None
    aims: tuple[AimRecord, ...] = ()
    together: str = ""
    """Name of the consistency check of several channels, in the engine's table; empty: none."""
    platform: Mapping[str, float] = field(default_factory=dict)
    """Numbers for the control of a platform [SI], by name; empty without one."""
    path: str = ""
    """Path of the bench file."""

    @property
    def valves(self) -> tuple[ValveRecord, ...]:
        """Every valve of every device."""
        return tuple(valve for device in self.devices for valve in device.valves)

    @property
    def channels(self) -> tuple[ChannelRecord, ...]:
        """Every channel of every device."""
        return tuple(channel for device in self.devices for channel in device.channels)

    @property
    def outputs(self) -> tuple[OutputRecord, ...]:
        """Every output of every device."""
        return tuple(output for device in self.devices for output in device.outputs)

    @property
    def commanded(self) -> dict[str, OutputRecord | AimRecord]:
        """All that plans command, by name: outputs, and quantities controlled by valves."""
        return {**{output.name: output for output in self.outputs}, **{aim.name: aim for aim in self.aims}}

    @property
    def pressures(self) -> tuple[OutputRecord, ...]:
        """The outputs that command the pressure of a muscle; each has the name of the channel that measures it."""
        return tuple(output for output in self.outputs if output.name.partition("_")[0] == "pressure")

    def to_json(self) -> str:
        """The bench as JSON, for the guard and for the run's snapshot."""
        return json.dumps(asdict(self), indent=1, sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> CompiledBench:
        """The inverse of `to_json`; raises KeyError if devices, trips or safe state are missing."""
        data = json.loads(text)
        for name in ("devices", "trips", "safe_state"):  # an empty default would make a bench without limits
            data[name]
        return _record(cls, data)


def device_from(data: Mapping[str, Any]) -> DeviceRecord:
    """A device record from its JSON object, as given by `dataclasses.asdict`."""
    return _record(DeviceRecord, data)


def _record(kind: type[R], data: Mapping[str, Any]) -> R:
    """A record from its JSON object, with its nested records."""
    values = dict(data)
    for name, hint in get_type_hints(kind).items():
        inner = next((each for each in (hint, *get_args(hint)) if isinstance(each, type) and is_dataclass(each)), None)
        if inner is not None and (given := values.get(name)) is not None:
            several = get_origin(hint) is tuple
            values[name] = tuple(_record(inner, item) for item in given) if several else _record(inner, given)
    return kind(**values)


@dataclass(frozen=True)
class Truth:
    """A rig as described by its truth file, by device name; without addresses.

    Channels, outputs, valves and interlocks are named by their meaning in the plant, and have the scales of what is
    wired to them.
    """

    path: str
    devices: Mapping[str, DeviceRecord]


COMPUTER = "computer"
"""`Identity.clock` of a device without a clock, whose driver stamps its samples."""
EMULATED = "emulated "
"""Prefix of the model name of an emulator: its recordings are never taken for those of a real muscle."""
UNPROVEN = f"{EMULATED}unproven "
"""The same if the emulator took wiring and scales from the bench file, so that mistakes cancel out."""


@dataclass(frozen=True)
class Identity:
    """Identity that a device reported when it was opened."""

    maker: str
    model: str
    serial: str
    firmware: str
    simulated: bool = False
    clock: str = "own"
    """`own`: samples carry its own clock. `computer`: the driver stamps them with bench time, halfway from request
    to answer, or at the first byte of a line; the delay from stamp to arrival is then half of a poll.
    """
    answers: float = 0.0
    """Shortest time for an answer [s], if the driver measures it and polls accordingly; else 0."""


@dataclass(frozen=True)
class Load:
    """What the operator attached to the free end."""

    force: float
    """Dead load F_L [N]."""
    mass: float
    """Mass that moves with it [kg]."""


@dataclass(frozen=True)
class Segment:
    """A command over a period of time, as data, so that a device can follow it by itself.

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
    are arrays or lists (`array.array("q")` and `array.array("d")` cost least on their way to the engine).
    """

    time: Sequence[int]
    columns: Mapping[str, Sequence[float]]
    host: int = -1
    """Arrival of the newest sample at the computer [ns, bench time]; -1 if unknown."""


@runtime_checkable
class Device(Protocol):
    """The interface of every driver."""

    def open(self) -> Identity:
        """Connect and identify; nothing moves and nothing is commanded."""

    def close(self) -> None:
        """Close the connection; may be called again."""


@runtime_checkable
class OpensToVent(Protocol):
    """Can be opened to vent if `open` refuses a fault that matters for measuring only, such as another range."""

    def open_to_vent(self) -> Identity:
        """Connect as far as the commands of a safe state need it; nothing is set, moved or commanded."""


@runtime_checkable
class Stream(Protocol):
    """Samples its channels together on one clock."""

    def start(self, rate: float) -> float:
        """Begin to sample at `rate` [Hz]; returns the actual rate."""

    def collect(self) -> Block:
        """All samples since the last call, oldest first; returns at once, possibly an empty block."""

    def stop(self) -> None:
        """End sampling; may be called again."""


@runtime_checkable
class SetPoint(Protocol):
    """Takes commanded values."""

    def write(self, output: str, value: float) -> None:
        """Command `value` [device units] at once, ending a segment in progress; never retried."""

    def read_back(self, output: str) -> float:
        """The value that the device holds now [device units]."""


@runtime_checkable
class Follower(Protocol):
    """Follows ramps and sines by itself.

    A driver that makes the steps itself keeps in an attribute `unanswered` the time of its last step with an unknown
    outcome [s, bench time]: such a step may be carried out after the safe value.
    """

    def follow(self, output: str, segment: Segment) -> None:
        """Begin the segment; the next `write` or `follow` ends it."""


@runtime_checkable
class Hands(Protocol):
    """A device that simulates the operator too: it is informed of what was attached, as answered at the prompt."""

    def place(self, load: Load) -> None:
        """Inform the device that the free end now carries `load`."""


@runtime_checkable
class Switch(Protocol):
    """Switches valves."""

    def switch(self, output: str, *, on: bool) -> None:
        """Energise the output or not; never retried."""

    def is_on(self, output: str) -> bool:
        """Whether the output is energised, as held by the device."""


@runtime_checkable
class Pulses(Protocol):
    """Opens valves for a time that the device keeps, independent of the sample period."""

    def pulse(self, output: str, seconds: float) -> None:
        """Energise the output for `seconds` from now; one that is on stays on until the later end; never retried."""


@runtime_checkable
class Motion(Protocol):
    """Can stop a motion by itself, faster than a new set-point would."""

    def halt(self, output: str) -> None:
        """Stop at the present position (drive quick stop), and hold it."""


@runtime_checkable
class Inputs(Protocol):
    """Has digital inputs."""

    def level(self, name: str) -> bool:
        """Whether the input is high now."""


@runtime_checkable
class Watchdog(Protocol):
    """Vents by itself when communication stops."""

    def arm_watchdog(self, seconds: float) -> float:
        """Arm it; returns the time-out that the device reports [s]."""

    def feed_watchdog(self) -> None:
        """Signal the device that the program is alive."""

    def disarm_watchdog(self) -> None:
        """Disarm it; outputs stay as they are."""


@runtime_checkable
class Supervised(Protocol):
    """Reports its state apart from its outputs, so that a restart or a changed setting is detected (promise S11)."""

    def held(self) -> Mapping[str, float | str]:
        """State that the device reports now: read from it at each call, never cached by the driver.

        `watchdog`: time without a sign of life after which it would vent [s], 0 if it is off or has fired. A device
        that continues to count after firing reports its time: there, outputs that are read back show the vent.
        `uptime`: a number that only grows until the device restarts. Every other entry (serial number, trigger of the
        watchdog, mode, count of restarts) must stay what it was when the bench was armed. The name of an entry is
        printed in the reason of a trip.
        """


@runtime_checkable
class Rescue(Protocol):
    """Has a second connection to its outputs, for when the usual call hangs."""

    def rescue(self, output: str, value: float) -> None:
        """Command `value` [device units; 0 and 1 for a valve] over a separate connection, within 0.2 s, no retry.

        Called from another thread than the one that may be hanging.
        """
