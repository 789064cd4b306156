"""The force cell against the weights that hang on it: its drift, its gain, or one weight that is not as it is marked.

At a plateau nothing moves and the cell reads the weight; before a trial the weight lies on its support and the cell
reads the same in every trial. What both scatter by is seen in them, so the friction of a pulley needs no assumption.
Knows no muscle.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, log, sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.kinds.contraction_relaxation.diagnosis.columns import course
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import Explanation
from pmabench.kinds.contraction_relaxation.segments import Gate
from pmabench.kinds.contraction_relaxation.trials import Campaign, settled, strokes
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


def readings(campaign: Campaign) -> Readings:
    """The mean reading of each trial at rest before it, and at its plateau; none without a cell."""
    if not campaign.cell:
        return Readings(*(np.empty(0) for _ in range(3)))
    loads = np.array([samples.load for samples in campaign.samples])
    shares, rest, held = course(campaign), _means(campaign, "rest"), _means(campaign, "plateau")
    if not np.nanmedian(np.abs([*rest, inf])) < LYING * np.median(loads):
        rest[:] = np.nan  # the load hangs before the trial, too: a second reading of the same
    read = np.concatenate((rest, held))
    ends = np.concatenate([[share[0] for share in shares], [share[len(share) // 2] for share in shares]])
    known = np.isfinite(read)
    return Readings(ends[known], np.concatenate((0 * loads, loads))[known], read[known])


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
    terms = {"drift": readings.course[rows] - 0.5} | ({"gain": weight} if len(loads) > 1 else {})

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

    several = loads.tolist() if len(loads) >= FEWEST_LOADS else []
    best = min(_models(tuple(terms), several), key=lambda model: sized(*model)[0])
    if best[1] is not None and abs(sized(tuple(terms), best[1])[1]["wrong"][0]) < SMALL * best[1]:
        best = min(_models(tuple(terms), ()), key=lambda model: sized(*model)[0])
    chosen, load = best
    sizes = sized(tuple(terms), load)[1]
    lying = bool((weight == 0).any())
    # without a weight nothing says how small a drift is: none is corrected
    small = {"drift": SMALL * float(np.median(weight[weight > 0])) if len(loads) else inf, "gain": SMALL}
    least = {name: max(known.get(name, 0.0) + 3 * sizes[name][1], small[name]) for name in chosen}
    clear = [name for name in chosen if abs(sizes[name][0]) > least[name]]
    return Weighed(
        sizes.get("drift"), sizes.get("gain"), sizes.get("offset"),
        (load, *sizes["wrong"]) if load is not None else None,
        tuple(Explanation(name, "", (sizes[name][0],)) for name in clear if lying),
    )  # fmt: skip


def _models(terms: tuple[str, ...], loads: Sequence[float]) -> Iterator[tuple[tuple[str, ...], float | None]]:
    """Names of the terms of each model, and the weight that is wrong in it."""
    for names in ((), *((term,) for term in terms), *([terms] if len(terms) > 1 else [])):
        yield names, None
        yield from ((names, load) for load in loads)


def _errors(readings: Readings) -> Array:
    """Standard deviation of each reading, by their scatter about a line over time, of each weight about its own mean;
    widened for few, and inf where they are too few; shape (n,).
    """
    weight, found = readings.weight, np.full(len(readings.weight), inf)
    typical = float(np.median(weight[weight > 0])) if (weight > 0).any() else 0.0
    for rows in (weight == 0, weight > 0):
        if rows.sum() < FEWEST:
            continue
        marks = np.unique(np.round(weight[rows], 3))
        if len(marks) > rows.sum() // 2:
            columns = np.column_stack((np.ones(int(rows.sum())), readings.course[rows], weight[rows]))
        else:
            each = [np.abs(weight[rows] - mark) < SAME for mark in marks]
            columns = np.column_stack((readings.course[rows], *each)).astype(np.float64)
        values = readings.read[rows]
        left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
        free = max(1, int(rows.sum()) - int(np.linalg.matrix_rank(columns)))
        scatter = max(sqrt(float(left @ left) / free), LEAST * typical, 1e-6)
        found[rows] = scatter * float(student.ppf(BEYOND, free)) / 3.0
    return found


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
