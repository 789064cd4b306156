"""The force cell against the weights that hang on it: drift, gain and zero, by plateaus and by rest; fits no muscle.

At a plateau nothing moves and the cell reads the weight; before a trial the weight lies on its support and the cell
reads the same in every trial. What both scatter by is seen in them, so the friction of a pulley needs no assumption.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.kinds.contraction_relaxation.segments import Gate
from pmabench.kinds.contraction_relaxation.trials import Campaign, settled, strokes
from pmabench.store.records import Array

G = 9.80665
HANGING = 0.9
"""A load hangs where the moving mass weighs at least this share of it."""
LYING = 0.1
"""Before a trial the load lies on a support where the cell reads less than this share of it."""
FEWEST = 6
"""Fewest trials for a straight line over them."""
LEAST = 1e-6
"""Least scatter of a reading [N]: a simulation without noise has none."""
NORMAL = 1.96
"""Half width of a 95 % interval by its standard deviation."""


@dataclass(frozen=True)
class Weighed:
    """What the weights say of the cell; standard deviations from the scatter of the readings, widened for few."""

    drift: tuple[float, float] | None
    """Change of the zero over the campaign [N] and its standard deviation."""
    gain: tuple[float, float] | None
    """How much too much the cell reads, as a share of the weight, and its standard deviation [1]."""
    offset: tuple[float, float] | None
    """The same at no weight [N]."""


def weighed(campaign: Campaign, order: Array) -> Weighed:
    """The cell against the weights; `order` (trials,) is the place of each trial in the campaign, from -0.5 to 0.5."""
    nothing = Weighed(None, None, None)
    if not campaign.cell:
        return nothing
    loads = np.array([samples.load for samples in campaign.samples])
    ones, none = np.ones(len(loads)), np.zeros(len(loads))
    rest, held = (_means(campaign, kind) for kind in ("rest", "plateau"))
    if not np.nanmedian(np.abs([*rest, np.inf])) < LYING * np.median(loads):
        rest[:] = np.nan  # the load hangs before the trial, too: a second reading of the same
    several = np.isfinite(held).any() and np.ptp(loads[np.isfinite(held)]) > 0
    kinds = [
        (rest, np.column_stack((order, none, ones, none))),
        (held - loads, np.column_stack((order, ones, none, loads if several else none))),
    ]
    rows = [(values[np.isfinite(values)], design[np.isfinite(values)]) for values, design in kinds]
    rows = [(values / error, design / error) for values, design in rows if (error := _scatter(values, design)) > 0]
    if not rows:
        return nothing
    solved, errors = _solved(*(np.concatenate(part) for part in zip(*rows, strict=True)))
    found = [(float(a), float(s)) if s > 0 else None for a, s in zip(solved, errors, strict=True)]
    return Weighed(found[0], found[3], found[1])


def _means(campaign: Campaign, where: str) -> Array:
    """Mean reading of the cell in each trial [N], at rest before it or at its plateau; nan where there is none."""
    found = np.full(len(campaign.trials), np.nan)
    for i, (samples, trial) in enumerate(zip(campaign.samples, campaign.trials, strict=True)):
        if samples.force is None or samples.mass * G < HANGING * samples.load:
            continue
        times = [c.t for c in trial.commands if c.output == "pressure"]
        if where == "plateau":
            rows = np.zeros(len(samples.t), bool)
            rows[settled(trial)] = True
            rows &= samples.ok & (samples.x > Gate.lift)
        elif times and len(strokes(trial)):
            rows = samples.ok & (samples.t < min(times))
        else:
            continue
        if rows.sum() > 1:
            found[i] = float(np.mean(samples.force[rows]))
    return found


def _scatter(values: Array, design: Array) -> float:
    """Standard deviation of readings about a line, widened for few; 0 where they are too few."""
    columns = design[:, np.any(design != 0, axis=0)]
    if len(values) < FEWEST:
        return 0.0
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    free = len(values) - columns.shape[1]
    return max(sqrt(float(left @ left) / free), LEAST) * float(student.ppf(0.975, free)) / NORMAL


def _solved(values: Array, design: Array) -> tuple[Array, Array]:
    """Least squares of rows of error 1, and the standard deviation of each unknown; 0 for one in no row."""
    scale = np.sqrt(np.sum(design**2, axis=0))
    used = scale > 0
    columns = design[:, used] / scale[used]
    solved, errors = np.zeros(len(scale)), np.zeros(len(scale))
    inverse = np.linalg.pinv(columns.T @ columns)
    solved[used] = inverse @ (columns.T @ values) / scale[used]
    errors[used] = np.sqrt(np.diag(inverse)) / scale[used]
    return solved, errors
