"""Trials and loads left out: whether the form of a fit holds, and how far a corrected one can be trusted.

Whether it holds: how well it predicts trials that were left out, and whether neighbours agree, both compared with what
noise allows. Knows no cause of a misfit: columns of forces are given.

How far a corrected fit can be trusted: by loads and trials left out, the correction itself, other explanations. The
spread over loads that are left out does not see what biases all of them alike. So a part of the correction counts, as
large as what it leaves of the misfit, within bounds that campaigns with known faults gave. Decision 0019.
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
"""Rms of what trials that were left out are missed by, over what noise allows, from which on the form is doubted."""
MOST_ALIKE = 0.3
"""Mean product of neighbouring residuals, over the variance of the noise, from which on the form is doubted."""
SURE = 4.0
"""Both count only beyond so many standard deviations of them by chance, which few segments make large."""
NEAR = 5e-4
"""A residual this small, as a share of the typical force, says nothing against the form."""
FOLDS = 6
"""Every sixth trial is left out at a time."""
ENOUGH = 50
"""Fewest segments that a fit to other trials predicts well for a comparison with noise."""
HICCUPS = 0.02
"""Share of the rows of polled devices that answers may displace which came much later than usual: a busy computer."""
FEWEST_REPEATS = 10
"""Fewest repetitions in all from which the scatter between trials is estimated."""
TINY = 1e-9
"""Columns of which less than this share of the squares is left by the coefficients have no size."""


@dataclass(frozen=True, eq=False)
class Test:
    """A fit, what it leaves over, and what noise allows."""

    campaign: Campaign
    segments: Segments
    fit: Fit
    expected: float
    """Root mean square of the noise that the fit was made with [N]."""
    own: Array
    """Variance of each row by noise [N^2], shape (n,)."""
    after: Array
    """Covariance of it with the next, shape (n - 1,)."""
    may: Array
    """What departures of known size may do, shape (n, m)."""
    scatter: float
    """Variance between repeats beyond noise [N^2]."""

    @classmethod
    def of(cls, campaign: Campaign, segments: Segments, fit: Fit, expected: float) -> Test:
        """The test of a fit to `segments`; `expected` [N] is the noise that it was made with."""
        own, after = _noise(campaign, segments, fit)
        least = max((FLOOR * rms_of(segments.force)) ** 2, 1e-24)  # a dead force cell has none at all
        own = np.maximum(own, least)
        may = allowed(campaign, segments, fit)
        return cls(campaign, segments, fit, expected, own, after, may, _scatter(campaign, segments, fit.residual, own))

    @cached_property
    def whole(self) -> Array:
        """Variance of each row that is no misfit [N^2], shape (n,)."""
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
        """Share of rows that late answers of a device may have displaced."""
        return HICCUPS if any(vars(self.campaign.late).values()) else 0.0

    @property
    def ratio(self) -> float:
        """Rms of what trials are missed by that were left out, over what noise and the fit's own uncertainty make of
        it; where the others predict too few rows as well as one row is known, of the residual of the fit to all.
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
        """Segments that are followed at once by the next."""
        return np.flatnonzero(self.segments.followed)

    @cached_property
    def alike(self) -> float:
        """Mean product of neighbouring residuals, beyond what noise makes of it, over its variance."""
        pairs, residual, may = self._pairs, self.fit.residual, self.may
        expected = self.after[pairs] + np.sum(may[pairs] * may[pairs + 1], axis=1) + self.scatter
        product = residual[pairs] * residual[pairs + 1] - expected
        return float(np.sum(product) / np.sum(self.whole[pairs])) if len(pairs) else 0.0

    @property
    def most_alike(self) -> float:
        """Agreement of neighbours from which on the form is doubted."""
        return max(MOST_ALIKE, SURE / sqrt(max(1, len(self._pairs))))

    @property
    def doubted(self) -> bool:
        """Whether the data speak against the form."""
        return self.ratio >= self.most_ratio or self.alike >= self.most_alike

    @property
    def excess(self) -> float:
        """Mean square of what is missed beyond noise, over that of noise: 0 where the form is right."""
        return max(0.0, self.ratio**2 - 1)

    @cached_property
    def _folds(self) -> list[_Fold]:
        """Each sixth of the trials, left out."""
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
        """The ratio with forces of free size in the fit, for each group of them, shape (n, k) each [N]."""
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
    """Trials that were left out: their rows, the fit to the others, and what it misses them by."""

    rows: NDArray[np.bool_]
    inverse: Array
    theta: Array
    miss: Array
    variance: Array
    sure: NDArray[np.bool_]
    """Rows that the others predict as well as one row is known."""


def _noise(campaign: Campaign, segments: Segments, fit: Fit) -> tuple[Array, Array]:
    """Variance of each row [N^2], shape (n,), and covariance with the next, shape (n - 1,).

    The times of polled samples scatter by no more than half a poll; how much of that they do is estimated from the
    residuals, which grow with the speed by it. Of each row that counts which the fit leaves free: the few fast ones are
    fitted closely, and would say that nothing scatters.
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
    """Variance between repeats of a cell beyond that of noise, as a force that is constant in each trial [N^2]."""
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
    """Mean of squares without the largest `share` of them, scaled so that it is 1 for normal noise of size 1.

    Infinite where there are none: what no trial that was left out can show explains nothing.
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
"""By which times of streams are moved to see what they change [s]."""
PART_OF_MUSCLE, PART_OF_BENCH = (0.05, 0.17), (0.002, 0.01)
"""Least and greatest share of a correction by the fit that may be wrong: of what a muscle does no form is exact, of a
delay, a drift or a slip nearly so. Chosen and confirmed on campaigns with known faults."""
CHANCE = 0.1
"""Excess that a right form leaves by chance."""
UNSHOWN = 25.0
"""A size whose variance grows by so much without a group is determined by that group alone."""
FEWEST_LEFT = 3
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
        spreads = [
            self._spread(fit, rows, group, noise) for group in groups if len(np.unique(group[trial])) >= FEWEST_LEFT
        ]
        others_of = np.array(others).reshape(-1, len(fit.theta))
        return Correction(self._unsure(fit, noise), tuple(spreads), others_of, self.factor)

    def _unsure(self, fit: Fit, noise: float) -> Array:
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
        if len(np.unique(trial)) < FEWEST_LEFT:
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
        if count < FEWEST_LEFT:
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
