"""Numbers as people read them: rounded to the second significant digit of their interval; knows no units, no markup."""

from __future__ import annotations

import re
from decimal import Decimal
from math import floor, isfinite, log10

MOST_DIGITS = 7
"""Significant digits of a value whose interval would ask for more."""
PLAIN = (1e-3, 1e6)
"""Sizes outside these are written with a power of ten."""
RESOLVED = 1e-9
"""Less than this of the unit that people read is rounding of the computer and no measurement."""
UNRESOLVED = "below resolution"
WITHHELD = "withheld"
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def rounded(value: float | None, half: float | None = None, digits: int = 4) -> str:
    """`value`, and `± half` where there is an interval: `7.552 ± 0.021`, `(9.73 ± 0.12)×10⁻⁶`, `900 ± 1200`.

    Without an interval `digits` significant digits; "not identifiable" where there is no value.
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
    text = _pair(scaled, width, digits)
    if power == 0:
        return text
    raised = f"×10{str(power).translate(RAISED)}"
    return f"({text}){raised}" if half is not None else text + raised


def printed(text: str) -> str:
    """A sentence with the signs of print: `±` for `+-`, a minus before a number, products of units by a middle dot."""
    text = re.sub(r"(?<![\w.,)\]])-(?=\d)", "−", text.replace("+-", "±").replace("+/-", "±"))
    return re.sub(r"(?<=[A-Za-z])\.(?=(?:s|m|K)\b(?:[/) ,;]|$))", "·", text)


def cut(value: float, half: float) -> str:
    """A value whose interval value ± half ends at 0, below which it cannot be: `0.022 (0 to 0.071)`."""
    decimals = min(_decimals(half, 2), _decimals(value, MOST_DIGITS))
    return f"{_fixed(value, decimals)} (0 to {_fixed(value + half, decimals)})"


def half_width(half: float | None, least: float = 0.0) -> str:
    """An interval's half width alone, with two significant digits; empty where it was not assessed.

    Above 0 and below `least` it says so.
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
    if half is None:
        return _fixed(value, _decimals(value, digits)).replace("-", "−")
    finest = _decimals(value, MOST_DIGITS)
    if half == 0:
        return f"{_fixed(value, _decimals(value, digits))} ± 0".replace("-", "−")
    decimals = _decimals(half, 2)
    if decimals > finest:
        return f"{_fixed(value, finest)} ± {_fixed(10.0**-finest, finest)}".replace("-", "−")
    return f"{_fixed(value, decimals)} ± {_fixed(half, decimals)}".replace("-", "−")


def _decimals(number: float, digits: int) -> int:
    """Decimals (negative: left of the point) that show `number` with so many significant digits."""
    if number == 0:
        return digits - 1
    return digits - 1 - Decimal(f"{abs(number):.{digits - 1}e}").adjusted()


def _fixed(number: float, decimals: int) -> str:
    text = f"{round(number, decimals):.{max(0, decimals)}f}"
    return text[1:] if text.startswith("-") and float(text) == 0 else text
