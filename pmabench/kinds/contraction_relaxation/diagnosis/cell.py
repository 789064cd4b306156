"""Comparison of the force cell with the weights that hang on it: drift, gain, or one wrongly marked weight.

At a plateau nothing moves and the cell reads the weight; before a trial the weight lies on its support and the cell
should read the same in every trial. The scatter of both is estimated from the readings, so no assumption about pulley
friction is needed. Uses no model of the muscle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, log, sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.kinds.contraction_relaxation.diagnosis.columns import course
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import GUIDE, Explanation
from pmabench.kinds.contraction_relaxation.segments import Campaign, Gate, resting, settled
from pmabench.store.records import Array

G = 9.80665
HANGING = 0.9
"""A load counts as hanging where the moving mass weighs at least this share of it."""
LYING = 0.1
"""Before a trial the load counts as supported where the cell reads less than this share of it."""
FEWEST = 6
"""Fewest readings for a straight line over them."""
LEAST = 5e-5
"""Smallest scatter of a reading, as a share of the typical weight."""
BEYOND = 0.99865
"""Probability of a normal value below three standard deviations."""
TERM = 9.0
"""Fall of the sum of squares, in units of the scatter, that justifies one more term: three standard deviations."""
SMALL = 5e-4
"""Smallest gain, drift (as a share of the typical weight) or error of one weight (as a share of it) that is corrected
or named; smaller ones are in lines of the budget.
"""
SAME = 1e-3
"""Weights closer than this count as equal [N]."""
PART_OF_GAIN, OR_OF_GUIDE = 1.1, 1.5
"""Share of the gain correction that may be wrong: because of the marks of the weights or a swinging load (above 1,
since the whole gain is uncertain and other errors come on top); and where friction of a guide may cause it as well.
"""
PIECES, EACH = 8, 4
"""Most straight pieces of a nonlinear drift, and fewest readings for each."""
FEWEST_LOADS = 3
"""Fewest different weights among which a wrong one can be found."""
NOTHING: Mapping[str, float] = {}


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of the cell while nothing moved; arrays of shape (n,)."""

    course: Array
    """Share of the campaign elapsed at the reading, 0 to 1."""
    weight: Array
    """Weight on the cell [N]; 0 while it lay on its support."""
    read: Array
    """[N]"""
    guide: float | None = None
    """Typical friction between cell and weight [N], subtracted from `read`; None where the data do not show it."""


@dataclass(frozen=True)
class Weighed:
    """Result of the comparison; standard deviations from the scatter of the readings, widened for few readings."""

    drift: tuple[float, float] | None = None
    """Change of the zero over the campaign [N] and its standard deviation."""
    gain: tuple[float, float] | None = None
    """Relative excess of the cell's reading and its standard deviation [1]."""
    offset: tuple[float, float] | None = None
    """Excess of the reading at zero weight, in the middle of the campaign, and its standard deviation [N]."""
    wrong: tuple[float, float, float] | None = None
    """Wrongly marked weight [N], excess of the cell's reading with it, and its standard deviation [N]."""
    found: tuple[Explanation, ...] = ()
    """Significant drift and gain, to be corrected."""
    errors: tuple[Array, ...] = ()
    """Standard deviations of the sizes, one array for each of `found`."""
    guide: float | None = None
    """See `Readings`."""
    unsure: float = 0.0
    """Share of the correction that may be wrong [1]: nonlinear drift, or a nonlinear cell."""


def readings(campaign: Campaign) -> Readings:
    """Mean reading of each trial at rest before it and at its plateau; none without a cell.

    Where loads also come to rest after a partial descent, the plateau is the middle of both readings: friction of a
    guide increases the reading after the ascent and decreases it equally after the descent.
    """
    if not campaign.cell:
        return Readings(np.empty(0), np.empty(0), np.empty(0))
    loads = np.array([samples.load for samples in campaign.samples])
    rest, held, lower = (_means(campaign, where) for where in ("rest", "plateau", "lower"))
    friction = _of_guide(held, lower, loads)
    held = held if friction is None else held - friction
    if not np.nanmedian(np.abs([*rest, inf])) < LYING * np.median(loads):
        rest[:] = np.nan  # the load hangs before the trial, too: a second reading of the same
    read = np.concatenate((rest, held))
    shares = map(course(campaign), range(len(loads)))
    ends = np.array([(share[0], share[len(share) // 2]) for share in shares]).T.ravel()
    known = np.isfinite(read)
    typical = None if friction is None else float(np.median(friction))
    return Readings(ends[known], np.concatenate((0 * loads, loads))[known], read[known], typical)


def _of_guide(held: Array, lower: Array, loads: Array) -> Array | None:
    """Friction below the cell [N] at each of the loads (n,), as a constant plus a share of the load, from the lower
    reading after a descent. 0 where not significant, None where too few loads descend.
    """
    both = np.isfinite(held - lower)
    if both.sum() < FEWEST:
        return None
    half, line = 0.5 * (held - lower)[both], np.column_stack((np.ones(len(loads)), loads / loads.mean()))
    left, free = _left(half, line[both])
    least = max(SMALL * float(np.median(loads)), float(student.ppf(BEYOND, free)) * sqrt(left / free / len(half)))
    if half.mean() <= least:
        return np.zeros(len(loads))
    return np.asarray(line @ np.linalg.lstsq(line[both], half, rcond=None)[0])


def weighed(readings: Readings, known: Mapping[str, float] = NOTHING) -> Weighed:
    """Comparison of the cell with the weights: a drift, a gain and one wrong weight, as far as the readings justify
    them.

    `known` holds bounds of the drift [N] and gain [1] from the record: smaller ones already are lines of the budget.
    """
    error = _errors(readings)
    rows = np.isfinite(error)
    if not rows.any():
        return Weighed()
    weight, off = readings.weight[rows], (readings.read - readings.weight)[rows]
    loads = np.unique(np.round(weight[weight > 0], 3))
    base = {"offset": np.where(weight > 0, 1.0, 0.0), "rest": np.where(weight > 0, 0.0, 1.0)}
    course, count = readings.course[rows], _pieces(readings)
    pieces = (_rising(course, count) - _rising(np.array([0.5]), count)).T
    drift = tuple(f"drift {number}" for number in range(len(pieces)))
    terms = dict(zip(drift, pieces, strict=True)) | {"gain": weight, "bow": 4 * (course - 0.5) ** 2}
    gain = ("gain",) if len(loads) > 1 else ()

    def sized(names: tuple[str, ...], load: float | None) -> tuple[float, dict[str, tuple[float, float]]]:
        """Cost of a model, and the size of each of its terms with its standard deviation."""
        columns = base | {name: terms[name] for name in names}
        if load is not None:
            columns["wrong"] = np.where(np.abs(weight - load) < SAME, 1.0, 0.0)
        design = np.column_stack(list(columns.values())) / error[rows, None]
        solved, errors = _solved(off / error[rows], design)
        left = off / error[rows] - design @ solved
        cost = float(left @ left) + TERM * len(names) + (TERM + 2 * log(len(loads)) if load is not None else 0.0)
        both = zip(columns, solved.tolist(), errors.tolist(), strict=True)
        return cost, {name: (size, own) for name, size, own in both if own > 0}

    def best(several: Sequence[float]) -> tuple[tuple[str, ...], float | None]:
        """Names of the terms and the wrong weight (None for none) of the model with the lowest cost."""
        models = [
            ((*by_time, *more), load) for by_time in ((), drift) for more in ((), gain) for load in (None, *several)
        ]
        return min(models, key=lambda model: sized(*model)[0])

    every = (*drift, *gain)
    chosen, load = best(loads.tolist() if len(loads) >= FEWEST_LOADS else [])
    if load is not None and abs(sized(every, load)[1]["wrong"][0]) < SMALL * load:
        chosen, load = best(())
    sizes = sized(every, load)[1]
    lying = bool((weight == 0).any())
    # without a weight there is no scale for a small drift: none is corrected
    small = {"drift": SMALL * float(np.median(weight[weight > 0])) if len(loads) else inf, "gain": SMALL}
    explanations, errors = list[Explanation](), list[Array]()
    for kind, names in (("drift", drift), ("gain", gain)):
        size, own = np.array([sizes.get(name, (0.0, 0.0)) for name in names]).reshape(-1, 2).T
        least = np.maximum(known.get(kind, 0.0) + 3 * own, small[kind])
        if lying and set(names) & set(chosen) and (np.abs(size) > least).any():
            rubs = kind == "gain" and readings.guide is None and size[0] > 0
            explanations.append(Explanation(kind, GUIDE if rubs else "", tuple(size.tolist())))
            errors.append(own)
    return Weighed(
        sizes.get(drift[-1]), sizes.get("gain"), sizes.get("offset"),
        (load, *sizes["wrong"]) if load is not None else None,
        tuple(explanations), tuple(errors), readings.guide,
        _unsure(explanations, errors, sized((*every, "bow"), load)[1]),
    )  # fmt: skip


def _unsure(
    explanations: Sequence[Explanation], errors: Sequence[Array], bent: Mapping[str, tuple[float, float]]
) -> float:
    """See `Weighed.unsure`; `bent`: size and standard deviation [N] of `bow`, a parabola added to the drift."""
    gains = [one.which for one in explanations if one.kind == "gain"]
    if gains:
        return OR_OF_GUIDE if GUIDE in gains else PART_OF_GAIN
    if not explanations:
        return 0.0
    drift = explanations[0].sizes
    size, own = (0.0, 2 * float(np.mean(errors[0]))) if len(drift) > 1 else bent.get("bow", (0.0, 0.0))
    return 0.5 * (abs(size) + 2 * own) / max(map(abs, drift))


def _pieces(readings: Readings) -> int:
    """Number of straight pieces of the drift: 1 where a line fits the unloaded readings nearly as well as `PIECES`."""
    rows = readings.weight == 0
    course, read, count = readings.course[rows], readings.read[rows], min(PIECES, int(rows.sum()) // EACH)
    if count < 2:
        return 1
    ones = np.ones(len(read))
    (line, free), (less, fewer) = (
        _left(read, np.column_stack((_rising(course, pieces), ones))) for pieces in (1, count)
    )
    return count if line - less > TERM * (free - fewer) * less / fewer else 1


def _rising(course: Array, count: int) -> Array:
    """Columns of a drift in equal pieces over the campaign, one for its value at the end of each; shape (n, count)."""
    ends = np.linspace(0.0, 1.0, count + 1)
    return np.column_stack([np.interp(course, ends, one) for one in np.eye(count + 1)[1:]])


def _errors(readings: Readings) -> Array:
    """Standard deviation of each reading, shape (n,): scatter about a drift and the mean of each weight, widened for
    few readings; inf where there are too few.
    """
    weight, found = readings.weight, np.full(len(readings.weight), inf)
    typical = float(np.median(weight[weight > 0])) if (weight > 0).any() else 0.0
    count = _pieces(readings)
    for rows in (weight == 0, weight > 0):
        if rows.sum() < FEWEST:
            continue
        marks = np.unique(np.round(weight[rows], 3))
        each = [np.abs(weight[rows] - mark) < SAME for mark in marks]
        own = np.column_stack(each if len(marks) <= rows.sum() // 2 else (np.ones(int(rows.sum())), weight[rows]))
        left, free = _left(readings.read[rows], np.column_stack((_rising(readings.course[rows], count), own)))
        scatter = max(sqrt(left / free), LEAST * typical, 1e-6)
        found[rows] = scatter * float(student.ppf(BEYOND, free)) / 3.0
    return found


def _left(values: Array, columns: Array) -> tuple[float, int]:
    """Residual sum of squares of a least squares of `values` on `columns`, and its degrees of freedom, at least 1."""
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(left @ left), max(1, len(values) - int(np.linalg.matrix_rank(columns)))


def _means(campaign: Campaign, where: str) -> Array:
    """Mean reading of the cell in each trial [N]: `rest` before it, `plateau`, or `lower` after the command that
    follows the plateau; nan where there is none.
    """
    found = np.full(len(campaign.trials), np.nan)
    for i, (samples, trial) in enumerate(zip(campaign.samples, campaign.trials, strict=True)):
        if samples.force is None or samples.mass * G < HANGING * samples.load:
            continue
        rows = resting(samples, trial)
        if where != "rest":
            rows = np.zeros(len(samples.t), bool)
            rows[settled(trial, int(where == "lower"))] = True
            if (samples.x[rows] <= Gate.lift).any():
                continue
            rows &= samples.ok
        if rows.sum() > 1:
            found[i] = float(np.mean(samples.force[rows]))
    return found


def _solved(values: Array, design: Array) -> tuple[Array, Array]:
    """Least squares of rows with unit error: unknowns and their standard deviations; the latter is 0 for an unknown
    without rows.
    """
    scale = np.sqrt(np.sum(design**2, axis=0))
    used = scale > 0
    columns = design[:, used] / scale[used]
    solved, errors = np.zeros(len(scale)), np.zeros(len(scale))
    inverse = np.linalg.pinv(columns.T @ columns)
    solved[used] = inverse @ (columns.T @ values) / scale[used]
    errors[used] = np.sqrt(np.diag(inverse)) / scale[used]
    return solved, errors
