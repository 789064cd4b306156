"""A library model as a least-squares problem over some of its inputs, and how well a fit identifies each of them.

Knows no file, no units and no statistics; all values SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import isfinite, sqrt
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from pmabench.analysis.shared.calibration import listed
from pmabench.model.library import Model, OutsideDomain, Parameter, check
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array

RANK = 1e-6
"""Singular value of the Jacobian with columns of length 1, by the largest, below which nothing is identifiable."""
TOGETHER = 0.99
"""Correlation from which on two unknowns move together."""
MOST = 4
"""Pairs that are named."""


@dataclass(frozen=True)
class Spread:
    """How well the unknowns are known [SI]; shapes (p,), (p, p)."""

    errors: tuple[float | None, ...]
    """Standard errors; None where not identifiable or without degrees of freedom."""
    covariance: Array
    """NaN in rows and columns that are not identifiable."""
    correlation: Array
    tied: tuple[tuple[int, ...], ...]
    """Unknowns that the data determine in combination only: for each combination left open, their places."""


def spread_of(slopes: Array, squares: float, freedom: int) -> Spread:
    """From derivatives of the output (n, p) and the sum of squares at the best values [squares of the output]."""
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


def identifiability(
    names: Sequence[str],
    spread: Spread,
    intervals: Sequence[tuple[float | None, float | None] | None],
    at_end: Sequence[str],
) -> list[Finding]:
    """Doubts on single unknowns: no effect, tied to others, open intervals, an end of the domain; then pairs."""
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
"""Starts from which is fitted, the reference values among them; these alone where a net cannot fill the domain."""
TRIED = 200
"""Points of the domain of which the best become starts."""
STEP = 6e-6
"""Step of central differences, as a share of a parameter's size."""
WIDE = 20.0
"""A domain that reaches further than this beyond the reference value is searched within a factor of 5 of it."""
FLAT = 1e-5
"""Cosine between the residuals and the slopes by an unknown, up to which a fit is at its end."""
MOST_EVALUATIONS = 400
"""Of the residual, in one fit from one start."""
TOGETHER_AT_MOST = 1_000_000
"""Outputs that are computed in one call, for their memory."""
FEW = 8
"""Unknowns up to which a net can fill the domain."""
ELSEWHERE = 3
"""Points of the net from which is fitted again where a profile seems to end."""
SHORTEST = 6
"""Halvings of a step along a valley to keep near it,"""
REFUSED = 12
"""and to get past places where the model does not hold."""


@dataclass
class Problem:
    """A model over its unknowns at the measured rows, all SI: output, residuals, slopes, bounds."""

    model: Model
    output: str
    names: Sequence[str]
    inputs: Mapping[str, Any]
    measured: Array | None
    """None where only the output is asked for."""
    count: int = field(init=False)
    span: float = field(init=False)
    size: Array = field(init=False)
    low: Array = field(init=False)
    high: Array = field(init=False)
    fixed: Mapping[str, Any] | None = field(init=False, default=None)
    """All inputs but the unknowns, once each was looked at; None where one of them is refused."""

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
        """The output, shape (count,); raises OutsideDomain."""
        return np.array(self.outputs_at(at[None])[0])

    def outputs_at(self, every: Array) -> Array:
        """The outputs at several places (places, unknowns), shape (places, count); raises OutsideDomain at any."""
        named = {name: every[:, [i]] for i, name in enumerate(self.names)}
        if self.fixed is not None and bool(np.all((every >= self.low) & (every <= self.high))):
            found = self.model.unchecked(**self.fixed, **named)
        else:
            found = self.model.evaluate({**self.inputs, **named})
        return np.broadcast_to(found[self.output], (len(every), self.count))

    def off_measured(self, output: Array) -> Array:
        """Computed less measured in units of the span."""
        return (output - (0.0 if self.measured is None else self.measured)) / self.span

    def residuals(self, at: Array) -> Array:
        """Computed less measured in units of the span; NaN where the model does not hold."""
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
        """Derivatives of the output by the unknowns, shape (count, unknowns); one-sided at the end of a domain."""
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
        """The output, or `middle` where the model refuses."""
        try:
            return self.output_at(at)
        except OutsideDomain:
            return middle


def _size(p: Parameter) -> float:
    """Typical size of an input: its reference value, or a usual value of its quantity."""
    value = abs(float(p.value))
    if value > 0:
        return value
    return float(p.high - p.low) if isfinite(p.high - p.low) and p.high > p.low else 1.0


def acting(
    model: Model, output: str, names: Sequence[str], inputs: Mapping[str, Any], start: Mapping[str, float] | None = None
) -> list[str]:
    """Those of `names` that change the output on these inputs, at or near `start` or the reference values."""
    known = {p.name: p for p in model.parameters}
    problem = Problem(model, output, names, inputs, None)
    first = np.array([float((start or {}).get(name, known[name].value)) for name in names])
    moves = np.zeros(len(names), dtype=bool)
    for share in (1.0, 0.9, 1.1):
        with suppress(OutsideDomain):
            moves |= (np.abs(problem.slopes(np.clip(share * first, problem.low, problem.high))) > 0).any(axis=0)
    return [name for name, does in zip(names, moves, strict=True) if does]


def net_of(problem: Problem, start: Array) -> list[Array]:
    """Points of a scrambled net of the domain around `start`, best first; none where it cannot fill the domain."""
    if len(start) > FEW:
        return []
    ranges = list(map(_range, start, problem.low, problem.high, problem.size))
    net = qmc.Halton(len(start), seed=0).random(TRIED)
    points = [np.array([low * (high / low) ** u if raised else low + (high - low) * u
                        for u, (low, high, raised) in zip(row, ranges, strict=True)]) for row in net]  # fmt: skip
    return _best_first(problem, points)


def _best_first(problem: Problem, points: Sequence[Array]) -> list[Array]:
    """Those of the points where the model holds."""
    costs = problem.costs(points)
    return [points[i] for i in np.argsort(costs) if isfinite(costs[i])]


def _range(start: float, low: float, high: float, size: float) -> tuple[float, float, bool]:
    """Where an unknown is searched, and whether evenly in its logarithm."""
    middle = abs(start) or size
    if low >= 0:
        ends = max(low, middle / 5), min(high, middle * 5)
        if isfinite(high) and high <= WIDE * middle and high > 0:
            ends = max(low, high / 1e3), high
        return (*ends, True) if ends[0] > 0 else (*ends, False)
    return max(low, start - 3 * middle), min(high, start + 3 * middle), False


End = tuple[float, Array, bool]
"""Sum of squares in units of the span, unknowns, whether it converged."""


def solve(problem: Problem, start: Array, held: int | None = None) -> End:
    """Least squares from `start`; unknown `held` stays where it is."""
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
    how: dict[str, Any] = {"x_scale": "jac", "xtol": fine * 1e-11, "ftol": fine * 1e-13, "gtol": fine * 1e-13}
    if len(free) <= problem.count:
        # MINPACK takes a third of the time, and knows no bounds: where they hold it up, the rest is done with them
        found = least_squares(residuals, inside, slopes, method="lm", max_nfev=MOST_EVALUATIONS, **how)
        lengths = np.linalg.norm(np.asarray(found.jac), axis=0) * np.sqrt(2 * found.cost)
        if found.status > 0 and bool(np.all(np.abs(found.grad) <= FLAT * lengths)):
            return 2.0 * float(found.cost), whole(np.asarray(found.x)), True
        inside = found.x
    found = least_squares(residuals, inside, slopes, (low, high), max_nfev=MOST_EVALUATIONS, **how)
    return 2.0 * float(found.cost), whole(np.asarray(found.x)), bool(found.status > 0)


def along(problem: Problem, point: Array, i: int, wanted: float, most: float) -> tuple[float, Array | None]:
    """`point` moved along the tangent of a valley towards `wanted` of unknown `i`, as far as the sum of squares stays
    below `most`, but a part of the way at least; None where the model refuses at once.
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
    """Sum of squares and unknowns of the refit with unknown `i` held as in `guess`: from there, and from the best of
    the net where that is not below `enough`.
    """
    cost, point, _ = solve(problem, guess, held=i)
    if cost >= enough:
        moved = [np.where(np.arange(len(guess)) == i, guess[i], other) for other in net]
        for other in _best_first(problem, moved)[:ELSEWHERE]:
            cost, point = min((cost, point), solve(problem, other, held=i)[:2], key=lambda end: end[0])
    return cost, point
