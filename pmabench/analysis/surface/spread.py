"""How well a value of the muscle is known: without each group of trials, and with other choices of the analyst."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.surface.choice import CLEAR, Choice
from pmabench.analysis.surface.fit import Data, fitted, muscle_of, solve
from pmabench.analysis.surface.muscle import Muscle
from pmabench.store.records import Array

FEWEST = 4
"""Groups of trials without which there is no interval."""
SMOOTHER = 10.0
"""The surface may as well be so many times smoother or rougher."""


@dataclass(frozen=True)
class Known:
    """A value with its half widths (95 %)."""

    value: float
    repeats: float | None
    """Jackknife: from the values without each group; None with too few groups."""
    method: float
    """The largest change by other smoothness or terms that predict about as well, or without the rows that come before
    it is known which way friction acts.
    """


@dataclass(frozen=True, eq=False)
class Spread:
    """The muscle, those without each group of trials, and those of other choices."""

    muscle: Muscle
    without: tuple[Muscle, ...]
    others: tuple[Muscle, ...]

    @classmethod
    def of(cls, choice: Choice) -> Spread:
        """All muscles that a choice allows."""
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
        """What a function of the muscle is, and how well it is known."""
        middle = value(self.muscle)
        changed = max((abs(value(other) - middle) for other in self.others), default=0.0)
        number = len(self.without)
        if number < FEWEST:
            return Known(middle, None, changed)
        each = np.array([value(one) for one in self.without])
        error = sqrt((number - 1) / number * float(np.sum((each - each.mean()) ** 2)))
        return Known(middle, float(student.ppf(0.975, number - 1)) * error, changed)
