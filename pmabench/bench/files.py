"""Bench, specimen and calibration files as strict models: what people write, checked each by itself."""

from __future__ import annotations

import datetime
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from pmabench.files.document import Strict
from pmabench.files.quantity import (
    Acceleration,
    Damping,
    Force,
    Length,
    Mass,
    Plates,
    Pressure,
    Ratio,
    Speed,
    Stiffness,
    Time,
    raw_quantity,
)

Reading = Annotated[
    tuple[float, str],
    BeforeValidator(raw_quantity),
    WithJsonSchema({"type": "string", "description": "a number with its unit", "examples": ["5.003 V", "600 kPa"]}),
]
"""A number with the device's or the quantity's unit, kept apart."""

Text = Annotated[str, Field(max_length=400)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$")]


class Weights(Strict):
    """A stack of weights on the free end."""

    hanger: Mass
    plates: list[Plates] = []
    g: Acceleration = 9.81
    carriage: Mass = 0.0
    """What moves besides the stack: table, cable, rod."""
    act_as: Literal["mass", "force"] = "mass"
    """`mass`: the stack moves with the muscle; `force`: a constant-force device that has no inertia of its own."""
    pulley: bool = False
    support: Length = 0.0
    catch_height: Length | None = None


class Actuator(Strict):
    """A displacement actuator that drives the free end."""

    stroke: tuple[Length, Length]
    speed: Speed
    force: Force


class Air(Strict):
    """The supply and what protects against it."""

    supply: Pressure
    relief_valve: Pressure | Literal["none"] = "none"
    isolation_valve: str = "none"
    dump_valve: Literal["normally open", "normally closed", "none"] = "none"
    atmosphere: Pressure = 101325.0
    overshoot: Pressure = 0.0
    """Most that the regulator overshoots a step."""


class DeviceFile(Strict):
    """One device: driver by name, address, and the driver's own options."""

    driver: str
    address: str = ""
    options: dict[str, Any] = {}


class ChannelFile(Strict):
    """One measured quantity: where it is wired, and either its calibration or the unit that the device gives."""

    device: str
    input: str
    range: tuple[Reading, Reading]
    calibration: str | None = None
    unit: str | None = None
    reference: Literal["gauge", "absolute"] = "gauge"
    at: Text = ""

    @model_validator(mode="after")
    def _one_scale(self) -> ChannelFile:
        if (self.calibration is None) == (self.unit is None):
            raise ValueError('give either "calibration" (an id) or "unit" (what the device itself gives)')
        return self


class OutputFile(Strict):
    """One commanded quantity: scale by two points, the smallest step in device units."""

    device: str
    output: str
    scale: tuple[tuple[Reading, Reading], tuple[Reading, Reading]]
    resolution: Reading | None = None
    safe: Reading | None = None


class LimitFile(Strict):
    """Limits on one quantity: `command` is what may be set, `trip` what may be measured."""

    command: Reading | None = None
    command_low: Reading | None = None
    trip: Reading | None = None
    trip_low: Reading | None = None
    delay: Time = 0.0
    action: Literal["vent"] = "vent"


class SafeActionFile(Strict):
    """One ordered action of the safe state."""

    set: str | None = None
    to: Reading | None = None
    confirm: str | None = None
    below: Reading | None = None
    within: Time

    @model_validator(mode="after")
    def _one_action(self) -> SafeActionFile:
        if not ((self.set and self.to) or (self.confirm and self.below)) or (self.set and self.confirm):
            raise ValueError('an action is "set: OUTPUT, to: VALUE" or "confirm: CHANNEL, below: VALUE"')
        return self


class HandsFile(Strict):
    """When hands may go in."""

    below: Pressure
    at_pressure: Pressure = 0.0
    """Highest pressure for protocols that need hands at pressure; 0: none are allowed."""


class BenchFile(Strict):
    """The station: devices, channels, outputs, limits, safe state."""

    schema_: Annotated[Literal["pmabench.bench/1"], Field(alias="schema")]
    name: Text
    free_end: Literal["weights", "actuator", "fixed", "free"]
    time: Literal["real", "virtual"] = "real"
    weights: Weights | None = None
    actuator: Actuator | None = None
    air: Air
    devices: dict[Name, DeviceFile]
    channels: dict[Name, ChannelFile]
    outputs: dict[Name, OutputFile]
    limits: dict[Literal["pressure", "force", "contraction", "displacement"], LimitFile]
    safe_state: Annotated[list[SafeActionFile], Field(min_length=1)]
    hands: HandsFile
    slack_below: Force = 0.0
    reviewed: dict[Literal["by", "date"], str | datetime.date] | None = None

    @model_validator(mode="after")
    def _free_end(self) -> BenchFile:
        for kind, given in (("weights", self.weights), ("actuator", self.actuator)):
            if (self.free_end == kind) != (given is not None):
                raise ValueError(f'"free_end: {kind}" and the section "{kind}" belong together')
        return self


class MountedFile(Strict):
    """How the specimen sits in the bench."""

    date: str | None = None
    length: Length
    at: Text | dict[str, str] = ""


class SpecimenPressure(Strict):
    """Pressure limits of the specimen."""

    command: Pressure
    never_above: Pressure


class SpecimenLimits(Strict):
    """What the specimen bears, and who says so."""

    pressure: SpecimenPressure
    contraction: Ratio
    source: Text


class ExpectedPoint(Strict):
    """What is already believed of the specimen at one pressure; straight lines between the points."""

    pressure: Pressure
    F_ce: Force
    K: Stiffness
    B_c: Damping
    B_r: Damping


class ExpectedFile(Strict):
    """Earlier coefficients, used by `check` to predict forces; never by the analysis."""

    source: Text
    F_c: Force = 0.0
    points: Annotated[list[ExpectedPoint], Field(min_length=1)]


class SpecimenFile(Strict):
    """The muscle under test."""

    schema_: Annotated[Literal["pmabench.specimen/1"], Field(alias="schema")]
    make: Text
    type: Text
    serial: Text
    nominal_length: Length
    inner_diameter: Length
    braid_angle: Text | None = None
    cycles_before: int = 0
    mounted: MountedFile
    limits: SpecimenLimits
    expected: ExpectedFile | None = None


class CalibrationFile(Strict):
    """A calibration: reference points, and how well they are known (95 %, k = 2)."""

    schema_: Annotated[Literal["pmabench.calibration/1"], Field(alias="schema")]
    id: Text
    quantity: Literal["pressure", "force", "length"]
    reference: Text
    date: datetime.date
    valid_until: datetime.date | None = None
    points: Annotated[list[tuple[Reading, Reading]], Field(min_length=2, max_length=200)]
    expanded_uncertainty: Reading
    gain_uncertainty: Ratio = 0.0
    sensor_lag: Time = 0.0
