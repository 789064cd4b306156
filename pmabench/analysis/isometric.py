"""Isometric tests: the straight line F = m P + c at each contraction, by a rule that was written down beforehand.

Knows trials with pressure and force at a set contraction; not where they come from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from scipy.stats import t as student

from pmabench.analysis.calibration import Scales
from pmabench.analysis.imported import flagged_counts, import_findings, rule_of, unusable_because
from pmabench.analysis.results import Analysis, Curve, Dropped, Estimate, Finding, Parts, Trace
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

METHOD = "isometric-line"
FEWEST = 50
"""Samples above the threshold that a trial needs."""
LONGEST_TRACE = 1500
SAME = 4
"""Contractions that agree to so many decimals of a metre are one."""
SENSITIVE = 0.05
"""Relative change of the slope over the thresholds that is doubted."""


@dataclass(frozen=True, eq=False)
class _Test:
    """One trial: its usable samples in the wanted phases, and which phase each is in."""

    run: RunData
    trial: TrialData
    P: Array
    F: Array
    phase: Array
    """Index into the phase names of the rule, shape (n,); -1 where none is known."""

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name


@dataclass(frozen=True)
class _Line:
    """F = m P + c through samples above a threshold."""

    m: float
    c: float
    n: int
    r2: float
    rms: float
    low: float
    high: float
    """Range of pressures [Pa]."""


@dataclass(frozen=True)
class _Pooled:
    """The line through the samples of all tests at one contraction, and the lines of each test."""

    line: _Line
    each: tuple[_Line, ...]

    def half(self, of: str) -> float | None:
        """Half width of the 95 % interval of `m` or `c` from the scatter between tests, Student's t."""
        values = np.array([getattr(line, of) for line in self.each])
        if len(values) < 2:
            return None
        return float(student.ppf(0.975, len(values) - 1)) * float(values.std(ddof=1)) / sqrt(len(values))


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Slope m [N/Pa] and intercept c [N] of F = m P + c at each contraction [m].

    All usable samples with force above `force_above` [N] in the wanted `phases`, the tests of one contraction pooled
    into one least-squares line (samples count alike). The interval is Student's t on the scatter of the slopes of the
    tests: samples within a test are no repeats. The thresholds of `also_at` [N] are shown beside it as methods of
    their own, since a threshold on the fitted quantity bends the fit.

    `options` (else the rule of the import map, else the values given here): `force_above` 0, `also_at` [], `phases`
    [] (all).
    """
    rule, findings = rule_of(runs, options or {})
    above = float(rule.get("force_above") or 0.0)
    thresholds = [above, *(float(x) for x in rule.get("also_at") or () if float(x) != above)]
    phases = [str(name) for name in rule.get("phases") or ()]
    groups, dropped = _tests(runs, phases, above)
    estimates: list[Estimate] = []
    others: list[Estimate] = []
    curves: list[Curve] = []
    traces: list[Trace] = []
    cells: list[dict[str, Any]] = []
    for contraction, tests in sorted(groups.items()):
        fits = {threshold: pooled for threshold in thresholds if (pooled := _pool(tests, threshold)) is not None}
        first = fits[above]
        at = {"contraction": contraction}
        m, c = _estimates(first, tests, at, METHOD)
        estimates += [m, c]
        others += [
            _estimates(pooled, tests, at, f"{METHOD} above {show(threshold, 'force')}")[0]
            for threshold, pooled in sorted(fits.items())
            if threshold != above
        ]
        line = first.line
        curves.append(Curve("F", "line", (c, m), "pressure", (line.low, line.high), line.r2, line.rms, METHOD))
        branches = _branches(tests, above, phases)
        findings += _sentences(contraction, fits, above, branches)
        cells.append(
            {
                "contraction": contraction,
                "tests": len(tests),
                "samples": line.n,
                "r2": line.r2,
                "residual_rms": line.rms,
                "slopes_of_tests": {test.name: one.m for test, one in zip(tests, first.each, strict=True)},
                "slopes_of_phases": branches,
                "slopes_above": {f"{threshold:g}": pooled.line.m for threshold, pooled in sorted(fits.items())},
            }
        )
        traces.append(_trace(contraction, tests, line, above))
    if estimates:
        if lack := Scales.of([test.run for tests in groups.values() for test in tests]).lack(("force", "pressure")):
            findings.append(Finding("note", lack))
        shown = "the other thresholds show what the choice of one is worth" if len(thresholds) > 1 else "one threshold"
        findings.append(Finding("note", f"no method part of m and c: {shown}"))
    return Analysis.of(
        runs[0].kind if runs else "isometric",
        runs,
        estimates=(*estimates, *others),
        curves=curves,
        dropped=dropped,
        findings=(*import_findings(runs), *findings),
        traces=traces,
        facts={"rule": rule, "cells": cells, "flagged": flagged_counts(runs)},
    )


def _tests(
    runs: Sequence[RunData], phases: Sequence[str], above: float
) -> tuple[dict[float, list[_Test]], list[Dropped]]:
    """Usable tests by contraction."""
    groups: dict[float, list[_Test]] = {}
    dropped: list[Dropped] = []
    for run in runs:
        for trial in run.trials:
            test, reason = _test(run, trial, phases, above)
            if test is None:
                dropped.append(Dropped(trial.name, trial.point, reason))
            else:
                groups.setdefault(round(trial.point["contraction"], SAME), []).append(test)
    return groups, dropped


def _test(run: RunData, trial: TrialData, phases: Sequence[str], above: float) -> tuple[_Test | None, str]:
    missing = [name for name in ("pressure", "force") if name not in trial.channels]
    if missing:
        return None, f"{' and '.join(missing)} not recorded"
    if "contraction" not in trial.point:
        return None, "its point names no contraction"
    if trial.status != "finished":
        return None, f"the trial is {trial.status}"
    phase = _phase_of(run, trial, phases)
    wanted = trial.usable & ((phase >= 0) | (not phases))
    P, F = trial.channels["pressure"][wanted], trial.channels["force"][wanted]
    count = int(np.count_nonzero(above < F))
    if count < FEWEST or np.ptp(P[above < F]) == 0:
        flagged = unusable_because(trial)
        return None, f"{count} usable samples above {show(above, 'force')} (flagged: {flagged}), {FEWEST} are needed"
    return _Test(run, trial, P, F, phase[wanted]), ""


def _phase_of(run: RunData, trial: TrialData, phases: Sequence[str]) -> Array:
    """Index of the phase of each sample, from the run's `phase` events; without any, the first wanted phase."""
    begun = [e for e in run.events if e.kind == "phase" and e.data.get("trial") == trial.index]
    index = np.full(len(trial.t), -1.0)
    if not begun:
        return np.zeros(len(trial.t))
    for event in sorted(begun, key=lambda e: e.t):
        name = str(event.data.get("name"))
        index[trial.t >= event.t - 1e-9] = phases.index(name) if name in phases else -1
    return index


def _line(P: Array, F: Array, above: float) -> _Line | None:
    """Least squares of F = m P + c over samples with F > `above`."""
    used = above < F
    if np.count_nonzero(used) < FEWEST or np.ptp(P[used]) == 0:
        return None
    P, F = P[used], F[used]
    middle = float(P.mean())
    off, pull = P - middle, F - float(F.mean())
    # Sums and not dot products: BLAS hands these to threads, which is slow on a busy machine.
    m = float(np.sum(off * pull) / np.sum(off * off))
    residual = pull - m * off
    total = float(np.sum(pull * pull))
    return _Line(
        m=m,
        c=float(F.mean()) - m * middle,
        n=len(P),
        r2=1.0 - float(np.sum(residual * residual)) / total if total > 0 else 0.0,
        rms=float(np.sqrt(np.mean(residual**2))),
        low=float(P.min()),
        high=float(P.max()),
    )


def _pool(tests: Sequence[_Test], above: float) -> _Pooled | None:
    whole = _line(np.concatenate([test.P for test in tests]), np.concatenate([test.F for test in tests]), above)
    each = [line for test in tests if (line := _line(test.P, test.F, above)) is not None]
    return None if whole is None else _Pooled(whole, tuple(each))


def _branches(tests: Sequence[_Test], above: float, phases: Sequence[str]) -> dict[str, float]:
    """Slope [N/Pa] in each phase alone."""
    found = {}
    for index, name in enumerate(phases):
        P = np.concatenate([test.P[test.phase == index] for test in tests])
        F = np.concatenate([test.F[test.phase == index] for test in tests])
        line = _line(P, F, above)
        if line is not None:
            found[name] = line.m
    return found


def _estimates(
    pooled: _Pooled, tests: Sequence[_Test], at: Mapping[str, float], method: str
) -> tuple[Estimate, Estimate]:
    line = pooled.line
    scales = Scales.of([test.run for test in tests])
    slope = scales.part({"force": line.m, "pressure": line.m})
    start = scales.part({"force": line.c}, {"force": 1.0, "pressure": line.m})
    note = "no repeats part: one test only" if len(pooled.each) < 2 else ""
    parents = tuple(test.name for test in tests)

    def estimate(symbol: str, value: float, unit: str, quantity: str, calibration: float | None) -> Estimate:
        parts = Parts(repeats=pooled.half(symbol), calibration=calibration)
        return Estimate(
            symbol, value, unit, quantity, method, at, parts, len(pooled.each), note=note, trials=parents,
            coordinate={"m": "slope", "c": "intercept"}[symbol],
        )  # fmt: skip

    return estimate("m", line.m, "N/Pa", "force per pressure", slope), estimate("c", line.c, "N", "force", start)


def _sentences(
    contraction: float, fits: Mapping[float, _Pooled], above: float, branches: Mapping[str, float]
) -> list[Finding]:
    where = f"contraction {show(contraction, 'length', 3)}"
    slopes = {threshold: pooled.line.m for threshold, pooled in sorted(fits.items())}
    lines = []
    if len(slopes) > 1:
        told = ", ".join(f"{show(m, 'force per pressure', 3)} above {show(f, 'force')}" for f, m in slopes.items())
        change = (max(slopes.values()) - min(slopes.values())) / abs(slopes[above])
        level = "doubt" if change > SENSITIVE else "note"
        lines.append(Finding(level, f"{where}: the slope depends on the threshold by {change:.1%}: {told}"))
    if len(branches) > 1:
        told = ", ".join(f"{show(m, 'force per pressure', 3)} in {name}" for name, m in branches.items())
        text = f"{where}: slope of each branch alone {told}"
        if not min(branches.values()) <= slopes[above] <= max(branches.values()):
            text += "; the line through both lies outside these, for they are apart and not evenly sampled"
        lines.append(Finding("note", text))
    return lines


def _trace(contraction: float, tests: Sequence[_Test], line: _Line, above: float) -> Trace:
    """Samples of all tests, thinned evenly, with the line where it was fitted."""
    P = np.concatenate([test.P for test in tests])
    F = np.concatenate([test.F for test in tests])
    number = np.concatenate([np.full(len(test.P), float(test.trial.repeat)) for test in tests])
    stride = max(1, -(-len(P) // LONGEST_TRACE))
    P, F, number = P[::stride], F[::stride], number[::stride]
    fitted = np.where(above < F, line.m * P + line.c, np.nan)
    return Trace(
        name=f"isometric-{contraction * 1e3:g}mm",
        figure="isometric",
        title=f"Force over pressure at a contraction of {show(contraction, 'length', 3)}, and the line through it",
        columns={"pressure": P, "force": F, "fit": fitted, "test": number},
        quantities={"pressure": "pressure", "force": "force", "fit": "force", "test": "count"},
        marks={
            "contraction": contraction,
            "m": line.m,
            "c": line.c,
            "force_above": above,
            "low": line.low,
            "high": line.high,
        },
    )
