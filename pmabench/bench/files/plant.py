"""Plant files: a lab's own muscle with its regulator and sensor noise, by one of four laws."""

from __future__ import annotations

from math import acos, sqrt
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from pmabench.bench.files.specimen import Reading, Text, within
from pmabench.files import quantity as q
from pmabench.files.document import Strict

NEUTRAL = acos(1 / sqrt(3)) - 1e-3
"""Braid angle from which a muscle no longer contracts [rad]."""


Coefficients = Annotated[list[float], Field(min_length=1, max_length=10)]
"""Coefficients of a polynomial, lowest power first."""


class Table(Strict):
    """A coefficient at some pressures; straight lines between them."""

    points: Annotated[list[tuple[Reading, Reading]], Field(min_length=2, max_length=200)]


class Polynomial(Strict):
    """A coefficient as polynomials of (P - centre) / scale, joined at breaks."""

    coefficients: Coefficients | None = None
    pieces: Annotated[list[Coefficients], Field(min_length=2, max_length=50)] | None = None
    breaks: Annotated[list[Reading], Field(min_length=1, max_length=49)] | None = None
    """Pressures where one piece ends and the next begins: one fewer than pieces."""
    unit: Text
    """Unit of the coefficient, for instance `N/mm`."""
    pressure: Text
    """Unit of the polynomial's pressure, for instance `kPa`."""
    centre: Reading | None = None
    scale: Reading | None = None
    domain: tuple[Reading, Reading] | None = None
    """Range of pressures in the source; from 0 to the plant's highest pressure if not given."""

    @model_validator(mode="after")
    def _one_form(self) -> Polynomial:
        if (self.coefficients is None) == (self.pieces is None):
            raise ValueError('either "coefficients" or "pieces" with "breaks" is expected')
        if (self.pieces is None) != (self.breaks is None):
            raise ValueError('"pieces" and "breaks" belong together')
        if self.pieces is not None and self.breaks is not None and len(self.pieces) != len(self.breaks) + 1:
            raise ValueError(f"{len(self.pieces)} pieces are joined at {len(self.pieces) - 1} breaks")
        return self


def _form(value: Any) -> str:
    if isinstance(value, (dict, Strict)):
        return "a table" if "points" in (value if isinstance(value, dict) else vars(value)) else "a polynomial"
    return "a constant"


Coefficient = Annotated[
    Annotated[Reading, Tag("a constant")]
    | Annotated[Table, Tag("a table")]
    | Annotated[Polynomial, Tag("a polynomial")],
    Discriminator(_form),
]
"""A coefficient over gauge pressure."""


class FrictionFile(Strict):
    """Coulomb friction inside the muscle: F_s at rest, falling on a straight line to F_c at `speed`."""

    F_s: Annotated[q.Force, within(0, 1e4, "force")]
    F_c: Annotated[q.Force, within(0, 1e4, "force")]
    speed: Annotated[q.Speed, within(1e-5, 1.0, "speed")] = 1e-3

    @model_validator(mode="after")
    def _in_order(self) -> FrictionFile:
        if self.F_c > self.F_s:
            raise ValueError('"F_c" (while it moves) cannot be more than "F_s" (at rest)')
        return self


class RegulatorFile(Strict):
    """How the pressure follows its command."""

    dead_time: Annotated[q.Time, within(0, 10, "time")] = 0.0
    lag: Annotated[q.Time, within(0, 60, "time")] = 0.0
    """First-order lag while filling."""
    vent_ratio: Annotated[float, Field(ge=0.01, le=100)] = 1.0
    """Lag while venting over lag while filling."""
    dead_band: Annotated[q.Pressure, within(0, 1e6, "pressure")] = 0.0
    """Pressure error below which the regulator does nothing."""
    leak: Annotated[q.Rate, within(0, 10, "rate")] = 0.0
    """Fraction of the pressure lost per second, for instance `2 %/s`."""
    natural_frequency: Annotated[q.Frequency, within(0, 1e3, "frequency")] = 0.0
    """Natural frequency of a second-order response, in place of `lag`."""
    damping_ratio: Annotated[float, Field(ge=0.05, le=20)] = 1.0
    """Damping ratio of a second-order response; 1 is critical, lower values overshoot."""

    @model_validator(mode="after")
    def _one_order(self) -> RegulatorFile:
        if self.natural_frequency > 0 and self.lag > 0:
            raise ValueError('"lag" (first order) and "natural_frequency" (second order) exclude each other')
        if "damping_ratio" in self.model_fields_set and self.natural_frequency == 0:
            raise ValueError('"damping_ratio" needs a "natural_frequency" above zero')
        if self.dead_band > 0 and self.lag == 0:
            raise ValueError('"dead_band" needs a "lag" above zero')
        return self


class NoiseFile(Strict):
    """Standard deviation of the noise of each sensor."""

    pressure: Annotated[q.Pressure, within(0, 1e5, "pressure")] = 0.0
    displacement: Annotated[q.Length, within(0, 0.01, "length")] = 0.0
    force: Annotated[q.Force, within(0, 1e3, "force")] = 0.0


class FlowFile(Strict):
    """A regulator that has to move air in and out, so that the pressure depends on the motion."""

    fill: Annotated[q.Conductance, within(0, 1e-5, "conductance")]
    """Mass flow per difference between the regulator's and the muscle's pressure."""
    vent: Annotated[q.Conductance, within(0, 1e-5, "conductance")]
    polytropic: Annotated[float, Field(ge=1, le=1.4)] = 1.2
    """Polytropic exponent; 1: isothermal, 1.4: adiabatic."""
    temperature: Annotated[q.Temperature, within(230, 370, "temperature")] = 293.0
    atmosphere: Annotated[q.Pressure, within(5e4, 1.1e5, "pressure")] = 101325.0

    @model_validator(mode="after")
    def _flows(self) -> FlowFile:
        if not (self.fill or self.vent):
            raise ValueError('one of "fill" and "vent" must be above zero')
        return self


class HysteresisFile(Strict):
    """A hysteresis loop, the same at all rates: half its gap, and the contraction in which a turn fades to 1/e."""

    height: Annotated[q.Force, within(0, 1e4, "force")]
    width: Annotated[q.Ratio, within(1e-5, 0.5, "ratio")]


class PlantFile(Strict):
    """A muscle of one's own behind its regulator; what all laws share."""

    schema_: Annotated[Literal["pmabench.plant/1"], Field(alias="schema")]
    name: Annotated[str, Field(min_length=1, max_length=80)]
    source: Text
    """Where the numbers come from."""
    length: Annotated[q.Length, within(1e-3, 10, "length")]
    """Nominal length, without pressure."""
    highest_pressure: Annotated[q.Pressure, within(1e3, 2e6, "pressure")]
    """Range of the law; the simulated regulator goes no higher."""
    regulator: RegulatorFile = RegulatorFile()
    noise: NoiseFile = NoiseFile()
    follow_lag: Annotated[q.Time, within(0, 10, "time")] = 0.0
    """First-order lag of an actuator that drives the free end behind its command."""


class ThreeElementFile(PlantFile):
    """A muscle F = F_ce(P) - K(P) x - B(P) x' - friction, x the contraction."""

    law: Literal["three-element"]
    stop: Annotated[q.Length, within(1e-4, 10, "length")]
    """Largest possible contraction, at its stop."""
    F_ce: Coefficient
    K: Coefficient
    B_c: Coefficient
    """Damping while it contracts."""
    B_r: Coefficient
    """Damping while it relaxes."""
    tau_r: Coefficient | None = None
    """With a free end it relaxes with this time constant of the pressure before the release, not `B_r` (paper 1)."""
    friction: FrictionFile | None = None
    diameter: Annotated[q.Length, within(1e-4, 1, "length")] | None = None
    """Free diameter of the braid."""
    braid_angle: Annotated[q.Angle, within(0.01, NEUTRAL, "angle")] | None = None
    """Angle between braid and muscle axis without contraction."""
    flow: FlowFile | None = None
    """If given, the pressure depends on the motion; needs `diameter` and `braid_angle`."""

    @model_validator(mode="after")
    def _shorter(self) -> ThreeElementFile:
        if self.stop >= self.length:
            raise ValueError('"stop" must be shorter than "length"')
        if self.flow is not None and (self.diameter is None or self.braid_angle is None):
            raise ValueError('"flow" needs "diameter" and "braid_angle", from which the volume follows')
        return self


class DaerdenFile(PlantFile):
    """A muscle F = S(eps) P + A eps (eps - B1) / (eps + B2) for a driven end, eps = x / length (paper 3)."""

    law: Literal["daerden"]
    diameter: Annotated[q.Length, within(1e-4, 1, "length")]
    """Free diameter."""
    braid_angle: Annotated[q.Angle, within(0.01, NEUTRAL, "angle")]
    """Angle between braid and muscle axis at eps = 0."""
    alpha: Annotated[float, Field(ge=1, le=5)] = 2.0
    """Exponent; 2 is that of Tondu and Lopez."""
    A: Annotated[q.Force, within(0, 1e6, "force")]
    """Size of the rubber term."""
    B1: Annotated[q.Ratio, within(0, 1, "ratio")]
    """Contraction at which the rubber term is 0 again."""
    B2: Annotated[q.Ratio, within(1e-3, 1, "ratio")]
    """The rubber term has its pole at eps = -B2."""
    reach: tuple[Annotated[q.Ratio, within(-0.5, 0, "ratio")], Annotated[q.Ratio, within(0.001, 0.5, "ratio")]]
    """Lowest and highest contraction that may be driven, as fractions of the length; stretched if negative."""
    hysteresis: HysteresisFile | None = None
    flow: FlowFile | None = None
    """If given, the pressure depends on the motion."""


class ContractorFile(PlantFile):
    """A home-made contractor of paper 2: its force at a driven end, its length without load at a free one."""

    law: Literal["contractor"]
    radius: Annotated[q.Length, within(1e-4, 0.5, "length")]
    """Radius at eps = 0."""
    braid_angle: Annotated[q.Angle, within(0.01, NEUTRAL, "angle")]
    """Angle between braid and muscle axis at eps = 0."""
    threshold: Annotated[q.Pressure, within(0, 2e5, "pressure")] = 45e3
    """Pressure below which there is no force."""
    reach: tuple[Annotated[q.Ratio, within(0, 0.3, "ratio")], Annotated[q.Ratio, within(0.001, 0.5, "ratio")]]
    """Lowest and highest contraction that may be driven, as fractions of the length."""


Weights = Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=1, max_length=20)]
"""Weights of the stop operators of a hysteresis; their sum is 1."""


def _whole(widths: list[float], weights: list[float]) -> None:
    if len(widths) != len(weights):
        raise ValueError(f'{len(widths)} "widths" and {len(weights)} "weights": each stop needs one of both')
    if abs(sum(weights) - 1) > 1e-6:
        raise ValueError(f'"weights" add up to {sum(weights):.4g}; they must add up to 1')


class SurfaceFile(Strict):
    """F_s = (A + A_P P) exp(-s eps) + (C eps + D) P + E, eps = x / length: the force without any history."""

    A: q.Force
    A_P: q.ForcePerPressure
    s: Annotated[float, Field(gt=0, le=1000)]
    """Steepness at small contraction, for instance 33.4."""
    C: q.ForcePerPressure
    D: q.ForcePerPressure
    E: q.Force
    bend: Annotated[float, Field(ge=0, le=2)] = 1.0
    """1 as written; 0 replaces exp(-s eps) by a straight line over eps."""
    span: Annotated[q.Ratio, within(0.001, 0.5, "ratio")] = 0.16
    """Contraction at which that line meets the exponential again."""


class StopsOverLengthFile(Strict):
    """Hysteresis over contraction, at most `height` + `per_pressure` P to each side."""

    height: Annotated[q.Force, within(0, 1e4, "force")]
    per_pressure: q.ForcePerPressure = 0.0
    widths: Annotated[list[Annotated[q.Length, within(1e-7, 1, "length")]], Field(min_length=1, max_length=20)]
    """Half of the contraction after a reversal at which each stop operator slides again."""
    weights: Weights
    first_cycle: Annotated[q.Ratio, within(0, 10, "ratio")] = 0.0
    """Fraction by which the hysteresis is higher after a rest."""
    way: Annotated[q.Length, within(1e-4, 10, "length")] = 0.08
    """Travel, in both directions, after which 1/e of that fraction is left."""

    @model_validator(mode="after")
    def _weighted(self) -> StopsOverLengthFile:
        if self.per_pressure < 0:
            raise ValueError('"per_pressure" cannot be below zero')
        _whole(self.widths, self.weights)
        return self


class StopsOverPressureFile(Strict):
    """Hysteresis over pressure, at most `height` to each side."""

    height: Annotated[q.Force, within(0, 1e4, "force")]
    widths: Annotated[list[Annotated[q.Pressure, within(1, 1e6, "pressure")]], Field(min_length=1, max_length=20)]
    weights: Weights

    @model_validator(mode="after")
    def _weighted(self) -> StopsOverPressureFile:
        _whole(self.widths, self.weights)
        return self


class CreepFile(Strict):
    """A length that creeps after the contraction, `share` of it with each time constant."""

    share: Annotated[q.Ratio, within(0, 0.2, "ratio")]
    times: Annotated[list[Annotated[q.Time, within(1e-3, 1e6, "time")]], Field(min_length=1, max_length=20)]

    @model_validator(mode="after")
    def _less_than_all(self) -> CreepFile:
        if self.share * len(self.times) > 0.5:
            each = f"{self.share:.3g} for each of {len(self.times)} times"
            raise ValueError(f'"share" of {each} is more than half in all')
        return self


class RealFile(PlantFile):
    """A muscle with curved force, hysteresis over contraction and pressure, and creep; effects not given are absent."""

    law: Literal["real"]
    reach: tuple[Annotated[q.Ratio, within(-0.1, 0, "ratio")], Annotated[q.Ratio, within(0.001, 0.5, "ratio")]]
    """Lowest and highest contraction that may be driven, as fractions of the length; a free end starts at 0."""
    surface: SurfaceFile
    B_c: Coefficient
    """Damping while it contracts."""
    B_r: Coefficient
    """Damping while it relaxes."""
    hysteresis: StopsOverLengthFile | None = None
    pressure_hysteresis: StopsOverPressureFile | None = None
    creep: CreepFile | None = None


AnyPlant = Annotated[ThreeElementFile | DaerdenFile | ContractorFile | RealFile, Field(discriminator="law")]
LAWS: dict[str, type[ThreeElementFile | DaerdenFile | ContractorFile | RealFile]] = {
    "three-element": ThreeElementFile,
    "daerden": DaerdenFile,
    "contractor": ContractorFile,
    "real": RealFile,
}
"""Name of the law -> model of its file."""
