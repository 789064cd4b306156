"""Isometric tests: the straight line F = m P + c at each contraction, by a rule that is fixed in advance.

Uses trials with pressure and force at a set contraction, from any source.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pmabench.analysis.imported import flagged_counts, import_findings, rule_of, unusable_because
from pmabench.analysis.shared import isometric_lines
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import cut_off, half_steps, weighed
from pmabench.analysis.shared.isometric_lines import FEWEST, METHOD, Line, Pooled, Test, estimates_of, pool
from pmabench.analysis.shared.samples import noise_of, on_time_run
from pmabench.analysis.shared.trials import ONE_SESSION, session_of, thinned
from pmabench.analysis.verdict.agreement import SAME, Offer, Place, between
from pmabench.base.quantities import show
from pmabench.kinds.isometric import RESULTS
from pmabench.kinds.isometric.form import departures, even
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Parts, Trace
from pmabench.store.records import RunData

NO_METHOD = "no method part: it is one of the choices in that of the first method"
RANGE = (0.025, 0.05, 0.1, 0.5)
"""Alternative thresholds as shares of the largest force, where no rule names others; the last one, the upper half, is
always tried: it does not change a straight line.
"""
AT_REST = 0.02
"""Share of the pressures, and of the largest force, within which a muscle may be slack."""
NOISE = 5.0
"""Standard deviations of noise above the slack reading from which on a force is of the muscle."""
SENSITIVE = 0.05
"""Relative change of the slope between thresholds from which on it is a doubt."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Slope m [N/Pa] and intercept c [N] of F = m P + c at each contraction [m].

    All usable samples with force above `force_above` [N] in the wanted `phases`; the tests of one contraction pooled
    into one least-squares line (equal weight of samples). The repeats part is Student's t on the scatter of the
    sessions' mean slopes, for one session on that of the tests: samples within a test are no repeats. Thresholds
    `also_at` [N] are shown as separate methods, since a threshold on the fitted quantity biases the fit. The method
    part is the largest change by one of them, by the upper half of the force, or by equal weights of the sessions or of
    rising and falling pressure; and the uncertainty of the sensors' lags.

    `options` (else the rule of the import map, else these defaults): `force_above` (reading of a slack muscle),
    `also_at` (`RANGE` of the largest force above `force_above`), `phases` [] (all).
    """
    runs = [on_time_run(run, "pressure", "force") for run in runs]
    rule, findings = rule_of(runs, options or {})
    phases = [str(name) for name in rule.get("phases") or ()]
    above = float(rule.get("force_above") or 0.0) or _above_slack(runs, phases)
    groups, dropped = isometric_lines.tests_of(runs, phases, lambda test: _lack(test, above))
    asked = [float(x) for x in rule.get("also_at") or () if float(x) != above]
    sessions = {session_of(test.run) for tests in groups.values() for test in tests}
    estimates: list[Estimate] = []
    others: list[Estimate] = []
    curves: list[Curve] = []
    traces: list[Trace] = []
    cells: list[dict[str, Any]] = []
    for contraction, tests in sorted(groups.items()):
        fits = _fits(tests, above, asked)
        first = fits[above]
        at = {"contraction": contraction}
        whole = lambda test: test.F > above, (first.line.m, first.line.c)
        found = departures(tests, *whole)
        lines = [first.mean, *((pooled.line.m, pooled.line.c) for pooled in fits.values()), even(tests, *whole)]
        half = half_steps([(test.run, test.trial) for test in tests], ("force", "pressure"))
        level = {"c": cut_off(half, {"force": 1.0, "pressure": first.line.m})}
        m, c = (
            weighed(e, [*found.doubts(e), *([level[e.symbol]] if e.symbol in level else [])])
            for e in estimates_of(first, tests, at, others=lines)
        )
        estimates += [m, c]
        for threshold in sorted(set(asked) & set(fits)):
            m_there, _ = estimates_of(fits[threshold], tests, at, f"{METHOD} above {show(threshold, 'force')}")
            others.append(replace(m_there, note=sentences(m_there.note, NO_METHOD)))
        line = first.line
        curves.append(Curve("F", "line", (c, m), "pressure", (line.low, line.high), line.r2, line.rms, METHOD))
        by_phase = isometric_lines.branches(tests, lambda test: test.F > above, phases)
        findings += [*_sentences(contraction, fits, above), *found.findings(_where(contraction))]
        forces = isometric_lines.forces_of(first, tests, [*lines, *found.lines((line.m, line.c))])
        cells.append({**_facts(contraction, tests, fits, above), "forces": forces, "slopes_of_phases": by_phase})
        traces.append(_trace(contraction, tests, line, above))
    if estimates:
        if lack := Scales.of([test.run for tests in groups.values() for test in tests]).lack(("force", "pressure")):
            findings.append(Finding("note", lack))
        if len(sessions) < 2:
            findings.append(Finding("note", ONE_SESSION))
    return Analysis.of(
        runs[0].kind if runs else "isometric",
        runs,
        results=RESULTS,
        estimates=(*estimates, *others),
        curves=curves,
        dropped=dropped,
        findings=(*import_findings(runs), *findings),
        traces=traces,
        facts={"rule": rule, "cells": cells, "flagged": flagged_counts(runs)},
    )


def _above_slack(runs: Sequence[RunData], phases: Sequence[str]) -> float:
    """Force [N] above the reading of a slack muscle: reading at the lowest pressures, if small, plus its noise."""
    found = [0.0]
    for run in runs:
        for trial in run.trials:
            test, _ = isometric_lines.as_test(run, trial, phases)
            if test is not None and len(test.F) >= FEWEST:
                least = test.P <= test.P.min() + AT_REST * np.ptp(test.P)
                level = max(float(np.median(part)) for part in np.array_split(test.F[least], 2) if len(part))
                slack = level if 0 < level < AT_REST * float(test.F.max()) else 0.0
                found.append(slack + NOISE * noise_of(test.F))
    return max(found)


def _fits(tests: Sequence[Test], above: float, asked: Sequence[float]) -> dict[float, Pooled]:
    """Threshold of force [N] -> line above it: the rule's, those asked for, and shares of the largest force."""
    largest = max(float(test.F.max()) for test in tests)
    also = [above + share * (largest - above) for share in (RANGE[-1:] if asked else RANGE)]
    fits = {least: pool(tests, lambda test, least=least: test.F > least) for least in (above, *asked, *also)}  # type: ignore[misc]
    return {threshold: pooled for threshold, pooled in fits.items() if pooled is not None}


def _facts(contraction: float, tests: Sequence[Test], fits: Mapping[float, Pooled], above: float) -> dict[str, Any]:
    """Details of the lines of one contraction, for the record."""
    line, each = fits[above].line, zip(fits[above].names, fits[above].each, strict=True)
    return {
        "contraction": contraction,
        "tests": len(tests),
        "samples": line.n,
        "r2": line.r2,
        "residual_rms": line.rms,
        "slopes_of_tests": {name: one.m for name, one in each},
        "slopes_above": {f"{threshold:g}": pooled.line.m for threshold, pooled in sorted(fits.items())},
    }


def _lack(test: Test, above: float) -> str:
    """Why a test has too few samples above the threshold; empty where it has enough."""
    used = test.F > above
    count = int(np.count_nonzero(used))
    if count >= FEWEST and np.ptp(test.P[used]) > 0:
        return ""
    flagged = unusable_because(test.trial)
    return f"{count} usable samples above {show(above, 'force')} (flagged: {flagged}), {FEWEST} are needed"


def _where(contraction: float) -> str:
    return f"contraction {show(contraction, 'length', 3)}"


def _sentences(contraction: float, fits: Mapping[float, Pooled], above: float) -> list[Finding]:
    slopes = {threshold: pooled.line.m for threshold, pooled in sorted(fits.items())}
    if len(slopes) < 2:
        return []
    others = ", ".join(f"{show(m, 'force per pressure', 3)} above {show(f, 'force')}" for f, m in slopes.items())
    change = (max(slopes.values()) - min(slopes.values())) / abs(slopes[above])
    text = f"{_where(contraction)}: the slope depends on the threshold by {change:.1%}: {others}"
    return [Finding("doubt" if change > SENSITIVE else "note", text)]


def _trace(contraction: float, tests: Sequence[Test], line: Line, above: float) -> Trace:
    """Samples of all tests, thinned evenly, with the line where it was fitted."""
    number = np.concatenate([np.full(len(test.P), float(test.trial.repeat)) for test in tests])
    P, F = (np.concatenate([getattr(test, name) for test in tests]) for name in ("P", "F"))
    columns = {"pressure": P, "force": F, "fit": np.where(above < F, line(P), np.nan), "test": number}
    quantities = {"pressure": "pressure", "force": "force", "fit": "force", "test": "count"}
    ends = {"low": line.low, "high": line.high}
    marks = {"contraction": contraction, "m": line.m, "c": line.c, "force_above": above, **ends}
    title = f"Force over pressure at a contraction of {show(contraction, 'length', 3)}, and the line through it"
    return Trace(f"isometric-{contraction * 1e3:g}mm", "isometric", title, thinned(columns), quantities, marks)


def offers(analysis: Analysis) -> Iterator[Offer]:
    """F along each line; nothing where the map selected one phase only, which has friction of one direction."""
    if len((analysis.facts.get("rule") or {}).get("phases") or ()) == 1:
        return
    for cell in analysis.facts.get("cells", ()):
        x = cell["contraction"]
        like = next(e for e in analysis.estimates if e.symbol == "m" and e.at["contraction"] == x)
        if like.value is not None:
            yield _along(x, like, cell.get("forces", ()))


def _along(x: float, like: Estimate, rows: Sequence[Sequence[float]]) -> Offer:
    """F at one contraction [m] between the first and the last pressure of `rows`, the result of `forces_of`."""
    F = replace(like, symbol="F", unit="N", quantity="force", coordinate="", budget=())
    known = [(P, replace(F, value=value, parts=Parts(*parts))) for P, value, *parts in rows]

    def at(place: Place) -> Estimate | None:
        return between(known, place[0]) if place[1] is not None and abs(place[1] - x) <= SAME else None

    return Offer("F", {(P, x): e for P, e in known}, at, rubs=True)
