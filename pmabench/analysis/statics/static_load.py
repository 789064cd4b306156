"""Reduction of static-load runs: F_ce over pressure from the pressures at which loads lift off and set down.

Knows what the searches found; not how they were made, and not how the bench is built.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.declared import Result
from pmabench.analysis.results import Analysis, Curve, Dropped, Estimate, Finding, Parts, Trace
from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

KIND = "static-load"
RESULTS = (
    Result("F_ce", "contractile force", "force", headline=True),
    Result("F_f", "friction, half the difference of both directions", "force"),
)
"""What it can give; columns and figures have this order."""
MEAN, LIFT, SET_DOWN = "static-mean", "static-lift", "static-set-down"
SIDES = {LIFT: "lift", SET_DOWN: "set-down"}
"""Method -> phase of the search."""
HALF = "static-half-difference"
GRID = 50e3
"""F_ce is given at whole multiples of this pressure, as in paper 0 [Pa]."""
UNEQUAL = 0.25
"""Share of the half difference by which the mean may be off: a load lifts against stiction and sets down against
sliding friction, which is taken as at least 60 % of it."""
LONGEST_TRACE = 1500
SHOWN = 3


@dataclass(frozen=True, eq=False)
class _Line:
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
        return self.a + self.s * P

    def half(self, row: Array) -> float:
        """95 % half width of row @ (a, s)."""
        return self.factor * sqrt(max(0.0, float(row @ self.covariance @ row)))


@dataclass(frozen=True, eq=False)
class _Points:
    """What was found, one row per trial: load [N] and pressures [Pa]; nan where a search found nothing."""

    names: tuple[str, ...]
    load: Array
    lift: Array
    set_down: Array

    def side(self, method: str) -> Array:
        """Pressures of a method [Pa]."""
        if method == MEAN:
            return 0.5 * (self.lift + self.set_down)
        return self.lift if method == LIFT else self.set_down


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """F_ce [N] over pressure from lift, set-down and their mean, and half their difference [N] as friction.

    With the load F_L on its support, F_ce(P) - f = F_L at lift and F_ce(P) + f = F_L at set-down (paper 0 at
    x = 0 with friction f): the mean pressure of the two at each load belongs to F_ce = F_L. Lines by least squares of
    P on F_L, as it is P that carries the error. No options are known.
    """
    points, dropped = _points(runs)
    estimates: list[Estimate] = []
    curves: list[Curve] = []
    findings: list[Finding] = []
    lines: dict[str, _Line] = {}
    for method in (MEAN, LIFT, SET_DOWN):
        usable = np.isfinite(points.side(method))
        line = _fit(points.load[usable], points.side(method)[usable])
        if line is not None:
            lines[method] = line
    scales = Scales.of(runs)
    friction = _friction(points, lines)
    for method, line in lines.items():
        found, through = _of_line(points, method, line, lines.get(MEAN), friction, scales)
        estimates += found
        curves.append(through)
        findings += _line_findings(method, line)
    estimates += _half_differences(points, lines)
    if lines and (lack := scales.lack(["pressure"])):
        findings.append(Finding("note", lack))
    if not lines:
        findings.append(Finding("fault", "no line F_ce(P): fewer than two loads were found to lift or to set down"))
    elif MEAN not in lines:
        findings.append(Finding("doubt", "one direction only: F_ce is off by the friction of the muscle"))
    if MEAN in lines and friction is not None:
        text = f"lift and set-down lie {show(2 * friction, 'force', 3)} apart: friction of about half of that"
        findings.append(Finding("note", f"{text}, between sliding and static"))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        curves=curves,
        dropped=dropped,
        findings=findings,
        traces=_traces(runs, points),
        facts={
            "options": dict(options or {}),
            "trials": sum(len(run.trials) for run in runs),
            "trials_used": len(points.names),
            "loads": len(np.unique(points.load)),
            "residual_rms": lines[MEAN].rms if MEAN in lines else None,
            "table": _table(points),
        },
    )


def _points(runs: Sequence[RunData]) -> tuple[_Points, list[Dropped]]:
    rows: list[tuple[str, float, float, float]] = []
    dropped: list[Dropped] = []
    for run in runs:
        for trial in run.trials:
            name = trial.name
            found = {phase: trial.found.get(phase) or {} for phase in ("lift", "set-down")}
            pressures = {phase: _pressure(result) for phase, result in found.items()}
            if trial.status not in ("finished", "failed"):
                dropped.append(Dropped(name, trial.point, f"the trial is {trial.status}"))
            elif "load" not in trial.point:
                dropped.append(Dropped(name, trial.point, "the trial names no load"))
            elif not np.isfinite(list(pressures.values())).any():
                reasons = [str(result["reason"]) for result in found.values() if result.get("reason")]
                dropped.append(Dropped(name, trial.point, "; ".join(reasons) or "neither lift nor set-down was found"))
            else:
                rows.append((name, trial.point["load"], pressures["lift"], pressures["set-down"]))
    columns = np.array([row[1:] for row in rows], dtype=np.float64).reshape(len(rows), 3)
    return _Points(tuple(row[0] for row in rows), columns[:, 0], columns[:, 1], columns[:, 2]), dropped


def _pressure(result: Mapping[str, Any]) -> float:
    """Pressure of a search's result [Pa]; nan where it found nothing."""
    value = result.get("pressure")
    return float(value) if result.get("found", True) and isinstance(value, int | float) else float("nan")


def _fit(load: Array, P: Array) -> _Line | None:
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
    return _Line(
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


def _friction(points: _Points, lines: Mapping[str, _Line]) -> float | None:
    """Half difference of lift and set-down over all trials [N]."""
    apart = 0.5 * (points.lift - points.set_down)
    apart = apart[np.isfinite(apart)]
    return float(np.mean(apart)) * lines[MEAN].s if MEAN in lines and len(apart) else None


def _of_line(
    points: _Points,
    method: str,
    line: _Line,
    mean: _Line | None,
    friction: float | None,
    scales: Scales,
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
            note=sentences(few, "" if bias is None else f"bias: against {MEAN}, the friction of one direction"),
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


def _half_differences(points: _Points, lines: Mapping[str, _Line]) -> list[Estimate]:
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


def _line_findings(method: str, line: _Line) -> list[Finding]:
    if method != MEAN:
        return []
    text = f"F_ce = {show(line.a, 'force', 4)} + {show(line.s, 'force per pressure', 5)} P"
    left = f"residual {show(line.rms, 'force', 2)} rms" if line.factor else "through two points"
    found = [Finding("note", f"{text}, {left}")]
    if line.lack > 3.0 and line.rms > 0.5:
        found.append(
            Finding(
                "doubt",
                f"the loads lie off the line {line.lack:.2g} times as far as their repeats scatter: F_ce(P) is no line"
                " over these pressures",
            )
        )
    return found


def _table(points: _Points) -> list[dict[str, float | int | None]]:
    """Per load: number of trials, mean and standard deviation of the pressures."""
    rows: list[dict[str, float | int | None]] = []
    for load in np.unique(points.load):
        row: dict[str, float | int | None] = {"load": float(load), "n": int((points.load == load).sum())}
        for name, values in (("lift", points.lift), ("set_down", points.set_down)):
            known = values[(points.load == load) & np.isfinite(values)]
            row[name] = float(known.mean()) if len(known) else None
            row[f"{name}_sd"] = float(known.std(ddof=1)) if len(known) > 1 else None
        rows.append(row)
    return rows


def _traces(runs: Sequence[RunData], points: _Points) -> tuple[Trace, ...]:
    """All points, and displacement over pressure of a few trials."""
    if not points.names:
        return ()
    traces = [
        Trace(
            name="static-load",
            figure="static",
            title="Pressure at which each load lifts and sets down",
            columns={"load": points.load, "lift": points.lift, "set_down": points.set_down},
            quantities={"load": "force", "lift": "pressure", "set_down": "pressure"},
        )
    ]
    trials = {trial.name: trial for run in runs for trial in run.trials}
    first = [points.names[int(np.flatnonzero(points.load == load)[0])] for load in np.unique(points.load)]
    for name in dict.fromkeys(first[round(i)] for i in np.linspace(0, len(first) - 1, SHOWN)):
        traces += _lift_trace(trials[name])
    return tuple(traces)


def _lift_trace(trial: TrialData) -> list[Trace]:
    if "pressure" not in trial.channels or "displacement" not in trial.channels or not len(trial.t):
        return []
    stride = -(-len(trial.t) // LONGEST_TRACE)
    marks = {phase: _pressure(trial.found.get(phase) or {}) for phase in SIDES.values()}
    return [
        Trace(
            name=f"lift-{trial.point['load']:.0f}N",
            figure="lift",
            title=f"{show(trial.point['load'], 'force', 4)}: lift and set-down",
            columns={
                "t": (trial.t - trial.t[0])[::stride],
                "pressure": trial.channels["pressure"][::stride],
                "displacement": trial.channels["displacement"][::stride],
            },
            quantities={"t": "time", "pressure": "pressure", "displacement": "length"},
            marks={"load": trial.point["load"], **{name: P for name, P in marks.items() if np.isfinite(P)}},
        )
    ]
