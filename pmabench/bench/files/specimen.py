"""The specimen file, the calibration file, and types of values shared by all files of a bench.

A specimen is the muscle under test, its limits, and values known before the test. A calibration has reference points
and their uncertainty.
"""

from __future__ import annotations

import datetime
from math import inf
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema, model_validator

from pmabench.base.quantities import show
from pmabench.files import quantity as q
from pmabench.files.document import Strict

Reading = Annotated[
    tuple[float, str],
    BeforeValidator(q.raw_quantity),
    WithJsonSchema({"type": "string", "description": "a number with its unit", "examples": ["5.003 V", "600 kPa"]}),
]
"""A number with the device's or the quantity's unit, kept separate."""

Text = Annotated[str, Field(max_length=400)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$")]
Place = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}(\.[A-Za-z0-9_-]{1,40}){0,9}$")]
"""Path of keys to a value in a file: `limits.pressure.trip`."""


def above_zero(value: float) -> float:
    """`value` if it is above zero, else ValueError."""
    if not value > 0:
        raise ValueError("a value above zero is expected")
    return value


def not_below_zero(value: float) -> float:
    """`value` if it is not below zero, else ValueError."""
    if value < 0:
        raise ValueError("a value that is not below zero is expected")
    return value


def within(low: float, high: float, quantity: str) -> AfterValidator:
    """Validator that refuses values outside the plausible range, with a message in display units."""

    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"{show(value, quantity)} is outside {show(low, quantity)} to {show(high, quantity)}")
        return value

    return AfterValidator(check)


PressureAbove0 = Annotated[q.Pressure, AfterValidator(above_zero)]
PressureNotBelow0 = Annotated[q.Pressure, AfterValidator(not_below_zero)]
RateAbove0 = Annotated[q.PressureRate, AfterValidator(above_zero)]
LengthAbove0 = Annotated[q.Length, AfterValidator(above_zero)]
TimeAbove0 = Annotated[q.Time, AfterValidator(above_zero)]
RatioAbove0 = Annotated[q.Ratio, AfterValidator(above_zero)]
AngleAbove0 = Annotated[q.Angle, AfterValidator(above_zero)]
MassAbove0 = Annotated[q.Mass, AfterValidator(above_zero)]
MassNotBelow0 = Annotated[q.Mass, AfterValidator(not_below_zero)]
ConductanceAbove0 = Annotated[q.Conductance, AfterValidator(above_zero)]
RatioNotBelow0 = Annotated[q.Ratio, AfterValidator(not_below_zero)]


class CalibrationFile(Strict):
    """A calibration: reference points, and how well they are known (95 %, k = 2)."""

    schema_: Annotated[Literal["pmabench.calibration/1"], Field(alias="schema")]
    id: Text
    quantity: Literal["pressure", "force", "length", "angle", "torque", "mass flow", "acceleration", "angular speed"]
    reference: Text
    date: datetime.date
    valid_until: datetime.date | None = None
    points: Annotated[list[tuple[Reading, Reading]], Field(min_length=2, max_length=200)]
    expanded_uncertainty: Reading
    gain_uncertainty: RatioNotBelow0 = 0.0
    sensor_lag: q.Time = 0.0


class MountedFile(Strict):
    """How the specimen sits in the bench."""

    date: str | None = None
    length: LengthAbove0
    at: Text | dict[str, str] = ""


class SpecimenPressure(Strict):
    """Pressure limits of the specimen."""

    command: PressureAbove0
    never_above: PressureAbove0

    @model_validator(mode="after")
    def _in_order(self) -> SpecimenPressure:
        if self.command >= self.never_above:
            raise ValueError('"command" must lie below "never_above"')
        return self


class SpecimenLimits(Strict):
    """Limits of the specimen, and their source."""

    pressure: SpecimenPressure
    contraction: RatioAbove0
    source: Text


class ExpectedPoint(Strict):
    """Expected coefficients of the specimen at one pressure; straight lines between the points."""

    pressure: q.Pressure
    F_ce: q.Force
    K: q.Stiffness
    B_c: q.Damping
    B_r: q.Damping


class ExpectedFile(Strict):
    """Earlier coefficients: `check` predicts forces by them, `accept` may ask for agreement; no fit knows them."""

    source: Text
    F_c: q.Force = 0.0
    points: Annotated[list[ExpectedPoint], Field(min_length=1)]


class AssemblyFile(Strict):
    """Several like muscles tested as one specimen."""

    parallel: Annotated[int, Field(ge=1, le=100)] = 1
    """Number of muscles next to each other: their forces add up."""
    series: Annotated[int, Field(ge=1, le=100)] = 1
    """Number of muscles end to end: their lengths add up."""
    section: LengthAbove0
    """Nominal length of one muscle."""
    connector: Annotated[q.Length, AfterValidator(not_below_zero)] = 0.0
    """Total length of the connectors between muscles end to end; it does not contract."""


class SpecimenFile(Strict):
    """The muscle under test."""

    schema_: Annotated[Literal["pmabench.specimen/1"], Field(alias="schema")]
    make: Text
    type: Text
    serial: Text
    nominal_length: LengthAbove0
    inner_diameter: LengthAbove0
    braid_angle: AngleAbove0 | None = None
    """Angle between braid and muscle axis at the nominal length; F_ce of paper 1 is computed from it."""
    mass: MassAbove0 | None = None
    """Mass of the muscle; half of its weight is added to the load if it hangs (paper 1)."""
    cycles_before: int = 0
    assembly: AssemblyFile | None = None
    mounted: MountedFile
    limits: SpecimenLimits
    expected: ExpectedFile | None = None
    to_confirm: list[Place] = []
    """Keys of this file without a value from a person; each must be deleted before a run in real time."""

    @model_validator(mode="after")
    def _without_connectors(self) -> SpecimenFile:
        """Lengths must exclude connectors, as contraction refers to the muscles alone."""
        if self.assembly is None:
            return self
        one = self.assembly
        whole = one.series * one.section
        for name, length in (("nominal_length", self.nominal_length), ("mounted: length", self.mounted.length)):
            if abs(length - whole) > max(0.5 * one.connector, 0.02 * whole):
                raise ValueError(
                    f'"{name}" is {1e3 * length:g} mm, {one.series} x {1e3 * one.section:g} mm are {1e3 * whole:g} mm: '
                    "give the length of the muscles without the connectors, which do not contract; every contraction "
                    f"would come out {abs(1 - whole / length):.1%} too {'small' if length > whole else 'large'}"
                )
        return self


def any_specimen() -> SpecimenFile:
    """A specimen without limits, to inspect a bench alone; nothing is ever run with it."""
    pressure = SpecimenPressure.model_construct(command=inf, never_above=inf)
    limits = SpecimenLimits.model_construct(pressure=pressure, contraction=inf, source="")
    mounted = MountedFile.model_construct(date=None, length=inf, at="")
    unknown: dict[str, Any] = {"make": "", "type": "", "serial": "", "nominal_length": inf, "inner_diameter": inf}
    return SpecimenFile.model_construct(schema_="pmabench.specimen/1", **unknown, mounted=mounted, limits=limits)
