"""Words and units of reports: what methods, kinds and operating points are called; holds no results.

Unknown names are shown as they are: a new kind of test needs no entry here. Coefficients have theirs in `names`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pmabench.analysis.results import POINT_QUANTITIES
from pmabench.base.quantities import QUANTITIES
from pmabench.base.text import clean as clean

_LABELS = {
    "pressure": "P",
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
}
POINTS = {name: (_LABELS.get(name, name), quantity) for name, quantity in POINT_QUANTITIES.items()}
"""Name of a coordinate of an operating point -> label and quantity; the order is that of columns."""

SPOKEN: dict[str, str] = {
    "setpoint": "set-point",
    "mean": "mean contraction",
    "from": "pressure before",
    "tip_mass": "load",
}
"""Coordinates whose word is not their name."""

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
    "length": "length",
    "angle": "bending angle",
    "below": "reached from below",
    "above": "reached from above",
}
"""Column of a trace -> words for axes and headers."""

_FACTORS = {"Pa": ("kPa", 1e3), "m": ("mm", 1e-3)}


@dataclass(frozen=True)
class Shown:
    """The unit that people read, and how much SI one of it is."""

    unit: str
    scale: float

    def label(self, text: str) -> str:
        """`text [unit]`; `text` alone where there is no unit."""
        return f"{text} [{self.unit}]" if self.unit else text


def shown(quantity: str, unit: str = "") -> Shown:
    """The unit to show for a quantity of `QUANTITIES`; for others their SI unit with kPa and mm in it."""
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
    """A middle dot for a product, raised exponents."""
    return re.sub(r"(?<=[A-Za-z])[23]", lambda m: "²³"[int(m[0]) - 2], unit.replace(".", "·"))


def plain_unit(unit: str) -> str:
    """The unit in ASCII, for files: `N.s/mm`, `m/s2`."""
    return unit.replace("·", ".").replace("²", "2").replace("³", "3")


def point_shown(name: str) -> tuple[str, Shown]:
    """Label and unit of a coordinate of an operating point."""
    label, quantity = POINTS.get(name, (name, ""))
    return clean(label), shown(quantity)


def spoken(name: str) -> str:
    """A coordinate as a word: `pressure`, `set-point`."""
    return SPOKEN.get(name) or clean(name, 40)


def point_text(at: Mapping[str, float]) -> str:
    """An operating point in words: `P = 300 kPa, f = 0.5 Hz`; the moving mass is left out where the load is given."""
    parts = []
    for name in in_order(at, POINTS):
        if name == "mass" and "load" in at:
            continue
        label, unit = point_shown(name)
        parts.append(f"{label} = {number(at[name] / unit.scale)} {unit.unit}".rstrip())
    return ", ".join(parts)


def number(value: float) -> str:
    """A setting as people write it, six digits at most."""
    return f"{value:.6g}".replace("-", "−")


def in_order(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """`names` once each: those of `known` in its order, then the others as they come."""
    given = list(dict.fromkeys(names))
    return [name for name in known if name in given] + [name for name in given if name not in set(known)]


def symbol_text(symbol: str, coordinate: str = "") -> str:
    """A symbol with the name of its variant: `t_d command-to-motion`."""
    return clean(f"{symbol} {coordinate}".strip())
