"""Quantities as written in files, NUMBER UNIT, to SI floats; knows units, not their use.

Number and unit are split by our own pattern before the units library sees the unit alone, because on a whole string it
reads `1,5 bar` as 15 bar, takes `nan`, and hangs on `9**9**9 mm`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from math import isfinite, pi
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core.core_schema import CoreSchema, no_info_before_validator_function

from pmabench.base.quantities import QUANTITIES

if TYPE_CHECKING:
    from pint import UnitRegistry

NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,3})?"
UNIT = r"[A-Za-zµΩ°%][A-Za-z0-9µΩ°%·*/^. ]{0,30}"
_PATTERN = re.compile(rf"({NUMBER})\s*({UNIT})")
_COUNTED = re.compile(rf"(\d{{1,3}})\s*x\s*({NUMBER}\s*{UNIT})")

_TYPED = str.maketrans({"·": ".", "²": "2", "³": "3"})
USUAL = {q.name: {q.unit: 1.0, q.shown_in.translate(_TYPED): q.scale} for q in QUANTITIES.values() if q.example}
"""Quantity -> unit -> factor, equal to those of the units library, which takes a quarter of a second to load."""
USUAL["pressure"] |= {"hPa": 100.0, "MPa": 1e6, "mbar": 100.0, "bar": 1e5}
USUAL["length"] |= {"um": 1e-6, "cm": 1e-2}
USUAL["time"] |= {"ms": 1e-3, "min": 60.0, "h": 3600.0}
USUAL["force"]["kN"], USUAL["mass"]["g"], USUAL["voltage"]["mV"], USUAL["rate"]["Hz"] = 1e3, 1e-3, 1e-3, 1.0
USUAL["frequency"]["rad/s"] = 1.0 / (2 * pi)
USUAL["volume"]["cm3"], USUAL["volume per pressure"]["cm3/bar"] = 1.0000000000000002e-06, 1.0000000000000003e-11


@lru_cache(maxsize=1)
def _units() -> UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry()


@lru_cache(maxsize=512)
def unit_factor(unit: str, quantity: str) -> float:
    """Factor from `unit` of `quantity` to SI; raises ValueError with a hint if it is not a unit of it."""
    usual = USUAL.get(quantity, {}).get(unit)
    return library_factor(unit, quantity) if usual is None else usual


def library_factor(unit: str, quantity: str) -> float:
    """The same from the units library."""
    if unit == "%":
        if quantity != "ratio":
            raise ValueError(f'"%" is allowed only where a ratio is expected, here a {quantity}, {_hint(quantity)}')
        return 0.01
    if quantity == "count":
        if unit in {"count", "counts", "1"}:
            return 1.0
        raise ValueError(f'"{unit}" is no count')
    if quantity == "temperature" and unit != "K":
        raise ValueError(f'"{unit}" is no unit of temperature here, {_hint(quantity)}')
    if "**" in unit or re.search(r"\d\d", unit):
        raise ValueError(_unknown(unit, quantity))
    registry = _units()
    try:
        one = registry.Quantity(1.0, registry.parse_units(_in_library(unit)))
        factor = one.to(_in_library(QUANTITIES[quantity].unit)).magnitude
        if quantity == "frequency" and "radian" in str(one.to_base_units().units):
            factor /= 2 * pi  # rpm, rad/s, turn/s
    except Exception as error:
        if type(error).__name__ == "DimensionalityError":
            raise ValueError(f'"{unit}" is no unit of {quantity}, {_hint(quantity)}') from error
        raise ValueError(_unknown(unit, quantity)) from error
    return float(factor)


def _in_library(unit: str) -> str:
    """A unit in the notation of the units library."""
    text = re.sub(r"([A-Za-zµΩ])(-?\d)", r"\1**\2", unit.replace("·", "*").replace("^", "").replace("µ", "u"))
    return re.sub(r"(?<=[A-Za-z0-9])\.(?=[A-Za-z])", "*", text)


def _unknown(unit: str, quantity: str) -> str:
    """What is wrong with a unit; capitals count, so the likeliest mistake is a unit in other capitals."""
    known = [name for units in (USUAL.get(quantity, {}), *USUAL.values()) for name in units]
    alike = next((name for name in known if name.lower() == unit.lower()), None)
    return f'unknown unit "{unit}"' + (f'; did you mean "{alike}"?' if alike else f", {_hint(quantity)}")


def _hint(quantity: str) -> str:
    return f'for instance "{_example(quantity)}"'


def _example(quantity: str) -> str:
    known = QUANTITIES.get(quantity)
    return (known.example if known is not None else "") or "1 s"


def parse_quantity(value: object, quantity: str) -> float:
    """`"300 kPa"` to 300000.0; raises ValueError with what was expected."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        value = float(value) if abs(value) < 1e300 else float("inf")
        if value == 0 and quantity == "ratio":
            return 0.0
        example = _example(quantity)
        shown = f"{value:g} {example.split(' ', 1)[1]}" if isfinite(value) else example
        raise ValueError(f'{value:g} needs a unit, for instance "{shown}"')
    if not isinstance(value, str):
        raise ValueError(f"a {quantity} with its unit is expected, {_hint(quantity)}")
    match = _PATTERN.fullmatch(value.strip())
    if match is None:
        if re.match(r"[+-]?\d+,\d", value.strip()):
            raise ValueError(f'"{value}" has a decimal comma; write a point, {_hint(quantity)}')
        if re.search(r"\((?:g|a|abs|gauge)\)", value):
            raise ValueError(f'"{value}": gauge or absolute is said by "reference" of the channel, {_hint(quantity)}')
        raise ValueError(f'"{value}" is no {quantity} with a unit, {_hint(quantity)}')
    number = float(match[1]) * unit_factor(match[2].strip(), quantity)
    if not isfinite(number):
        raise ValueError(f'"{value}" is out of all range')
    return number


def parse_mass_or_force(value: object) -> tuple[str, float]:
    """`("mass", kg)` for `"6 kg"`, `("force", N)` for `"58.86 N"`."""
    try:
        return "mass", parse_quantity(value, "mass")
    except ValueError as mass_error:
        try:
            return "force", parse_quantity(value, "force")
        except ValueError:
            if "no unit of mass" in str(mass_error):
                raise ValueError(f'"{value}" is neither a mass nor a force, for instance "6 kg" or "58.86 N"') from None
            raise


def parse_plates(value: object) -> tuple[int, float]:
    """`"5 x 5 kg"` to `(5, 5.0)`: COUNT x QUANTITY, for plates only."""
    match = _COUNTED.fullmatch(str(value).strip())
    if match is None:
        raise ValueError(f'"{value}" is no plates, for instance "5 x 5 kg"')
    mass = parse_quantity(match[2], "mass")
    if mass <= 0:
        raise ValueError(f'"{value}": a plate weighs more than nothing')
    return int(match[1]), mass


class AsText:
    """Annotation for a field of a pydantic model that is written as text: its parser and its JSON schema."""

    def __init__(self, parse: Callable[[object], object], description: str, *examples: str, **more: str) -> None:
        self.parse = parse
        self.schema = {"type": "string", "description": description, "examples": list(examples), **more}

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Parse the text before the value is validated."""
        return no_info_before_validator_function(self.parse, handler(source))

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, _handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Schema of the text."""
        return dict(self.schema)


def _of(quantity: str) -> AsText:
    """A quantity, as `NUMBER UNIT`."""

    def parse(value: object) -> float:
        number = parse_quantity(value, quantity)
        if quantity == "time" and number < 0:
            raise ValueError(f'"{value}": a time is not below zero')
        return number

    return AsText(parse, f"{quantity} with its unit", _example(quantity), pattern=rf"^\s*{NUMBER}\s*{UNIT}\s*$")


Pressure = Annotated[float, _of("pressure")]
PressureRate = Annotated[float, _of("pressure rate")]
Length = Annotated[float, _of("length")]
Speed = Annotated[float, _of("speed")]
Acceleration = Annotated[float, _of("acceleration")]
Force = Annotated[float, _of("force")]
Mass = Annotated[float, _of("mass")]
Time = Annotated[float, _of("time")]
Frequency = Annotated[float, _of("frequency")]
Ratio = Annotated[float, _of("ratio")]
Angle = Annotated[float, _of("angle")]
AngularSpeed = Annotated[float, _of("angular speed")]
Gain = Annotated[float, _of("gain")]
Rate = Annotated[float, _of("rate")]
Temperature = Annotated[float, _of("temperature")]
Conductance = Annotated[float, _of("conductance")]
TorsionalStiffness = Annotated[float, _of("torsional stiffness")]
TorqueRate = Annotated[float, _of("torque rate")]
AngularIntegralGain = Annotated[float, _of("angular integral gain")]
Stiffness = Annotated[float, _of("stiffness")]
Damping = Annotated[float, _of("damping")]
ForcePerPressure = Annotated[float, _of("force per pressure")]
Volume = Annotated[float, _of("volume")]
Load = Annotated[tuple[str, float], AsText(parse_mass_or_force, "a mass or a force", "6 kg", "58.86 N")]
Plates = Annotated[tuple[int, float], AsText(parse_plates, "COUNT x MASS", "5 x 5 kg")]


def raw_quantity(value: object) -> tuple[float, str]:
    """`"9.998 V"` to `(9.998, "V")`: a reading in device units, not converted."""
    if isinstance(value, str):
        match = _PATTERN.fullmatch(value.strip())
        if match is not None and isfinite(float(match[1])):
            return float(match[1]), match[2].strip()
    raise ValueError(f'"{value}" is no reading with a unit, for instance "5.003 V" or "1200 count"')
