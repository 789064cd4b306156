"""Units as people write them next to names and in the properties of files, by the spelling that pmabench takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pmabench.base.errors import InvalidFile, Problem
from pmabench.store.importers.map_rules import ColumnRule

_SPELLINGS = {
    "s": "sec secs second seconds sekunden",
    "ms": "msec msecs millisecond milliseconds",
    "us": "usec microsecond microseconds µs μs",
    "ns": "nsec nanosecond nanoseconds",
    "min": "minute minutes minuten",
    "h": "hr hrs hour hours stunde stunden std",
    "d": "day days tage",
    "Pa": "pascal pascals",
    "kPa": "kilopascal kilopascals kpa",
    "MPa": "megapascal mpa",
    "hPa": "hectopascal",
    "mbar": "millibar",
    "bar": "bars barg bar(g) bar_g",
    "psi": "psig psi(g) lbf/in2 lb/in2 lbf/in^2 lb/in^2 lbf/in² lb/in²",
    "kgf/cm2": "kgf/cm^2 kgf/cm² kg/cm2 kg/cm^2 kg/cm² kp/cm2 kp/cm^2 kp/cm² ksc",
    "N/mm2": "n/mm^2 n/mm²",
    "atm": "atmosphere atmospheres",
    "mmHg": "torr mm_hg",
    "inHg": "in_hg",
    "N": "newton newtons",
    "kN": "kilonewton kilonewtons kn",
    "mN": "millinewton millinewtons",
    "daN": "decanewton",
    "lbf": "lb lbs pound pounds",
    "g": "gram grams gramm",
    "kg": "kilogram kilograms kgs",
    "kgf": "kp kilopond kg-f kg_f",
    "gf": "pond g-f",
    "ozf": "oz",
    "mm": "millimeter millimeters millimetre millimetres",
    "cm": "centimeter centimeters centimetre centimetres",
    "m": "meter meters metre metres",
    "um": "micrometer micron microns µm μm",
    "in": "inch inches",
    "ft": "foot feet",
    "V": "volt volts",
    "mV": "millivolt millivolts mvolt mvolts",
    "A": "amp amps ampere amperes",
    "mA": "milliamp milliamps milliampere milliamperes ma",
    "count": "counts digit digits raw adc lsb",
    "degC": "°c degc celsius",
    "Hz": "hertz hz",
    "%": "percent",
}
_KNOWN = {name: name for name in _SPELLINGS} | {
    spelling: name for name, spellings in _SPELLINGS.items() for spelling in spellings.split()
}
QUANTITY = {
    **dict.fromkeys(("s", "ms", "us", "ns", "min", "h", "d"), "time"),
    **dict.fromkeys(("Pa", "kPa", "MPa", "hPa", "mbar", "bar", "psi", "kgf/cm2", "N/mm2", "atm"), "pressure"),
    **dict.fromkeys(("mmHg", "inHg"), "pressure"),
    **dict.fromkeys(("N", "kN", "mN", "daN", "lbf", "kgf", "gf", "ozf"), "force"),
    **dict.fromkeys(("mm", "cm", "m", "um", "in", "ft"), "length"),
    **dict.fromkeys(("g", "kg"), "mass"),
    **dict.fromkeys(("V", "mV", "A", "mA", "count"), "reading"),
}
"""What a unit measures; `reading`: a sensor's own output, which needs a calibration."""


def spelled(text: str) -> str:
    """The unit that a text means, as pmabench spells it, or an empty text; case counts first, then not."""
    text = text.strip().strip("[](){}").strip()
    return _KNOWN.get(text) or _KNOWN.get(text.lower(), "")


def agree(path: Path, columns: Sequence[ColumnRule], units: Mapping[str, str]) -> None:
    """Raises InvalidFile where the file gives a column another unit than the map does."""
    problems = []
    for column in columns:
        said, mapped = spelled(units.get(column.column, "")), spelled(column.raw_unit)
        if said and mapped and said != mapped and column.back == (1.0, 0.0):
            text = f'says that the unit of "{column.column}" is {said}, the map says {mapped}'
            problems.append(Problem(str(path), 0, 0, text))
    if problems:
        raise InvalidFile(problems)
