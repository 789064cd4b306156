"""The plant file: a muscle of one's own for the simulated bench, with its regulator and the noise of the sensors."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from pmabench.base.quantities import show
from pmabench.bench.files.parts import Reading, Text
from pmabench.files.document import Strict
from pmabench.files.quantity import Force, Length, Pressure, Rate, Speed, Time


def _within(low: float, high: float, quantity: str) -> AfterValidator:
    """Refuses what no plant has, in the units of people."""

    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"{show(value, quantity)} is outside {show(low, quantity)} to {show(high, quantity)}")
        return value

    return AfterValidator(check)


Coefficients = Annotated[list[float], Field(min_length=1, max_length=10)]
"""Of a polynomial, lowest power first."""


class Table(Strict):
    """A coefficient at some pressures; straight lines between them."""

    points: Annotated[list[tuple[Reading, Reading]], Field(min_length=2, max_length=200)]


class Polynomial(Strict):
    """A coefficient as polynomials of (P - centre) / scale, joined at breaks."""

    coefficients: Coefficients | None = None
    pieces: Annotated[list[Coefficients], Field(min_length=2, max_length=50)] | None = None
    breaks: Annotated[list[Reading], Field(min_length=1, max_length=49)] | None = None
    """Where one piece ends and the next begins: one less than pieces."""
    unit: Text
    """Of the coefficient, for instance `N/mm`."""
    pressure: Text
    """Unit of the pressure that the polynomial is of, for instance `kPa`."""
    centre: Reading | None = None
    scale: Reading | None = None
    domain: tuple[Reading, Reading] | None = None
    """Between which pressures the source gives it; from 0 up to the plant's highest pressure where not given."""

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
"""A coefficient over the gauge pressure."""


class FrictionFile(Strict):
    """Coulomb friction inside the muscle: F_s at rest, falling on a straight line to F_c at `speed`."""

    F_s: Annotated[Force, _within(0, 1e4, "force")]
    F_c: Annotated[Force, _within(0, 1e4, "force")]
    speed: Annotated[Speed, _within(1e-5, 1.0, "speed")] = 1e-3

    @model_validator(mode="after")
    def _in_order(self) -> FrictionFile:
        if self.F_c > self.F_s:
            raise ValueError('"F_c" (while it moves) cannot be more than "F_s" (at rest)')
        return self


class RegulatorFile(Strict):
    """How the pressure follows its command."""

    dead_time: Annotated[Time, _within(0, 10, "time")] = 0.0
    lag: Annotated[Time, _within(0, 60, "time")] = 0.0
    """First-order, while filling."""
    vent_ratio: Annotated[float, Field(ge=0.01, le=100)] = 1.0
    """Lag while venting by lag while filling."""
    dead_band: Annotated[Pressure, _within(0, 1e6, "pressure")] = 0.0
    """Pressure error that it does not act on."""
    leak: Annotated[Rate, _within(0, 10, "rate")] = 0.0
    """Share of the pressure that is lost in a second, for instance `2 %/s`."""

    @model_validator(mode="after")
    def _needs_a_lag(self) -> RegulatorFile:
        if self.dead_band > 0 and self.lag == 0:
            raise ValueError('"dead_band" needs a "lag" above zero')
        return self


class NoiseFile(Strict):
    """Standard deviation of the noise of each sensor."""

    pressure: Annotated[Pressure, _within(0, 1e5, "pressure")] = 0.0
    displacement: Annotated[Length, _within(0, 0.01, "length")] = 0.0
    force: Annotated[Force, _within(0, 1e3, "force")] = 0.0


class PlantFile(Strict):
    """A muscle of one's own, F = F_ce(P) - K(P) x - B(P) x' - friction, behind its regulator."""

    schema_: Annotated[Literal["pmabench.plant/1"], Field(alias="schema")]
    name: Annotated[str, Field(min_length=1, max_length=80)]
    source: Text
    """Where the numbers come from."""
    law: Literal["three-element"]
    length: Annotated[Length, _within(1e-3, 10, "length")]
    """Nominal, without pressure."""
    stop: Annotated[Length, _within(1e-4, 10, "length")]
    """Contraction at which it cannot go further."""
    highest_pressure: Annotated[Pressure, _within(1e3, 1e6, "pressure")]
    """Up to which the coefficients hold; the simulated regulator goes no higher."""
    F_ce: Coefficient
    K: Coefficient
    B_c: Coefficient
    """Damping while it contracts."""
    B_r: Coefficient
    """Damping while it relaxes."""
    friction: FrictionFile | None = None
    regulator: RegulatorFile = RegulatorFile()
    noise: NoiseFile = NoiseFile()
    follow_lag: Annotated[Time, _within(0, 10, "time")] = 0.0
    """First-order lag of an actuator that drives the free end behind its command."""

    @model_validator(mode="after")
    def _shorter(self) -> PlantFile:
        if self.stop >= self.length:
            raise ValueError('"stop" must be shorter than "length"')
        return self
