"""Choice of the terms of a muscle by cross-validation, and intervals of its values.

Whole groups of trials are left out: a load, a pressure, a loop. A term is kept if it reduces the error there by more
than `CLEAR` and by more than the standard error of that reduction over the groups. R squared and information criteria
are not used, since the errors of one trial are correlated. The interval of a value is from its values without each
group of trials, and with other choices of the analyst.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.surface import muscle as muscle_terms
from pmabench.analysis.surface.fit import Data, Sums, first_stiffness, fitted, misfit, muscle_of, solve, split, sums
from pmabench.analysis.surface.muscle import ALWAYS, CREEP_X, TERMS, Muscle
from pmabench.store.records import Array

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
RIVALS = ((muscle_terms.STOPS_X, CREEP_X), (muscle_terms.STOPS_P, muscle_terms.CREEP_P))
"""Pairs of hysteresis and creep that a single cycle does not distinguish."""
STRAIGHT_FORM = (muscle_terms.STRAIGHT, muscle_terms.VISCOUS, muscle_terms.SLIDING)
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
