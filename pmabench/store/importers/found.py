"""Findings in an imported file: a record for each, and the report that collects them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import show
from pmabench.store.importers.map_file import Question
from pmabench.store.importers.map_rules import ColumnRule
from pmabench.store.records import Array, Flag, Flags

Bools = NDArray[np.bool_]
Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Found:
    """One finding: a sentence, the number of samples, and the first of them."""

    level: str
    """`note`, `doubt` or `fault`."""
    kind: str
    text: str
    channel: str = ""
    count: int = 0
    index: int | None = None
    """Row of the first sample, from 0."""
    t: float | None = None
    """Time of the first sample [s]."""
    withholds: bool = False
    """No rule can correct it: results of the file are withheld until the map resolves it."""


@dataclass(frozen=True)
class Summary:
    """Data of a file for comparison with files at the same operating point: the peak of each channel [SI]."""

    point: tuple[tuple[str, float], ...]
    peaks: Mapping[str, float]
    trusted: bool
    """False if the file was already found to be wrong."""
    slope: float | None = None
    """Slope of force over pressure [N/Pa] of a muscle held at constant length; None without force."""
    measured: tuple[tuple[str, float], ...] = ()
    """Coordinates of its trials' operating points that were measured instead of given [SI]."""


@dataclass(frozen=True)
class Checked:
    """One channel: raw readings and SI values, both of shape (n,), and its rule."""

    rule: ColumnRule
    raw: Array
    si: Array

    @property
    def numbers(self) -> Array:
        """The numbers as the file has them."""
        return self.raw * self.rule.back[0] + self.rule.back[1]


@dataclass
class Report:
    """Collects flags and findings; `t` [s] and `flags` have shape (n,)."""

    t: Array
    flags: Flags
    found: list[Found] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    """What the numbers cannot decide."""

    def mark(self, where: Bools | Rows, flag: Flag, level: str, kind: str, text: str, channel: str = "") -> None:
        """Flag samples, given by rows or by a mask, and report them; no finding if there are none."""
        rows: Rows = np.arange(len(self.t))[where]
        if len(rows) == 0:
            return
        self.flags[rows] |= np.uint16(flag)
        first = int(rows[0])
        samples = f"{len(rows)} sample" + ("s" if len(rows) > 1 else "")
        named = f"{channel}: {text}" if channel else text
        sentence = f"{named}; {samples}, first at {self.t[first]:.3f} s (row {first + 1})"
        self.found.append(Found(level, kind, sentence, channel, len(rows), first, float(self.t[first])))

    def add(self, level: str, kind: str, text: str, channel: str = "", index: int | None = None) -> None:
        """Report a finding without flags; `index` is the row where it begins."""
        named = f"{channel}: {text}" if channel else text
        if index is None:
            self.found.append(Found(level, kind, named, channel))
        else:
            at = float(self.t[index])
            self.found.append(Found(level, kind, f"{named}; from {at:.3f} s (row {index + 1})", channel, 1, index, at))

    def withhold(self, kind: str, text: str, channel: str = "", index: int | None = None) -> None:
        """Report a fault that no rule can correct."""
        self.add("fault", kind, text, channel, index)
        self.found[-1] = replace(self.found[-1], withholds=True)

    def ask(self, what: str, column: str, question: str, used: str) -> None:
        """Ask a question about a column; `used`: what is taken until it is answered."""
        self.questions.append(Question(what, column, question, used))


FEWEST = 20
"""Least number of samples for a slope."""
BAR = 1e5


def slope(pressure: Array, other: Array) -> float | None:
    """Least-squares slope of `other` over `pressure`, both shape (n,) [SI]; None if constant or too few samples."""
    if len(pressure) < FEWEST:
        return None
    apart = pressure - pressure.mean()
    square = float(apart @ apart)
    return float(apart @ (other - other.mean())) / square if square > 0 and np.isfinite(square) else None


def correlation(a: Array, b: Array) -> float:
    """Correlation of two channels, shape (n,) each, over samples finite in both; 0 where one is constant."""
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 3 or np.ptp(a[good]) == 0 or np.ptp(b[good]) == 0:
        return 0.0
    return float(np.corrcoef(a[good], b[good])[0, 1])


def in_words(value: float, follower: str) -> str:
    """A slope in practical units, for a message."""
    if follower == "force":
        return show(value, "force per pressure", 4)
    return f"{show(value * BAR, 'length', 4)}/bar"
