"""How far a corrected fit can be trusted: loads and trials left out, the correction itself, other explanations.

The spread over loads that are left out does not see what biases all of them alike. So a part of the correction counts,
as large as what it leaves of the misfit, within bounds that campaigns with known faults gave. Decision 0019.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.kinds.contraction_relaxation.diagnosis.columns import FINER
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import TIMES
from pmabench.kinds.contraction_relaxation.diagnosis.search import Search, State
from pmabench.kinds.contraction_relaxation.intervals import NORMAL, Correction
from pmabench.kinds.contraction_relaxation.pooled import Fit
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.store.records import Array

STEP = 1.5e-3
"""By which times of streams are moved to see what they change [s]."""
PART_OF_MUSCLE, PART_OF_BENCH = (0.05, 0.17), (0.002, 0.01)
"""Least and greatest share of a correction by the fit that may be wrong: of what a muscle does no form is exact, of a
delay, a drift or a slip nearly so. Chosen and confirmed on campaigns with known faults."""
CHANCE = 0.1
"""Excess that a right form leaves by chance."""
UNSHOWN = 25.0
"""A size whose variance grows by so much without a group is determined by that group alone."""
FEWEST = 3
"""Fewest loads, or trials, of which one is left out at a time."""


@dataclass(frozen=True, eq=False)
class Spread:
    """A corrected state and the segments as they were recorded: what a fit to both says of its interval."""

    search: Search
    before: State
    """Without a correction by the fit."""
    state: State
    recorded: Segments
    others: tuple[State, ...]
    """With other explanations, between which and the corrected ones the data do not decide."""
    unsure: float
    """Share of the correction by the weights that may be wrong [1]."""
    factor: float
    """By which all widths grow, for what the form still misses."""

    def of(self, fit: Fit, rows: NDArray[np.bool_], noise: float) -> Correction:
        """What a fit to some `rows` of the corrected segments, whose residual should be `noise` [N], owes to it."""
        others = [fit.again(state.test.segments, noise).theta - fit.theta for state in self.others]
        # loads left out show where a form is not exact; without an explanation by the fit nothing is sized anew
        samples, trial = self.state.test.campaign.samples, self.state.test.segments.trial[rows]
        groups = [np.arange(len(samples), dtype=np.float64)] if self.state.explanations else []
        groups += [np.array([round(one.load, 2) for one in samples])] if self._of_muscle else []
        spreads = [self._spread(fit, rows, group, noise) for group in groups if len(np.unique(group[trial])) >= FEWEST]
        others_of = np.array(others).reshape(-1, len(fit.theta))
        return Correction(self._unsure(fit, rows, noise), tuple(spreads), others_of, self.factor)

    def _unsure(self, fit: Fit, rows: NDArray[np.bool_], noise: float) -> Array:
        """The part of each step of the correction that may be wrong, as changes of theta, shape (2, p): by the weights,
        and by the fit.
        """
        weighed = fit.again(self.search.uncorrected, noise).theta
        by_weights = weighed - fit.again(self.recorded, noise).theta
        found = [max(PART_OF_BENCH[0], self.unsure) * by_weights, self._part * (fit.theta - weighed)]
        return np.array(found)

    @property
    def _part(self) -> float:
        """Share of the correction by the fit that may be wrong: as much as it leaves of the misfit.

        The most where a coarser form of a muscle's property failed: nobody knows which one it has.
        """
        if any(one.which == FINER.get(one.kind) for one in self.state.explanations):
            return PART_OF_MUSCLE[1]
        left = max(self.state.excess, CHANCE) / max(self.before.excess, CHANCE)
        return float(np.clip(np.sqrt(left), *(PART_OF_MUSCLE if self._of_muscle else PART_OF_BENCH)))

    @property
    def _of_muscle(self) -> bool:
        return any(one.of_muscle for one in self.state.explanations)

    def sizes(self) -> tuple[Array, ...]:
        """What the sizes of each explanation are off by without each trial, shape (trials, sizes) [SI].

        Not without each load: a slip is seen from one load on, and has no size without it.
        """
        trial, group = self.state.test.segments.trial, np.arange(len(self.state.test.campaign.trials), dtype=np.float64)
        if not self.state.explanations:
            return ()
        if len(np.unique(trial)) < FEWEST:
            return tuple(np.zeros((1, len(one.sizes))) for one in self.state.explanations)
        left, begin, found = self._left_out(self.state.test.fit, np.ones(len(trial), bool), group)[1], 0, []
        for place, one in enumerate(self.state.explanations):
            numbers = range(len(one.sizes)) if one.kind in TIMES else ()
            times = [self._time(place, number, group, np.unique(trial)) for number in numbers]
            mine = np.column_stack(times) if times else left[:, begin : begin + len(one.sizes)]
            begin += 0 if times else len(one.sizes)
            mine = mine[np.isfinite(mine).all(axis=1)]
            found.append(mine - mine.mean(axis=0) if len(mine) else np.zeros((1, len(one.sizes))))
        return tuple(found)

    def _spread(self, fit: Fit, rows: NDArray[np.bool_], group: Array, noise: float) -> Array:
        """Covariance of theta by the jackknife over groups of rows, widened for few, shape (p, p); `group` (trials,)
        has the group of each trial.
        """
        theta, _ = self._left_out(fit, rows, group)
        names = np.unique(group[self.state.test.segments.trial[rows]])
        times = [(place, one) for place, one in enumerate(self.state.explanations) if one.kind in TIMES]
        for place, number, size in ((place, *each) for place, one in times for each in enumerate(one.sizes)):
            later, earlier = (fit.again(self._moved(place, number, by)[0], noise).theta for by in (STEP, -STEP))
            every = self._time(place, number, group, names)
            theta = theta + (every - size)[:, None] * (later - earlier) / (2 * STEP)
        theta = theta[np.isfinite(theta).all(axis=1)]
        count = len(theta)
        if count < FEWEST:
            return np.zeros((len(fit.theta), len(fit.theta)))
        off = theta - theta.mean(axis=0)
        wide = float(student.ppf(0.975, count - 1)) / NORMAL
        return np.asarray(wide**2 * (count - 1) / count * off.T @ off)

    def _left_out(self, fit: Fit, rows: NDArray[np.bool_], group: Array) -> tuple[Array, Array]:
        """Theta and sizes off those of the state, without each group in turn; shapes (groups, p), (groups, sizes).

        nan where only that group determines a size: without the loads after a slip its size is unknown.
        """
        forces, of_row = self._forces[rows], group[self.state.test.segments.trial[rows]]
        scale = np.maximum(np.sqrt(np.mean(forces**2, axis=0)), 1e-300)
        whole, p = np.hstack([fit.design, forces / scale]), fit.design.shape[1]
        normal = whole.T @ whole
        normal[:p, :p] = np.linalg.inv(fit.inverse)
        right = whole.T @ (fit.residual + fit.design @ fit.theta)
        target = fit.residual + fit.design @ fit.theta
        sure = np.diag(_inverse(normal))[p:]
        found = []
        for one in np.unique(of_row):
            mine = of_row == one
            inverse = _inverse(normal - whole[mine].T @ whole[mine])
            shown = bool((np.abs(np.diag(inverse)[p:]) < UNSHOWN * sure).all())
            solved = inverse @ (right - whole[mine].T @ target[mine])
            found.append(solved if shown else np.full(len(solved), np.nan))
        both = np.array(found)
        return both[:, :p], both[:, p:] / scale

    @property
    def _forces(self) -> Array:
        """Columns of all explanations but of times, shape (n, sizes)."""
        test = self.state.test
        found = [
            self.search.columns(one, test.campaign, test.segments, self.state.straight, self.state.explanations)
            for one in self.state.explanations
            if one.kind not in TIMES
        ]
        return np.hstack([np.empty((len(test.segments), 0)), *found])

    def _moved(self, place: int, number: int, by: float) -> tuple[Segments, Array]:
        """Segments with a time moved by so much [s], and the residual of the fit to them."""
        explanations = list(self.state.explanations)
        sizes = np.array(explanations[place].sizes) + by * (np.arange(len(explanations[place].sizes)) == number)
        explanations[place] = replace(explanations[place], sizes=tuple(sizes.tolist()))
        test = self.state.test
        return self.search.left(tuple(explanations), test.fit, test.expected)

    def _time(self, place: int, number: int, group: Array, names: Array) -> Array:
        """A time of an explanation [s] without each of the groups `names`: where the parabola of the squares of the
        residual has its vertex.
        """
        squares = []
        for by in (-STEP, 0.0, STEP):
            segments, residual = self._moved(place, number, by)
            mine = group[segments.trial]
            squares.append(
                [float(np.sum(residual[mine != name] ** 2)) / max(1, int(np.sum(mine != name))) for name in names]
            )
        before, now, after = np.array(squares)
        curved = np.maximum(before + after - 2 * now, 1e-300)
        vertex = np.clip(0.5 * STEP * (before - after) / curved, -4 * STEP, 4 * STEP)
        return np.asarray(self.state.explanations[place].sizes[number] + vertex)


def _inverse(normal: Array) -> Array:
    """Inverse of a normal matrix, scaled to its diagonal first; the least one where that does not exist."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return np.asarray(
        np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-13, hermitian=True) / np.outer(scale, scale)
    )
