"""Force over pressure of isometric tests in bins: both branches and the straight part; no line over contractions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.shared.isometric_lines import Mask, Test, as_test, stairs
from pmabench.store.records import Array, RunData, TrialData

PHASES = ("fill", "empty")
BINS = 50
SHIFTS = 20
"""Places of the bins that are tried so that no hold of a staircase is cut."""
WITHIN = 0.02
"""How far the straight part may leave its line, and how much of the force lies below it, as a share of the span."""
SHORTEST = 0.5
"""Least share of the bins with force that a straight part has."""
FEWEST_BINS, FEWEST_HOLDS = 5, 3
REST = 1.0
"""How long before and after the ramps the force is at rest [s]."""


@dataclass(frozen=True, eq=False)
class Mean:
    """The mean curve of the tests of one contraction, and the branches of each; shape (bins,), (tests, bins)."""

    P: Array
    """Middle of each bin [Pa]."""
    fill: Array
    """Mean force while the pressure rises [N]; NaN where there is no sample."""
    empty: Array
    """While it falls."""
    held: bool = False
    """Whether the pressure was a staircase, of which the holds count."""

    @property
    def each(self) -> Array:
        """Mean of both branches of each test [N]."""
        return np.asarray(0.5 * (self.fill + self.empty))

    @property
    def force(self) -> Array:
        """Mean over the tests that have the bin [N]."""
        known = np.isfinite(self.each)
        total = np.where(known, self.each, 0.0).sum(axis=0)
        return np.asarray(np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan))

    def of(self, rows: Mask) -> Mean:
        """That of some of the tests."""
        return Mean(self.P, self.fill[rows], self.empty[rows], self.held)

    @property
    def opened(self) -> tuple[Array, Array, float]:
        """Pressures [Pa], the gap there over all tests [N], and its median in the middle half of the pressures [N]."""
        known = np.isfinite(self.empty - self.fill)
        seen = known.any(axis=0)
        gap = np.where(known, self.empty - self.fill, 0.0).sum(axis=0)[seen] / known.sum(axis=0)[seen]
        middle = np.abs((self.P[seen] - self.P[0]) / (self.P[-1] - self.P[0]) - 0.5) < 0.25
        return self.P[seen], gap, float(np.median(gap[middle] if middle.any() else gap)) if seen.any() else 0.0

    @property
    def turned(self) -> tuple[Array, Array]:
        """Pressures [Pa], and what of the middle of the loop the mean of both branches has too much there [N].

        Half of the difference between the gap there, where the loop has not opened or closed yet, and that of the
        middle half of the pressures. The mean is that of the branch just left: too high at the lower end, too low at
        the upper one.
        """
        P, gap, usual = self.opened
        return P, np.copysign(0.5 * np.abs(gap - usual), 0.5 * (self.P[0] + self.P[-1]) - P)

    def gaps(self, low: float) -> Array:
        """Force while emptying minus while filling of each test, mean over the pressures from `low` [Pa] on [N].

        The highest pressure of a staircase, one hold for both directions, does not count.
        """
        gap = self.empty - self.fill
        high = self.P[np.isfinite(gap).any(axis=0)].max(initial=0.0)
        part = gap[:, (self.P >= low) & ((self.P < high) | (not self.held))]
        known = np.isfinite(part)
        return np.asarray(np.where(known, part, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def pulling(test: Test) -> Mask:
    """Samples in which the muscle pulls: at rest without force its end may be moved."""
    return np.asarray(test.F > WITHIN * float(test.F.max()))


def mean_of(tests: Sequence[Test]) -> Mean:
    """The branches of tests at one contraction in equal bins of pressure; both ramps weigh the same in each bin."""
    held = any(stairs(test.trial, PHASES) is not None for test in tests)
    edges = _edges(np.concatenate([test.P for test in tests]), held=held)
    middle = 0.5 * (edges[1:] + edges[:-1])

    def branch(test: Test, phase: int) -> Array:
        P, F = test.P[test.phase == phase], test.F[test.phase == phase]
        return _binned(np.clip(np.searchsorted(edges, P, side="right") - 1, 0, len(middle) - 1), P, F, middle)

    fill, empty = (np.array([branch(test, phase) for test in tests]) for phase in (0, 1))
    return Mean(middle, fill, empty, held)


def _edges(P: Array, *, held: bool) -> Array:
    """Edges of the bins [Pa]: none within a hold of a staircase, as far as that can be."""
    edges = np.linspace(P.min(), P.max(), BINS + 1)
    if not held:
        return edges
    width = float(edges[1] - edges[0])
    tried = np.linspace(0.0, width, SHIFTS, endpoint=False)
    away = [float(np.abs((P - P.min() + shift + 0.5 * width) % width - 0.5 * width).min()) for shift in tried]
    return np.asarray(np.append(edges, edges[-1] + width) - tried[int(np.argmax(away))])


def _binned(place: Array, P: Array, F: Array, middle: Array) -> Array:
    """Mean force of each bin, moved to the bin's middle along the slope between the means."""
    count = np.bincount(place, minlength=len(middle))
    full = count > 0
    at, force = (np.bincount(place, values, len(middle))[full] / count[full] for values in (P, F))
    result = np.full(len(middle), np.nan)
    slope = np.gradient(force, at) if full.sum() > 1 and np.all(np.diff(at) > 0) else np.zeros(len(at))
    result[full] = force + slope * (middle[full] - at)
    return result


def straight_from(mean: Mean) -> tuple[float | None, float]:
    """The pressure from which on F(P) is a straight line [Pa], and the largest distance from that line [N].

    The rule: above the pressures at which the force is within `WITHIN` of its span from its least value, the lowest
    pressure from which on no bin is further than `WITHIN` of the span from the line through all of them, if at least
    `SHORTEST` of these bins are left. None where there is none; the distance is then that of the shortest part. Of a
    staircase fewer do, and its lowest hold need not be without force.
    """
    known = np.isfinite(mean.force)
    P, F = mean.P[known], mean.force[known]
    if not len(F):
        return None, 0.0
    span = float(np.ptp(F))
    slack = np.flatnonzero(F - (min(0.0, F.min()) if mean.held else F.min()) <= WITHIN * span)
    first = len(F) if span <= 0 else int(slack[-1]) + 1 if len(slack) else 0
    least = max(FEWEST_HOLDS if mean.held else FEWEST_BINS, int(np.ceil(SHORTEST * (len(F) - first))))
    off = 0.0
    for start in range(first, len(F) - least + 1):
        off = float(np.abs(F[start:] - np.polyval(np.polyfit(P[start:], F[start:], 1), P[start:])).max())
        if off <= WITHIN * span:
            edge = P[start] - 0.5 * float(mean.P[1] - mean.P[0])
            return float(edge), off
    return None, off


def largest_force(run: RunData, trial: TrialData) -> float | None:
    """Largest force of a muscle held at one length [N]; None where nothing is usable."""
    test, _ = as_test(run, trial, PHASES)
    return float(test.F.max()) if test is not None and len(test.F) else None
