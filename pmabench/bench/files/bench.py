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
"""What follows a crossed limit: a line in the record, no new command until it is over, a controlled stop, a vent."""

WATCH_KEYS = {
    "rate": ("faster_than", "for"),
    "stale": ("for",),
    "frozen": ("for",),
    "off_range": ("for",),
    "following": ("more_than", "for"),
    "burst": ("falls", "within"),
    "slack": ("below", "for"),
}
"""Kind of watch -> the keys that belong to it."""
WATCH_OPTIONAL = {("rate", "for"), ("off_range", "for"), ("slack", "for")}
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
"""Action of the safe state -> the keys that belong to it."""
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
    """Which kind an entry is; ValueError where that is not clear, a key is missing or one does not belong to it."""
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
    within: s.TimeAbove0 | None = None
    for_: Annotated[q.Time | None, Field(alias="for")] = None
    action: Action

    @property
    def kind(self) -> str:
        """Key of `WATCH_KEYS`."""
        return one_of(self, WATCH_KEYS, WATCH_OPTIONAL)

    @property
    def channel(self) -> str:
        """The channel that is watched."""
        return str(getattr(self, self.kind))

    @model_validator(mode="after")
    def _one_kind(self) -> WatchFile:
        assert self.kind  # noqa: S101  (raises where there is not exactly one)
        return self


class SafeActionFile(Strict):
    """One ordered action of the safe state; which of the verbs is given says what."""

    set: s.Name | None = None
    ramp_down: s.Name | None = None
    drive_quick_stop: s.Name | None = None
    hold: q.Time | None = None
    open: s.Name | None = None
    close: s.Name | None = None
    confirm: s.Name | None = None
    to: s.Reading | None = None
    at: s.Reading | None = None
    below: s.Reading | None = None
    within: s.TimeAbove0 | None = None
    """Deadline; the next action follows then at the latest."""

    @property
    def verb(self) -> str:
        """Key of `SAFE_KEYS`."""
        return one_of(self, SAFE_KEYS, SAFE_OPTIONAL)

    @model_validator(mode="after")
    def _one_verb(self) -> SafeActionFile:
        assert self.verb  # noqa: S101  (raises where there is not exactly one)
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


class ProofFile(Strict):
    """The vent path tried before each use: filled to `pressure`, it must be `below` after `within`."""

    pressure: s.PressureAbove0
    below: s.PressureAbove0
    within: s.TimeAbove0
    fill: s.TimeAbove0 = 5.0
    """Longest time to fill."""

    @model_validator(mode="after")
    def _in_order(self) -> ProofFile:
        if self.below >= self.pressure:
            raise ValueError('"below" must lie under "pressure", else nothing is proven')
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
"""Channels whose zero is where hands bring the free end."""


ZEROED, ZEROED_EACH = ("pressure", "force", *PLACED), ("pressure",)
"""Channels that may have a zero, and which of them each of several muscles has."""
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
    """A load that is on its support meanwhile."""
    noise: dict[s.Name, s.Reading] = {}
    """Most rms noise per channel; 0.5 % of the range if not given."""
    linearity: s.RatioAbove0 = 0.05
    """Most by which the regulator may leave its straight line, of the highest pressure."""
    alignment: s.TimeAbove0 = 0.02
    """Most time between force and pressure."""
    leak: s.RateAbove0 = 5e3 / 60
    """Most that the pressure may fall with the isolation valve shut."""


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

    hanger: q.Mass
    plates: list[q.Plates] = []
    g: q.Acceleration = 9.81
    carriage: q.Mass = 0.0
    """What moves with the stack: table, cable, rod."""
    act_as: Literal["mass", "force"] = "mass"
    """`mass`: the stack moves with the muscle; `force`: a constant-force device without inertia."""
    pulley: bool = False
    support: q.Length = 0.0
    catch_height: q.Length | None = None
    load_tolerance: s.RatioAbove0 = 0.1
    """How far the measured force of a load at rest may be from its weight, in addition to the cell's uncertainty."""
    load_action: Literal["warn", "stop"] = "warn"
    """What follows when it is further: a line in the record, or a controlled stop."""


class Joint(Strict):
    """A joint that the muscles turn: how far its angle may go, and how fast a drive turns it where there is one."""

    stroke: tuple[q.Angle, q.Angle]
    speed: q.AngularSpeed = 0.0
    pulley: Annotated[q.Length, Field(gt=0)] | None = None
    """Radius on which the muscles pull; `check --simulate` needs it on a real bench, as it does the next one."""
    contraction: s.RatioAbove0 | None = None
    """Of both muscles at angle 0."""


class PlatformFile(Strict):
    """A platform that three muscles tilt about two axes: how far it may tilt, and what its control must know of it."""

    tilt: Annotated[q.Angle, Field(gt=0)]
    """The furthest that may be asked for."""
    stops: Annotated[q.Angle, Field(gt=0)]
    """Angle of either axis at which a stop holds it."""
    circle: Annotated[q.Length, Field(gt=0)]
    """Radius of the circle on which the muscles pull."""
    contraction: s.RatioAbove0
    """Of each muscle while it is level."""
    mass: q.Mass
    height: q.Length
    """Of its centre of mass above the joint."""
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
"""What can be limited."""
LIMITED_EACH = ("pressure", "force", "contraction", "displacement")
"""Of it what each of several muscles has: `pressure_1`, `pressure_2` ..."""
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
    """A dump valve that the program does not switch; one that it switches is among the outputs."""
    atmosphere: q.Pressure = 101325.0
    overshoot: s.PressureNotBelow0 = 0.0
    """Most that the regulator overshoots a step."""
    conductance: AirConductance | None = None
    """For `check` to predict the pressure that a driven end makes; without it a fast motion counts as closed."""


class VerifiedFile(Strict):
    """Who compared this device with instruments through this driver, when, and with which firmware."""

    by: Annotated[str, Field(min_length=1, max_length=100)]
    date: datetime.date
    firmware: Annotated[str, Field(max_length=100)] = ""
    """As the device reports it (`bench probe`); with another one the driver counts as not verified."""


class DeviceFile(Strict):
    """One device: driver by name, address, and the driver's own options."""

    driver: str
    address: str = ""
    options: dict[str, Any] = {}
    watchdog: s.TimeAbove0 | None = None
    """After so long without a word from the program the device vents by itself."""
    verified: VerifiedFile | None = None
    """That this driver was tried on this device itself, not on an emulator only."""


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
    """What a regulator does when its power fails; many hold the pressure."""


class ValveFile(Strict):
    """A valve that is switched: an output with `energised`."""

    device: str
    output: str
    energised: Literal["closed", "open"]
    """Its position while the output is on; without power it is the other one."""
    pulse: s.TimeAbove0 | None = None
    """It opens in pulses of at most so long, and is shut between them."""


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
    """Where there are several, by number from 1 on; their channels carry it: `pressure_1`, `pressure_2` ..."""
    vents: Literal["together"] | Annotated[list[s.Name], Field(min_length=2, max_length=20)] | None = None
    """In what order the safe state takes several muscles down: all at once, or the outputs and valves in order."""
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
    slack_below: q.Force = 0.0
    session: SessionFile | None = None
    reviewed: ReviewFile | None = None
    to_confirm: list[s.Place] | None = None
    """Keys whose values a program derived and nobody has confirmed; an empty list where all are, by `reviewed`."""
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
        """The outputs that take values."""
        return {name: output for name, output in self.outputs.items() if isinstance(output, OutputFile)}

    @property
    def valves(self) -> dict[str, ValveFile]:
        """The outputs that are switched."""
        return {name: output for name, output in self.outputs.items() if isinstance(output, ValveFile)}

    @property
    def normally_open_dump(self) -> bool:
        """Whether a dump valve opens when its power fails, switched by the program or not."""
        return self.air.dump_valve == "normally open" or self.switched_dump

    @property
    def switched_dump(self) -> bool:
        """Whether the program switches dump valves that empty every muscle when their power fails."""
        empties = [name for name, valve in self.valves.items() if valve.energised == "closed"]
        each = [f"dump_valve_{number}" for number in self.muscles]
        return "dump_valve" in empties or (bool(each) and set(each) <= set(empties))

    @property
    def steered(self) -> list[str]:
        """The pressures that valves bring about in pulses, and no output takes as a value."""
        return [f"pressure_{number}" for number in self.muscles] if self.platform is not None else []

    @property
    def pressures(self) -> list[str]:
        """What commands the pressure of a muscle: outputs, or a pressure that valves bring about."""
        names = [f"pressure_{number}" for number in self.muscles] or ["pressure"]
        return self.steered or [name for name in names if name in self.set_points]
