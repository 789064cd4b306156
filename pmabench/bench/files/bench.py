"""The bench file: devices, channels, outputs and air; what it says about safety is described in `safety`."""

from __future__ import annotations

import datetime
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from pmabench.bench.files.parts import (
    ConductanceAbove0,
    Name,
    PressureAbove0,
    PressureNotBelow0,
    RatioAbove0,
    Reading,
    Text,
    TimeAbove0,
)
from pmabench.bench.files.safety import (
    HandsFile,
    InterlockFile,
    LimitFile,
    NoWatchdogFile,
    ProofFile,
    ReviewFile,
    SafeActionFile,
    StopFile,
    WatchFile,
)
from pmabench.bench.files.session import SessionFile
from pmabench.files.document import Strict
from pmabench.files.quantity import Acceleration, Force, Length, Mass, Plates, Pressure, Speed


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
    load_tolerance: RatioAbove0 = 0.1
    """How far the measured force of a load at rest may be from its weight, besides the cell's uncertainty."""
    load_action: Literal["warn", "stop"] = "warn"
    """What follows when it is further: a line in the record, or a controlled stop."""


class Actuator(Strict):
    """A displacement actuator that drives the free end."""

    stroke: tuple[Length, Length]
    speed: Speed
    force: Force


class AirConductance(Strict):
    """How fast air goes through the regulator and its line: mass flow by difference of pressure."""

    fill: ConductanceAbove0
    vent: ConductanceAbove0


class Air(Strict):
    """The supply and what protects against it."""

    supply: PressureAbove0
    relief_valve: PressureAbove0 | Literal["none"] = "none"
    isolation_valve: str = "none"
    dump_valve: Literal["normally open", "normally closed", "none"] | None = None
    """A dump valve that the program does not switch; one that it switches stands among the outputs."""
    atmosphere: Pressure = 101325.0
    overshoot: PressureNotBelow0 = 0.0
    """Most that the regulator overshoots a step."""
    conductance: AirConductance | None = None
    """For `check` to predict the pressure that a driven end makes; without it a fast motion counts as closed."""


class VerifiedFile(Strict):
    """Who compared this device with instruments through this driver, when, and with which firmware."""

    by: Annotated[str, Field(min_length=1, max_length=100)]
    date: datetime.date
    firmware: Annotated[str, Field(max_length=100)] = ""
    """As the device tells it (`devices probe`); with another one the driver counts as not verified."""


class DeviceFile(Strict):
    """One device: driver by name, address, and the driver's own options."""

    driver: str
    address: str = ""
    options: dict[str, Any] = {}
    watchdog: TimeAbove0 | None = None
    """After so long without a word from the program the device vents by itself."""
    verified: VerifiedFile | None = None
    """That this driver was tried on this device itself, not on an emulator only."""


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
    without_power: Literal["holds", "vents"] = "holds"
    """What a regulator does when its own power fails; many hold the pressure."""


class ValveFile(Strict):
    """A valve that is switched: an output with `energised`."""

    device: str
    output: str
    energised: Literal["closed", "open"]
    """Its position while the output is on; without power it stands the other way."""


def _kind_of_output(value: Any) -> str:
    given = value if isinstance(value, dict) else vars(value) if isinstance(value, (OutputFile, ValveFile)) else {}
    return "a valve" if "energised" in given else "a set-point"


AnyOutput = Annotated[
    Annotated[OutputFile, Tag("a set-point")] | Annotated[ValveFile, Tag("a valve")], Discriminator(_kind_of_output)
]


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
    outputs: dict[Name, AnyOutput]
    interlocks: list[InterlockFile] = []
    limits: dict[Literal["pressure", "force", "contraction", "displacement", "angle", "supply"], LimitFile]
    watch: Annotated[list[WatchFile], Field(max_length=100)] = []
    safe_state: Annotated[list[SafeActionFile], Field(min_length=1, max_length=50)]
    stop: StopFile | None = None
    proof: ProofFile | None = None
    setup_pressure: PressureAbove0 | None = None
    """Highest pressure that may be commanded before the bench is proven."""
    no_watchdog: NoWatchdogFile | None = None
    hands: HandsFile
    slack_below: Force = 0.0
    session: SessionFile | None = None
    reviewed: ReviewFile | None = None

    @model_validator(mode="after")
    def _free_end(self) -> BenchFile:
        for kind, given in (("weights", self.weights), ("actuator", self.actuator)):
            if (self.free_end == kind) != (given is not None):
                raise ValueError(f'"free_end: {kind}" and the section "{kind}" belong together')
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
        valve = self.valves.get("dump_valve")
        return self.air.dump_valve == "normally open" or (valve is not None and valve.energised == "closed")
