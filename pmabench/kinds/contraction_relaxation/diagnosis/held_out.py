"""Tests of the form of a fit: how well it predicts trials that were left out, and whether neighbours agree.

Both are compared with what noise allows. Knows no cause of a misfit: columns of forces are given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, sqrt
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from pmabench.kinds.contraction_relaxation.diagnosis.columns import allowed
from pmabench.kinds.contraction_relaxation.pooled import FLOOR, Fit, levers, noise_covariance, rms_of, without_each
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments
from pmabench.store.records import Array

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
