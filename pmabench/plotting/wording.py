"""Words, units, numbers and tables of text in reports: names of operating points, number of digits.

A value is rounded to the second significant digit of its interval. Unknown names are shown unchanged: a new kind of
test needs no entry here. Holds no results; titles of coefficients are in `pmabench.report.words`. A `Frame`
is used instead of pandas, whose import takes longer than most reductions.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache
from itertools import compress
from math import floor, isfinite, log10
from typing import Any

from pmabench.base.quantities import QUANTITIES
from pmabench.base.text import clean as clean
from pmabench.store.analyses.results import POINT_QUANTITIES

_LABELS = {
    "pressure": "P",
    **{f"pressure_{n}": f"P_{n}" for n in (1, 2, 3)},
    "from": "P before",
    "contraction": "x",
    "setpoint": "set-point",
    "mean": "mean x",
    "frequency": "f",
    "speed": "v",
    "start": "start x",
    "step": "step of x",
    "load": "F_L",
    "bias": "bias P",
    "mass": "moving mass",
    "tip_mass": "load",
    "displacement": "x",
    "lower": "lower x",
    "upper": "upper x",
    "lowest_angle": "lowest angle",
    "highest_angle": "highest angle",
}
POINTS = {name: (_LABELS.get(name, name), quantity) for name, quantity in POINT_QUANTITIES.items()}
"""Coordinate of an operating point -> label and quantity, in the order of columns."""

SPOKEN: dict[str, str] = {
    "setpoint": "set-point",
    "mean": "mean contraction",
    "from": "pressure before",
    "tip_mass": "load",
    "psi": "ψ",
    **{f"pressure_{n}": f"pressure of muscle {n}" for n in (1, 2, 3)},
}
"""Coordinates whose word differs from their name."""

COLUMNS: dict[str, str] = {
    "t": "time",
    "setpoint": "set-point",
    "displacement": "contraction",
    "model": "model",
    "pressure": "pressure",
    "pressure_command": "commanded pressure",
    "force": "force",
    "fit": "fitted line",
    "log_ratio": "ln(growth) per half period",
    "gain": "gain",
    "stiffness": "stiffness",
    "loss": "loss, −Im(F/x) A",
    "speed": "speed amplitude ω A",
    "width": "loop width",
    "load": "load",
    "lift": "pressure at lift-off",
    "set_down": "pressure at set-down",
    "slope": "S, force by pressure",
    "half": "half width of 95 %",
    "curve": "fitted S(ε)",
    "low": "lower end of the band",
    "high": "upper end of the band",
    "branch": "0 filling, 1 emptying",
    **{f"pressure_{n}": f"pressure of muscle {n}" for n in (1, 2, 3)},
    "length": "length",
    "angle": "angle",
    "below": "reached from below",
    "above": "reached from above",
}
"""Column of a trace -> words for axes and headers."""

_FACTORS = {"Pa": ("kPa", 1e3), "m": ("mm", 1e-3)}


@dataclass(frozen=True)
class Shown:
    """A display unit, and its size in SI."""

    unit: str
    scale: float

    def label(self, text: str) -> str:
        """`text [unit]`; `text` alone without a unit."""
        return f"{text} [{self.unit}]" if self.unit else text

    def plain_label(self, text: str) -> str:
        """As `label`, with the unit in ASCII, for files."""
        return f"{text} [{plain_unit(self.unit)}]" if self.unit else text

    def of(self, value: float | None) -> float | None:
        """An SI value in this unit; None stays None."""
        return None if value is None else value / self.scale

    def rounded(self, value: float | None, half: float | None = None, digits: int = 4) -> str:
        """`rounded` of an SI value and half width in this unit."""
        return rounded(self.of(value), self.of(half), digits)


@lru_cache
def shown(quantity: str, unit: str = "") -> Shown:
    """Display unit of a quantity of `QUANTITIES`; for others the SI unit with kPa and mm."""
    if quantity in QUANTITIES:
        known = QUANTITIES[quantity]
        return Shown(_typeset(known.shown_in), known.scale)
    if unit in ("", "1"):
        return Shown("", 1.0)
    scale = 1.0
    above: list[str] = []
    below: list[str] = []
    inside = divided = False
    for part in re.findall(r"[A-Za-z%]+\d*|[/()]", unit):
        if part == "/":
            divided = True
        elif part == "(":
            inside = True
        elif part == ")":
            inside = divided = False
        else:
            name, power = re.fullmatch(r"([A-Za-z%]+)(\d*)", part).groups()  # type: ignore[union-attr]
            other, factor = _FACTORS.get(name, (name, 1.0))
            exponent = int(power or 1)
            scale *= factor ** (-exponent if divided else exponent)
            (below if divided else above).append(f"{other}{power}")
            divided = divided and inside
    denominator = f"/({'.'.join(below)})" if len(below) > 1 else "".join(f"/{part}" for part in below)
    return Shown(_typeset((".".join(above) or "1") + denominator), float(f"{scale:.12g}"))


def _typeset(unit: str) -> str:
    """The unit with a middle dot for products and raised exponents."""
    return re.sub(r"(?<=[A-Za-z])[23]", lambda m: "²³"[int(m[0]) - 2], unit.replace(".", "·"))


def plain_unit(unit: str) -> str:
    """The unit in ASCII, for files: `N.s/mm`, `m/s2`."""
    return unit.replace("·", ".").replace("²", "2").replace("³", "3")


def point_shown(name: str) -> tuple[str, Shown]:
    """Label and unit of a coordinate of an operating point."""
    label, quantity = POINTS.get(name, (name, ""))
    return clean(label), shown(quantity)


def point_head(name: str) -> str:
    """Header of a column with a coordinate of operating points: `P [kPa]`."""
    label, unit = point_shown(name)
    return unit.label(label)


def spoken(name: str) -> str:
    """A coordinate as a word: `pressure`, `set-point`."""
    return SPOKEN.get(name) or clean(name, 40)


def point_text(at: Mapping[str, float]) -> str:
    """An operating point in words: `P = 300 kPa, f = 0.5 Hz`; the moving mass is left out if the load is given."""
    parts = []
    for name in in_order(at, POINTS):
        if name == "mass" and "load" in at:
            continue
        label, unit = point_shown(name)
        parts.append(f"{label} = {number(at[name] / unit.scale)} {unit.unit}".rstrip())
    return ", ".join(parts)


def brief(text: str, most: int) -> str:
    """Text of at most `most` characters: whole clauses if possible, else whole words and "…"."""
    text = clean(text)
    if len(text) <= most:
        return text
    end = max(text.rfind(mark, most // 3, most) for mark in ("; ", ". "))
    return text[:end] if end > 0 else f"{text[: most - 2].rpartition(' ')[0].rstrip(',;:')} …"


def listed(words: Sequence[str]) -> str:
    """A list in words: `a, b and c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""


def number(value: float) -> str:
    """A setting with at most six digits."""
    return f"{value:.6g}".replace("-", "−")


def in_order(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """`names` once each: those of `known` in its order, then the others in their own."""
    given = list(dict.fromkeys(names))
    return [name for name in known if name in given] + [name for name in given if name not in set(known)]


def symbol_text(symbol: str, coordinate: str = "") -> str:
    """A symbol with the name of its variant: `t_d command-to-motion`."""
    return clean(f"{symbol} {coordinate}".strip())


MOST_DIGITS = 7
"""Most significant digits of a value, even if its interval asks for more."""
PLAIN = (1e-3, 1e6)
"""Sizes outside this range are written with a power of ten."""
RESOLVED = 1e-9
"""Smaller values, in display units, are rounding errors of the computer."""
UNRESOLVED = "below resolution"
AT_MOST = "≤ "
WITHHELD = "withheld"
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def rounded(value: float | None, half: float | None = None, digits: int = 4) -> str:
    """`value`, and `± half` if there is an interval: `7.552 ± 0.021`, `(9.73 ± 0.12)×10⁻⁶`, `900 ± 1200`.

    Without an interval `digits` significant digits; "not identifiable" without a value.
    """
    if value is None or not isfinite(value):
        return "not identifiable"
    if half is not None and not (isfinite(half) and half >= 0):
        half = None
    size = max(abs(value), half or 0.0)
    power = 0
    if size != 0 and not PLAIN[0] <= size < PLAIN[1]:
        power = floor(log10(size))
    scaled, width = value / 10.0**power, None if half is None else half / 10.0**power
    text = _pair(scaled, width, digits).replace("-", "−")
    if power == 0:
        return text
    raised = f"×10{str(power).translate(RAISED)}"
    return f"({text}){raised}" if half is not None else text + raised


def printed(text: str) -> str:
    """A sentence in typography: `±` for `+-`, a true minus before a number, a middle dot in products of units."""
    text = re.sub(r"(?<![\w.,)\]])-(?=\d)", "−", text.replace("+-", "±").replace("+/-", "±"))
    return re.sub(r"(?<=[A-Za-z])\.(?=(?:s|m|K)\b(?:[/) ,;]|$))", "·", text)


def cut(value: float, half: float) -> str:
    """A non-negative value whose interval is cut off at 0: `0.022 (0 to 0.071)`."""
    decimals = min(_decimals(half, 2), _decimals(value, MOST_DIGITS))
    return f"{_fixed(value, decimals)} (0 to {_fixed(value + half, decimals)})"


def half_width(half: float | None, least: float = 0.0) -> str:
    """Half width of an interval alone, with two significant digits; empty if it was not assessed.

    If it is above 0 but below `least`, an upper bound such as `< 10⁻⁹`.
    """
    if half is None or not (isfinite(half) and half >= 0):
        return ""
    if half == 0:
        return "0"
    if half < least:
        return f"< 10{str(round(log10(least))).translate(RAISED)}"
    half = float(f"{half:.1e}")
    if not PLAIN[0] <= half < PLAIN[1]:
        power = floor(log10(half))
        return f"{half / 10.0**power:.1f}×10{str(power).translate(RAISED)}"
    return _fixed(half, _decimals(half, 2))


def _pair(value: float, half: float | None, digits: int) -> str:
    if not half:
        return _fixed(value, _decimals(value, digits)) + ("" if half is None else " ± 0")
    finest, decimals = _decimals(value, MOST_DIGITS), _decimals(half, 2)
    if decimals > finest:
        return f"{_fixed(value, finest)} ± {_fixed(10.0**-finest, finest)}"
    return f"{_fixed(value, decimals)} ± {_fixed(half, decimals)}"


def _decimals(number: float, digits: int) -> int:
    """Decimals (negative: left of the point) that show `number` with `digits` significant digits."""
    return digits - 1 if number == 0 else digits - 1 - Decimal(f"{abs(number):.{digits - 1}e}").adjusted()


def _fixed(number: float, decimals: int) -> str:
    text = f"{round(number, decimals):.{max(0, decimals)}f}"
    return text[1:] if text.startswith("-") and float(text) == 0 else text


class Frame:
    """Named columns and rows of cells; a missing cell is an empty text."""

    def __init__(self, rows: Iterable[Mapping[str, Any]] = (), columns: Sequence[str] | None = None) -> None:
        """Rows as column -> cell; columns in order of appearance, or as given."""
        given = list(rows)
        self.columns = list(dict.fromkeys(name for row in given for name in row) if columns is None else columns)
        self.rows = [{name: "" if row.get(name) is None else row[name] for name in self.columns} for row in given]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, column: str) -> list[Any]:
        """The cells of a column."""
        return [row[column] for row in self.rows]

    def select(self, columns: Sequence[str]) -> Frame:
        """Only these columns, in the order given."""
        return Frame(self.rows, columns)

    def without(self, column: str) -> Frame:
        """All columns but one."""
        return self.select([name for name in self.columns if name != column])

    def where(self, keep: Iterable[bool]) -> Frame:
        """Only the rows for which `keep` is true."""
        return Frame(compress(self.rows, keep), self.columns)

    def filled(self) -> Frame:
        """Only the columns with a non-empty cell."""
        return self.select([name for name in self.columns if any(cell != "" for cell in self[name])])

    def renamed(self, column: str, name: str) -> Frame:
        """With another name for a column."""
        rows = [{name if key == column else key: cell for key, cell in row.items()} for row in self.rows]
        return Frame(rows, [name if key == column else key for key in self.columns])

    def cells(self) -> list[list[str]]:
        """All cells as text, row by row."""
        return [[str(cell) for cell in row.values()] for row in self.rows]
