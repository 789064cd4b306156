"""Strict parsing of typed answers: every function raises ValueError with what was expected."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from pmabench.files.quantity import parse_mass_or_force, parse_plates, parse_quantity, raw_quantity

GRAVITY = 9.81
"""Gravity of the benches that are written [m/s2]."""
QUANTITY_OF = {"pressure": "pressure", "displacement": "length", "force": "force"}
"""Measured channel -> quantity."""
_NAME = re.compile(r"[A-Za-z0-9_/.-]{1,40}")


MOST_SIGNS = 200
"""Longest text in characters: an address can contain a file's path."""


def text(value: str) -> str:
    """One line of text that can be put between double quotes."""
    if not value or len(value) > MOST_SIGNS or any(sign in value for sign in '"\\\n'):
        raise ValueError(f"a text of at most {MOST_SIGNS} signs is expected, without quotation marks")
    return value


def above_zero(quantity: str) -> Callable[[str], float]:
    """Parser of a `quantity` above zero [SI]."""

    def read(value: str) -> float:
        number = parse_quantity(value, quantity)
        if not number > 0:
            raise ValueError("a value above zero is expected")
        return number

    return read


def mounted(value: str) -> tuple[float, float]:
    """`250 mm, 6 kg`: mounted length [m] and the load during mounting [kg]."""
    length, _, load = (part.strip() for part in value.partition(","))
    kind, number = parse_mass_or_force(load or "0 kg")
    return above_zero("length")(length), number if kind == "mass" else number / GRAVITY


@dataclass(frozen=True)
class Stack:
    """Weights on the free end [kg]; plates as (count, mass [kg])."""

    hanger: float
    carriage: float
    plates: list[tuple[int, float]] = field(default_factory=list)
    pulley: bool = False


def stack(value: str) -> Stack:
    """`hanger 1 kg, plates 10 x 5 kg + 1 x 2 kg, carriage 2 kg, pulley`; all but the hanger may be left out."""
    hanger, carriage, plates, pulley = 0.0, 0.0, [], False
    for part in (one.strip() for one in value.split(",")):
        word, _, rest = part.partition(" ")
        if word == "hanger":
            hanger = above_zero("mass")(rest)
        elif word == "carriage":
            carriage = parse_quantity(rest, "mass")
        elif word == "plates":
            plates = [parse_plates(one) for one in rest.split("+")]
        elif part == "pulley":
            pulley = True
        else:
            raise ValueError(f'"{part}" is none of hanger, plates, carriage, pulley')
    if not hanger:
        raise ValueError('the hanger is missing: "hanger 1 kg, plates 10 x 5 kg"')
    return Stack(hanger, carriage, plates, pulley)


def actuator(value: str) -> tuple[float, float, float]:
    """`60 mm, 100 mm/s, 2000 N`: stroke [m], speed [m/s] and force [N]."""
    parts = [part.strip() for part in value.split(",")]
    if len(parts) != 3:
        raise ValueError('stroke, speed and force are expected: "60 mm, 100 mm/s, 2000 N"')
    stroke, speed, force = (above_zero(q)(p) for q, p in zip(("length", "speed", "force"), parts, strict=True))
    return stroke, speed, force


def inputs(value: str) -> dict[str, str]:
    """`pressure AIN0, displacement AIN1, force AIN2, command AIN3, actuator AIN4`: signal -> input."""
    found = {}
    for part in value.split(","):
        word, _, name = part.strip().partition(" ")
        if word not in {*QUANTITY_OF, "command", "actuator"} or not _NAME.fullmatch(name.strip()):
            known = "pressure, displacement, force, command, actuator"
            raise ValueError(f'"{part.strip()}" is none of {known} with an input')
        found[word] = name.strip()
    if missing := [word for word in (*QUANTITY_OF, "command") if word not in found]:
        raise ValueError(f"{missing[0]} is missing; the command is what the regulator is set to, looped into an input")
    return found


@dataclass(frozen=True)
class Scale:
    """A straight line through two points: raw readings as typed, values [SI]."""

    raw: tuple[str, str]
    values: tuple[float, float]

    @property
    def span(self) -> float:
        """Difference of the two values [SI]."""
        return abs(self.values[1] - self.values[0])


def scale(value: str, quantity: str) -> Scale:
    """`0 V..10 V = 0 kPa..1000 kPa`: device readings and their values."""
    left, equals, right = value.partition("=")
    raw, values = ([end.strip() for end in side.split("..")] for side in (left, right))
    if not equals or len(raw) != 2 or len(values) != 2:
        raise ValueError(f'"{value.strip()}" is no scale: "0 V..10 V = 0 kPa..1000 kPa" is one')
    if raw_quantity(raw[0])[1] != raw_quantity(raw[1])[1]:
        raise ValueError("both readings in one unit are expected")
    low, high = (parse_quantity(end, quantity) for end in values)
    if low >= high:
        raise ValueError("the lower value comes first")
    return Scale((raw[0], raw[1]), (low, high))


def sensors(value: str) -> dict[str, Scale]:
    """`pressure 0 V..10 V = 0 kPa..1 MPa; displacement ...; force ...`: channel -> scale."""
    found = {}
    for part in value.split(";"):
        word, _, rest = part.strip().partition(" ")
        if word not in QUANTITY_OF:
            raise ValueError(f'"{part.strip()}" does not begin with pressure, displacement or force')
        found[word] = scale(rest, QUANTITY_OF[word])
    if missing := [word for word in QUANTITY_OF if word not in found]:
        raise ValueError(f"{missing[0]} is missing")
    return found


def regulator(value: str) -> tuple[str, Scale]:
    """`DAC0 0 V..5 V = 0 kPa..1000 kPa`: output of the regulator and its scale."""
    name, _, rest = value.strip().partition(" ")
    if not _NAME.fullmatch(name):
        raise ValueError(f'"{name}" is no output')
    return name, scale(rest, "pressure")


def dump_valve(value: str) -> tuple[str, str] | None:
    """`FIO0 closed`: output, and position of the valve while it is on; None for `none`."""
    if value == "none":
        return None
    name, _, energised = (part.strip() for part in value.partition(" "))
    if energised not in {"closed", "open"} or not _NAME.fullmatch(name):
        raise ValueError('the output and where the valve is while it is on are expected: "FIO0 closed", or "none"')
    return name, energised


def supply(value: str) -> tuple[float, float | None]:
    """`700 kPa, relief 650 kPa` or `700 kPa, relief none`: supply and relief valve [Pa]."""
    if (found := re.fullmatch(r"(.+?),\s*relief\s+(.+)", value)) is None:
        raise ValueError('supply and relief valve are expected: "700 kPa, relief 650 kPa", or "relief none"')
    relief = None if found[2] == "none" else above_zero("pressure")(found[2])
    return above_zero("pressure")(found[1]), relief


def interlock(value: str) -> str | None:
    """Name of an input, or None for `none`."""
    if not _NAME.fullmatch(value):
        raise ValueError('the name of an input is expected, or "none"')
    return None if value == "none" else value
