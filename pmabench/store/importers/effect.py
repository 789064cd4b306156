"""What samples change in the result: the slope over pressure with and without them; pure functions of arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers.found import Bools, Checked, Report
from pmabench.store.records import UNUSABLE, Array

FEWEST = 20
"""Samples that a slope needs."""
SMALL = 0.001
"""Smaller changes [1] are not spelled out."""
BAR = 1e5


def slope(pressure: Array, other: Array) -> float | None:
    """Least-squares slope of `other` over `pressure`, both of shape (n,) [SI]; None where pressure does not move."""
    if len(pressure) < FEWEST:
        return None
    apart = pressure - pressure.mean()
    square = float(apart @ apart)
    return float(apart @ (other - other.mean())) / square if square > 0 and np.isfinite(square) else None


def follower_of(values: Mapping[str, Array], kept: Bools) -> str:
    """The channel that goes with pressure, force or displacement; empty where there is none."""
    names = [name for name in ("force", "displacement") if name in values and "pressure" in values]
    return max(names, key=lambda name: abs(correlation(values["pressure"][kept], values[name][kept])), default="")


def correlation(a: Array, b: Array) -> float:
    """Correlation of two channels, shape (n,) each, where both have a value; 0 where one does not move."""
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 3 or np.ptp(a[good]) == 0 or np.ptp(b[good]) == 0:
        return 0.0
    return float(np.corrcoef(a[good], b[good])[0, 1])


def in_words(value: float, follower: str) -> str:
    """A slope in units that people read."""
    if follower == "force":
        return show(value, "force per pressure", 4)
    return f"{show(value * BAR, 'length', 4)}/bar"


def add_effects(report: Report, channels: Sequence[Checked]) -> None:
    """Complete each finding that flags samples by the slope over pressure with and without these samples."""
    values = {channel.rule.role: channel.si for channel in channels}
    usable = (report.flags & np.uint16(UNUSABLE)) == 0
    follower = follower_of(values, usable)
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
        with np.errstate(over="ignore", invalid="ignore"):
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
