"""Force over pressure of isometric tests in bins: both branches and the straight part.

And S(eps) of the modified Daerden model from slopes of force over pressure: D0, theta0 and alpha, and what is open.

S = (pi/4) D0^2 [3 (1 - eps)^alpha / tan^2 theta0 - 1 / sin^2 theta0] (paper 3 eq. 9). For a given alpha it is a line in
(1 - eps)^alpha, so only alpha is searched; no start values. Knows no line over contractions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import asin, atan, pi, sqrt

import numpy as np
from scipy.optimize import minimize_scalar

from pmabench.analysis.shared import student
from pmabench.analysis.shared.isometric_lines import Mask, Test, as_test, stairs
from pmabench.model.library.daerden import section_factor
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


ALPHAS = (1.0, 5.0)
"""Where alpha is looked for: the domain of the model."""
FLOOR = 2e-3
"""Floor of the error of a slope, as a share of the largest: nothing on a bench is known better."""
NAMES = ("D_0", "theta_0", "alpha")
OPEN = 0.25
"""A parameter whose 95 % interval is wider than this share of its value is not separable from the others."""
FURTHEST = 3.0
"""Errors by which a slope may be off the curve."""
STEP = 1e-6
NONE = 1e30
"""Sum of squares that counts where no braid has an alpha: the search cannot do with infinity."""


@dataclass(frozen=True)
class Slopes:
    """Slopes S [N/Pa] over contraction eps [1], and the standard error of each; shape (n,)."""

    eps: Array
    S: Array
    error: Array

    @property
    def weight(self) -> Array:
        """One over the error, at least `FLOOR` of the largest slope."""
        return np.asarray(1.0 / np.hypot(self.error, FLOOR * np.abs(self.S).max()))


@dataclass(frozen=True)
class Section:
    """S(eps) through slopes: D0 [m], theta0 [rad], alpha [1], of which `free` were fitted."""

    slopes: Slopes
    D_0: float
    theta_0: float
    alpha: float
    free: tuple[str, ...]
    power: float
    """Weighted sum of squares."""

    @property
    def values(self) -> Array:
        """D0, theta0, alpha."""
        return np.array([self.D_0, self.theta_0, self.alpha])

    def at(self, eps: Array) -> Array:
        """S [N/Pa] at eps [1]."""
        return section_factor(eps, *self.values)

    @property
    def freedom(self) -> int:
        """Slopes less free parameters."""
        return len(self.slopes.S) - len(self.free)

    @property
    def rms(self) -> float:
        """Residual [N/Pa]."""
        return float(np.sqrt(np.mean((self.slopes.S - self.at(self.slopes.eps)) ** 2)))

    @property
    def other_form(self) -> bool:
        """Whether a slope is further from the curve than three times its error: S(eps) is not of this form."""
        off = self.slopes.S - self.at(self.slopes.eps)
        return self.freedom > 0 and bool(np.max(np.abs(off) * self.slopes.weight) > FURTHEST)

    def _jacobian(self, eps: Array) -> Array:
        """Change of S by the free parameters, shape (n, free)."""
        columns = []
        for name in self.free:
            step = np.where(np.array(NAMES) == name, STEP * np.abs(self.values), 0.0)
            up, down = (section_factor(eps, *(self.values + way * step)) for way in (1, -1))
            columns.append((up - down) / (2 * float(step.sum())))
        return np.column_stack(columns)

    @cached_property
    def condition(self) -> float:
        """Condition number of the weighted Jacobian by relative parameters with columns of length one."""
        scaled = self._jacobian(self.slopes.eps) * self.slopes.weight[:, None]
        scaled = scaled / np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
        return float(np.linalg.cond(scaled))

    @property
    def _variance(self) -> float:
        """Of weighted slopes: what the residuals show, at least what the slopes' own errors are."""
        return max(self.power / self.freedom, float(np.mean((self.slopes.error * self.slopes.weight) ** 2)))

    @cached_property
    def _spread(self) -> tuple[Array, float]:
        """Covariance of the free parameters and Student's t for 95 %."""
        weighted = self._jacobian(self.slopes.eps) * self.slopes.weight[:, None]
        covariance = np.asarray(np.linalg.pinv(weighted.T @ weighted) * self._variance)
        return covariance, float(student.ppf(0.975, self.freedom))

    def half(self, name: str) -> float | None:
        """Half width of the 95 % interval of a parameter, the wider of linear and profile; None without freedom."""
        if name not in self.free or self.freedom < 1:
            return None
        covariance, t = self._spread
        at = self.free.index(name)
        linear = t * sqrt(max(0.0, float(covariance[at, at])))
        ends = [abs(values[NAMES.index(name)] - getattr(self, name)) for values in self.as_good]
        return max(linear, *ends) if ends else linear

    def band(self, eps: Array) -> Array:
        """Half width of the 95 % band of S at eps [N/Pa]; NaN without freedom."""
        if self.freedom < 1:
            return np.full(len(eps), np.nan)
        covariance, t = self._spread
        rows = self._jacobian(eps)
        return np.asarray(t * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, covariance, rows), 0.0)))

    @cached_property
    def as_good(self) -> list[Array]:
        """The sets of parameters at the ends of the range of alpha that fits as well (profile, 95 %)."""
        if "alpha" not in self.free or self.freedom < 1:
            return []
        most = self.power + float(student.ppf(0.975, self.freedom)) ** 2 * self._variance
        given = {name: float(getattr(self, name)) for name in NAMES[:2] if name not in self.free}
        ends = []
        for bound in ALPHAS:
            good = self
            for alpha in np.linspace(self.alpha, bound, 200)[1:]:
                one = _at_alpha(self.slopes, float(alpha), given, self.free)
                if one is None or one.power > most:
                    break
                good = one
            if good is not self:
                ends.append(good.values)
        return ends

    @property
    def open(self) -> tuple[str, ...]:
        """Free parameters that the slopes do not determine: their interval is too wide, or there is none."""
        halves = {name: self.half(name) for name in self.free}
        return tuple(n for n, half in halves.items() if half is None or half > OPEN * abs(getattr(self, n)))


def fit(
    slopes: Slopes, *, D_0: float | None = None, theta_0: float | None = None, alpha: float | None = None
) -> Section | None:
    """The section through slopes with the parameters that are not given free; None where none can be found."""
    given = {name: value for name, value in zip(NAMES, (D_0, theta_0, alpha), strict=True) if value is not None}
    free = tuple(name for name in NAMES if name not in given)
    if len(slopes.S) < max(1, len(free)) or len(np.unique(np.round(slopes.eps, 6))) < len(free):
        return None
    if alpha is not None:
        return _at_alpha(slopes, alpha, given, free)

    def power(value: float) -> float:
        one = _at_alpha(slopes, value, given, free)
        return NONE if one is None else one.power

    grid = np.linspace(*ALPHAS, 81)
    powers = np.array([power(float(value)) for value in grid])
    if not (powers < NONE).any():
        return None
    best = int(np.argmin(powers))
    bounds = float(grid[max(0, best - 1)]), float(grid[min(len(grid) - 1, best + 1)])
    found = float(minimize_scalar(power, bounds=bounds, method="bounded", options={"xatol": 1e-9}).x)
    return _at_alpha(slopes, found if power(found) <= powers[best] else float(grid[best]), given, free)


def _at_alpha(slopes: Slopes, alpha: float, given: dict[str, float], free: tuple[str, ...]) -> Section | None:
    """Least squares of D0 and theta0 at an alpha; None where no braid has them."""
    w, g = slopes.weight, (1 - slopes.eps) ** alpha
    D_0, theta_0 = given.get("D_0", 0.0), given.get("theta_0", 0.0)
    if "D_0" in free and "theta_0" in free:  # S = C1 g - C2, C1 = 3 C2 cos^2 theta0
        C1, C2 = np.linalg.lstsq(np.column_stack([g, -np.ones_like(g)]) * w[:, None], slopes.S * w, rcond=None)[0]
        if not 0 < C1 < 3 * C2:
            return None
        sine = 1 - C1 / (3 * C2)
        D_0, theta_0 = sqrt(4 * C2 * sine / pi), asin(sqrt(sine))
    elif "D_0" in free:
        shape = section_factor(slopes.eps, *np.array([1.0, theta_0, alpha]))
        square = float(np.sum(w**2 * shape * slopes.S) / np.sum(w**2 * shape**2))
        if square <= 0:
            return None
        D_0 = sqrt(square)
    elif "theta_0" in free:  # S / A0 + 1 = (3 g - 1) / tan^2 theta0
        area = pi / 4 * D_0**2
        row, left = (3 * g - 1) * w, (slopes.S / area + 1) * w
        cotangent = float(np.sum(row * left) / np.sum(row * row))
        if cotangent <= 0:
            return None
        theta_0 = atan(1 / sqrt(cotangent))
    off = (slopes.S - section_factor(slopes.eps, *np.array([D_0, theta_0, alpha]))) * w
    return Section(slopes, D_0, theta_0, alpha, free, float(np.sum(off * off)))
