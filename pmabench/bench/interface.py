"""What every driver implements, and the compiled bench as plain records; standard library only.

A driver is a class that is built as `Driver(device, clock)` from a `DeviceRecord` and a clock, imports nothing heavy
before `open`, and implements `Device` and those of the small capabilities below that its device has.
Values that cross this interface are in the device's own units (counts, volts, pascal ...); the scaling to SI is
next to them in the records and is done above the driver. Raises only `pmabench.base.errors.DeviceError`.

In real time each device has one thread that calls it. A call returns within 0.2 s (`open` within 2 s) or raises; no
write is retried; after a time-out the line is drained, so that no answer belongs to an older question. `collect` never
waits for a sample: a polled device has its own thread that polls. A class method `check(device)` may name what is
wrong with the options before anything is opened, others, `fastest(device)` and `lacks(device)`, how fast it samples at
most with them, and what of them may surprise: `pmabench.bench.driver_options`.

The records are all that guard, engine and drivers know of a bench file, and go to other processes as JSON. Values are
SI; a `Scale` has what the device itself gives. `Truth` is what is really wired to the devices of a rig, for emulators.
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
    """What the session's zero took off the calibration's `scale.offset` [SI]; None: no zero was taken."""

    @property
    def calibrated(self) -> Scale:
        """The scale of the calibration, without any zero: what the device itself knows."""
        return Scale(self.scale.slope, self.scale.offset + (self.zero or 0.0))


@dataclass(frozen=True)
class OutputRecord:
    """One commanded quantity; `low` and `high` are the active command limits [SI].

    `low_from` and `high_from` say who set them, as `file:line:column`.
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
class ValveRecord:
    """A valve that is switched: `energised` says whether it is `closed` or `open` while its output is on."""

    name: str
    device: str
    output: str
    energised: str = "closed"
    safe: str = "open"
    """Where the safe state leaves it; while the bench runs it is the other way, unless it opens in pulses."""
    longest: float = 0.0
    """It opens in pulses of at most so long [s], and is shut between them; 0: it is switched and stays."""
    never_with: str = ""
    """The valve that is never open at the same time: the other one of the muscle."""


@dataclass(frozen=True)
class AimRecord:
    """What valves steer and no device takes as a set-point, as a muscle's pressure or a tilt, and its limits [SI]."""

    name: str
    quantity: str
    low: float
    high: float
    source: str = ""
    """`file:line:column` of the limit."""

    @property
    def low_from(self) -> str:
        """As of an output."""
        return self.source

    @property
    def high_from(self) -> str:
        """As of an output."""
        return self.source


@dataclass(frozen=True)
class InterlockRecord:
    """A digital input that must stay at its `safe` level, `high` or `low`; elsewhere the guard vents and latches."""

    name: str
    device: str
    input: str
    safe: str = "high"


@dataclass(frozen=True)
class TripRecord:
    """A limit on what is measured.

    `kind` says what is looked at: `range` (outside `low` .. `high`), `rate` (changes faster than `high` [SI/s]),
    `stale` (no sample for `delay`), `frozen` (not one change of the raw value for `delay`), `off-range` (at or
    beyond the end of the channel's range), `following` (further than `high` from what is commanded), `burst` (falls
    by more than `high` within `window` while it is commanded to stay or rise), `slack` (under `low`).
    """

    channel: str
    low: float | None
    high: float | None
    delay: float
    """How long it must be so before the action [s]."""
    action: str
    """What happens then: `warn`, `hold` (nothing new is commanded until it is over), `stop` (controlled), `vent`."""
    source: str = ""
    """`file:line:column` of the limit."""
    kind: str = "range"
    window: float = 0.0
    """Over what time a burst falls [s]."""


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
    """Deadline [s]; the next action follows then at the latest."""
    rate: float = 0.0


@dataclass(frozen=True)
class ProofTest:
    """The vent path tried at arming: fill to `pressure` [Pa], vent; it must be below `below` within `within` [s]."""

    pressure: float
    below: float
    within: float
    fill: float = 5.0
    """Longest time to fill [s]."""


def place(address: str, options: Mapping[str, Any], *, resolve: bool = True) -> str:
    """Where a device is, in one spelling for all bench files; empty for a simulation without an address."""
    if not address or address.startswith("/"):
        return os.path.realpath(address) if address else ""  # what a link of /dev/serial/by-id leads to
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
    """The device vents by itself when it hears nothing for so long [s]; 0: it has no watchdog."""
    verified: str = ""
    """What its driver was tried on: `hardware (who, date, firmware)`, `emulator only`, or in other words."""
    verified_firmware: str = ""
    """The firmware for which the bench file says so; empty: any."""
    drift: float = 2e-4
    """How far its clock may drift against the computer's [1]; what comes later by more each second is late."""
    fastest: float = 0.0
    """Highest rate at which it samples with these options [Hz]; 0: its driver does not say."""
    fastest_from: str = ""
    """Where the options that set it are written, as `path:line:column`."""

    @property
    def guarded(self) -> bool:
        """Whether its link belongs to the guard: it carries something that moves, vents or forbids."""
        return bool(self.outputs or self.valves or self.interlocks or self.watchdog)


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
    load_tolerance: float = 0.1
    """How far the force of a load at rest may be from its weight [1]."""
    load_action: str = "warn"
    """What follows when it is further: `warn` or `stop`."""
    slack_below: float = 0.0
    """Force under which the specimen counts as slack [N]."""
    length: float = 0.0
    """Mounted length of the specimen [m]."""
    setup_pressure: float = 100e3
    """Highest pressure that may be commanded before the bench is proven [Pa]."""
    stop_rate: float = 0.0
    """Rate at which a controlled stop takes the pressure down before the safe state [Pa/s]; 0: at once."""
    proof: ProofTest | None = None
    aims: tuple[AimRecord, ...] = ()
    together: str = ""
    """The watch on what several channels say about one thing, by its name in the engine's table; empty: none."""
    platform: Mapping[str, float] = field(default_factory=dict)
    """What the control of a platform must know of it [SI], by name; empty where there is none."""
    path: str = ""
    """The bench file."""

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
        """All that plans command, by name: values of outputs, and what valves bring about."""
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
        """The inverse of `to_json`; KeyError where something that protects is missing."""
        data = json.loads(text)
        for name in ("devices", "trips", "safe_state"):  # an empty default would be a bench without limits
            data[name]
        return _record(cls, data)


def device_from(data: Mapping[str, Any]) -> DeviceRecord:
    """A device from its JSON object, as `dataclasses.asdict` gives it."""
    return _record(DeviceRecord, data)


def _record(kind: type[R], data: Mapping[str, Any]) -> R:
    """A record from its JSON object, with all the records that are in it."""
    values = dict(data)
    for name, hint in get_type_hints(kind).items():
        inner = next((each for each in (hint, *get_args(hint)) if isinstance(each, type) and is_dataclass(each)), None)
        if inner is not None and (given := values.get(name)) is not None:
            several = get_origin(hint) is tuple
            values[name] = tuple(_record(inner, item) for item in given) if several else _record(inner, given)
    return kind(**values)


@dataclass(frozen=True)
class Plug:
    """What is plugged into one terminal: a sensor or an actuator with its signal, and how the terminal shows that."""

    sensor: Scale
    """Signal to SI."""
    digits: Scale = field(default_factory=Scale)
    """Scale from what the device gives or takes to the signal."""
    unit: str = ""
    """Of the signal: only plugs with the same one fit into each other's terminals."""
    low: float = 0.0
    """Where the range of the sensor begins [SI]."""

    @property
    def scale(self) -> Scale:
        """Scale from what the device gives or takes to SI."""
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


COMPUTER = "computer"
"""`Identity.clock` of a device that has none, whose driver stamps its samples."""
EMULATED = "emulated "
"""How the model name of an emulator begins: what it records is never taken for a real muscle."""
UNPROVEN = f"{EMULATED}unproven "
"""How the model name begins where the emulator took wiring and scales from the bench file: errors cancel out."""


@dataclass(frozen=True)
class Identity:
    """Who answered when the device was opened."""

    maker: str
    model: str
    serial: str
    firmware: str
    simulated: bool = False
    clock: str = "own"
    """`own`: its samples carry the device's clock. `computer`: they are stamped with bench time by the driver, halfway
    between question and answer, or when a line began to come; half of a poll is then the time from stamp to arrival."""
    answers: float = 0.0
    """How long it took at least to answer a question [s], where the driver measures that and polls as that allows."""


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
    are arrays or lists (`array.array("q")` and `array.array("d")` cost least on their way to the engine).
    """

    time: Sequence[int]
    columns: Mapping[str, Sequence[float]]
    host: int = -1
    """When the newest sample arrived at the computer [ns, bench time]; -1 where nobody noted it."""


@runtime_checkable
class Device(Protocol):
    """The interface of every driver."""

    def open(self) -> Identity:
        """Connect and identify; nothing moves and nothing is commanded."""

    def close(self) -> None:
        """Let go of the link; harmless when repeated."""


@runtime_checkable
class OpensToVent(Protocol):
    """Can be opened where `open` refuses what only matters for measuring, as a fault of a sensor or another range."""

    def open_to_vent(self) -> Identity:
        """Connect as far as the commands of a safe state need it; nothing is set, moved or commanded."""


@runtime_checkable
class Stream(Protocol):
    """Samples its channels together on one clock."""

    def start(self, rate: float) -> float:
        """Begin to sample at `rate` [Hz]; returns the rate that the device will really use."""

    def collect(self) -> Block:
        """Every sample taken since the last call, oldest first; at once, and may be empty."""

    def stop(self) -> None:
        """End sampling; harmless when repeated."""


@runtime_checkable
class SetPoint(Protocol):
    """Takes commanded values."""

    def write(self, output: str, value: float) -> None:
        """Command `value` [device units] at once, ending a segment under way; never retried."""

    def read_back(self, output: str) -> float:
        """The value that the device holds now [device units]."""


@runtime_checkable
class Follower(Protocol):
    """Follows ramps and sines by itself.

    A driver that steps along them keeps in an attribute `unanswered` when a step was sent last of which nobody knows
    whether it was carried out [s, bench time]: such a step may come after the safe value.
    """

    def follow(self, output: str, segment: Segment) -> None:
        """Begin the segment; the next `write` or `follow` ends it."""


@runtime_checkable
class Hands(Protocol):
    """A bench whose operator is part of the device: it is informed of what hands did, as answered at the prompt."""

    def place(self, load: Load) -> None:
        """The free end now carries `load`."""


@runtime_checkable
class Switch(Protocol):
    """Switches valves."""

    def switch(self, output: str, *, on: bool) -> None:
        """Energise the output or not; never retried."""

    def is_on(self, output: str) -> bool:
        """What the device holds now."""


@runtime_checkable
class Pulses(Protocol):
    """Opens valves for a time that it keeps by itself, whatever the sample period is."""

    def pulse(self, output: str, seconds: float) -> None:
        """Energise the output from now on for `seconds`; one that is on stays on until the later end; never retried."""


@runtime_checkable
class Motion(Protocol):
    """Can stop a motion by itself, faster than a new set-point would."""

    def halt(self, output: str) -> None:
        """Stop where it is (drive quick stop), and hold."""


@runtime_checkable
class Inputs(Protocol):
    """Has digital inputs."""

    def level(self, name: str) -> bool:
        """Whether the input is high now."""


@runtime_checkable
class Watchdog(Protocol):
    """Vents by itself when the program is silent."""

    def arm_watchdog(self, seconds: float) -> float:
        """Arm it; returns the time that the device itself says it will wait [s]."""

    def feed_watchdog(self) -> None:
        """Show the device that the program is alive."""

    def disarm_watchdog(self) -> None:
        """End it; outputs stay as they are."""


@runtime_checkable
class Supervised(Protocol):
    """Reports what it holds apart from its outputs, so that a restart or a changed setting is seen (promise S11)."""

    def held(self) -> Mapping[str, float | str]:
        """What the device itself reports now: read from it at each call, never remembered by the driver.

        `watchdog`: after how long without a sign of life it would vent [s], 0 where it is off or has fired. A device
        that goes on counting after it has fired reports its time: there, outputs that are read back show the vent.
        `uptime`: a number that only grows until the device restarts. Every other entry (serial number, trigger of the
        watchdog, mode, count of restarts) must stay what it was when the bench was armed. The name of an entry is
        printed in the reason of a trip.
        """


@runtime_checkable
class Rescue(Protocol):
    """Has a second way to its outputs, for when the usual call hangs."""

    def rescue(self, output: str, value: float) -> None:
        """Command `value` [device units; 0 and 1 for a valve] over a separate connection, within 0.2 s, no retry.

        Called from another thread than the one that may be hanging.
        """
