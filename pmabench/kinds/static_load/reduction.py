"""Reduction of static-load runs: F_ce over pressure from the pressures at which loads lift off and set down.

Knows what the searches found; not how they were made, and not how the bench is built.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.verdict.agreement import SAME, Offer, Place, anywhere, at_pressures, between
from pmabench.base.quantities import show
from pmabench.kinds.static_load import RESULTS, figures
from pmabench.kinds.static_load.points import LIFT, MEAN, SET_DOWN, Points, Stiffness, carried, points_of
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Parts
from pmabench.store.records import Array, RunData

KIND = "static-load"
HALF = "static-half-difference"
OF_ONE_SIDE = f"bias: against {MEAN}, the friction of one direction"
GRID = 50e3
"""F_ce is given at whole multiples of this pressure, as in paper 0 [Pa]."""
UNEQUAL = 0.35
"""Share of the half difference by which the mean may be off: a load lifts against stiction and sets down against
sliding friction, which is taken as at least 60 % of it, and a slow muscle is damped by up to twice as much one way."""


@dataclass(frozen=True, eq=False)
class Line:
    """F_ce = a + s P [N, N/Pa] with the covariance (2, 2) of (a, s), to be multiplied by t squared."""

    a: float
    s: float
    covariance: Array
    factor: float
    """Student's t for 95 %."""
    r2: float
    rms: float
    """Residual [N]."""
    lack: float
    """Root mean square distance of the loads' means from the line, by what their repeats allow; 0 if not known."""

    def __call__(self, P: float) -> float:
        """F_ce [N] at P [Pa]."""
        return self.a + self.s * P

    def half(self, row: Array) -> float:
        """95 % half width of row @ (a, s)."""
        return self.factor * sqrt(max(0.0, float(row @ self.covariance @ row)))


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """F_ce [N] over pressure from lift, set-down and their mean, and half their difference [N] as friction.

    With the load F_L on its support, F_ce(P) - f = F_L at lift and F_ce(P) + f = F_L at set-down (paper 0 at
    x = 0 with friction f): the mean pressure of the two at each load belongs to F_ce = F_L. Lines by least squares of
    P on F_L, as it is P that carries the error.

    A load that was lifted hangs above its support when it breaks away again: the mean is of pressures carried to x = 0
    along the load's own way down, or with the option `stiffness` (K over pressure from another test of the specimen,
    `points.option_of`) where that is too short; the sides by themselves are the paper's, as they were found.
    """
    points, dropped = points_of(runs)
    plain = points
    estimates: list[Estimate] = []
    curves: list[Curve] = []
    findings: list[Finding] = []
    lines: dict[str, Line] = {}
    uncorrected: Line | None = None
    for method in (LIFT, SET_DOWN, MEAN):
        if method == MEAN and SET_DOWN in lines:
            stiffness = Stiffness.of((options or {}).get("stiffness"))
            moved = _carried(runs, points, lines[SET_DOWN].s, stiffness)
            uncorrected, points = (None, points) if moved is None else (_fit_side(points, MEAN), moved)
        line = _fit_side(points, method)
        if line is not None:
            lines[method] = line
    lines = {method: lines[method] for method in (MEAN, LIFT, SET_DOWN) if method in lines}
    scales = Scales.of(runs)
    friction = _friction(points, lines)
    for method, line in lines.items():
        of = points if method == MEAN else plain
        found, through = _of_line(of, method, line, lines.get(MEAN), friction, scales, uncorrected)
        estimates += found
        curves.append(through)
        findings += figures.line_findings(line) if method == MEAN else []
    estimates += _half_differences(points, lines)
    if lines and (lack := scales.lack(["pressure"])):
        findings.append(Finding("note", lack))
    findings += _of_both_ways(points, lines, friction, uncorrected)
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        curves=curves,
        dropped=dropped,
        findings=findings,
        traces=figures.traces(runs, plain),
        facts={
            "options": dict(options or {}),
            "trials": sum(len(run.trials) for run in runs),
            "trials_used": len(points.names),
            "loads": len(np.unique(points.load)),
            "residual_rms": lines[MEAN].rms if MEAN in lines else None,
            "table": figures.table(plain),
        },
    )


def _of_both_ways(
    points: Points, lines: Mapping[str, Line], friction: float | None, uncorrected: Line | None
) -> list[Finding]:
    """What is missing of lift and set-down, and the friction that their difference shows."""
    findings = []
    if not lines:
        findings.append(Finding("fault", "no line F_ce(P): fewer than two loads were found to lift or to set down"))
    elif MEAN not in lines:
        findings.append(Finding("doubt", "one direction only: F_ce is off by the friction of the muscle"))
    if MEAN in lines and friction is not None:
        text = f"lift and set-down lie {show(2 * friction, 'force', 3)} apart: friction of about half of that"
        text += ", at which a muscle at rest begins to move; F_c of other tests is that of a muscle that moves"
        findings.append(Finding("note", f"{text}, and is smaller or alike"))
        findings.append(figures.of_place(points, uncorrected, lines[MEAN]))
    return findings


def _fit_side(points: Points, method: str) -> Line | None:
    usable = np.isfinite(points.side(method))
    return _fit(points.load[usable], points.side(method)[usable])


def _carried(runs: Sequence[RunData], points: Points, slope: float, stiffness: Stiffness | None) -> Points | None:
    """The points with lift and set-down carried to x = 0; None where some set-down could not be."""
    trials = {trial.name: trial for run in runs for trial in run.trials}
    rows = zip(points.names, points.lift, points.set_down, strict=True)
    moved = [carried(trials[name], {"lift": lift, "set-down": down}, slope, stiffness) for name, lift, down in rows]
    lift, down, half, place = np.array([(one.lift, one.set_down, one.half, one.place) for one in moved]).T
    if not np.isfinite(place[np.isfinite(points.set_down)]).all():
        return None
    return replace(points, lift=lift, set_down=down, uncertain=float(half.mean()), place=float(np.nanmean(place)))


def _fit(load: Array, P: Array) -> Line | None:
    """P = c + m F_L by least squares, turned into F_ce = (P - c) / m; None below two loads.

    The covariance is that of single points or that of the loads' means, whichever is wider: repeats of one load share
    what the line cannot follow there.
    """
    names, group, count = np.unique(np.round(load, 3), return_inverse=True, return_counts=True)
    if len(names) < 2:
        return None
    design = np.column_stack([np.ones_like(load), load])
    inverse = np.linalg.inv(design.T @ design)
    c, m = inverse @ (design.T @ P)
    if m <= 0:
        return None
    residual = P - c - m * load
    chosen, factor = np.zeros((2, 2)), 0.0
    middle = np.array([1.0, float(load.mean())])
    means = np.bincount(group, residual) / count
    for power, freedom in ((float(residual @ residual), len(P) - 2), (float(count @ means**2), len(names) - 2)):
        if freedom < 1:
            continue
        covariance, t = power / freedom * inverse, float(student.ppf(0.975, freedom))
        if t**2 * (middle @ covariance @ middle) > factor**2 * (middle @ chosen @ middle):
            chosen, factor = covariance, t
    turn = np.array([[-1 / m, c / m**2], [0.0, -1 / m**2]])
    total = float(np.sum((P - P.mean()) ** 2))
    return Line(
        a=float(-c / m),
        s=float(1 / m),
        covariance=turn @ chosen @ turn.T,
        factor=factor,
        r2=1.0 - float(residual @ residual) / total,
        rms=float(np.sqrt(np.mean(residual**2)) / m),
        lack=_lack(residual, group, means, count),
    )


def _lack(residual: Array, group: NDArray[np.intp], means: Array, count: NDArray[np.intp]) -> float:
    """Scatter of the loads' means about the line by what the scatter of repeats explains, as a ratio of deviations."""
    within, freedom = residual - means[group], len(residual) - len(means)
    if freedom < 1 or len(means) < 3:
        return 0.0
    pure = float(within @ within) / freedom
    between = float(count @ means**2) / (len(means) - 2)
    return sqrt(between / pure) if pure > 0 else 0.0


def _friction(points: Points, lines: Mapping[str, Line]) -> float | None:
    """Half difference of lift and set-down over all trials [N]."""
    apart = 0.5 * (points.lift - points.set_down)
    apart = apart[np.isfinite(apart)]
    return float(np.mean(apart)) * lines[MEAN].s if MEAN in lines and len(apart) else None


def _of_line(
    points: Points,
    method: str,
    line: Line,
    mean: Line | None,
    friction: float | None,
    scales: Scales,
    uncorrected: Line | None,
) -> tuple[list[Estimate], Curve]:
    """F_ce on the grid inside the domain, and the line itself; one-sided lines carry their distance to the mean.

    Calibration: with P off by an offset o and a gain g, F_ce(P) is off by s (o + g P), the slope by s g.
    """
    P = points.side(method)
    usable = np.isfinite(P)
    low, high = float(P[usable].min()), float(P[usable].max())
    names = tuple(name for name, use in zip(points.names, usable, strict=True) if use)
    two_sided = method == MEAN
    few = "" if line.factor else "no repeats part: two points leave no scatter about the line through them"

    def estimate(row: Array, calibration: float | None, at: float | None, coordinate: str = "") -> Estimate:
        value = float(row @ (line.a, line.s))
        bias = None
        off = UNEQUAL * abs(friction) if two_sided and friction is not None and row[0] else 0.0
        if two_sided and uncorrected is not None:
            bias = float(row @ (uncorrected.a, uncorrected.s)) - value
            off = hypot(off, 0.5 * points.uncertain * line.s * row[0])
        if not two_sided and mean is not None:
            bias = value - float(row @ (mean.a, mean.s))
            off = abs(bias)
        slope = coordinate == "slope"
        return Estimate(
            symbol="F_ce",
            value=value,
            unit="N/Pa" if slope else "N",
            quantity="force per pressure" if slope else "force",
            method=method,
            at={} if at is None else {"pressure": at},
            parts=Parts(repeats=line.half(row) if line.factor else None, method=off, calibration=calibration),
            n=len(names),
            bias=bias,
            corrected=two_sided and bias is not None,
            note=sentences(few, "" if bias is None else "bias: K x at set-down" if two_sided else OF_ONE_SIDE),
            trials=names,
            coordinate=coordinate,
        )

    first, last = int(np.ceil(low / GRID - 0.05)), int(np.floor(high / GRID + 0.05))
    grid = [GRID * k for k in range(first, last + 1)]
    shift = {"pressure": line.s}
    values = [estimate(np.array([1.0, at]), scales.part({"pressure": line.s * at}, shift), at) for at in grid]
    terms = (
        estimate(np.array([1.0, 0.0]), scales.part({}, shift), None, "intercept"),
        estimate(np.array([0.0, 1.0]), scales.part(shift), None, "slope"),
    )
    curve = Curve("F_ce", "line", terms, "pressure", (low, high), line.r2, line.rms, method)
    return values, curve


def _half_differences(points: Points, lines: Mapping[str, Line]) -> list[Estimate]:
    """Half the difference of lift and set-down in N, per load and over all: friction, between F_c and F_s.

    The pressure's scale drops out of it: a gain changes the difference and the slope alike.
    """
    if MEAN not in lines:
        return []
    half = 0.5 * lines[MEAN].s * (points.lift - points.set_down)
    estimates = []
    groups: list[tuple[dict[str, float], NDArray[np.bool_]]] = [({}, np.ones(len(half), dtype=np.bool_))]
    groups += [({"load": float(load)}, points.load == load) for load in np.unique(points.load)]
    for at, rows in groups:
        rows = rows & np.isfinite(half)
        n = int(rows.sum())
        if not n:
            continue
        values = half[rows] if at else _means(points.load[rows], half[rows])
        few = len(values) < 2
        spread = None if few else float(student.ppf(0.975, len(values) - 1) * values.std(ddof=1) / sqrt(len(values)))
        estimates.append(
            Estimate(
                symbol="F_f",
                value=float(np.mean(values)),
                unit="N",
                quantity="force",
                method=HALF,
                at=at,
                parts=Parts(repeats=spread, calibration=0.0),
                n=n,
                note=sentences(
                    f"no repeats part: {'one trial at this load' if at else 'one load'}" if few else "",
                    "half the difference of lift and set-down: between sliding and static friction",
                    "no method part: what the search adds is not assessed",
                ),
                trials=tuple(name for name, use in zip(points.names, rows, strict=True) if use),
            )
        )
    return estimates


def _means(group: Array, values: Array) -> Array:
    """Mean of the values of each group."""
    return np.array([values[group == name].mean() for name in np.unique(group)])


def offers(analysis: Analysis) -> Iterator[Offer]:
    """F at x = 0, a line over pressure and so known between its points, and friction at rest, which F_c is below."""
    known = at_pressures(analysis, "F_ce", MEAN)
    line = sorted(known.items())

    def at(place: Place) -> Estimate | None:
        P, x = place
        return between(line, P) if x is not None and abs(x) <= SAME else None

    yield Offer("F", {(P, 0.0): e for P, e in line}, at)
    why = "that of a muscle at rest is static friction, F_c is that of a moving one, and the smaller"
    for e in analysis.estimates:
        if e.method == HALF and not e.at and e.value is not None:
            yield replace(anywhere("F_c", e, "friction at rest"), side=1, why=why)
