"""Fit of a library model to measured rows: unknown inputs with intervals, residual, identifiability.

Least squares by scipy within the domains of the inputs, from several starts; intervals from the profile of the sum of
squares (Bates and Watts 1988, chapter 6). All values SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, isfinite, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.model_problem import (
    FEW,
    STARTS,
    End,
    Problem,
    Spread,
    acting,
    along,
    identifiability,
    lowest,
    net_of,
    solve,
    spread_of,
    with_halves,
)
from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import listed
from pmabench.model.library import Model
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array

EXACT = 1e-7
"""Residual rms over the output's span below which the data are taken to be computed by the model itself."""
ENOUGH = 4
"""Number of starts with the lowest sum of squares after which no more are tried."""
SAME = 1e-6
BETTER = 6
"""Number of better minima found by profiles from which on the fit counts as not converged."""
WALK = 60
"""Most iterations of the search for one end of an interval."""
AHEAD = 3.0
"""A step of this search is shortened until the sum of squares is below that at this multiple of the limit."""
CLOSE = 0.01
"""Tolerance of an end, as a share of the half width or of the limit."""
ALIKE = 0.5
"""Correlation of neighbouring residuals above which rows do not count as independent."""


Interval = tuple[float | None, float | None]
"""Ends of a 95 % interval; None for an end that is not reached within the domain."""


@dataclass(frozen=True)
class Unknown:
    """A fitted input [SI]."""

    name: str
    value: float
    standard_error: float | None
    """From the Jacobian; None where the input is not identifiable or without degrees of freedom."""
    ci95: Interval | None
    start: float
    note: str = ""


@dataclass(frozen=True)
class Follows:
    """Another output that is one number for all rows [SI]; no error where it does not depend on the unknowns."""

    name: str
    value: float
    standard_error: float | None
    ci95: tuple[float, float] | None


@dataclass(frozen=True)
class ModelFit:
    """Result of a fit."""

    model: Model
    output: str
    unknowns: tuple[Unknown, ...]
    follows: tuple[Follows, ...]
    fixed: Mapping[str, Any]
    """Inputs that were not fitted."""
    idle: tuple[str, ...]
    """Names of the fixed inputs that do not affect the output here."""
    columns: Mapping[str, Array]
    measured: Array
    computed: Array
    covariance: Array
    """Covariance of the unknowns, in their order; NaN where not identifiable."""
    correlation: Array
    residual_rms: float
    """Root of the sum of squares over the degrees of freedom [SI of the output]."""
    freedom: int
    starts: int
    agreeing: int
    """Number of starts that ended at these values."""
    converged: bool
    method: str
    """How intervals were found: `profile` or `jacobian`."""
    findings: tuple[Finding, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """The fitted inputs [SI] by name."""
        return {unknown.name: unknown.value for unknown in self.unknowns}

    def identified(self, name: str, unit: str) -> tuple[float | None, float | None, str]:
        """Value, half width [SI] and note of an unknown; None, None and the reason where it is not identifiable.

        The half width is the distance to the farther end of the interval. `unit` is used in the reason only.
        """
        (one,) = (unknown for unknown in self.unknowns if unknown.name == name)
        low, high = one.ci95 or (None, None)
        if not self.converged:
            return None, None, "the fit did not converge"
        if low is None or high is None:
            return None, None, f"not identifiable from what was tested: fitted {one.value:.4g} {unit}"
        return one.value, max(high - one.value, one.value - low), one.note

    def band(self, values: Mapping[str, Any]) -> tuple[Array, Array | None]:
        """The output at other inputs, and the half width of its 95 % confidence band.

        The half width is None where the covariance is not known. Raises OutsideDomain where the model does not hold.
        """
        at = np.array([u.value for u in self.unknowns])
        problem = Problem(self.model, self.output, [u.name for u in self.unknowns], {**self.fixed, **values}, None)
        middle = problem.output_at(at)
        if not np.isfinite(self.covariance).all():
            return middle, None
        slope = problem.slopes(at)
        variance = np.maximum(np.einsum("ij,jk,ik->i", slope, self.covariance, slope), 0)
        return middle, float(student.ppf(0.975, self.freedom)) * np.sqrt(variance)


def fit_model(
    model: Model,
    output: str,
    columns: Mapping[str, Array],
    fixed: Mapping[str, Any],
    measured: Array,
    unknown: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
    halves: Array | None = None,
    profiles: bool = True,
    elsewhere: bool = True,
) -> ModelFit:
    """Fit the inputs `unknown` of `model` so that `output` follows `measured` (n,) at `columns` (n,) and `fixed`, SI.

    `start` replaces reference values in the first start. `halves` are 95 % half widths of `measured` (n,); they go into
    the intervals, not into the weights. Without `profiles` intervals are linear, which takes a fraction of the time;
    not `elsewhere`: no other start is tried, for rows that hardly differ from those whose fit `start` is.
    Raises ValueError where there are fewer rows than unknowns, or where the model holds at none of the starts.
    """
    problem = Problem(model, output, unknown, {**fixed, **columns}, measured)
    if len(measured) < len(unknown):
        rows = f"{len(measured)} row{'s' if len(measured) != 1 else ''}"
        raise ValueError(f"{rows} cannot give {len(unknown)} values; give some of them with --set")
    begin = {p.name: p.value for p in model.parameters} | dict(start or {})
    first = np.clip([float(begin[name]) for name in unknown], problem.low, problem.high)
    net = net_of(problem, first) if elsewhere else []
    ends = _ends(problem, [first, *net[: STARTS - 1]])
    best = min(ends, key=lambda end: end[0])
    tried = len(ends)
    freedom = len(measured) - len(unknown)
    exact = sqrt(best[0] / len(measured)) < EXACT
    method = "profile" if profiles and freedom > 0 and len(unknown) <= FEW and not exact else "jacobian"
    spread, intervals, better = _intervals(problem, best, freedom, net, profiled=method == "profile")
    ends = [*better, *ends]
    best = ends[0] if better else best
    if halves is not None and freedom > 0:
        spread, intervals = _widened(problem, best[1], spread, intervals, halves, freedom)
    computed = problem.output_at(best[1])
    at_end = _at_ends(problem, best[1])
    findings = identifiability(unknown, spread, intervals, at_end)
    findings += _other_minima(unknown, ends, best, spread, freedom)
    findings += _of_residuals(computed - measured, exact=exact, freedom=freedom)
    if not best[2]:
        findings.insert(0, Finding("fault", "the fit did not converge; give start values with --start or fix some"))
    return ModelFit(
        model=model,
        output=output,
        unknowns=tuple(map(Unknown, unknown, best[1].tolist(), spread.errors, intervals, first.tolist(), at_end)),
        follows=_follows(problem, best[1], spread, freedom),
        fixed={name: value for name, value in fixed.items() if name not in unknown},
        idle=_idle(problem, fixed, best[1]),
        columns=dict(columns),
        measured=measured,
        computed=computed,
        covariance=spread.covariance,
        correlation=spread.correlation,
        residual_rms=sqrt(best[0] / max(1, freedom)) * problem.span,
        freedom=freedom,
        starts=tried,
        agreeing=sum(_same(end, best, spread, problem.size) for end in ends[-tried:]),
        converged=best[2],
        method=method,
        findings=tuple(findings),
    )


def _ends(problem: Problem, starts: Sequence[Array]) -> list[End]:
    """Results of the fit from each start, until `ENOUGH` are as low as the best; ValueError without a valid start."""
    begun = [at for at in starts if np.isfinite(problem.residuals(at)).all()]
    if not begun:
        raise ValueError("the model holds at none of the start values; give better ones with --start")
    ends: list[End] = []
    for at in begun:
        ends.append(solve(problem, at))
        best = min(ends, key=lambda end: end[0])
        if sum(_as_low(end, best) for end in ends) >= ENOUGH:
            break
    return ends


def _intervals(
    problem: Problem, best: End, freedom: int, net: Sequence[Array], *, profiled: bool
) -> tuple[Spread, list[Interval | None], list[End]]:
    """Spread, interval of each unknown, and better minima that the profiles found, the best first."""
    better: list[End] = []
    for _ in range(BETTER if profiled else 0):
        spread = spread_of(problem.slopes(best[1]), best[0] * problem.span**2, freedom)
        intervals, point = _profiles(problem, best, spread, freedom, net)
        if point is None:
            return spread, intervals, better
        best = min(solve(problem, point), best, key=lambda end: end[0])
        better.insert(0, best)
    if better:  # the last profile found a better one, too
        better[0] = best = (*best[:2], False)
    spread = spread_of(problem.slopes(best[1]), best[0] * problem.span**2, freedom)
    return spread, [_wald(v, s, freedom) for v, s in zip(best[1], spread.errors, strict=True)], better


def _widened(
    problem: Problem, at: Array, spread: Spread, intervals: Sequence[Interval | None], halves: Array, freedom: int
) -> tuple[Spread, list[Interval | None]]:
    """Spread and intervals with what half widths of the rows add, in squares at each end."""
    limit = float(student.ppf(0.975, freedom))
    wider = with_halves(spread, problem.slopes(at), halves, limit)
    found: list[Interval | None] = []
    for value, old, new, ends in zip(at.tolist(), spread.errors, wider.errors, intervals, strict=True):
        more = limit * sqrt(max(0.0, (new or 0.0) ** 2 - (old or 0.0) ** 2))
        low, high = ends or (None, None)
        wide = (
            None if low is None else value - hypot(value - low, more),
            None if high is None else value + hypot(high - value, more),
        )
        found.append(None if ends is None else wide)
    return wider, found


def _wald(value: float, error: float | None, freedom: int) -> Interval | None:
    if error is None or freedom < 1:
        return None
    half = float(student.ppf(0.975, freedom)) * error
    return float(value) - half, float(value) + half


def _profiles(
    problem: Problem, best: End, spread: Spread, freedom: int, net: Sequence[Array]
) -> tuple[list[Interval | None], Array | None]:
    """Intervals at whose ends the sum of squares, others refitted, has risen by t^2 s^2; or a point below `best`."""
    limit = float(student.ppf(0.975, freedom))
    found: list[Interval | None] = []
    for i, error in enumerate(spread.errors):
        ends: list[float | None] = []
        for way in (-1.0, 1.0) if error is not None else ():
            end, better = _end(problem, best, i, way * limit * (error or 0.0), limit, best[0] / freedom, net)
            if better is not None:
                return found, better
            ends.append(end)
        found.append((ends[0], ends[1]) if ends else None)
    return found, None


def _end(
    problem: Problem, best: End, i: int, reach: float, limit: float, variance: float, net: Sequence[Array]
) -> tuple[float | None, Array | None]:
    """One end of a profile interval by secants, or None beyond the domain; and a point better than `best`, or None.

    An end counts only where no start of the net gives less either: a refit may end in a local minimum.
    """
    middle, stop = float(best[1][i]), float(problem.high[i] if reach > 0 else problem.low[i])
    inner, point, outer, wanted = middle, best[1], None, middle + reach
    for _ in range(WALK):
        wanted = min(wanted, stop) if reach > 0 else max(wanted, stop)
        wanted, guess = along(problem, point, i, wanted, best[0] + (AHEAD * limit) ** 2 * variance)
        if guess is None:  # a refusal ends the domain here
            return outer, None
        cost, refitted = lowest(problem, guess, net, i, best[0] + ((1 - CLOSE) * limit) ** 2 * variance)
        if cost < best[0] * (1 - 1e-4):
            return None, refitted
        rise = sqrt(max(cost - best[0], 0.0) / variance)
        if abs(rise - limit) < CLOSE * limit:
            return wanted, None
        if rise > limit:
            outer = wanted
        elif wanted == stop:
            return None, None
        else:
            inner, point = wanted, refitted
        wanted = middle + (wanted - middle) * min(3.0, limit / rise if rise > 0 else 3.0)
        if outer is not None:
            gap = outer - inner
            if abs(gap) < CLOSE * abs(outer - middle):
                return None if outer == stop else outer, None
            wanted = inner + float(np.clip((wanted - inner) / gap, 0.1, 0.9)) * gap
    return outer, None


def _as_low(end: End, best: End) -> bool:
    return end[0] <= best[0] * (1 + 1e-4) + 1e-14


def _same(end: End, best: End, spread: Spread, size: Array) -> bool:
    """Whether the fit from a start ended at the best values."""
    if not _as_low(end, best):
        return False
    errors = np.array([np.inf if e is None else e for e in spread.errors])
    room = 0.1 * errors + 1e-4 * np.maximum(np.abs(best[1]), 1e-3 * size)
    return bool((np.abs(end[1] - best[1]) <= room).all())


def _at_ends(problem: Problem, at: Array) -> list[str]:
    """For each unknown the end of its domain at which it lies, as text, or an empty one."""
    words = []
    for value, low, high, size in zip(at, problem.low, problem.high, problem.size, strict=True):
        ends = {"lower": low, "upper": high}
        near = [word for word, end in ends.items() if isfinite(end) and abs(value - end) < SAME * size]
        words.append(f"at the {near[0]} end of its domain" if near else "")
    return words


def _other_minima(names: Sequence[str], ends: Sequence[End], best: End, spread: Spread, freedom: int) -> list[Finding]:
    """A doubt where the fit from another start ended at other values with nearly the same residual."""
    if freedom < 1 or any(e is None for e in spread.errors):
        return []
    ratio = 1 + 4 * len(names) / freedom
    for end in ends:
        far = [
            name
            for name, one, other, error in zip(names, best[1], end[1], spread.errors, strict=True)
            if abs(other - one) > 5 * (error or 0.0) + 1e-3 * abs(one)
        ]
        if end[2] and best[0] < end[0] * (1 - 1e-6) and end[0] < best[0] * ratio and far:
            more = sqrt(end[0] / best[0])
            text = f"other values of {listed(far)} fit nearly as well (residual {more:.3g} times as large)"
            return [Finding("doubt", f"{text}; data over a wider range would separate them")]
    return []


def _of_residuals(residual: Array, *, exact: bool, freedom: int) -> list[Finding]:
    """Findings on the degrees of freedom and on correlated residuals."""
    if freedom < 1:
        return [Finding("doubt", "as many rows as unknowns: nothing is left to take an interval from")]
    if exact:
        return [Finding("note", "the data follow the model to rounding: the intervals say nothing of a measurement")]
    off = residual - residual.mean()
    power = float(off @ off)
    alike = float(off[1:] @ off[:-1]) / power if power > 0 else 0.0
    if len(residual) >= 20 and alike > ALIKE:
        text = f"residuals of neighbouring rows are alike (correlation {alike:.2f})"
        return [Finding("doubt", f"{text}: the model misses something, and the intervals are too narrow")]
    return []


def _idle(problem: Problem, fixed: Mapping[str, Any], at: Array) -> tuple[str, ...]:
    """Names of fixed numeric inputs that do not affect the output at the best values."""
    held = {p.name: float(fixed[p.name]) for p in problem.model.parameters if p.name in fixed and not p.choices}
    inputs = {**problem.inputs, **dict(zip(problem.names, at.tolist(), strict=True))}
    moving = acting(problem.model, problem.output, list(held), inputs, held)
    return tuple(name for name in held if name not in moving)


def _follows(problem: Problem, at: Array, spread: Spread, freedom: int) -> tuple[Follows, ...]:
    """Other outputs that are one number for all rows."""
    found = []
    for output in problem.model.outputs:
        other = Problem(problem.model, output.name, problem.names, problem.inputs, None)
        values = other.output_at(at)
        size = float(np.abs(values).max())
        if output.name == problem.output or not np.isfinite(values).all() or float(np.ptp(values)) > 1e-9 * size:
            continue
        slope = other.slopes(at)[0]
        error = half = None
        power = float(slope @ spread.covariance @ slope) if np.isfinite(spread.covariance).all() else float("nan")
        if np.any(slope) and isfinite(power) and freedom > 0:
            error = sqrt(max(power, 0.0))
            half = float(student.ppf(0.975, freedom)) * error
        value = float(values[0])
        found.append(Follows(output.name, value, error, None if half is None else (value - half, value + half)))
    return tuple(found)
