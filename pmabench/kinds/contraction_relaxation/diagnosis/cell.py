"""The force cell against the weights that hang on it: its drift, its gain, or one weight that is not as it is marked.

At a plateau nothing moves and the cell reads the weight; before a trial the weight lies on its support and the cell
reads the same in every trial. What both scatter by is seen in them, so the friction of a pulley needs no assumption.
Knows no muscle.
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
"""A load hangs where the moving mass weighs at least this share of it."""
LYING = 0.1
"""Before a trial the load lies on a support where the cell reads less than this share of it."""
FEWEST = 6
"""Fewest readings for a straight line over them."""
LEAST = 5e-5
"""Least scatter of a reading, as a share of the typical weight: smaller differences change nothing."""
BEYOND = 0.99865
"""Probability of a normal value below three standard deviations."""
TERM = 9.0
"""So much a further term lowers the sum of squares, in units of the scatter, to be taken: three standard deviations."""
SMALL = 5e-4
"""A gain, a drift as a share of the typical weight, or an error of one weight as a share of it, that is not worth a
correction or a name: lines of the budget hold it.
"""
SAME = 1e-3
"""Weights this near are one [N]."""
PART_OF_GAIN, OR_OF_GUIDE = 1.1, 1.5
"""Share of a gain by the weights that may be wrong: the marks may be, or what hangs may swing; and of one that a guide
may make as well: then all of it is wrong, and what else is unsure comes on top.
"""
PIECES, EACH = 8, 4
"""Most straight pieces of a drift that is no straight line itself, and fewest readings for each."""
FEWEST_LOADS = 3
"""Fewest weights of which one can be found to be wrong."""
NOTHING: Mapping[str, float] = {}


@dataclass(frozen=True, eq=False)
class Readings:
    """What the cell read while nothing moved; arrays of shape (n,)."""

    course: Array
    """Share of the campaign that was over, from 0 to 1."""
    weight: Array
    """What hung on it [N]; 0 where that lay on its support."""
    read: Array
    """[N]"""
    guide: float | None = None
    """Friction between cell and weight [N], in the middle, taken off; None where nothing shows whether there is any."""


@dataclass(frozen=True)
class Weighed:
    """What the weights say of the cell; standard deviations from the scatter of the readings, widened for few."""

    drift: tuple[float, float] | None = None
    """Change of the zero over the campaign [N] and its standard deviation."""
    gain: tuple[float, float] | None = None
    """How much too much the cell reads, as a share of the weight, and its standard deviation [1]."""
    offset: tuple[float, float] | None = None
    """The same at no weight, in the middle of the campaign [N]."""
    wrong: tuple[float, float, float] | None = None
    """Weight [N] that is not as it is marked, how much more the cell reads of it, and its standard deviation [N]."""
    found: tuple[Explanation, ...] = ()
    """Drift and gain, where the readings ask for them: to be taken off."""
    errors: tuple[Array, ...] = ()
    """Standard deviation of each size of these."""
    guide: float | None = None
    """As in `Readings`."""
    unsure: float = 0.0
    """Share of the correction that may be wrong [1]: by the course of a drift, or as the cell may not be straight."""


def readings(campaign: Campaign) -> Readings:
    """The mean reading of each trial at rest before it, and at its plateau; none without a cell.

    Of loads that rest once more after they have come down a little, what lies in the middle of both counts: friction of
    a guide makes them heavier after the way up, and as much lighter after the way down.
    """
    if not campaign.cell:
        return Readings(np.empty(0), np.empty(0), np.empty(0))
    loads = np.array([samples.load for samples in campaign.samples])
    shares, rest, held, lower = course(campaign), *(_means(campaign, where) for where in ("rest", "plateau", "lower"))
    friction = _of_guide(held, lower, loads)
    held = held if friction is None else held - friction
    if not np.nanmedian(np.abs([*rest, inf])) < LYING * np.median(loads):
        rest[:] = np.nan  # the load hangs before the trial, too: a second reading of the same
    read = np.concatenate((rest, held))
    ends = np.concatenate([[share[0] for share in shares], [share[len(share) // 2] for share in shares]])
    known = np.isfinite(read)
    typical = None if friction is None else float(np.median(friction))
    return Readings(ends[known], np.concatenate((0 * loads, loads))[known], read[known], typical)


def _of_guide(held: Array, lower: Array, loads: Array) -> Array | None:
    """Friction below the cell [N] at each of the loads (n,), by what it reads less after the way down: a constant and a
    share of the load. 0 where none shows, None where too few loads come down.
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
    """The cell against the weights: of {constants}, drift, gain and one wrong weight, what the readings ask for.

    `known` holds the drift [N] and gain [1] that the record allows: smaller ones are lines of the budget already.
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
        """Names of the terms and the wrong weight of the model that costs least."""
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
    # without a weight nothing says how small a drift is: none is corrected
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
    """See `Weighed`; `bent` has the size of a parabola next to a line and its standard deviation [N]."""
    gains = [one.which for one in explanations if one.kind == "gain"]
    if gains:
        return OR_OF_GUIDE if GUIDE in gains else PART_OF_GAIN
    if not explanations:
        return 0.0
    drift = explanations[0].sizes
    size, own = (0.0, 2 * float(np.mean(errors[0]))) if len(drift) > 1 else bent.get("bow", (0.0, 0.0))
    return 0.5 * (abs(size) + 2 * own) / max(map(abs, drift))


def _pieces(readings: Readings) -> int:
    """Straight pieces that the drift has: 1 where a line does nearly as well for what is read without a load."""
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
    """Columns of a drift in even pieces over the campaign, each its size at the end of a piece; shape (n, count)."""
    ends = np.linspace(0.0, 1.0, count + 1)
    return np.column_stack([np.interp(course, ends, one) for one in np.eye(count + 1)[1:]])


def _errors(readings: Readings) -> Array:
    """Standard deviation of each reading, by their scatter about a drift, of each weight about its own mean; widened
    for few, and inf where they are too few; shape (n,).
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
    """Sum of squares that columns leave of values, and its degrees of freedom, at least 1."""
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(left @ left), max(1, len(values) - int(np.linalg.matrix_rank(columns)))


def _means(campaign: Campaign, where: str) -> Array:
    """Mean reading of the cell in each trial [N], at rest before it, at its plateau, or after the command that follows
    it; nan where there is none.
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
    """Least squares of rows of error 1, and the standard deviation of each unknown; 0 for one in no row."""
    scale = np.sqrt(np.sum(design**2, axis=0))
    used = scale > 0
    columns = design[:, used] / scale[used]
    solved, errors = np.zeros(len(scale)), np.zeros(len(scale))
    inverse = np.linalg.pinv(columns.T @ columns)
    solved[used] = inverse @ (columns.T @ values) / scale[used]
    errors[used] = np.sqrt(np.diag(inverse)) / scale[used]
    return solved, errors
