"""Kinds of values that bench, specimen and calibration files share."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from pmabench.files.quantity import Angle, Conductance, Length, Mass, Pressure, PressureRate, Ratio, Time, raw_quantity

Reading = Annotated[
    tuple[float, str],
    BeforeValidator(raw_quantity),
    WithJsonSchema({"type": "string", "description": "a number with its unit", "examples": ["5.003 V", "600 kPa"]}),
]
"""A number with the device's or the quantity's unit, kept apart."""

Text = Annotated[str, Field(max_length=400)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,39}$")]


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


PressureAbove0 = Annotated[Pressure, AfterValidator(above_zero)]
PressureNotBelow0 = Annotated[Pressure, AfterValidator(not_below_zero)]
RateAbove0 = Annotated[PressureRate, AfterValidator(above_zero)]
LengthAbove0 = Annotated[Length, AfterValidator(above_zero)]
TimeAbove0 = Annotated[Time, AfterValidator(above_zero)]
RatioAbove0 = Annotated[Ratio, AfterValidator(above_zero)]
AngleAbove0 = Annotated[Angle, AfterValidator(above_zero)]
MassAbove0 = Annotated[Mass, AfterValidator(above_zero)]
ConductanceAbove0 = Annotated[Conductance, AfterValidator(above_zero)]
RatioNotBelow0 = Annotated[Ratio, AfterValidator(not_below_zero)]
