"""The bench file: devices, channels, outputs, free end, air; limits, safe state and session are in other modules."""

from __future__ import annotations

import datetime
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema, model_validator

from pmabench.base.quantities import MUSCLES
from pmabench.bench.files import safety
from pmabench.bench.files import specimen as s
from pmabench.bench.files.session import SessionFile
from pmabench.files import quantity as q
from pmabench.files.document import Strict, among, schema_of


class ReviewFile(Strict):
    """Who read the bench file over, and when."""

    by: s.Text
    date: datetime.date | s.Text


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
    interlocks: list[safety.InterlockFile] = []
    limits: dict[Limited, safety.LimitFile]
    watch: Annotated[list[safety.WatchFile], Field(max_length=100)] = []
    safe_state: Annotated[list[safety.SafeActionFile], Field(min_length=1, max_length=50)]
    stop: safety.StopFile | None = None
    proof: safety.ProofFile | None = None
    setup_pressure: s.PressureAbove0 | None = None
    """Highest pressure that may be commanded before the bench is proven."""
    no_watchdog: safety.NoWatchdogFile | None = None
    hands: safety.HandsFile
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
