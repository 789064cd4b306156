"""The bench file: devices, channels, outputs, air; limits, watch list, safe state, proof of the vent path; session."""

from __future__ import annotations

import datetime
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema, model_validator

from pmabench.base.quantities import MUSCLES, without_number
from pmabench.bench.files import specimen as s
from pmabench.files import quantity as q
from pmabench.files.document import Strict, among, schema_of

Action = Literal["warn", "hold", "stop", "vent"]
"""Consequence of a crossed limit: a line in the record, no new command until it is over, a controlled stop, a vent."""

WATCH_KEYS = {
    "rate": ("faster_than", "for"),
    "stale": ("for",),
    "frozen": ("for",),
    "off_range": ("for",),
    "following": ("more_than", "for"),
    "burst": ("falls", "within"),
    "slack": ("below", "for"),
}
"""Kind of watch -> its keys."""
WATCH_OPTIONAL = {("rate", "for"), ("off_range", "for"), ("slack", "for")}
UpToAMinute = Annotated[q.Time, s.within(0.0, 60.0, "time")]
"""A wait of the watch list, the safe state or the proof of the vent path; the muscle may be full meanwhile."""
Deadline = Annotated[s.TimeAbove0, s.within(0.0, 60.0, "time")]
"""The same, above zero."""
ALIASES = {"for_": "for"}
"""Field of a model -> its key in the file."""

SAFE_KEYS = {
    "set": ("to", "within"),
    "ramp_down": ("at", "to", "within"),
    "drive_quick_stop": ("within",),
    "hold": (),
    "open": ("within",),
    "close": ("within",),
    "confirm": ("below", "within"),
}
"""Action of the safe state -> its keys."""
SAFE_OPTIONAL = {("ramp_down", "to")}


class LimitFile(Strict):
    """Limits on one quantity: `command` is what may be set, `trip` what may be measured."""

    command: s.Reading | None = None
    command_low: s.Reading | None = None
    trip: s.Reading | None = None
    trip_low: s.Reading | None = None
    delay: q.Time = 0.0
    action: Action = "vent"


def one_of(model: Strict, kinds: dict[str, tuple[str, ...]], optional: set[tuple[str, str]]) -> str:
    """The kind of an entry; raises ValueError if that is not clear, a key is missing or one does not belong to it."""
    given = {ALIASES.get(name, name) for name in model.model_fields_set if getattr(model, name) is not None}
    found = [kind for kind in kinds if kind in given]
    if len(found) != 1:
        what = "none" if not found else " and ".join(f'"{kind}"' for kind in found)
        raise ValueError(f"exactly one of {', '.join(kinds)} is expected here, and there is {what}")
    kind = found[0]
    missing = [key for key in kinds[kind] if key not in given and (kind, key) not in optional]
    if missing:
        raise ValueError(f'"{kind}" needs "{missing[0]}"')
    if extra := sorted(given - {kind, "action", *kinds[kind]}):
        belongs = ", ".join(f'"{key}"' for key in kinds[kind]) or "nothing else"
        raise ValueError(f'"{extra[0]}" does not belong to "{kind}", which takes {belongs}')
    return kind


class WatchFile(Strict):
    """One thing to watch in addition to the limits; which of the kinds is given says what."""

    rate: s.Name | None = None
    stale: s.Name | None = None
    frozen: s.Name | None = None
    off_range: s.Name | None = None
    following: s.Name | None = None
    burst: s.Name | None = None
    slack: s.Name | None = None
    faster_than: s.Reading | None = None
    more_than: s.Reading | None = None
    falls: s.Reading | None = None
    below: s.Reading | None = None
    within: Deadline | None = None
    for_: Annotated[UpToAMinute | None, Field(alias="for")] = None
    action: Action

    @property
    def kind(self) -> str:
        """Kind of the entry, a key of `WATCH_KEYS`."""
        return one_of(self, WATCH_KEYS, WATCH_OPTIONAL)

    @property
    def channel(self) -> str:
        """The watched channel."""
        return str(getattr(self, self.kind))

    @model_validator(mode="after")
    def _one_kind(self) -> WatchFile:
        assert self.kind  # noqa: S101  (raises unless there is exactly one)
        return self


class SafeActionFile(Strict):
    """One ordered action of the safe state; which of the verbs is given says what."""

    set: s.Name | None = None
    ramp_down: s.Name | None = None
    drive_quick_stop: s.Name | None = None
    hold: UpToAMinute | None = None
    open: s.Name | None = None
    close: s.Name | None = None
    confirm: s.Name | None = None
    to: s.Reading | None = None
    at: s.Reading | None = None
    below: s.Reading | None = None
    within: Deadline | None = None
    """Deadline, after which the next action starts in any case."""

    @property
    def verb(self) -> str:
        """Verb of the action, a key of `SAFE_KEYS`."""
        return one_of(self, SAFE_KEYS, SAFE_OPTIONAL)

    @model_validator(mode="after")
    def _one_verb(self) -> SafeActionFile:
        assert self.verb  # noqa: S101  (raises unless there is exactly one)
        return self


class InputFile(Strict):
    """A digital input of a device."""

    device: str
    input: str


class InterlockFile(Strict):
    """A digital input that must stay at its safe level, else the guard vents and latches."""

    name: s.Name
    input: InputFile
    safe: Literal["high", "low"] = "high"


class StopFile(Strict):
    """A controlled stop: the pressure goes down at a rate, then the safe state follows."""

    ramp: s.RateAbove0


PROVEN = 0.8
"""Largest fraction of the filled pressure to which a vent path that is proven may leave it [1]."""


class ProofFile(Strict):
    """The vent path tried before each use: filled to `pressure`, it must be `below` after `within`."""

    pressure: s.PressureAbove0
    below: s.PressureAbove0
    within: Deadline
    fill: Deadline = 5.0
    """Longest time for filling."""

    @model_validator(mode="after")
    def _in_order(self) -> ProofFile:
        if self.below > PROVEN * self.pressure:
            raise ValueError(f'"below" must be at most {PROVEN:g} of "pressure": a small leak proves no vent path')
        return self


class NoWatchdogFile(Strict):
    """Who accepts that a pressurising device has no watchdog, when and why."""

    accepted_by: Annotated[str, Field(min_length=1, max_length=100)]
    date: datetime.date
    reason: Annotated[str, Field(min_length=1, max_length=400)]


class HandsFile(Strict):
    """When hands may go in."""

    below: s.PressureAbove0
    at_pressure: s.PressureNotBelow0 = 0.0
    """Highest pressure for protocols that need hands at pressure; 0: none are allowed."""


class ReviewFile(Strict):
    """Who read the bench file over, and when."""

    by: s.Text
    date: datetime.date | s.Text


PLACED = ("displacement", "angle")
"""Channels whose zero is at a position that the operator sets by hand."""


ZEROED, ZEROED_EACH = ("pressure", "force", *PLACED), ("pressure",)
"""Channels that may have a zero, and those of them that each of several muscles has."""
Zeroed = Annotated[str, BeforeValidator(among(ZEROED, ZEROED_EACH)), WithJsonSchema(schema_of(ZEROED, ZEROED_EACH))]


class WarmUpFile(Strict):
    """Cycles between no pressure and `pressure` before the zeros are taken."""

    duration: q.Time = 600.0
    pressure: s.PressureAbove0
    period: s.TimeAbove0 = 10.0


class ZeroFile(Strict):
    """The zero of one channel: at most `most` away from where its calibration has it."""

    most: s.Reading
    at: s.Text = ""
    """Where a displacement or an angle is zero, in words for the operator."""
    load: q.Load | None = None
    """The load that brings the free end there."""


class SelfTestFile(Strict):
    """The start check: pressure goes up in steps of `step` to `pressure`, and every channel is looked at."""

    step: s.PressureAbove0 = 25e3
    pressure: s.PressureAbove0 | None = None
    """Highest pressure; the bench's set-up pressure if not given."""
    settle: s.TimeAbove0 = 3.0
    """Time at each pressure."""
    load: q.Load | None = None
    """Load that is on its support during the check."""
    noise: dict[s.Name, s.Reading] = {}
    """Largest rms noise per channel; 0.5 % of the range if not given."""
    linearity: s.RatioAbove0 = 0.05
    """Largest deviation of the regulator from a straight line, as a fraction of the highest pressure."""
    alignment: s.TimeAbove0 = 0.02
    """Largest delay between force and pressure."""
    leak: s.RateAbove0 = 5e3 / 60
    """Largest rate at which the pressure may fall with the isolation valve shut."""


class SessionFile(Strict):
    """Done once before the first run, and again when it has run out."""

    self_test: SelfTestFile | None = None
    warm_up: WarmUpFile | None = None
    zeros: dict[Zeroed, ZeroFile] = {}
    valid: s.TimeAbove0 = 12 * 3600.0

    @model_validator(mode="after")
    def _references(self) -> SessionFile:
        for name, zero in self.zeros.items():
            placed = without_number(name)[0] in PLACED
            if placed and not zero.at:
                raise ValueError(f'the zero of the {name} needs "at": where the free end is then, in words')
            if not placed and (zero.at or zero.load is not None):
                raise ValueError(
                    f'"at" and "load" belong to the displacement or the angle; {name} is zeroed without any'
                )
        return self


class Weights(Strict):
    """A stack of weights on the free end."""

    hanger: s.MassNotBelow0
    plates: list[q.Plates] = []
    g: Annotated[q.Acceleration, s.within(9.7, 9.9, "acceleration")] = 9.81
    carriage: s.MassNotBelow0 = 0.0
    """Mass that moves with the stack: table, cable, rod."""
    act_as: Literal["mass", "force"] = "mass"
    """`mass`: the stack moves with the muscle; `force`: a constant-force device without inertia."""
    pulley: bool = False
    support: q.Length = 0.0
    catch_height: Annotated[q.Length, s.within(0.0, 1.0, "length")] | None = None
    load_tolerance: s.RatioAbove0 = 0.1
    """Allowed deviation of the force of a load at rest from its weight, in addition to the cell's uncertainty."""
    load_action: Literal["warn", "stop"] = "warn"
    """Consequence of a larger deviation: a line in the record, or a controlled stop."""


class Joint(Strict):
    """A joint that the muscles turn: how far its angle may go, and how fast a drive turns it, if there is one."""

    stroke: tuple[q.Angle, q.Angle]
    speed: q.AngularSpeed = 0.0
    pulley: Annotated[q.Length, Field(gt=0)] | None = None
    """Radius at which the muscles pull; `check --simulate` needs this and `contraction` on a real bench."""
    contraction: s.RatioAbove0 | None = None
    """Contraction of both muscles at angle 0."""


class PlatformFile(Strict):
    """A platform that three muscles tilt about two axes: how far it may tilt, and what its control must know of it."""

    tilt: Annotated[q.Angle, Field(gt=0)]
    """Largest tilt that may be commanded."""
    stops: Annotated[q.Angle, Field(gt=0)]
    """Angle of either axis at which it hits a stop."""
    circle: Annotated[q.Length, Field(gt=0)]
    """Radius of the circle of the points where the muscles pull."""
    contraction: s.RatioAbove0
    """Contraction of each muscle while the platform is level."""
    mass: q.Mass
    height: q.Length
    """Height of its centre of mass above the joint."""
    accelerometer: q.Length = 0.0
    """Height of the accelerometer above the joint."""

    @model_validator(mode="after")
    def _before_the_stops(self) -> PlatformFile:
        if self.tilt >= self.stops:
            raise ValueError('"tilt" must lie below "stops"')
        return self


class MuscleFile(Strict):
    """One of several muscles on a bench: which it is, and what it bears."""

    type: s.Text
    serial: s.Text
    limits: s.SpecimenLimits


LIMITED = ("pressure", "force", "contraction", "displacement", "angle", "torque", "supply")
"""Quantities that can have limits."""
LIMITED_EACH = ("pressure", "force", "contraction", "displacement")
"""Those of them that each of several muscles has: `pressure_1`, `pressure_2` ..."""
Limited = Annotated[
    str, BeforeValidator(among(LIMITED, LIMITED_EACH)), WithJsonSchema(schema_of(LIMITED, LIMITED_EACH))
]
MuscleNumber = Annotated[str, Field(pattern=f"^[1-{MUSCLES}]$")]


class Actuator(Strict):
    """A displacement actuator that drives the free end."""

    stroke: tuple[q.Length, q.Length]
    speed: q.Speed
    force: q.Force


class AirConductance(Strict):
    """How fast air goes through the regulator and its line: mass flow by difference of pressure."""

    fill: s.ConductanceAbove0
    vent: s.ConductanceAbove0


class Air(Strict):
    """The supply and what protects against it."""

    supply: s.PressureAbove0
    relief_valve: s.PressureAbove0 | Literal["none"] = "none"
    isolation_valve: str = "none"
    dump_valve: Literal["normally open", "normally closed", "none"] | None = None
    """A dump valve that the program does not switch; one that it switches is an output."""
    atmosphere: q.Pressure = 101325.0
    overshoot: s.PressureNotBelow0 = 0.0
    """Largest overshoot of the regulator after a step."""
    conductance: AirConductance | None = None
    """For `check` to predict the pressure at a driven end; without it, the muscle counts as closed in a fast motion."""


class VerifiedFile(Strict):
    """Who compared this device with instruments through this driver, when, and with which firmware."""

    by: Annotated[str, Field(min_length=1, max_length=100)]
    date: datetime.date
    firmware: Annotated[str, Field(max_length=100)] = ""
    """Firmware as the device reports it (`bench probe`); with another one the driver counts as not verified."""


class DeviceFile(Strict):
    """One device: driver by name, address, and the driver's own options."""

    driver: str
    address: str = ""
    options: dict[str, Any] = {}
    watchdog: Annotated[s.TimeAbove0, s.within(0.0, 10.0, "time")] | None = None
    """Time without communication after which the device vents by itself; the muscle is full until then."""
    verified: VerifiedFile | None = None
    """Confirms that this driver was tried on this device itself, not only on an emulator."""


class ChannelFile(Strict):
    """One measured quantity: where it is wired, and either its calibration or the unit that the device gives."""

    device: str
    input: str
    range: tuple[s.Reading, s.Reading]
    calibration: str | None = None
    unit: str | None = None
    reference: Literal["gauge", "absolute"] = "gauge"
    at: s.Text = ""

    @model_validator(mode="after")
    def _one_scale(self) -> ChannelFile:
        if (self.calibration is None) == (self.unit is None):
            raise ValueError('give either "calibration" (an id) or "unit" (what the device itself gives)')
        return self


class OutputFile(Strict):
    """One commanded quantity: scale by two points, the smallest step in device units."""

    device: str
    output: str
    scale: tuple[tuple[s.Reading, s.Reading], tuple[s.Reading, s.Reading]]
    resolution: s.Reading | None = None
    safe: s.Reading | None = None
    without_power: Literal["holds", "vents"] = "holds"
    """What the regulator does without power; many hold the pressure."""


class ValveFile(Strict):
    """A valve that is switched: an output with `energised`."""

    device: str
    output: str
    energised: Literal["closed", "open"]
    """Its position while the output is on; without power it is the other one."""
    pulse: s.TimeAbove0 | None = None
    """Longest pulse, if it opens in pulses and is shut between them."""


def _kind_of_output(value: Any) -> str:
    given = value if isinstance(value, dict) else vars(value) if isinstance(value, (OutputFile, ValveFile)) else {}
    return "a valve" if "energised" in given else "a set-point"


AnyOutput = Annotated[
    Annotated[OutputFile, Tag("a set-point")] | Annotated[ValveFile, Tag("a valve")], Discriminator(_kind_of_output)
]


class BenchFile(Strict):
    """The station: devices, channels, outputs, limits, safe state."""

    schema_: Annotated[Literal["pmabench.bench/1"], Field(alias="schema")]
    name: s.Text
    free_end: Literal["weights", "actuator", "fixed", "free", "joint", "platform"]
    time: Literal["real", "virtual"] = "real"
    weights: Weights | None = None
    actuator: Actuator | None = None
    joint: Joint | None = None
    platform: PlatformFile | None = None
    muscles: dict[MuscleNumber, MuscleFile] = {}
    """Muscles by number from 1, if there are several; also in the names of channels: `pressure_1`, `pressure_2` ..."""
    vents: Literal["together"] | Annotated[list[s.Name], Field(min_length=2, max_length=20)] | None = None
    """Order in which the safe state vents several muscles: all at once, or this list of outputs and valves."""
    air: Air
    devices: dict[s.Name, DeviceFile]
    channels: dict[s.Name, ChannelFile]
    outputs: dict[s.Name, AnyOutput]
    interlocks: list[InterlockFile] = []
    limits: dict[Limited, LimitFile]
    watch: Annotated[list[WatchFile], Field(max_length=100)] = []
    safe_state: Annotated[list[SafeActionFile], Field(min_length=1, max_length=50)]
    stop: StopFile | None = None
    proof: ProofFile | None = None
    setup_pressure: s.PressureAbove0 | None = None
    """Highest pressure that may be commanded before the bench is proven."""
    no_watchdog: NoWatchdogFile | None = None
    hands: HandsFile
    slack_below: Annotated[q.Force, s.within(0.0, 100.0, "force")] = 0.0
    session: SessionFile | None = None
    reviewed: ReviewFile | None = None
    to_confirm: list[s.Place] | None = None
    """Keys of values that a program derived and nobody has confirmed; empty once all are confirmed by `reviewed`."""
    web_vent: bool = False
    """Whether `watch --web --vent` shows a button that vents this bench."""

    @model_validator(mode="after")
    def _free_end(self) -> BenchFile:
        for kind in ("weights", "actuator", "joint", "platform"):
            if (self.free_end == kind) != (getattr(self, kind) is not None):
                raise ValueError(f'"free_end: {kind}" and the section "{kind}" belong together')
        if list(self.muscles) != [str(number) for number in range(1, len(self.muscles) + 1)] or len(self.muscles) == 1:
            raise ValueError('"muscles" are numbered from 1 on, and there are at least two: 1: {...}, 2: {...}')
        if bool(self.muscles) != (self.vents is not None):
            raise ValueError('"muscles" and "vents" (together, or what vents first) belong together')
        return self

    @property
    def set_points(self) -> dict[str, OutputFile]:
        """Outputs that take values."""
        return {name: output for name, output in self.outputs.items() if isinstance(output, OutputFile)}

    @property
    def valves(self) -> dict[str, ValveFile]:
        """Outputs that are switched."""
        return {name: output for name, output in self.outputs.items() if isinstance(output, ValveFile)}

    @property
    def normally_open_dump(self) -> bool:
        """Whether a dump valve opens without power, switched by the program or not."""
        return self.air.dump_valve == "normally open" or self.switched_dump

    @property
    def switched_dump(self) -> bool:
        """Whether the program switches dump valves that empty every muscle without power."""
        empties = [name for name, valve in self.valves.items() if valve.energised == "closed"]
        each = [f"dump_valve_{number}" for number in self.muscles]
        return "dump_valve" in empties or (bool(each) and set(each) <= set(empties))

    @property
    def steered(self) -> list[str]:
        """Pressures that valves control in pulses, without an output that takes them as a value."""
        return [f"pressure_{number}" for number in self.muscles] if self.platform is not None else []

    @property
    def pressures(self) -> list[str]:
        """Names of the commanded muscle pressures: outputs, or pressures controlled by valves."""
        names = [f"pressure_{number}" for number in self.muscles] or ["pressure"]
        return self.steered or [name for name in names if name in self.set_points]
