"""Bounded least squares of all trials of a muscle, choice of its terms by cross-validation, intervals of its values.

The least squares use sums over each trial, so that leaving out trials is fast. Trials whose length was set by hand have
an unknown constant force, a priori of the size `SETTING` times the stiffness; it is eliminated from the sums.

Whole groups of trials are left out: a load, a pressure, a loop. A term is kept if it reduces the error there by more
than `CLEAR` and by more than the standard error of that reduction over the groups. R squared and information criteria
are not used, since the errors of one trial are correlated. The interval of a value is from its values without each
group of trials, and with other choices of the analyst.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from pmabench.analysis.shared import student
from pmabench.analysis.surface.muscle import (
    ALWAYS,
    CREEP_P,
    CREEP_X,
    FREE,
    SLIDING,
    STOPS_P,
    STOPS_X,
    STRAIGHT,
    SURFACE,
    TERMS,
    VISCOUS,
    Frame,
    Memory,
    Muscle,
    Stiffness,
    columns_of,
    memory,
)
from pmabench.analysis.surface.trials import Record, Rows
from pmabench.store.records import Array

FIRST_SMOOTH = 0.1
RIDGE = 1e-9
TURNS = 1e-3
"""Weight of the second differences of the straight form, relative to the curvature of the surface."""
STILL = 0.01
"""Share of the range of pressure and contraction within which a muscle counts as held."""
HOLD = 1.0
"""Time after which the weights of the rows of a hold decrease [s]."""
SETTING = 0.3e-3
"""Scatter of a length set by hand [m]; recorded tests show 0.25 to 0.5 mm."""
BEGIN = 0.1
"""Share of the range of contraction after which the direction of friction is known."""
FRICTION = 0.02
"""Half the width of a typical loop over the largest force."""
NOISE = 0.003
"""A priori misfit over the largest force, for the weight of the constant of a trial."""


@dataclass(frozen=True, eq=False)
class Data:
    """All records of a muscle, with its memory at each row."""

    records: tuple[Record, ...]
    frame: Frame
    past: Memory
    rows: Rows
    weight: Array
    """Weight of each row, shape (n,)."""
    careful: bool
    """Whether rows before the direction of friction is known are left out, see `sure` and `level_of`."""

    @classmethod
    def of(cls, records: Sequence[Record], frame: Frame | None = None, *, careful: bool = False) -> Data:
        """The data of records; without a frame, over their own ranges."""
        rows = Rows.of_records(records)
        P, x = rows.P[rows.used], rows.x[rows.used]
        frame = frame or Frame.over((P.min(), P.max()), (x.min(), x.max()))
        weight = np.concatenate([weights_of(record, frame) for record in records])
        if careful:
            weight = weight * np.concatenate([sure(record, frame) for record in records])
        return cls(tuple(records), frame, memory(records, frame), rows, weight, careful)

    @cached_property
    def largest(self) -> float:
        """Largest force [N]."""
        return float(np.abs(self.rows.F[self.rows.used]).max())


def weights_of(record: Record, frame: Frame) -> Array:
    """Weight of each row, shape (n,): 1, and in a hold decreasing as 1 / time; 0 where it does not count."""
    places = np.column_stack([record.P / max(frame.P.span, 1.0), record.x / max(frame.x.span, 1e-6)]) / STILL
    found = np.ones(len(record.t))
    since, start = places[0], float(record.t[0])
    for row, (place, t) in enumerate(zip(places, record.t, strict=True)):
        if max(abs(place - since)) > 1.0:
            since, start = place, float(t)
        found[row] = HOLD / max(HOLD, t - start)
    return found * record.used


def sure(record: Record, frame: Frame) -> NDArray[np.bool_]:
    """Mask of rows with known direction of friction: those after a motion of `BEGIN` of the range; all without one."""
    so_far = np.maximum.accumulate(record.x) - np.minimum.accumulate(record.x)
    moved = so_far >= BEGIN * frame.x.span
    return moved if moved.any() else np.ones(len(moved), dtype=bool)


def level_of(record: Record, data: Data, stiffness: float) -> float:
    """Standard deviation of the constant force of a record [N]: from its length, or from unknown friction."""
    if record.by_hand:
        return SETTING * stiffness
    still = np.ptp(record.x) < BEGIN * data.frame.x.span
    return FRICTION * data.largest if data.careful and still else 0.0


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums of products over the rows of each record, for p columns and the force as last column.

    The p columns are those of all terms.
    """

    products: Array
    """Sums of products, with the constant of each record eliminated, shape (records, p + 1, p + 1)."""
    n: Array
    """Sum of the weights of each record, shape (records,)."""
    places: dict[str, slice]
    """Term -> its columns."""
    penalty: Array
    """Quadratic penalty of the weights, shape (p, p)."""

    @cached_property
    def _whole(self) -> Array:
        return np.asarray(self.products.sum(axis=0))

    def of(self, used: Array) -> Array:
        """Sum of `products` over the records with `used` 1, shape (p + 1, p + 1); `used` is (records,) of 0 and 1."""
        few = used.sum() < 0.5 * len(used)
        part = self.products[(used > 0) == few].sum(axis=0)
        return np.asarray(part if few else self._whole - part)

    def part(self, terms: Collection[str]) -> NDArray[np.int64]:
        """Indices of the columns of terms."""
        every = np.arange(len(self.penalty))
        return np.concatenate([every[self.places[term]] for term in self.places if term in terms])


def sums(data: Data, stiffness: Stiffness, terms: Sequence[str] = TERMS) -> Sums:
    """Sums for terms, with the stiffness [N/m] through which creep of contraction acts."""
    rows, number = data.rows, len(data.records)
    blocks = [columns_of(term, data.frame, rows, data.past, stiffness) for term in terms]
    ends = np.cumsum([0, *(block.shape[1] for block in blocks)])
    places = {term: slice(first, last) for term, first, last in zip(terms, ends, ends[1:], strict=False)}
    A = np.hstack([*blocks, rows.F[:, None]])
    products = np.empty((number, A.shape[1], A.shape[1]))
    n = np.empty(number)
    cuts = np.searchsorted(rows.of, np.arange(number + 1))
    steep = float(np.median(np.maximum(stiffness(rows.P, rows.x), 0.0)))
    for i, record in enumerate(data.records):
        part = slice(cuts[i], cuts[i + 1])
        weighted = data.weight[part, None] * A[part]
        n[i] = data.weight[part].sum()
        whole, total = weighted.T @ A[part], weighted.sum(axis=0)
        variance = level_of(record, data, steep) ** 2
        share = variance / max(n[i] * variance + (NOISE * data.largest) ** 2, 1e-300)
        products[i] = whole - share * np.outer(total, total)
    return Sums(products, n, places, _penalty(data.frame, np.einsum("rii->i", products), places))


def _penalty(frame: Frame, diagonal: Array, places: Mapping[str, slice]) -> Array:
    """Penalty (p, p) of the curvature of the surface, and of second differences of the straight form."""
    found = np.zeros((len(diagonal) - 1, len(diagonal) - 1))
    if surface := places.get(SURFACE):
        bends = frame.bends()
        found[surface, surface] = bends * diagonal[surface].mean() / max(float(np.trace(bends)) / len(bends), 1e-300)
    if lines := places.get(STRAIGHT):
        turns = np.kron(np.eye(2), np.diff(np.eye((lines.stop - lines.start) // 2), n=2, axis=0))
        found[lines, lines] = TURNS * turns.T @ turns * np.sqrt(np.outer(diagonal[lines], diagonal[lines]))
    return found


def solve(sums: Sums, terms: Collection[str], used: Array, smooth: float) -> Array:
    """Weights (p,) of the columns of terms from the records with `used` 1; 0 for all other columns."""
    part = sums.part(terms)
    whole = sums.of(used)
    H = whole[np.ix_(part, part)] + smooth * sums.penalty[np.ix_(part, part)]
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H / np.outer(size, size) + RIDGE * np.eye(len(part))
    found = np.zeros(len(sums.penalty))
    found[part] = bounded(H, whole[part, -1] / size, np.isin(part, sums.part(FREE))) / size
    return found


def bounded(H: Array, b: Array, free: NDArray[np.bool_]) -> Array:
    """Minimise y.H.y / 2 - b.y where all y but the `free` ones are at least 0; H (n, n) is positive definite."""
    inner = H[np.ix_(free, free)]
    cross = H[np.ix_(free, ~free)]
    through = np.linalg.solve(inner, np.column_stack([b[free], cross]))
    found = np.zeros(len(b))
    if not free.all():
        rest = H[np.ix_(~free, ~free)] - cross.T @ through[:, 1:]
        lower = np.linalg.cholesky(rest + 1e-13 * np.trace(rest) * np.eye(len(rest)))
        found[~free], _ = nnls(lower.T, np.linalg.solve(lower, b[~free] - cross.T @ through[:, 0]))
    found[free] = through[:, 0] - through[:, 1:] @ found[~free]
    return found


def muscle_of(sums: Sums, frame: Frame, terms: Collection[str], weights: Array) -> Muscle:
    """The muscle with the weights from `solve`."""
    return Muscle(frame, split(sums, [term for term in TERMS if term in terms], weights))


def split(sums: Sums, terms: Collection[str], weights: Array) -> dict[str, Array]:
    """Term -> its weights."""
    return {term: weights[sums.places[term]] for term in terms}


def misfit(sums: Sums, weights: Array, of: Array) -> float:
    """Rms residual [N] of the records with `of` 1, with the constant of each record eliminated."""
    both = np.append(weights, -1.0)
    left = float(both @ sums.of(of) @ both)
    return float(np.sqrt(max(left, 0.0) / max(float(of @ sums.n), 1e-300)))


def fitted(data: Data, stiffness: Stiffness, terms: Collection[str], smooth: float) -> Muscle:
    """The muscle fitted to all records with the given terms; creep acts through the given stiffness."""
    known = sums(data, stiffness)
    return muscle_of(known, data.frame, terms, solve(known, terms, np.ones(len(data.records)), smooth))


def first_stiffness(data: Data) -> Stiffness:
    """Stiffness of the surface from a fit without creep of contraction."""
    steep = data.largest / max(data.frame.x.span, 1e-3)
    terms = [term for term in TERMS if term != CREEP_X]
    return fitted(data, lambda P, x: np.full_like(P, steep), terms, FIRST_SMOOTH).stiffness


FEWEST = 4
"""Fewest groups of trials for an interval."""
SMOOTHER = 10.0
"""Factor on the smoothness, both ways, for alternative surfaces."""


@dataclass(frozen=True)
class Known:
    """A value with its half widths (95 %)."""

    value: float
    repeats: float | None
    """Half width by jackknife over groups of trials; None with fewer than `FEWEST`."""
    method: float
    """Largest change by another smoothness, by other terms that predict about as well, or without the rows before the

    direction of friction is known.
    """


@dataclass(frozen=True, eq=False)
class Spread:
    """The muscle, those fitted without each group of trials, and those of other choices."""

    muscle: Muscle
    without: tuple[Muscle, ...]
    others: tuple[Muscle, ...]

    @classmethod
    def of(cls, choice: Choice) -> Spread:
        """Fit all muscles for a choice."""
        known, frame, best = choice.sums, choice.data.frame, choice.score
        every = np.ones(len(choice.data.records))

        def muscle(terms: tuple[str, ...], used: Array, smooth: float) -> Muscle:
            return muscle_of(known, frame, terms, solve(known, terms, used, smooth))

        kept = [(choice.folds != one).astype(float) for one in np.unique(choice.folds)]
        without = [muscle(best.terms, used, best.smooth) for used in kept]
        others = [muscle(best.terms, every, best.smooth * factor) for factor in (SMOOTHER, 1 / SMOOTHER)]
        careful = Data.of(choice.data.records, frame, careful=True)
        others.append(fitted(careful, choice.muscle.stiffness, best.terms, best.smooth))
        alike = {score.terms: score for score in choice.tried if score.rms <= (1 + CLEAR) * best.rms}
        others += [muscle(one.terms, every, one.smooth) for one in alike.values() if one.terms != best.terms]
        return cls(choice.muscle, tuple(without), tuple(others))

    def of_value(self, value: Callable[[Muscle], float]) -> Known:
        """The value of a function of the muscle with its half widths."""
        middle = value(self.muscle)
        changed = max((abs(value(other) - middle) for other in self.others), default=0.0)
        number = len(self.without)
        if number < FEWEST:
            return Known(middle, None, changed)
        each = np.array([value(one) for one in self.without])
        error = sqrt((number - 1) / number * float(np.sum((each - each.mean()) ** 2)))
        return Known(middle, float(student.ppf(0.975, number - 1)) * error, changed)


CLEAR = 0.10
"""Relative reduction of the cross-validation error above which a term is kept."""
ALIKE = 1.3
"""Ratio of errors above which hysteresis and creep count as distinguished."""
PASSES = 3
"""Number of passes of the fit: creep acts through the stiffness of the pass before."""
FOLDS = 24
"""Most folds; with more groups several share a fold."""
SMOOTH = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Weights of the curvature of the surface that are tried; the one with the least cross-validation error is used."""
RIVALS = ((STOPS_X, CREEP_X), (STOPS_P, CREEP_P))
"""Pairs of hysteresis and creep that a single cycle does not distinguish."""
STRAIGHT_FORM = (STRAIGHT, VISCOUS, SLIDING)
"""Terms of the straight form with which the fit is compared."""


@dataclass(frozen=True, eq=False)
class Score:
    """Cross-validation error of a choice of terms."""

    terms: tuple[str, ...]
    rms: float
    """Rms error over all folds, each predicted without it [N]."""
    each: Array
    """Mean square error of each fold [N2]."""
    size: Array
    """Weight of each fold over that of all rows."""
    smooth: float
    """Weight of the curvature of the surface."""

    def better_than(self, other: Score) -> bool:
        """Whether the error is lower by more than `CLEAR` and by more than the standard error over the folds."""
        fall = other.rms - self.rms
        number = len(self.each)
        by_fold = (other.each - self.each) * self.size * number / max(self.rms + other.rms, 1e-300)
        error = float(np.std(by_fold, ddof=1)) / sqrt(number) if number > 1 else np.inf
        return bool(fall > CLEAR * other.rms and fall > error)


@dataclass(frozen=True, eq=False)
class Choice:
    """The muscle with the chosen terms, and the errors of all choices that were tried."""

    data: Data
    sums: Sums
    muscle: Muscle
    score: Score
    tried: tuple[Score, ...]
    undecided: tuple[tuple[str, str], ...]
    """Pairs of hysteresis and creep that predict about equally well, the chosen one first."""
    plain: Score
    """Score of surface and damping alone."""
    straight: Score
    """Score of the straight form with damping and Coulomb friction."""
    lines: Muscle
    """The straight form fitted to all records."""
    folds: Array
    """Fold of each record."""

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms of the muscle."""
        return self.score.terms


def choose(data: Data, passes: int = PASSES) -> Choice:
    """Choose terms by cross-validation, and fit the muscle to all records."""
    folds = folds_of(data)
    every = np.ones(len(data.records))
    known = sums(data, first_stiffness(data))
    best, tried = _selected(known, folds)
    for last in range(passes):
        muscle = muscle_of(known, data.frame, best.terms, solve(known, best.terms, every, best.smooth))
        if last < passes - 1 and CREEP_X in best.terms:
            known = sums(data, muscle.stiffness)
    undecided = _undecided(known, folds, best)
    straight = scored(plain := sums(data, muscle.stiffness, STRAIGHT_FORM), folds, STRAIGHT_FORM)
    lines = Muscle(data.frame, split(plain, STRAIGHT_FORM, solve(plain, STRAIGHT_FORM, every, straight.smooth)))
    alone = scored(known, folds, ALWAYS)
    return Choice(data, known, muscle, best, tuple(tried), undecided, alone, straight, lines, folds)


def folds_of(data: Data) -> Array:
    """Fold of each record, shape (records,); records of one group share a fold."""
    names = list(dict.fromkeys(record.group for record in data.records))
    number = min(len(names), FOLDS)
    return np.array([names.index(record.group) % number for record in data.records])


def scored(known: Sums, folds: Array, terms: Sequence[str]) -> Score:
    """Cross-validation error of a choice of terms, with the best smoothness of the surface."""
    numbers = np.unique(folds)
    rows = np.array([known.n[folds == one].sum() for one in numbers])
    size = rows / rows.sum()
    used = [np.where(folds == one, 0.0, 1.0) for one in numbers]
    ordered = tuple(term for term in known.places if term in terms)
    found = []
    for smooth in SMOOTH:
        each = np.array([misfit(known, solve(known, terms, one, smooth), 1.0 - one) ** 2 for one in used])
        found.append(Score(ordered, float(np.sqrt(size @ each)), each, size, smooth))
    return min(found, key=lambda score: score.rms)


def _selected(known: Sums, folds: Array) -> tuple[Score, list[Score]]:
    """Backward elimination of terms that do not clearly help; the best score, and all scores tried."""
    best = scored(known, folds, TERMS)
    tried = [best]
    while len(best.terms) > len(ALWAYS):
        fewer = [
            scored(known, folds, [t for t in best.terms if t != term]) for term in best.terms if term not in ALWAYS
        ]
        tried += fewer
        least = min(fewer, key=lambda one: one.rms)
        if best.better_than(least):
            break
        best = least
    return best, tried


def _undecided(known: Sums, folds: Array, best: Score) -> tuple[tuple[str, str], ...]:
    """Pairs of `RIVALS`, the chosen one first, where the other predicts about as well in its place."""
    found = []
    for one, two in RIVALS:
        if (one in best.terms) == (two in best.terms):
            continue
        taken, other = (one, two) if one in best.terms else (two, one)
        instead = scored(known, folds, [other if term == taken else term for term in best.terms])
        if instead.rms < ALIKE * best.rms or not best.better_than(instead):
            found.append((taken, other))
    return tuple(found)
