"""Hysteresis of the braid in lifts: how far it is in F_ce, from the loop of a load that is raised and lowered again.

A load always comes to its support from above. A force that lags behind the contraction (stops, Maxwell slip) is then
at the end of its loop at lift and at set-down alike, with one sign: their mean keeps it, and their distance, which
shows dry friction, does not show it. What shows it is a stroke: such a loop closes at x = 0 and is open in the middle,
whereas dry friction is as wide at x = 0 as in the middle. Half of what the middle is wider is what the mean keeps.
Damping widens the middle as well. It is what the load goes on by after the ramp upward has stopped.
Knows records of trials; no lines F_ce(P).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.analysis.shared.samples import noise_of
from pmabench.store.records import Array, TrialData

SMOOTH = 0.1
"""Pressure and displacement are means over this time [s]."""
LEAST = 2e-3
"""A stroke below it shows no loop [m]."""
LATE = (0.7, 0.95)
"""Part of the stroke whose line is carried on to where the load comes to rest after the ramp."""
MIDDLE = (0.4, 0.6)
"""Part of the stroke in which the loop is widest."""
SHOWN = 0.15
"""A loop is one if its middle is wider than its end by this share of the end: friction and damping differ by way."""
OFF, UNSEEN = 0.15, 3e-3
"""What the correction may be off, as a share of it: OFF, and UNSEEN [m] over the stroke for those parts of the braid
that yield later than the stroke turns. With Maxwell elements of 0.2 to 8 mm a stroke of 12 mm shows four fifths."""
STILL = 0.5
"""Friction is dry where a load stands still over this share of the distance from lift to set-down."""
CLEAR = 5.0
"""and where that distance is so many times the noise of the pressure."""


@dataclass(frozen=True)
class Loop:
    """The middle of one stroke: mean pressures there on the way up and down [Pa], and how far it went up [m]."""

    up: float
    down: float
    damped: float
    """How far the pressure ran ahead of a load that moves, by its damping [Pa]."""
    reach: float


@dataclass(frozen=True, eq=False)
class Kept:
    """Hysteresis in the mean of lift and set-down, per trial [N], NaN without a stroke, and its half width."""

    force: Array
    half: Array

    @property
    def on(self) -> NDArray[np.bool_]:
        """Rows that have it."""
        return np.isfinite(self.force)


def loop_of(trial: TrialData, times: Mapping[str, float]) -> Loop | None:
    """The loop between lift and set-down, `times` [s] by phase; None where the load was raised by less than `LEAST`."""
    ways = _ways(trial, times)
    if ways is None:
        return None
    P, x = ways
    top = int(np.argmax(x))
    reach = float(x[top])
    if reach < LEAST or top < 2 or len(x) - top < 3:
        return None
    grid = np.linspace(*MIDDLE, 41) * reach
    up, down = (
        float(np.mean(np.interp(grid, np.maximum.accumulate(x[way]), P[way])))
        for way in (slice(0, top + 1), slice(None, top - 1 if top else None, -1))
    )
    late = (x[:top] > LATE[0] * reach) & (x[:top] < LATE[1] * reach)
    damped = 0.0
    if np.count_nonzero(late) > 2 and np.ptp(x[:top][late]) > 0:
        damped = max(0.0, float(np.polyval(np.polyfit(x[:top][late], P[:top][late], 1), reach)) - float(P.max()))
    return Loop(up, down, damped, reach)


def kept(loops: Sequence[Loop | None], load: Array, gap: Array, slope: float) -> Kept | None:
    """How far the loops' middles are wider than their ends; None where none is, or where there are no two loads.

    `load` [N] and `gap`, the distance of lift from set-down [Pa], have shape (n,); `slope` is dF_ce/dP at x = 0 [N/Pa],
    that of the middle comes from the loads that passed it.
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
    half = np.full(len(load), np.nan)
    half[rows] = 0.5 * np.hypot(wider[rows] * (OFF + UNSEEN / reach), steep * damped)
    return Kept(0.5 * wider, half)


def stands_still(trial: TrialData, times: Mapping[str, float], gap: float) -> bool | None:
    """Whether the load stood still while the pressure fell by most of `gap` [Pa]; None where it was not recorded."""
    ways = _ways(trial, times)
    if ways is None or not np.isfinite(gap):
        return None
    P, x = ways
    noise = noise_of(trial.channels["pressure"][trial.usable])
    still = np.abs(x - np.median(x)) < max(0.1 * abs(float(np.median(x))), noise_of(x))
    return bool(gap > CLEAR * noise and still.any() and float(np.ptp(P[still])) > STILL * gap)


def _ways(trial: TrialData, times: Mapping[str, float]) -> tuple[Array, Array] | None:
    """Pressure and displacement from lift to set-down, smoothed; None where they were not recorded."""
    if not {"pressure", "displacement"} <= set(trial.channels) or not np.isfinite(list(times.values())).all():
        return None
    rows = trial.usable & (trial.t >= times["lift"]) & (trial.t <= times["set-down"])
    if np.count_nonzero(rows) < 3:
        return None
    width = max(1, round(SMOOTH / float(np.median(np.diff(trial.t[rows])))))
    if np.count_nonzero(rows) < 2 * width:
        return None
    window = np.ones(width) / width
    P, x = (np.convolve(trial.channels[name][rows], window, mode="valid") for name in ("pressure", "displacement"))
    return P, x
