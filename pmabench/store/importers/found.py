"""Findings in an imported file: a record for each, the report that collects them, and their effect on results.

A finding that flags samples also states the slope over pressure with and without these samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import show
from pmabench.store.importers.map_rules import ColumnRule
from pmabench.store.records import UNUSABLE, Array, Flag, Flags

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
    effect: float | None = None
    """Relative change of the slope over pressure by these samples [1]; None where not determined."""
    withholds: bool = False
    """No rule can correct it: results of the file are withheld until the map resolves it."""


@dataclass(frozen=True)
class Summary:
    """Data of a file for comparison with files at the same operating point: the peak of each channel [SI]."""

    point: tuple[tuple[str, float], ...]
    peaks: Mapping[str, float]
    numbers: Mapping[str, float]
    """The same peaks in the units of the file."""
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


@dataclass
class Report:
    """Collects flags and findings; `t` [s] and `flags` have shape (n,)."""

    t: Array
    flags: Flags
    found: list[Found] = field(default_factory=list)
    rows: dict[int, Rows] = field(default_factory=dict)
    """Index in `found` -> rows flagged by that finding."""

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
        self.rows[len(self.found)] = rows
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

    def with_effect(self, place: int, effect: float, text: str) -> None:
        """Add the effect of its samples to a finding."""
        self.found[place] = replace(self.found[place], effect=effect, text=f"{self.found[place].text}; {text}")


FEWEST = 20
"""Least number of samples for a slope."""
SMALL = 0.001
"""Relative changes below this [1] are only reported as small."""
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


def add_effects(report: Report, channels: Sequence[Checked]) -> None:
    """Complete each finding that flags samples by the slope over pressure with and without these samples."""
    values = {channel.rule.role: channel.si for channel in channels}
    usable = (report.flags & np.uint16(UNUSABLE)) == 0
    names = [name for name in ("force", "displacement") if name in values and "pressure" in values]
    together = {name: abs(correlation(values["pressure"][usable], values[name][usable])) for name in names}
    follower = max(names, key=together.__getitem__, default="")
    if not follower or not report.rows:
        return
    pressure, other = values["pressure"], values[follower]
    finite = np.isfinite(pressure) & np.isfinite(other)
    kept = finite & usable
    without = slope(pressure[kept], other[kept])
    for place, rows in report.rows.items():
        found = report.found[place]
        if found.level == "note" or found.channel not in {"pressure", follower} or without is None:
            continue
        here: Bools = kept.copy()
        here[rows] = finite[rows]
        all_of_it = slope(pressure[here], other[here])
        if all_of_it is None or not np.isfinite(all_of_it) or without == 0:
            continue
        change = all_of_it / without - 1.0
        if abs(change) < SMALL:
            report.with_effect(place, change, f"they are left out, which changes slopes by less than {SMALL:.1%}")
            continue
        text = (
            f"slope of {follower} over pressure {in_words(all_of_it, follower)} with them, "
            f"{in_words(without, follower)} without: they are left out"
        )
        report.with_effect(place, change, text)
