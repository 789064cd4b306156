"""Force over pressure of isometric tests in bins: both branches, the straight part, and where the force begins.

Knows the tests of one contraction; no line over contractions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.shared.isometric_lines import Mask, Test, as_test, ends
from pmabench.analysis.shared.samples import SEEN, noise_of, onset
from pmabench.store.records import Array, RunData, TrialData

PHASES = ("fill", "empty")
BINS = 50
WITHIN = 0.02
"""How far the straight part may leave its line, and how much of the force lies below it, as a share of the span."""
SHORTEST = 0.5
"""Least share of the bins with force that a straight part has."""
FEWEST_BINS = 5
LEAST = 0.2
"""Change of the force that counts as one, where there is less noise [N]."""
REST = 1.0
"""How long before and after the ramps the force is at rest [s]."""
AROUND = 0.25
"""The pressure at a moment is that of a line through the samples so far to both sides [s]."""


@dataclass(frozen=True, eq=False)
class Mean:
    """The mean curve of the tests of one contraction, and the branches of each; shape (bins,), (tests, bins)."""

    P: Array
    """Middle of each bin [Pa]."""
    fill: Array
    """Mean force while the pressure rises [N]; NaN where there is no sample."""
    empty: Array
    """While it falls."""

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
        return Mean(self.P, self.fill[rows], self.empty[rows])

    @property
    def turned(self) -> Array:
        """What the mean of both branches lacks where the loop has not opened or closed yet, by its middle [N]; (bins,).

        Half of the difference between the gap there and that of the middle half of the pressures.
        """
        known = np.isfinite(self.empty - self.fill)
        gap = np.where(known, self.empty - self.fill, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        place = (self.P - self.P[0]) / (self.P[-1] - self.P[0])
        return np.asarray(0.5 * np.abs(gap - np.median(gap[np.abs(place - 0.5) < 0.25])))

    def gaps(self, low: float) -> Array:
        """Force while emptying minus while filling of each test, mean over the pressures from `low` [Pa] on [N]."""
        part = (self.empty - self.fill)[:, self.P >= low]
        known = np.isfinite(part)
        return np.asarray(np.where(known, part, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def mean_of(tests: Sequence[Test]) -> Mean:
    """The branches of tests at one contraction in equal bins of pressure; both ramps weigh the same in each bin."""
    P = np.concatenate([test.P for test in tests])
    edges = np.linspace(P.min(), P.max(), BINS + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    rows: dict[int, list[Array]] = {0: [], 1: []}
    for phase, found in rows.items():
        for test in tests:
            mine = test.phase == phase
            place = np.clip(np.searchsorted(edges, test.P[mine], side="right") - 1, 0, BINS - 1)
            found.append(_binned(place, test.P[mine], test.F[mine], middle))
    return Mean(middle, np.array(rows[0]), np.array(rows[1]))


def _binned(place: Array, P: Array, F: Array, middle: Array) -> Array:
    """Mean force of each bin, moved to the bin's middle along the slope between the means."""
    count = np.bincount(place, minlength=BINS)
    full = count > 0
    at, force = (np.bincount(place, values, BINS)[full] / count[full] for values in (P, F))
    result = np.full(BINS, np.nan)
    slope = np.gradient(force, at) if full.sum() > 1 and np.all(np.diff(at) > 0) else np.zeros(len(at))
    result[full] = force + slope * (middle[full] - at)
    return result


def straight_from(mean: Mean) -> tuple[float | None, float]:
    """The pressure from which on F(P) is a straight line [Pa], and the largest distance from that line [N].

    The rule: above the pressures at which the force is within `WITHIN` of its span from its least value, the lowest
    pressure from which on no bin is further than `WITHIN` of the span from the line through all of them, if at least
    `SHORTEST` of these bins are left. None where there is none; the distance is then that of the shortest part.
    """
    known = np.isfinite(mean.force)
    P, F = mean.P[known], mean.force[known]
    span = float(np.ptp(F))
    first = int(np.flatnonzero(F - F.min() <= WITHIN * span)[-1]) + 1 if span > 0 else len(F)
    least = max(FEWEST_BINS, int(np.ceil(SHORTEST * (len(F) - first))))
    off = 0.0
    for start in range(first, len(F) - least + 1):
        off = float(np.abs(F[start:] - np.polyval(np.polyfit(P[start:], F[start:], 1), P[start:])).max())
        if off <= WITHIN * span:
            edge = P[start] - 0.5 * float(mean.P[1] - mean.P[0])
            return float(edge), off
    return None, off


def begins(trial: TrialData, times: float = 1.0) -> tuple[float | None, float | None]:
    """Pressure at which the force leaves its level of rest while filling, and reaches it while emptying [Pa].

    The rule is that of `onset`: the first sample that leaves the level of the rest before the ramp by six times its
    noise, at least 0.2 N or a thousandth of the largest force, followed back along the line through the next samples.
    While emptying the same backwards in time, from the rest after the ramp. `times` as large a threshold is another
    choice that an analyst could have made.
    """
    ramps = {c.phase: c for c in trial.commands if c.kind == "ramp" and c.phase in PHASES and c.data.get("rate")}
    use = trial.usable & np.isfinite(trial.channels["force"]) & np.isfinite(trial.channels["pressure"])
    t, P, F = trial.t[use], trial.channels["pressure"][use], trial.channels["force"][use]
    if len(ramps) < 2 or len(t) < 2:
        return None, None
    rest = F[t < ramps["fill"].t - 1e-9] if "fill" in ramps and times > 1 else F[:0]
    least = times * max(LEAST, 1e-3 * float(np.max(np.abs(F))), SEEN * noise_of(rest))
    turn, over = ramps["empty"].t, ends(ramps["empty"])
    up = (t >= ramps["fill"].t - REST) & (t < turn)
    down = (t >= turn) & (t <= over + REST)
    rise = onset(t[up], F[up], ramps["fill"].t, least)
    fall = onset(-t[down][::-1], F[down][::-1], -over, least)
    return _at(t[up], P[up], rise), _at(t[down], P[down], None if fall is None else -fall)


def _at(t: Array, P: Array, moment: float | None) -> float | None:
    """Pressure at a moment [Pa]."""
    if moment is None:
        return None
    near = np.abs(t - moment) <= AROUND
    if np.count_nonzero(near) < 3:
        return float(np.interp(moment, t, P))
    return float(np.polyfit(t[near] - moment, P[near], 1)[1])


def largest_force(run: RunData, trial: TrialData) -> float | None:
    """Largest force of a muscle held at one length [N]; None where nothing is usable."""
    test, _ = as_test(run, trial, PHASES)
    return float(test.F.max()) if test is not None and len(test.F) else None
