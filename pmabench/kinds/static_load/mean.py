"""The line through the means of lift and set-down, without what their mean keeps: K x at set-down, and hysteresis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from pmabench.kinds.static_load.line import Line, fit_side
from pmabench.kinds.static_load.loops import Kept, kept, loop_of, stands_still
from pmabench.kinds.static_load.points import (
    MEAN,
    Carried,
    Points,
    Stiffness,
    along_ways,
    by_stiffness,
    times_of,
)
from pmabench.store.records import Array, RunData

UNEQUAL = 0.35
"""Share of the half difference by which the mean may be off: a load lifts against stiction and sets down against
sliding friction, which is taken as at least 60 % of it, and a slow muscle is damped by up to twice as much one way."""
ADDS = 2.0
"""Nothing is carried to x = 0 where that adds to the half width more than this times what it takes off."""
YIELDS = (
    "lift and set-down lie too near to each other for dry friction, so that the braid yields little by little, and how"
    " far its hysteresis is in the mean is not known: raise the load by 10 mm and more before it sets down"
    " (trial.search.stroke in the protocol)"
)
"""Why F_ce is withheld where friction is not seen to be dry and no load was raised."""
UNTOLD = 0.5
"""As UNEQUAL, where there is hysteresis: that over pressure turns late, so that the sides are less alike."""


UNTESTED = 1.25
"""As UNEQUAL, where no load was raised: hysteresis that turns with the pressure moves the mean by about the half
difference of a muscle that also has dry friction."""


@dataclass(frozen=True, eq=False)
class Mean:
    """The line through the means of both directions, and what was taken off it."""

    points: Points
    line: Line
    before: Line
    """The line through the means as they were found."""
    carried: bool
    """Whether lift and set-down were carried to x = 0."""
    kept: Kept | None = None
    """Hysteresis that was taken off, per trial of the record."""
    raised: bool = True
    """Whether the loads were raised, which shows hysteresis where there is some."""
    why: str = ""
    """Why F_ce is withheld; empty where it is not."""

    @property
    def friction(self) -> float | None:
        """Half difference of lift and set-down over all trials [N]."""
        apart = 0.5 * (self.points.lift - self.points.set_down)
        apart = apart[np.isfinite(apart)]
        return float(np.mean(apart)) * self.line.s if len(apart) else None

    def off(self, row: Array) -> float:
        """Half width [N] of what the mean may be off, for `row` @ (a, s)."""
        if not row[0]:
            return 0.0
        share = UNTESTED if not self.raised else UNEQUAL if self.kept is None else UNTOLD
        friction = share * abs(self.friction or 0.0)
        place = 0.5 * self.points.uncertain * self.line.s if self.carried else 0.0
        loop = 0.0 if self.kept is None else float(np.nanmax(self.kept.half))
        return hypot(friction, place, loop)


def mean_of(runs: Sequence[RunData], plain: Points, slope: float, stiffness: Stiffness | None) -> Mean | None:
    """The line through the means of both directions, without K x and without hysteresis where the record shows them."""
    before = fit_side(plain, MEAN)
    moved = _carried(runs, plain, slope, stiffness)
    points = plain if moved is None else moved
    if before is None or (line := fit_side(points, MEAN)) is None:
        return None
    trials = {trial.name: trial for run in runs for trial in run.trials}
    own = [trials[name] for name in plain.names]
    times = [times_of(trial) for trial in own]
    gap = plain.lift - plain.set_down
    loops = [loop_of(trial, when) for trial, when in zip(own, times, strict=True)]
    held = kept(loops, plain.load, gap, before.s)
    if held is not None:
        points = points.only(held.on, held.force / before.s)
        without = fit_side(points, MEAN)
        if without is None:
            return None
        return Mean(points, without, before, moved is not None, held)
    seen = [still for trial, when, one in zip(own, times, gap, strict=True)
            if (still := stands_still(trial, when, one)) is not None]  # fmt: skip
    raised = sum(loop is not None for loop in loops) > 0.5 * len(loops)
    why = YIELDS if seen and not raised and np.mean(seen) < 0.5 else ""
    return Mean(points, line, before, moved is not None, None, raised, why)


def _carried(runs: Sequence[RunData], points: Points, slope: float, stiffness: Stiffness | None) -> Points | None:
    """The points with lift and set-down carried to x = 0; None where no way carries all of them to some gain.

    K of another test counts only where the load's own ways are too short or too uneven: it may be of another place.
    """
    trials = {trial.name: trial for run in runs for trial in run.trials}
    rows = zip(points.names, points.lift, points.set_down, strict=True)
    found = [(trials[name], {"lift": lift, "set-down": down}) for name, lift, down in rows]
    ways: list[list[Carried | None]] = [[along_ways(*one) for one in found]]
    if stiffness is not None:
        ways.append([by_stiffness(*one, slope, stiffness) for one in found])
    return next((moved for way in ways if (moved := _moved(points, way)) is not None), None)


def _moved(points: Points, way: Sequence[Carried | None]) -> Points | None:
    """The points as carried; None where some set-down could not be, or where too little is gained."""
    if None in way:
        return None
    lift, down, half, place = np.array([(one.lift, one.set_down, one.half, one.place) for one in way if one]).T
    if not np.isfinite(place[np.isfinite(points.set_down)]).all():
        return None
    taken = 0.5 * float(np.nanmean(points.lift + points.set_down - lift - down))
    if 0.5 * float(half.mean()) > ADDS * abs(taken):
        return None
    return replace(points, lift=lift, set_down=down, uncertain=float(half.mean()), place=float(np.nanmean(place)))
