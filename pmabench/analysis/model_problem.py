"""A library model as a least-squares problem over some of its inputs, and the identifiability of each of them.

All values SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import isfinite, sqrt
from typing import Any

import numpy as np
from scipy.optimize import least_squares, leastsq
from scipy.stats import qmc

from pmabench.analysis.shared.calibration import listed
from pmabench.model.library import Model, OutsideDomain, Parameter, check
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array

RANK = 1e-6
"""Ratio to the largest singular value of the scaled Jacobian below which a combination is not identifiable."""
TOGETHER = 0.99
"""Correlation above which two unknowns are reported as correlated."""
MOST = 4
"""Largest number of pairs named in a finding."""


@dataclass(frozen=True)
class Spread:
    """Standard errors, covariance and correlation of p unknowns [SI]; shapes (p,), (p, p)."""

    errors: tuple[float | None, ...]
    """Standard errors; None where not identifiable or without degrees of freedom."""
    covariance: Array
    """NaN for unknowns that are not identifiable."""
    correlation: Array
    tied: tuple[tuple[int, ...], ...]
    """Indices of the unknowns in each combination that the data do not determine."""


def spread_of(slopes: Array, squares: float, freedom: int) -> Spread:
    """Spread from derivatives of the output (n, p) and the sum of squares at the best values [square of the output]."""
    count = slopes.shape[1]
    lengths = np.linalg.norm(slopes, axis=0)
    dead = lengths == 0
    unit = slopes / np.where(dead, 1.0, lengths)
    _, singular, rows = np.linalg.svd(unit, full_matrices=False)
    kept = singular > RANK * singular[0] if singular[0] > 0 else np.zeros(len(singular), dtype=bool)
    tied = [tuple(int(j) for j in np.flatnonzero(np.abs(row) > 0.1)) for row in rows[~kept]]
    lost = {j for group in tied for j in group} | set(np.flatnonzero(dead).tolist())
    inverse = rows[kept].T @ np.diag(1 / singular[kept] ** 2) @ rows[kept]
    scale = np.where(dead, 1.0, lengths)
    covariance, correlation = np.full((2, count, count), np.nan)
    good = [j for j in range(count) if j not in lost]
    part = np.ix_(good, good)
    shape = inverse / np.outer(scale, scale)
    width = np.sqrt(np.diag(shape))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation[part] = (shape / np.outer(width, width))[part]
    if freedom > 0:
        covariance[part] = (squares / freedom * shape)[part]
    errors = tuple(None if j in lost or freedom < 1 else sqrt(max(float(covariance[j, j]), 0.0)) for j in range(count))
    return Spread(errors, covariance, correlation, tuple(tied))


def with_halves(spread: Spread, slopes: Array, halves: Array, limit: float) -> Spread:
    """The spread with what 95 % half widths of the rows (n,) do to the unknowns; `limit` is Student's t of the fit.

    Of which errors the rows have in common their widths do not say: all of it once, as a gain and a zero of one sensor,
    and all of it row by row, add up in squares.
    """
    lengths = np.linalg.norm(slopes, axis=0)
    scale = np.where(lengths > 0, lengths, 1.0)
    each = np.linalg.pinv(slopes / scale, rcond=RANK) / scale[:, None] * halves
    common = each.sum(axis=1)
    covariance = spread.covariance + (np.outer(common, common) + each @ each.T) / limit**2
    width = np.sqrt(np.diag(covariance))
    errors = tuple(None if e is None else float(w) for e, w in zip(spread.errors, width, strict=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        return Spread(errors, covariance, covariance / np.outer(width, width), spread.tied)


def identifiability(
    names: Sequence[str],
    spread: Spread,
    intervals: Sequence[tuple[float | None, float | None] | None],
    at_end: Sequence[str],
) -> list[Finding]:
    """Doubts about unknowns: without effect, tied, open intervals, at an end of the domain; then correlated pairs."""
    found = []
    for group in spread.tied:
        several = " are not identifiable separately: these rows determine only a combination of them; "
        several += "give one of them with --set"
        why = several if len(group) > 1 else " is not identifiable: it changes nothing at these rows"
        found.append(Finding("doubt", f"{listed([names[j] for j in group])}{why}"))
    for name, interval, place in zip(names, intervals, at_end, strict=True):
        if place:
            found.append(Finding("doubt", f"{name} ended {place}: the data pull it further, or do not determine it"))
        elif interval is not None and None in interval:
            side = "either side" if interval == (None, None) else "below" if interval[0] is None else "above"
            text = f"{name} is not identifiable to {side}: no value of its domain there is excluded"
            found.append(Finding("doubt", text))
    sizes = [(abs(float(spread.correlation[i, j])), i, j) for i in range(len(names)) for j in range(i)]
    pairs = sorted((pair for pair in sizes if pair[0] > TOGETHER), reverse=True)
    if pairs:
        named = [f"{names[j]} and {names[i]} ({spread.correlation[i, j]:+.4f})" for _, i, j in pairs[:MOST]]
        more = f" and {len(pairs) - MOST} other pairs" if len(pairs) > MOST else ""
        text = f"correlated: {', '.join(named)}{more}: the curve is known better than each value"
        found.append(Finding("doubt", f"{text}; more range of the inputs parts them"))
    return found


STARTS = 8
"""Most starts of a fit, including the reference values, which are the only one with more than `FEW` unknowns."""
TRIED = 200
"""Points of the domain that are evaluated; the best become starts."""
STEP = 6e-6
"""Relative step of central differences."""
WIDE = 20.0
"""A domain that extends beyond this multiple of the reference value is searched within a factor of 5 of it."""
FLAT = 1e-5
"""Cosine between residuals and each column of the Jacobian below which a fit has converged."""
MOST_EVALUATIONS = 400
"""Most evaluations of the residual in one fit."""
TOGETHER_AT_MOST = 1_000_000
"""Most output values computed in one call, which limits memory."""
FEW = 8
"""Most unknowns for which a net of points is used."""
ELSEWHERE = 3
"""Points of the net from which the fit is repeated where a profile seems to end."""
SHORTEST = 6
"""Halvings of a step after which any finite sum of squares is accepted."""
REFUSED = 12
"""Halvings of a step after which the model counts as not valid there."""


@dataclass
class Problem:
    """A model as a function of its unknowns at the measured rows, all SI: output, residuals, derivatives, bounds."""

    model: Model
    output: str
    names: Sequence[str]
    inputs: Mapping[str, Any]
    measured: Array | None
    """None where only the output is needed."""
    count: int = field(init=False)
    span: float = field(init=False)
    size: Array = field(init=False)
    low: Array = field(init=False)
    high: Array = field(init=False)
    fixed: Mapping[str, Any] | None = field(init=False, default=None)
    """All inputs but the unknowns, where they passed the check of their domains; else None."""

    def __post_init__(self) -> None:
        known = {p.name: p for p in self.model.parameters}
        self.count = max((len(v) for v in self.inputs.values() if isinstance(v, np.ndarray)), default=1)
        unknown = [known[name] for name in self.names]
        self.size = np.array([_size(p) for p in unknown])
        self.low = np.array([p.low + (1e-9 * _size(p) if p.above else 0.0) for p in unknown])
        self.high = np.array([p.high for p in unknown])
        span = 0.0 if self.measured is None else max(float(np.ptp(self.measured)), float(np.abs(self.measured).max()))
        self.span = span or 1.0
        if self.inputs.keys() <= known.keys():
            fixed = {name: self.inputs.get(name, p.value) for name, p in known.items() if name not in self.names}
            with suppress(OutsideDomain):
                check([known[name] for name in fixed], fixed)
                self.fixed = fixed

    def output_at(self, at: Array) -> Array:
        """Output at values of the unknowns, shape (count,); raises OutsideDomain."""
        return np.array(self.outputs_at(at[None])[0])

    def outputs_at(self, every: Array) -> Array:
        """Outputs at several points (k, unknowns), shape (k, count); raises OutsideDomain where one is outside."""
        named = {name: every[:, [i]] for i, name in enumerate(self.names)}
        if self.fixed is not None and (every >= self.low).all() and (every <= self.high).all():
            found = self.model.unchecked(**self.fixed, **named)[self.output]
        else:
            found = self.model.evaluate({**self.inputs, **named})[self.output]
        shape = len(every), self.count
        return found if found.shape == shape else np.broadcast_to(found, shape)

    def off_measured(self, output: Array) -> Array:
        """Computed minus measured, over the span."""
        return (output - (0.0 if self.measured is None else self.measured)) / self.span

    def residuals(self, at: Array) -> Array:
        """Computed minus measured, over the span; all NaN where the model does not hold."""
        try:
            return np.asarray(self.off_measured(self.output_at(at)))
        except OutsideDomain:
            return np.full(self.count, np.nan)

    def costs(self, points: Sequence[Array]) -> Array:
        """Sum of squares of the residuals at each point; NaN where the model does not hold."""
        if points and len(points) * self.count <= TOGETHER_AT_MOST:
            with suppress(OutsideDomain):
                return np.asarray(np.sum(self.off_measured(self.outputs_at(np.array(points))) ** 2, axis=1))
        return np.array([np.sum(self.residuals(point) ** 2) for point in points])

    def slopes(self, at: Array) -> Array:
        """Jacobian of the output, shape (count, unknowns), by central differences, at ends of the domain one-sided."""
        step = STEP * np.maximum(np.abs(at), 1e-3 * self.size)
        ends = [np.minimum(np.maximum(at + way * step, self.low), self.high) for way in (1.0, -1.0)]
        every = np.vstack([np.where(np.eye(len(at), dtype=bool), end, at) for end in ends])
        try:  # all at once: arrays broadcast against each other
            values = self.outputs_at(every)
        except OutsideDomain:
            middle = self.output_at(at)
            values = np.array([self._output_or(row, middle) for row in every])
            refused = (values == middle).all(axis=1).reshape(2, -1)
            ends = [np.where(out, at, end) for out, end in zip(refused, ends, strict=True)]
        wide = ends[0] - ends[1]
        rise = values[: len(at)] - values[len(at) :]
        return np.asarray((rise / np.where(wide > 0, wide, np.inf)[:, None]).T)

    def _output_or(self, at: Array, middle: Array) -> Array:
        """The output; `middle` outside the domain."""
        try:
            return self.output_at(at)
        except OutsideDomain:
            return middle


def _size(p: Parameter) -> float:
    """Typical size of an input: its reference value, else the width of its range, else 1."""
    value = abs(float(p.value))
    if value > 0:
        return value
    return float(p.high - p.low) if isfinite(p.high - p.low) and p.high > p.low else 1.0


def acting(
    model: Model, output: str, names: Sequence[str], inputs: Mapping[str, Any], start: Mapping[str, float] | None = None
) -> list[str]:
    """Those of `names` that affect the output at these inputs, within 10 % of `start` or of the reference values."""
    known = {p.name: p for p in model.parameters}
    problem = Problem(model, output, names, inputs, None)
    first = np.array([float((start or {}).get(name, known[name].value)) for name in names])
    moves = np.zeros(len(names), dtype=bool)
    for share in (1.0, 0.9, 1.1):
        with suppress(OutsideDomain):
            moves |= (np.abs(problem.slopes(np.clip(share * first, problem.low, problem.high))) > 0).any(axis=0)
    return [name for name, does in zip(names, moves, strict=True) if does]


def net_of(problem: Problem, start: Array) -> list[Array]:
    """Points of a scrambled Halton net around `start`, best first; none with more than `FEW` unknowns."""
    if len(start) > FEW:
        return []
    ranges = list(map(_range, start, problem.low, problem.high, problem.size))
    net = qmc.Halton(len(start), seed=0).random(TRIED)
    points = [np.array([low * (high / low) ** u if raised else low + (high - low) * u
                        for u, (low, high, raised) in zip(row, ranges, strict=True)]) for row in net]  # fmt: skip
    return _best_first(problem, points)


def _best_first(problem: Problem, points: Sequence[Array]) -> list[Array]:
    """Those of the points where the model holds, by rising sum of squares."""
    costs = problem.costs(points)
    return [points[i] for i in np.argsort(costs) if isfinite(costs[i])]


def _range(start: float, low: float, high: float, size: float) -> tuple[float, float, bool]:
    """Search range of an unknown, and whether it is searched on a logarithmic scale."""
    middle = abs(start) or size
    if low >= 0:
        ends = max(low, middle / 5), min(high, middle * 5)
        if isfinite(high) and high <= WIDE * middle and high > 0:
            ends = max(low, high / 1e3), high
        return (*ends, True) if ends[0] > 0 else (*ends, False)
    return max(low, start - 3 * middle), min(high, start + 3 * middle), False


End = tuple[float, Array, bool]
"""Result of a fit: sum of squares over span squared, unknowns, whether it converged."""


def solve(problem: Problem, start: Array, held: int | None = None) -> End:
    """Least squares from `start`; the unknown with index `held` is not changed."""
    free = [i for i in range(len(start)) if i != held]
    if not free:
        return float(np.sum(problem.residuals(start) ** 2)), start, True

    def whole(part: Array) -> Array:
        at = start.copy()
        at[free] = part
        return at

    def slopes(part: Array) -> Array:
        return np.asarray(problem.slopes(whole(part))[:, free] / problem.span)

    low, high = problem.low[free], problem.high[free]
    room = 1e-10 * problem.size[free]
    inside = np.clip(
        start[free], low + np.where(np.isfinite(low), room, 0), high - np.where(np.isfinite(high), room, 0)
    )

    def residuals(part: Array) -> Array:
        if (part < low).any() or (part > high).any():
            return np.full(problem.count, np.nan)
        return problem.residuals(whole(part))

    fine = 1.0 if held is None else 1e4  # with one held only the sum of squares is asked for
    how: dict[str, Any] = {"xtol": fine * 1e-11, "ftol": fine * 1e-13, "gtol": fine * 1e-13}
    if len(free) <= problem.count:
        # MINPACK takes a third of the time, and knows no bounds: where they hold it up, the rest is done with them
        x, _, facts, _, status = leastsq(
            residuals, inside, Dfun=slopes, full_output=True, maxfev=MOST_EVALUATIONS, **how
        )
        off, jacobian = facts["fvec"], slopes(x)
        squares = float(off @ off)
        flat = np.abs(jacobian.T @ off) <= FLAT * np.linalg.norm(jacobian, axis=0) * sqrt(squares)
        if status in (1, 2, 3, 4) and bool(np.all(flat)):
            return squares, whole(x), True
        inside = x
    found = least_squares(residuals, inside, slopes, (low, high), x_scale="jac", max_nfev=MOST_EVALUATIONS, **how)
    return 2.0 * float(found.cost), whole(np.asarray(found.x)), bool(found.status > 0)


def along(problem: Problem, point: Array, i: int, wanted: float, most: float) -> tuple[float, Array | None]:
    """Move `point` along the tangent of the valley towards `wanted` of unknown `i`; return that value and the point.

    The step is halved until the sum of squares is below `most`, `SHORTEST` times at most where the model holds. The
    point is None where the model does not hold even after `REFUSED` halvings.
    """
    slopes = problem.slopes(point) / problem.span
    others = np.delete(slopes, i, axis=1)
    size = np.linalg.norm(others, axis=0)
    scale = np.where(size > 0, size, 1.0)
    tangent = -np.linalg.lstsq(others / scale, slopes[:, i], rcond=RANK)[0] / scale
    for shorter in range(REFUSED):
        at = wanted if not shorter else float(point[i] + (wanted - point[i]) * 0.5**shorter)
        guess = np.clip(point + np.insert(tangent, i, 0.0) * (at - point[i]), problem.low, problem.high)
        guess[i] = at
        cost = float(np.sum(problem.residuals(guess) ** 2))
        if cost < most or (isfinite(cost) and shorter >= SHORTEST):
            return at, guess
    return wanted, None


def lowest(problem: Problem, guess: Array, net: Sequence[Array], i: int, enough: float) -> tuple[float, Array]:
    """Sum of squares and unknowns of the refit with unknown `i` held as in `guess`.

    The fit starts there, and where it is not below `enough` also from the best points of the net.
    """
    cost, point, _ = solve(problem, guess, held=i)
    if cost >= enough:
        moved = [np.where(np.arange(len(guess)) == i, guess[i], other) for other in net]
        for other in _best_first(problem, moved)[:ELSEWHERE]:
            cost, point = min((cost, point), solve(problem, other, held=i)[:2], key=lambda end: end[0])
    return cost, point
