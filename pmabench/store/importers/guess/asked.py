"""Questions about facts that no file states and that change results, with possible answers and their effect.

Pure functions of a guess; writes nothing. Where a provisional answer is possible, it is proposed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from pmabench.base.quantities import show
from pmabench.files.quantity import unit_factor
from pmabench.store.importers.found import slope
from pmabench.store.importers.guess.columns import Guess, Proposal, value_of, words
from pmabench.store.importers.guess.signs import lone
from pmabench.store.importers.magnitude import ATMOSPHERE
from pmabench.store.importers.map_file import OPEN, QUANTITY
from pmabench.store.importers.map_rules import NUMBER, number_in
from pmabench.store.records import Array

WEIGHT = {"g": 0.00980665, "kg": 9.80665}
"""Weight of one unit [N]."""
OF_ROLE = {
    "pressure_command": "pressure",
    "displacement_command": "length",
    "supply": "pressure",
    "displacement": "length",
}
HIGHEST = {"pressure": (2e4, 1.6e6), "force": (1.0, 3e4), "length": (3e-4, 3.0)}
"""Plausible range of a test's highest value [SI], for muscles of 5 to 80 mm: less moves nothing, more bursts it."""
UNITS = {
    "pressure": ("kPa", "bar", "psi", "MPa", "Pa"),
    "force": ("N", "kgf", "lbf"),
    "length": ("mm", "cm", "m", "in"),
}
"""Units to choose from, the likelier ones first."""
SHARES = (0.0, 0.02, 0.05, 0.1)
"""Thresholds of force to try, as shares of the range from lowest to highest."""
CHANGES = 0.02
"""Relative change of the slope by the thresholds above which the user is asked for the threshold."""
SAME_MOMENT = 1e-3
"""Two time columns that differ by less than this [s] in each row give the same times."""
LENGTH = re.compile(rf"{NUMBER}(?=[ _]?mm)")
"""A length in the name of a file [mm]."""
CONTRACTIONS = words("contraction disp displacement stroke shortening hub verkurzung kontraktion")
"""Words in the name of a column that is a contraction."""


@dataclass(frozen=True)
class Asked:
    """A value of the map with an open question."""

    value: str
    """Provisional value until it is answered; empty for none."""
    text: str
    """The question, in one line."""

    @property
    def scalar(self) -> str:
        """The value as YAML."""
        return json.dumps(f"{OPEN} {self.value}".strip(), ensure_ascii=False)


def quantity_of(column: Proposal) -> str:
    """Quantity of a column: `pressure`, `force` or `length`."""
    return OF_ROLE.get(column.role, column.role.removesuffix("_command"))


def factor_of(column: Proposal) -> Asked | None:
    """Question for a heading with a factor such as `x10`: labs write it for a scaling to do, or already done."""
    quantity, unit = quantity_of(column), column.unit
    weight = WEIGHT.get(unit, 0.0) if quantity == "force" else 0.0
    if not column.factor or not (weight or QUANTITY.get(unit) == quantity):
        return None
    factor, upper = value_of(column.factor) or 1.0, "N" if weight else unit
    each = [f"{value * (weight or 1.0):.6g} {upper}/{unit}" for value in (factor, 1.0 / factor, 1.0)]
    text = f'"{column.name}" has "{column.factor}" with its unit: is a number to be multiplied by it ({each[0]})'
    return Asked("", f"{text}, was it multiplied already ({each[1]}), or is it in {unit} ({each[2]})?")


def unit_of(column: Proposal) -> Asked | None:
    """Question for the unit of a column if the file gives none; else None."""
    quantity = quantity_of(column)
    top = float(np.quantile(np.abs(column.good), 0.995)) if len(column.good) else 0.0
    if column.unit or quantity not in HIGHEST or top == 0:
        return None
    low, high = HIGHEST[quantity]
    each = {unit: top * unit_factor(unit, quantity) for unit in UNITS[quantity]}
    fits = {unit: show(float(f"{most:.3g}"), quantity, 9) for unit, most in each.items() if low <= most <= high}
    if not fits or (column.whole and quantity != "pressure"):
        return None  # the calibration of counts is asked for instead
    head = f'in which unit is "{column.name}"? The file does not say it.'
    more = "; or counts of a converter (count, with the line to the quantity)" if column.whole else ""
    candidates = "; ".join(f"{unit}: at most {most}" for unit, most in fits.items())
    return Asked("" if column.whole or column.factor else next(iter(fits)), f"{head} Read in {candidates}{more}")


def _both(one: Array, other: Array) -> tuple[Array, Array]:
    """The samples that are finite in both arrays."""
    good = np.isfinite(one) & np.isfinite(other)
    return one[good], other[good]


def _ends(P: Array, F: Array) -> tuple[float, float]:
    """Medians of the force at the lowest and the highest tenth of pressure, robust against single wrong samples."""
    if not len(P):
        return 0.0, 0.0
    low, high = (float(value) for value in np.quantile(P, [0.1, 0.9]))
    return float(np.median(F[low >= P])), float(np.median(F[high <= P]))


def gauge_of(column: Proposal) -> Asked | None:
    """Question whether a pressure is absolute, where its numbers suggest it or contradict its name; else None."""
    named = absolute(column)
    if column.role != "pressure" or re.search("gauge", column.name, re.I) or not len(column.good):
        return None
    factor = unit_factor(column.unit, "pressure")
    low, top = (float(value) * factor for value in np.quantile(column.good, [0.001, 0.995]))
    vented = ATMOSPHERE[0] <= low <= ATMOSPHERE[1]
    if vented == named or (not named and top <= 1.2 * low):
        return None
    head = f'"{column.name}" never falls below {show(low, "pressure", 4)}'
    head += ", which is no pressure of air: is it absolute, as its name says" if named else ": is it absolute"
    text = f"Then this offset is right; a gauge pressure has 0 {column.unit} here. It moves each pressure by 101 kPa"
    return Asked(air(column.unit), f"{head}? {text}")


def absolute(column: Proposal) -> bool:
    """Whether the name of a pressure marks it as absolute: `P abs`, `Pabs`, `p_abs`."""
    return bool(re.search(r"(?:\b|_|p|druck|pressure)abs", column.name, re.IGNORECASE))


def air(unit: str) -> str:
    """Offset from absolute to gauge pressure, with unit: minus the standard atmosphere."""
    return f"{-101325.0 / unit_factor(unit, 'pressure'):.6g} {unit}"


def contraction_of(guess: Guess) -> Asked | str:
    """Question for the contraction of a held test; a text if the file gives the value, empty if it is not needed."""
    if guess.lacks or guess.tests or not guess.open_point("contraction"):
        return ""
    column = guess.role("displacement")
    head = "at which contraction was the muscle held? No name gives it"
    in_name = LENGTH.findall(guess.files[0].stem)
    if len(set(in_name)) == 1 and column is None:
        number = f"{number_in(in_name[0]):g}"
        text = f"at which contraction was the muscle held? The name has {number} mm, which may be another length, too"
        return Asked(f"{number} mm", f"{text}: is that it?")
    if column is None or QUANTITY.get(column.unit) != "length":
        return Asked("", f"{head}; each slope is that of one contraction. For instance 8 mm")
    if column.apart:
        return ""  # each file has its own
    middle = f"{float(np.median(column.good)):.4g} {column.unit}"
    if is_contraction(column):
        return middle
    if words(column.name) & {"length", "len", "lange"}:
        return Asked("", f'{head}; "{column.name}" is {middle} throughout: the length at no load less that is it')
    return Asked(middle, f'{head}; "{column.name}" is {middle} throughout: is that it?')


def is_contraction(column: Proposal) -> bool:
    """Whether the name of a displacement marks it as a contraction."""
    return bool(words(column.name) & CONTRACTIONS)


def threshold_of(guess: Guess) -> tuple[Asked, list[str]] | None:
    """Question for the force above which samples enter the slope, and other thresholds to show.

    None where the threshold has no effect, or it cannot be tested.
    """
    pressure, force = guess.role("pressure"), guess.role("force")
    if not guess.test.held or pressure is None or force is None:
        return None
    P, F = _both(pressure.values, force.values)
    if len(P) < 50:
        return None
    low, top = _ends(P, F)
    if top < low:  # the cell reads pulling as negative
        F, low, top = -F, -low, -top
    near = np.abs(F - (low + top) / 2) < abs(top - low)  # forces out of range are left to the checks of the import
    near &= ~lone(P) & ~lone(F)
    P, F = P[near], F[near]
    levels = [low + share * (top - low) for share in SHARES]
    slopes = [m for level in levels if (m := slope(P[level < F], F[level < F])) and np.isfinite(m)]
    if len(slopes) < len(SHARES):
        return None
    spread = (max(slopes) - min(slopes)) / abs(slopes[-1])
    if spread <= CHANGES:
        return None
    weight = 1.0 if force.factor else WEIGHT.get(force.unit, 1.0)  # the map converts to newtons
    known = "N" if weight != 1.0 else force.unit if QUANTITY.get(force.unit) == "force" and not force.factor else ""
    at = [f"{level * weight:.2g} {known}".strip() for level in levels]
    sentence = "; ".join(f"{place}: {100 * (m / slopes[-1] - 1):+.1f} %" for place, m in zip(at, slopes, strict=True))
    head = "from which force on do samples count? Below it the muscle hangs slack, and the slope moves by"
    text = f"{head} {100 * spread:.2g} % (against the slope above {at[-1]}: above {sentence})"
    if not known:
        return Asked("", f"{text}; in N"), []
    return Asked(at[2], text), [at[1], at[3]]


def two_clocks(columns: list[Proposal]) -> Iterator[Asked]:
    """Question which of two time columns is right, if their duration or their times in each row disagree."""
    times = [column for column in columns if column.role == "time"][:1]
    seconds = [c for c in columns if any(reason.startswith("a second time") for reason in c.reasons)]
    for time, other in product(times, seconds):
        one, two = _both(_in_seconds(time), _in_seconds(other))
        if not len(one):
            continue
        lasts = [float(clock[-1] - clock[0]) for clock in (one, two)]
        step = max(float(np.max(np.abs(np.diff(clock)), initial=0.0)) for clock in (one, two))
        later = float(np.median(two - one))
        if abs(lasts[1] - lasts[0]) > 0.001 * abs(lasts[0]) + step:
            text = f'"{time.name}" lasts {lasts[0]:.4g} s, "{other.name}" {lasts[1]:.4g} s'
            yield Asked("time", f"which clock is right? {text}; the other one then is to be: ignore")
        elif SAME_MOMENT + max(_coarseness(one), _coarseness(two)) < abs(later) < max(lasts):
            by, way = f"{abs(1e3 * later):.4g} ms", "later" if later > 0 else "earlier"
            text = f'"{other.name}" is {by} {way} than "{time.name}" in each row: were some channels read at each? '
            text += f"Then the later one is the time, the other: ignore, and its channels have late_by: [{by}, {by}]"
            yield Asked("time", f"{text}. If one only began at another moment, write time")
        # clocks that never overlap merely have different zeros


def _in_seconds(column: Proposal) -> Array:
    return column.values * (column.period or unit_factor(column.unit or "s", "time"))


def _coarseness(clock: Array) -> float:
    """Smallest step [s] of a clock, shape (n,), that repeats readings, and so may be late by that; else 0."""
    steps = np.diff(clock)
    return float(np.min(steps[steps > 0])) if (steps == 0).any() and (steps > 0).any() else 0.0
