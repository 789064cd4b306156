"""Reduction of static-load runs: F_ce over pressure from the pressures at which loads lift off and set down.

Uses the results of the searches; knows nothing of how they were made, or of the bench.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.verdict.agreement import SAME, Offer, Place, anywhere, at_pressures, between
from pmabench.base.quantities import show
from pmabench.kinds.static_load import RESULTS, figures
from pmabench.kinds.static_load.line import Line, Mean, fit_side, mean_of
from pmabench.kinds.static_load.points import (
    LIFT,
    MEAN,
    SET_DOWN,
    ByCell,
    Points,
    Stiffness,
    on_time_run,
    points_of,
    step_in,
    zero_moved,
)
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Parts, withhold
from pmabench.store.records import Array, RunData

KIND = "static-load"
HALF = "static-half-difference"
OF_ONE_SIDE = f"bias: against {MEAN}, the friction of one direction"
GRID = 50e3
"""F_ce is given at whole multiples of this pressure, as in paper 0 [Pa]."""
REVERSED = 0.5e3
"""Half of what set-down lies above lift from which on it is a doubt [Pa]."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """F_ce [N] over pressure from lift, set-down and their mean, and half their difference [N] as friction.

    With the load F_L on its support, F_ce(P) - f = F_L at lift and F_ce(P) + f = F_L at set-down (paper 0 at x = 0 with
    friction f): the mean pressure of both at each load belongs to F_ce = F_L. Lines by least squares of P on F_L, since
    the error is in P.

    A lifted load hangs above its support when it breaks away again: the mean is of pressures corrected to x = 0 along
    the load's own way down, or with the option `stiffness` (K over pressure from another test of the specimen,
    `points.option_of`) where that is too short; lines by lift or set-down alone are the paper's, uncorrected.
    Hysteresis that a raised load shows is subtracted, otherwise the interval covers it (`line`).
    """
    step = step_in(runs)
    runs = [on_time_run(run) for run in runs]
    plain, dropped = points_of(runs)
    plain = replace(plain, step=step, zero=zero_moved(runs))
    estimates, curves, findings = list[Estimate](), list[Curve](), list[Finding]()
    sides = {method: line for method in (LIFT, SET_DOWN) if (line := fit_side(plain, method)) is not None}
    stiffness = Stiffness.of((options or {}).get("stiffness"))
    mean = mean_of(runs, plain, sides[SET_DOWN].s, stiffness) if SET_DOWN in sides else None
    lines: dict[str, Line] = ({} if mean is None else {MEAN: mean.line}) | sides
    points = plain if mean is None else mean.points
    scales = Scales.of(runs)
    cell = ByCell.of(runs, scales.gains.get("force"), scales.offsets.get("force", 0.0))
    for method, line in lines.items():
        of = points if method == MEAN else plain
        found, through = _of_line(of, method, line, mean, scales, cell)
        estimates += found
        curves.append(through)
        findings += figures.line_findings(line) if mean is not None and method == MEAN and not mean.why else []
    estimates += _half_differences(points, lines)
    findings += scales.findings(lines, ["pressure"])
    findings += _of_both_ways(lines, mean, plain.zero)
    if cell is not None:
        way = "more" if cell.share > 0 else "less"
        text = (
            f"the load cell reads {abs(cell.share):.1%} {way} than the marks of the loads that hang on it, which its "
            "calibration does not allow: weigh the loads, and calibrate the cell. "
        )
        findings.append(Finding("doubt", f"{text}F_ce is given for the marks, and its intervals hold either"))
    facts = {
        "options": dict(options or {}),
        "trials": sum(len(run.trials) for run in runs),
        "trials_used": len(plain.names),
        "loads": len(np.unique(plain.load)),
        "residual_rms": lines[MEAN].rms if MEAN in lines else None,
        "hysteresis": mean.kept is not None if mean is not None and mean.raised else None,
    }
    traces = figures.traces(runs, plain)
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates, curves=curves, dropped=dropped, findings=findings,
        traces=traces, facts=facts,
    )  # fmt: skip


def _of_both_ways(lines: Mapping[str, Line], mean: Mean | None, zero: float) -> list[Finding]:
    """What lift and set-down lack, the friction from their difference, hysteresis, and drift.

    `zero`: as in `Points` [Pa].
    """
    findings = []
    if not lines:
        findings.append(Finding("fault", "no line F_ce(P): fewer than two loads were found to lift or to set down"))
    elif mean is None:
        findings.append(Finding("doubt", "one direction only: F_ce is off by the friction of the muscle"))
    if mean is not None and mean.friction is not None:
        text = f"lift and set-down lie {show(2 * mean.friction, 'force', 3)} apart: friction of about half of that"
        text += ", at which a muscle at rest begins to move; F_c of other tests is that of a muscle that moves, and is "
        larger = ", or larger by the hysteresis of a longer way" if mean.kept is not None else ""
        findings.append(Finding("note", f"{text}smaller or alike{larger}"))
        findings.append(figures.of_place(mean))
    if mean is not None and (mean.why or not mean.raised or mean.kept is not None):
        findings.append(figures.of_hysteresis(mean))
    if lines and zero:
        text = f"vented before each trial, the gauge reads up to {show(zero, 'pressure', 2)} apart: its zero drifts"
        findings.append(Finding("doubt", f"{text}, which is in the intervals; zero it, or let it warm up"))
    if mean is not None and mean.reversed > max(REVERSED, mean.points.step) * mean.line.s:
        text = "a load sets down at a higher pressure than it lifts, which no friction does: it swings, or hangs above"
        findings.append(Finding("doubt", f"{text} its support; half the difference is in the interval of F_ce"))
    return findings


def _of_line(
    points: Points, method: str, line: Line, mean: Mean | None, scales: Scales, cell: ByCell | None
) -> tuple[list[Estimate], Curve]:
    """F_ce on the grid inside the domain, and the line itself; lines of one direction have the difference to the mean
    as bias.

    Calibration: with P off by an offset o and a gain g, F_ce(P) is off by s (o + g P), the slope by s g.
    """
    P = points.side(method)
    usable = np.isfinite(P)
    low, high = float(P[usable].min()), float(P[usable].max())
    names = tuple(name for name, use in zip(points.names, usable, strict=True) if use)
    two_sided = method == MEAN
    of_mean = "bias: K x at set-down" if mean is None or mean.kept is None else "bias: hysteresis, and K x at set-down"
    few = "" if line.factor else "no repeats part: two loads do not show whether the line between them is straight"

    def estimate(row: Array, calibration: float | None, at: float | None, coordinate: str = "") -> Estimate:
        value = float(row @ (line.a, line.s))
        bias, off = None, 0.0
        if mean is not None and two_sided:
            off = mean.off(row)
            if mean.carried or mean.kept is not None:
                bias = float(row @ (mean.before.a, mean.before.s)) - value
        elif mean is not None:
            bias = value - float(row @ (mean.line.a, mean.line.s))
            off = abs(bias)
        off += 0.0 if cell is None else cell.of_force(line.a, line.s, row)
        unit, quantity = ("N/Pa", "force per pressure") if coordinate == "slope" else ("N", "force")
        drift = line.s * points.zero / (1.0 if row[0] else float(P[usable].mean()))
        parts = Parts(line.half(row) if line.factor else None, off, calibration, drift=drift)
        note = sentences(few, "" if bias is None else of_mean if two_sided else OF_ONE_SIDE)
        found = Estimate(
            "F_ce", value, unit, quantity, method, {} if at is None else {"pressure": at}, parts, len(names), bias,
            two_sided and bias is not None, note, names, coordinate,
        )  # fmt: skip
        return withhold(found, mean.why) if mean is not None and mean.why else found

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

    The pressure's scale cancels: a gain changes the difference and the slope alike.
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
        load = points.load[rows]
        values = half[rows] if at else np.array([half[rows][load == one].mean() for one in np.unique(load)])
        few = len(values) < 2
        mean, names = float(np.mean(values)), tuple(name for name, use in zip(points.names, rows, strict=True) if use)
        parts = Parts(spread(values), abs(mean), 0.0)
        note = sentences(
            f"no repeats part: {'one trial at this load' if at else 'one load'}" if few else "",
            "half the difference of lift and set-down: between sliding and static friction, and what damping "
            "and the search add at this rate of the ramp",
            "method part: all of it, for what they add is not known",
        )
        estimates.append(Estimate("F_f", mean, "N", "force", HALF, at, parts, n, note=note, trials=names))
    return estimates


def offers(analysis: Analysis) -> Iterator[Offer]:
    """F at x = 0, a line over pressure and therefore known between its points; and static friction, an upper bound of
    F_c.

    Not where raised loads showed hysteresis, or none was raised: it increases with motion, and here almost nothing
    moves.
    """
    known = at_pressures(analysis, "F_ce", MEAN)
    line = sorted(known.items())

    def at(place: Place) -> Estimate | None:
        P, x = place
        return between(line, P) if x is not None and abs(x) <= SAME else None

    yield Offer("F", {(P, 0.0): e for P, e in line}, at)
    if analysis.facts.get("hysteresis") is not False:
        return
    why = "that of a muscle at rest is static friction, F_c is that of a moving one, and the smaller"
    for e in analysis.estimates:
        if e.method == HALF and not e.at and e.value is not None:
            most = replace(e, parts=replace(e.parts, method=0.0))
            yield replace(anywhere("F_c", most, "friction at rest"), side=1, why=why)
