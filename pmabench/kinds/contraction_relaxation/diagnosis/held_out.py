"""Leaving out trials and loads: whether the form of a fit holds, and how uncertain a corrected fit is.

Test of the form: how well a fit predicts trials that were left out, and whether neighbouring residuals are correlated,
both compared with what noise allows. Independent of the cause of a misfit: columns of forces are given.

Uncertainty of a corrected fit: from loads and trials left out, the correction itself, and other explanations. The
spread over left-out loads does not show a bias that all share. So a share of the correction is added, as large as the
misfit that it leaves, within bounds found on campaigns with known faults. Decision 0019.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.kinds.contraction_relaxation.diagnosis.columns import FINER, allowed
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import TIMES
from pmabench.kinds.contraction_relaxation.intervals import NORMAL, Correction
from pmabench.kinds.contraction_relaxation.pooled import FLOOR, Fit, levers, noise_covariance, rms_of, without_each
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments
from pmabench.store.records import Array

if TYPE_CHECKING:
    from pmabench.kinds.contraction_relaxation.diagnosis.search import Search, State

MOST_RATIO = 1.2
"""Ratio of the rms prediction error of left-out trials to what noise allows, from which on the form is doubted."""
MOST_ALIKE = 0.3
"""Mean product of neighbouring residuals, as a share of the noise variance, from which on the form is doubted."""
SURE = 4.0
"""Both must also exceed what chance gives by this many standard deviations, which matters where segments are few."""
NEAR = 5e-4
"""Smallest residual, as a share of the typical force, that counts against the form."""
FOLDS = 6
"""Number of folds: every sixth trial is left out at a time."""
ENOUGH = 50
"""Fewest well predicted segments for a comparison of left-out trials with noise."""
HICCUPS = 0.02
"""Share of the rows of polled devices that may be displaced by answers that were much too late (busy computer)."""
FEWEST_REPEATS = 10
"""Fewest repetitions in all from which the scatter between trials is estimated."""
TINY = 1e-9
"""Relative singular value below which a column, after removal of the coefficients, is not sized."""


@dataclass(frozen=True, eq=False)
class Test:
    """The test of a fit: its residual, and that of trials left out of it, against what noise allows."""

    campaign: Campaign
    segments: Segments
    fit: Fit
    expected: float
    """Root mean square noise that the fit was made for [N]."""
    own: Array
    """Variance of each row by noise [N^2], shape (n,)."""
    after: Array
    """Covariance of each row with the next one [N^2], shape (n - 1,)."""
    may: Array
    """Effects of departures with known bounds [N], shape (n, m); see `columns.allowed`."""
    scatter: float
    """Variance between repeats beyond noise [N^2]."""

    @classmethod
    def of(cls, campaign: Campaign, segments: Segments, fit: Fit, expected: float) -> Test:
        """The test of a fit to `segments`; `expected` [N] is the rms noise it was made for."""
        own, after = _noise(campaign, segments, fit)
        least = max((FLOOR * rms_of(segments.force)) ** 2, 1e-24)  # a dead force cell has none at all
        own = np.maximum(own, least)
        may = allowed(campaign, segments, fit)
        return cls(campaign, segments, fit, expected, own, after, may, _scatter(campaign, segments, fit.residual, own))

    @cached_property
    def whole(self) -> Array:
        """Variance of each row that does not count as misfit [N^2], shape (n,)."""
        near = (NEAR * rms_of(self.segments.force)) ** 2
        return np.asarray(self.own + np.sum(self.may**2, axis=1) + self.scatter + near)

    @cached_property
    def _left_out(self) -> tuple[float, float, bool]:
        squares = np.concatenate([((f.miss**2) / f.variance)[f.sure] for f in self._folds])
        if len(squares) >= ENOUGH:
            return sqrt(_mean_without(squares, self._displaced)), len(squares), True
        fit = self.fit
        free = max(1.0, len(self.own) - float(np.sum(levers(fit.design, fit.inverse))))
        return sqrt(float(fit.residual @ fit.residual) / free / float(np.mean(self.whole))), free, False

    @property
    def _displaced(self) -> float:
        """Share of rows that may be displaced by late answers of a device."""
        return HICCUPS if any(vars(self.campaign.late).values()) else 0.0

    @property
    def ratio(self) -> float:
        """Rms prediction error of left-out trials, relative to noise and uncertainty of the fit; where the other trials
        predict too few rows as well as one row is known, rms residual of the fit to all, relative to noise.
        """
        return self._left_out[0]

    @property
    def held_out(self) -> bool:
        """Whether trials were left out for the ratio."""
        return self._left_out[2]

    @property
    def most_ratio(self) -> float:
        """Ratio from which on the form is doubted."""
        return max(MOST_RATIO, sqrt(1 + SURE * sqrt(2 / self._left_out[1])))

    @cached_property
    def _pairs(self) -> NDArray[np.intp]:
        """Indices of segments directly followed by the next one."""
        return np.flatnonzero(self.segments.followed)

    @cached_property
    def alike(self) -> float:
        """Mean product of neighbouring residuals beyond that of noise, relative to the variance."""
        pairs, residual, may = self._pairs, self.fit.residual, self.may
        expected = self.after[pairs] + np.sum(may[pairs] * may[pairs + 1], axis=1) + self.scatter
        product = residual[pairs] * residual[pairs + 1] - expected
        return float(np.sum(product) / np.sum(self.whole[pairs])) if len(pairs) else 0.0

    @property
    def most_alike(self) -> float:
        """Correlation of neighbours from which on the form is doubted."""
        return max(MOST_ALIKE, SURE / sqrt(max(1, len(self._pairs))))

    @property
    def doubted(self) -> bool:
        """Whether the data contradict the form."""
        return self.ratio >= self.most_ratio or self.alike >= self.most_alike

    @property
    def excess(self) -> float:
        """Mean square prediction error in excess of noise, relative to noise: 0 where the form is right."""
        return max(0.0, self.ratio**2 - 1)

    @cached_property
    def _folds(self) -> list[_Fold]:
        """The fits with one sixth of the trials left out."""
        found = []
        segments, fit = self.segments, self.fit
        trials, trial = np.unique(segments.trial, return_inverse=True)
        folds = [trial % FOLDS == fold for fold in range(min(FOLDS, len(trials)))]
        without = without_each(fit.design, segments.force, fit.prior(segments, self.expected), folds)
        for rows, (inverse, theta) in zip(folds, without, strict=True):
            design, force = fit.design[rows], segments.force[rows]
            lever = levers(design, inverse)
            sure = (lever >= 0) & (lever <= 1)
            variance = self.whole[rows] + self.own[rows] * np.maximum(lever, 0.0)
            found.append(_Fold(rows, inverse, theta, force - design @ theta, variance, sure))
        return found

    def with_columns(self, groups: Sequence[Array]) -> list[float]:
        """The ratio with each group of forces (n, k) [N], one group at a time, added to the fit with free sizes."""
        every = np.hstack(groups)
        every = every / np.maximum(np.sqrt(np.mean(every**2, axis=0)), 1e-300)
        ends = np.cumsum([group.shape[1] for group in groups])
        places = [slice(end - group.shape[1], end) for end, group in zip(ends, groups, strict=True)]
        squares: list[list[Array]] = [[] for _ in groups]
        crossed, inner, right = self.fit.design.T @ every, every.T @ every, every.T @ self.segments.force
        for fold in self._folds:
            mine, design = every[fold.rows], self.fit.design[fold.rows]
            cross = crossed - design.T @ mine
            moves = fold.inverse @ cross
            left = inner - mine.T @ mine - cross.T @ moves
            pull = right - mine.T @ self.segments.force[fold.rows] - cross.T @ fold.theta
            unexplained = mine - design @ moves
            for place, found in zip(places, squares, strict=True):
                size = np.linalg.lstsq(left[place, place], pull[place], rcond=TINY)[0]
                miss = fold.miss - unexplained[:, place] @ size
                found.append((miss**2 / fold.variance)[fold.sure])
        return [sqrt(_mean_without(np.concatenate(found), self._displaced)) for found in squares]


@dataclass(frozen=True, eq=False)
class _Fold:
    """Left-out trials: their rows, the fit to the others, and the prediction error."""

    rows: NDArray[np.bool_]
    inverse: Array
    theta: Array
    miss: Array
    variance: Array
    sure: NDArray[np.bool_]
    """Rows that the others predict as well as one row is known."""


def _noise(campaign: Campaign, segments: Segments, fit: Fit) -> tuple[Array, Array]:
    """Variance of each row [N^2], shape (n,), and covariance with the next, shape (n - 1,).

    The times of polled samples scatter by half a poll at most; the actual share is estimated from the residuals, which
    then grow with speed. Each row counts by the freedom that the fit leaves it: the few fast rows are fitted closely
    and alone would suggest no scatter.
    """
    still, after = noise_covariance(segments, fit, campaign.noise_of_means)
    moving, following = noise_covariance(segments, fit, campaign.noise_of_means, campaign.late)
    more = moving - still
    if not more.any():
        return still, after
    free = np.maximum(0.0, 1.0 - levers(fit.design, fit.inverse))
    weights = more / moving**2
    share = float(weights @ (fit.residual**2 - free * still)) / float(weights @ (free * more))
    share = min(max(share, 0.0), 1.0)
    return still + share * more, after + share * (following - after)


def _scatter(campaign: Campaign, segments: Segments, residual: Array, own: Array) -> float:
    """Variance between repeats of a cell beyond noise, as a force that is constant in each trial [N^2]; 0 for few
    repeats.
    """
    trials, rows, count = np.unique(segments.trial, return_inverse=True, return_counts=True)
    mean = np.bincount(rows, residual) / count
    noise = np.bincount(rows, own) / count**2
    _, cell, members = np.unique(campaign.cells[trials], return_inverse=True, return_counts=True)
    freedom = len(trials) - len(members)
    if freedom < FEWEST_REPEATS:
        return 0.0
    off = mean - (np.bincount(cell, mean) / members)[cell]
    expected = float(np.sum(noise * (1 - 1 / members[cell])))
    return max(0.0, (float(off @ off) - expected) / freedom)


def _mean_without(squares: Array, share: float) -> float:
    """Mean of `squares` without the largest `share` of them, scaled to 1 for normal noise of unit variance.

    inf for no squares: a departure that no left-out trial can show explains nothing.
    """
    if not len(squares):
        return inf
    left = int(share * len(squares))
    if not left:
        return float(squares.mean())
    kept = np.sort(squares)[:-left]
    normal = NormalDist()
    end = normal.inv_cdf(1 - share / 2)
    return float(kept.mean()) / (1 - 2 * end * normal.pdf(end) / (1 - share))


STEP = 1.5e-3
"""Time shift of a stream for numerical derivatives [s]."""
PART_OF_MUSCLE, PART_OF_BENCH = (0.05, 0.17), (0.002, 0.01)
"""Least and greatest share of a correction by the fit that may be wrong: no form describes a muscle exactly, while a
delay, drift or slip has a nearly exact form. Chosen and confirmed on campaigns with known faults.
"""
CHANCE = 0.1
"""Excess that a right form leaves by chance."""
UNSHOWN = 25.0
"""Growth of the variance of a size without a group from which on that group alone determines the size."""
FEWEST_LEFT = 3
"""Fewest loads, or trials, of which one is left out at a time."""


@dataclass(frozen=True, eq=False)
class Spread:
    """A corrected state and the recorded segments, for the interval of a corrected fit."""

    search: Search
    before: State
    """State before any correction by the fit."""
    state: State
    recorded: Segments
    others: tuple[State, ...]
    """States with other explanations, which the data do not exclude."""
    unsure: float
    """Share of the correction by the weights that may be wrong [1]."""
    factor: float
    """Factor on all widths for the remaining misfit."""

    def correction(self) -> Correction:
        """Uncertainty of the fit due to the correction."""
        fit, noise = self.state.test.fit, self.state.test.expected
        others = [fit.again(state.test.segments, noise).theta - fit.theta for state in self.others]
        # leaving out loads shows where a form is not exact; without an explanation there are no sizes to find again
        samples, trial = self.state.test.campaign.samples, self.state.test.segments.trial
        groups = [np.arange(len(samples), dtype=np.float64)] if self.state.explanations else []
        groups += [np.array([round(one.load, 2) for one in samples])] if self._of_muscle else []
        spreads = [self._spread(group) for group in groups if len(np.unique(group[trial])) >= FEWEST_LEFT]
        others_of = np.array(others).reshape(-1, len(fit.theta))
        return Correction(self._unsure(), tuple(spreads), others_of, self.factor)

    def _unsure(self) -> Array:
        """Possible error of each step of the correction as a change of theta, shape (2, p): by the weights, and by the
        fit.
        """
        fit, noise = self.state.test.fit, self.state.test.expected
        weighed = fit.again(self.search.uncorrected, noise).theta
        by_weights = weighed - fit.again(self.recorded, noise).theta
        found = [max(PART_OF_BENCH[0], self.unsure) * by_weights, self._part * (fit.theta - weighed)]
        return np.array(found)

    @property
    def _part(self) -> float:
        """Share of the correction by the fit that may be wrong: as much as it leaves of the misfit.

        The greatest share where a coarser form of a muscle's property failed, since its form is unknown.
        """
        if any(one.which == FINER.get(one.kind) for one in self.state.explanations):
            return PART_OF_MUSCLE[1]
        left = max(self.state.excess, CHANCE) / max(self.before.excess, CHANCE)
        return float(np.clip(np.sqrt(left), *(PART_OF_MUSCLE if self._of_muscle else PART_OF_BENCH)))

    @property
    def _of_muscle(self) -> bool:
        return any(one.of_muscle for one in self.state.explanations)

    def sizes(self) -> tuple[Array, ...]:
        """Deviation of the sizes of each explanation without each trial, shape (trials, sizes) [SI].

        Not without each load: a slip shows only from some load on and has no size without it.
        """
        trial, group = self.state.test.segments.trial, np.arange(len(self.state.test.campaign.trials), dtype=np.float64)
        if not self.state.explanations:
            return ()
        if len(np.unique(trial)) < FEWEST_LEFT:
            return tuple(np.zeros((1, len(one.sizes))) for one in self.state.explanations)
        left, begin, found = self._left_out(group)[1], 0, []
        for place, one in enumerate(self.state.explanations):
            numbers = range(len(one.sizes)) if one.kind in TIMES else ()
            times = [self._time(place, number, group, np.unique(trial)) for number in numbers]
            mine = np.column_stack(times) if times else left[:, begin : begin + len(one.sizes)]
            begin += 0 if times else len(one.sizes)
            mine = mine[np.isfinite(mine).all(axis=1)]
            found.append(mine - mine.mean(axis=0) if len(mine) else np.zeros((1, len(one.sizes))))
        return tuple(found)

    def _spread(self, group: Array) -> Array:
        """Jackknife covariance of theta over groups of rows, widened for few groups, shape (p, p); `group` (trials,) is
        the group of each trial.
        """
        fit, noise, (theta, _) = self.state.test.fit, self.state.test.expected, self._left_out(group)
        names = np.unique(group[self.state.test.segments.trial])
        times = [(place, one) for place, one in enumerate(self.state.explanations) if one.kind in TIMES]
        for place, number, size in ((place, *each) for place, one in times for each in enumerate(one.sizes)):
            later, earlier = (fit.again(self._moved(place, number, by)[0], noise).theta for by in (STEP, -STEP))
            every = self._time(place, number, group, names)
            theta = theta + (every - size)[:, None] * (later - earlier) / (2 * STEP)
        theta = theta[np.isfinite(theta).all(axis=1)]
        count = len(theta)
        if count < FEWEST_LEFT:
            return np.zeros((len(fit.theta), len(fit.theta)))
        off = theta - theta.mean(axis=0)
        wide = float(student.ppf(0.975, count - 1)) / NORMAL
        return np.asarray(wide**2 * (count - 1) / count * off.T @ off)

    def _left_out(self, group: Array) -> tuple[Array, Array]:
        """Changes of theta and of the sizes without each group in turn; shapes (groups, p), (groups, sizes).

        nan where only that group determines a size, such as a slip without the loads after it.
        """
        fit, forces, of_row = self.state.test.fit, self._forces, group[self.state.test.segments.trial]
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
        """Columns of all explanations whose size is not a time, shape (n, sizes)."""
        test = self.state.test
        found = [
            self.search.columns(one, test.campaign, test.segments, self.state.straight, self.state.explanations)
            for one in self.state.explanations
            if one.kind not in TIMES
        ]
        return np.hstack([np.empty((len(test.segments), 0)), *found])

    def _moved(self, place: int, number: int, by: float) -> tuple[Segments, Array]:
        """Segments with one time of an explanation changed by `by` [s], and the residual of the fit to them."""
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
    """Inverse of a normal matrix, scaled to its diagonal first; pseudo-inverse where it is singular."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return np.asarray(
        np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-13, hermitian=True) / np.outer(scale, scale)
    )
