"""A straight line F_ce(P) through the pressures of loads, and its uncertainty.

The line through the means of lift and set-down is corrected for K x at set-down and for hysteresis of the braid, which
do not cancel in the mean. A load always reaches its support from above. A force that lags behind the contraction
(friction elements, Maxwell slip) is then at the same end of its loop at lift and at set-down, with the same sign: it
shifts their mean and does not show in their difference, which shows dry friction. A stroke shows it: such a loop closes
at x = 0 and is open in the middle, while dry friction has the same width everywhere. The shift of the mean is half the
additional width in the middle if the force reverses within a small part of the stroke, and more if it takes longer,
which the shape of the loop shows. Damping also widens the middle; its size is how far the load still moves after the
ramp upward has stopped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.analysis.shared.samples import noise_of
from pmabench.kinds.static_load.points import (
    MEAN,
    Carried,
    Points,
    Stiffness,
    along_ways,
    by_stiffness,
    smoothed,
    times_of,
)
from pmabench.store.records import Array, RunData, TrialData


@dataclass(frozen=True, eq=False)
class Line:
    """F_ce = a + s P [N, N/Pa] with the covariance (2, 2) of (a, s), to be multiplied by t squared."""

    a: float
    s: float
    covariance: Array
    factor: float
    """Student's t for 95 %."""
    r2: float
    rms: float
    """Residual [N]."""
    lack: float
    """Rms distance of the loads' means from the line, relative to what their repeats allow; 0 if unknown."""

    def __call__(self, P: float) -> float:
        """F_ce [N] at P [Pa]."""
        return self.a + self.s * P

    def half(self, row: Array) -> float:
        """95 % half width of row @ (a, s)."""
        return self.factor * sqrt(max(0.0, float(row @ self.covariance @ row)))


COVERAGE = 2.0
"""Half width over standard deviation for errors that are not scatter."""


def fit_side(points: Points, method: str) -> Line | None:
    """The line through the pressures of one method; None below two loads."""
    usable = np.isfinite(points.side(method))
    # without friction lift and set-down have the same step error, so their mean is no better
    return _fit(points.load[usable], points.side(method)[usable], points.step**2 / 12)


def _fit(load: Array, P: Array, steps: float) -> Line | None:
    """P = c + m F_L by least squares, converted to F_ce = (P - c) / m; None for fewer than two loads.

    The covariance is the widest of: from single points, from the loads' means, and from the steps of the gauge with one
    repeat of each load. Repeats of a load share its deviation from the line, and may have the same step error. `steps`
    is the variance of a pressure due to its steps [Pa^2].
    """
    names, group, count = np.unique(np.round(load, 3), return_inverse=True, return_counts=True)
    if len(names) < 2:
        return None
    design = np.column_stack([np.ones_like(load), load])
    inverse = np.linalg.inv(design.T @ design)
    c, m = inverse @ (design.T @ P)
    if m <= 0:
        return None
    residual = P - c - m * load
    chosen, factor = np.zeros((2, 2)), 0.0
    middle = np.array([1.0, float(load.mean())])
    means = np.bincount(group, residual) / count
    once = np.column_stack([np.ones_like(names), names])
    allowed = [
        (power / freedom * inverse, float(student.ppf(0.975, freedom)))
        for power, freedom in ((float(residual @ residual), len(P) - 2), (float(count @ means**2), len(names) - 2))
        if freedom >= 1
    ]
    allowed.append((steps * np.linalg.inv(once.T @ once), COVERAGE))
    # two loads do not show whether the line between them is straight
    for covariance, t in allowed if len(names) > 2 else ():
        if t**2 * (middle @ covariance @ middle) > factor**2 * (middle @ chosen @ middle):
            chosen, factor = covariance, t
    turn = np.array([[-1 / m, c / m**2], [0.0, -1 / m**2]])
    total = float(np.sum((P - P.mean()) ** 2))
    rms, lack = float(np.sqrt(np.mean(residual**2)) / m), _lack(residual, group, means, count)
    r2 = 1.0 - float(residual @ residual) / total
    return Line(float(-c / m), float(1 / m), turn @ chosen @ turn.T, factor, r2, rms, lack)


def _lack(residual: Array, group: NDArray[np.intp], means: Array, count: NDArray[np.intp]) -> float:
    """Scatter of the loads' means about the line relative to that expected from repeats, as a ratio of standard
    deviations.
    """
    within, freedom = residual - means[group], len(residual) - len(means)
    if freedom < 1 or len(means) < 3:
        return 0.0
    pure = float(within @ within) / freedom
    between = float(count @ means**2) / (len(means) - 2)
    return sqrt(between / pure) if pure > 0 else 0.0


LEAST = 2e-3
"""Smallest stroke for a loop [m]."""
LATE = (0.7, 0.95)
"""Part of the stroke whose line is extrapolated to the position where the load rests after the ramp."""
MIDDLE = (0.4, 0.6)
"""Part of the stroke in which the loop is widest."""
SHOWN = 0.15
"""Smallest additional width in the middle, as a share of that at the end, for a loop: friction and damping vary along
the way.
"""
OFF, UNSEEN = 0.15, 3e-3
"""Uncertainty of the correction: the share OFF, plus UNSEEN [m] over the stroke for parts of the braid that yield
later.
"""
ALONG = np.linspace(0.06, 0.94, 45)
"""Shares of a stroke at which its loop is evaluated, without the ends, where the ramp starts and stops."""
SHORTEST_WAY, LONGEST_WAY = 0.3e-3, 8e-3
"""Range of distances over which the force of a braid reverses [m]."""
ALIKE, CHANCE = 1.5, 4.0
"""A shape fits equally well up to ALIKE times the rms misfit of the best, or CHANCE times the noise variance more."""
STILL = 0.5
"""Friction counts as dry if the load does not move over this share of the difference from lift to set-down ..."""
CLEAR = 5.0
"""... and if that difference exceeds this many times the noise of the pressure."""


@dataclass(frozen=True)
class Loop:
    """The middle of one stroke: mean pressures there on the way up and down [Pa], and its height `reach` [m]."""

    up: float
    down: float
    damped: float
    """Lead of the pressure before a moving load because of damping [Pa]."""
    reach: float
    gap: Array
    """Pressure on the way up minus that on the way down, at `ALONG` of the reach [Pa]."""


@dataclass(frozen=True, eq=False)
class Kept:
    """Hysteresis in the mean of lift and set-down, per trial [N], NaN without a stroke, and its half width."""

    force: Array
    half: Array

    @property
    def on(self) -> NDArray[np.bool_]:
        """Rows with a value."""
        return np.isfinite(self.force)


def loop_of(trial: TrialData, times: Mapping[str, float]) -> Loop | None:
    """The loop between lift and set-down; `times` [s] by phase; None where the load was raised by less than `LEAST`."""
    ways = smoothed(trial, times, times["lift"], times["set-down"])
    if ways is None:
        return None
    P, x = ways
    top = int(np.argmax(x))
    reach = float(x[top])
    if reach < LEAST or top < 2 or len(x) - top < 3:
        return None
    grid = np.linspace(*MIDDLE, 41) * reach
    up, down = (float(np.mean(_way(P, x, top, grid, up=one))) for one in (True, False))
    gap = _way(P, x, top, ALONG * reach, up=True) - _way(P, x, top, ALONG * reach, up=False)
    late = (x[:top] > LATE[0] * reach) & (x[:top] < LATE[1] * reach)
    damped = 0.0
    if np.count_nonzero(late) > 2 and np.ptp(x[:top][late]) > 0:
        damped = max(0.0, float(np.polyval(np.polyfit(x[:top][late], P[:top][late], 1), reach)) - float(P.max()))
    return Loop(up, down, damped, reach, gap)


def _way(P: Array, x: Array, top: int, at: Array, *, up: bool) -> Array:
    """Pressure [Pa] at displacements `at` [m] on the way up to, or down from, the highest one."""
    way = slice(0, top + 1) if up else slice(None, top - 1 if top else None, -1)
    return np.interp(at, np.maximum.accumulate(x[way]), P[way])


def kept(loops: Sequence[Loop | None], load: Array, gap: Array, slope: float) -> Kept | None:
    """Hysteresis from the additional width in the loops' middles; None where it is not significant, or with one load.

    `load` [N] and `gap`, lift minus set-down [Pa], have shape (n,); `slope` is dF_ce/dP at x = 0 [N/Pa]; that in the
    middle comes from the loads that passed it.
    """
    rows = np.array([loop is not None for loop in loops]) & np.isfinite(gap)
    if len(np.unique(load[rows])) < 2:
        return None
    found = [loop for loop, use in zip(loops, rows, strict=True) if use and loop is not None]
    up, down, damped, reach = np.array([(loop.up, loop.down, loop.damped, loop.reach) for loop in found]).T
    full = reach > 0.8 * reach.max()
    steep = slope
    middle = 0.5 * (up + down)[full]
    if len(np.unique(load[rows][full])) > 1 and np.ptp(middle) > 0:
        steep = float(np.polyfit(middle, load[rows][full], 1)[0])
    end = slope * gap[rows]
    wider = np.full(len(load), np.nan)
    wider[rows] = steep * (up - down - 2 * damped) - end
    mean, spread, n = float(wider[rows].mean()), float(wider[rows].std(ddof=1)), int(rows.sum())
    if mean - float(student.ppf(0.95, n - 1)) * spread / sqrt(n) < SHOWN * abs(float(end.mean())):
        return None
    stroke = float(reach[full].mean())
    turns = np.geomspace(0.5 * stroke / LONGEST_WAY, 0.5 * stroke / SHORTEST_WAY, 60)
    halves = turns * reach[:, None] / stroke
    ratios = np.tanh(halves) / (1 - 1 / np.cosh(halves))
    best, alike = _turning(turns, np.mean([loop.gap for loop, one in zip(found, full, strict=True) if one], axis=0))
    force, half = np.full(len(load), np.nan), np.full(len(load), np.nan)
    force[rows] = 0.5 * wider[rows] * ratios[:, best]
    apart = np.abs(ratios[:, alike] - ratios[:, [best]]).max(axis=1) / ratios[:, best]
    half[rows] = np.hypot(force[rows] * (OFF + UNSEEN / reach + apart), 0.5 * steep * damped)
    return Kept(force, half)


def _turning(turns: Array, gap: Array) -> tuple[int, NDArray[np.bool_]]:
    """Index of the one of `turns` (a below) that fits the shape of a gap best (at `ALONG`), and which ones fit equally
    well.

    A force that reverses over a distance w after each end of a stroke s opens the loop by h [1 - cosh((1 - 2 u) a) /
    cosh(a)] at the share u of the stroke, a = s / 2 w, and lags by h tanh(a) at the ends. Dry friction and damping open
    it equally everywhere.
    """
    left = []
    for a in turns:
        design = np.column_stack([np.ones_like(ALONG), 1 - np.cosh((1 - 2 * ALONG) * a) / np.cosh(a)])
        left.append(float(np.sum((gap - design @ np.linalg.lstsq(design, gap, rcond=None)[0]) ** 2)))
    best, noise = int(np.argmin(left)), float(np.mean(np.diff(gap, n=2) ** 2)) / 6
    off = max(0.0, left[best] - len(gap) * noise)
    return best, np.array(left) <= left[best] + CHANCE * noise + (ALIKE**2 - 1) * off


def rests(trial: TrialData, times: Mapping[str, float], gap: float) -> bool | None:
    """Whether the load did not move while the pressure fell by most of `gap` [Pa]; None where it was not recorded."""
    ways = smoothed(trial, times, times["lift"], times["set-down"])
    if ways is None or not np.isfinite(gap):
        return None
    P, x = ways
    noise = noise_of(trial.channels["pressure"][trial.usable])
    still = np.abs(x - np.median(x)) < max(0.1 * abs(float(np.median(x))), noise_of(x))
    return bool(gap > CLEAR * noise and still.any() and float(np.ptp(P[still])) > STILL * gap)


UNEQUAL = 0.35
"""Error of the mean as a share of the half difference: a load lifts against static and sets down against sliding
friction, assumed at least 60 % of it, and damping of a slow muscle may differ by a factor of two between directions.
"""
ADDS = 2.0
"""No correction to x = 0 where the half width that it adds exceeds this many times the correction."""
YIELDS = (
    "lift and set-down lie too near to each other for dry friction, so that the braid yields little by little, and how"
    " far its hysteresis is in the mean is not known: raise the load by 10 mm and more before it sets down"
    " (trial.search.stroke in the protocol)"
)
"""Why F_ce is withheld where friction does not look dry and no load was raised."""
UNTOLD = 0.5
"""As UNEQUAL, with hysteresis: that over pressure reverses late, so that the directions differ more."""


UNTESTED = 1.25
"""As UNEQUAL, where no load was raised: hysteresis that reverses with the pressure shifts the mean by about the half
difference, in a muscle that also has dry friction. Also where half of K x at set-down is in the mean.
"""


@dataclass(frozen=True, eq=False)
class Mean:
    """The line through the means of both directions, and its corrections."""

    points: Points
    line: Line
    before: Line
    """The line through the uncorrected means."""
    carried: bool
    """Whether lift and set-down were corrected to x = 0."""
    kept: Kept | None = None
    """Hysteresis that was subtracted, per trial."""
    raised: bool = True
    """Whether the loads were raised, so that hysteresis would show."""
    why: str = ""
    """Why F_ce is withheld; empty where it is not."""
    short: bool = False
    """Whether a load's way is too short to correct for K x at set-down, and no other test gives K."""

    @property
    def friction(self) -> float | None:
        """Half difference of lift and set-down over all trials [N]."""
        apart = 0.5 * (self.points.lift - self.points.set_down)
        apart = apart[np.isfinite(apart)]
        return float(np.mean(apart)) * self.line.s if len(apart) else None

    @property
    def reversed(self) -> float:
        """Largest half difference of a load that sets down at more pressure than it lifts [N]; else 0."""
        load, half = self.points.load, 0.5 * (self.points.set_down - self.points.lift) * self.line.s
        known = np.isfinite(half)
        return max([0.0, *(float(half[known & (load == one)].mean()) for one in np.unique(load[known]))])

    def off(self, row: Array) -> float:
        """Half width [N] of the mean's systematic error, for `row` @ (a, s); for s as if the error were proportional to
        pressure.
        """
        share = UNTESTED if self.short or not self.raised else UNEQUAL if self.kept is None else UNTOLD
        friction = share * abs(self.friction or 0.0)
        place = 0.5 * self.points.uncertain * self.line.s if self.carried else 0.0
        loop = 0.0 if self.kept is None else float(np.nanmax(self.kept.half))
        whole = hypot(friction, place, loop, self.reversed)
        return whole if row[0] else whole / float(np.nanmean(self.points.side(MEAN)))


def mean_of(runs: Sequence[RunData], plain: Points, slope: float, stiffness: Stiffness | None) -> Mean | None:
    """The line through the means of both directions, corrected for K x and hysteresis where the record shows them."""
    trials = {trial.name: trial for run in runs for trial in run.trials}
    own = [trials[name] for name in plain.names]
    before = fit_side(plain, MEAN)
    ways = [
        (trial, {"lift": lift, "set-down": down})
        for trial, lift, down in zip(own, plain.lift, plain.set_down, strict=True)
    ]
    moved = _carried(ways, plain, slope, stiffness)
    short = moved is None and any(along_ways(*way) is None for way in ways)
    points = plain if moved is None else moved
    if before is None or (line := fit_side(points, MEAN)) is None:
        return None
    times = [times_of(trial) for trial in own]
    gap = plain.lift - plain.set_down
    loops = [loop_of(trial, when) for trial, when in zip(own, times, strict=True)]
    held = kept(loops, plain.load, gap, before.s)
    if held is not None:
        points = points.only(held.on, held.force / before.s)
        without = fit_side(points, MEAN)
        if without is None:
            return None
        return Mean(points, without, before, moved is not None, held, short=short)
    seen = [still for trial, when, one in zip(own, times, gap, strict=True)
            if (still := rests(trial, when, one)) is not None]  # fmt: skip
    raised = sum(loop is not None for loop in loops) > 0.5 * len(loops)
    why = YIELDS if seen and not raised and np.mean(seen) < 0.5 else ""
    return Mean(points, line, before, moved is not None, None, raised, why, short)


def _carried(
    found: Sequence[tuple[TrialData, Mapping[str, float]]], points: Points, slope: float, stiffness: Stiffness | None
) -> Points | None:
    """The points of trials, each with its lift and set-down, with both corrected to x = 0; None where no method
    improves all of them.

    K of another test is used only where the load's own motion is too short or too uneven, since it may apply to another
    contraction.
    """
    ways: list[list[Carried | None]] = [[along_ways(*one) for one in found]]
    if stiffness is not None:
        ways.append([by_stiffness(*one, slope, stiffness) for one in found])
    return next((moved for way in ways if (moved := _moved(points, way)) is not None), None)


def _moved(points: Points, way: Sequence[Carried | None]) -> Points | None:
    """The points with the corrections; None where a set-down has none, or where they do not improve the result."""
    if None in way:
        return None
    lift, down, half, place = np.array([(one.lift, one.set_down, one.half, one.place) for one in way if one]).T
    if not np.isfinite(place[np.isfinite(points.set_down)]).all():
        return None
    taken = 0.5 * float(np.nanmean(points.lift + points.set_down - lift - down))
    if 0.5 * float(half.mean()) > ADDS * abs(taken):
        return None
    return replace(points, lift=lift, set_down=down, uncertain=float(half.mean()), place=float(np.nanmean(place)))
