"""Isometric tests: the straight line F = m P + c at each contraction, by a rule that is fixed in advance.

Uses trials with pressure and force at a set contraction, from any source. Departures of samples from one line (late
sensors, a drifting cell, unevenly sampled branches) are estimated without it, as a force that each adds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import copysign, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.imported import flagged_counts, import_findings, rule_of, unusable_because
from pmabench.analysis.shared import isometric_lines
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, cut_off, half_steps, weighed
from pmabench.analysis.shared.isometric_lines import (
    FEWEST,
    METHOD,
    Line,
    Mask,
    Pooled,
    Test,
    Used,
    estimates_of,
    line_of,
    pool,
)
from pmabench.analysis.shared.samples import NotUsable, lag_open, noise_of, on_time_run
from pmabench.analysis.shared.trials import ONE_SESSION, measured_trials, session_of, thinned
from pmabench.analysis.verdict.agreement import SAME, Offer, Place, between
from pmabench.base.quantities import show
from pmabench.kinds.isometric import RESULTS
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData

BLOCKS = 200
"""Number of means that describe the course of the pressure in a test."""
TURN = 0.05
"""Share of the pressure range near its turns that belongs to neither branch: there the pressure is held, or the loop
has not opened yet.
"""
LEAST_LEG = 0.2
"""Smallest change of the pressure, as a share of that range, that counts as rising or falling."""
FEWEST_OF_SIDE = 10
"""Fewest samples of a branch or a rest."""
WITHOUT = 0.02
"""Share of the highest pressure below which the muscle counts as vented."""
SETTLING = 0.3
"""Share of the rest after the ramps in which a muscle may still settle."""
BEYOND = 1.1
"""Factor on the change of the line by the branches, since turns extend further than the part left out."""
STRETCHED = 1e-4
"""Length above the nominal one from which on a muscle has tension without pressure [m]."""
LATE, DRIFT = "time between force and pressure", "drift of the force cell"
Terms = tuple[float, float]
"""Slope m [N/Pa] and intercept c [N]."""


@dataclass(frozen=True)
class Departures:
    """Possible errors in the tests of one contraction, apart from its line."""

    late: Terms
    """Change of the line by the uncertainty of the sensors' lags."""
    drift: Terms
    """Change of the line by the drift of the cell between the rests."""
    gone: float
    """Change of the cell's reading at rest from before to after the ramps [N], mean of the tests."""
    noise: float
    """Noise of the force [N]."""

    @property
    def seen(self) -> bool:
        """Whether the cell drifts by more than the noise of one sample; at rest it is a mean of many."""
        return abs(self.gone) > self.noise

    def doubts(self, e: Estimate) -> list[Doubt]:
        """Effects on m or c."""
        of = "mc".index(e.symbol)
        return [
            Doubt(LATE, "method", abs(self.late[of]), seen=False),
            Doubt(DRIFT, "drift", abs(self.drift[of]), self.seen),
        ]

    def lines(self, line: Terms) -> list[Terms]:
        """Alternative lines, one per departure."""
        m, c = line
        return [(m + more, c + higher) for more, higher in (self.late, self.drift)]

    def findings(self, where: str) -> list[Finding]:
        """A significant drift."""
        if not self.seen:
            return []
        text = (
            f"{where}: the force cell drifts: at rest it reads {show(abs(self.gone), 'force', 2)} "
            f"{'more' if self.gone > 0 else 'less'} after the ramps than before; the intervals of slope and "
            "intercept hold it. Let the cell warm up, and measure again"
        )
        return [Finding("doubt", text)]


def departures(tests: Sequence[Test], used: Used, line: Terms) -> Departures:
    """The departures of tests at one contraction, with the line through their `used` samples."""
    parts = [(test, used(test)) for test in tests]
    gone = [gone_since(test) for test in tests]
    drift = [
        np.zeros(len(test.t)) if one is None else one[0] * np.interp(test.t, one[1:], (0.0, 1.0))
        for test, one in zip(tests, gone, strict=True)
    ]
    late = [line[0] * _open(test.run) * _rate(test) for test in tests]
    return Departures(
        _change(parts, late),
        _change(parts, drift),
        float(np.mean([one[0] for one in gone if one is not None] or [0.0])),
        max(noise_of(test.F) for test in tests),
    )


def _open(run: RunData) -> float:
    """Largest uncertainty of the lag between force and pressure [s], from the record."""
    return max(lag_open(run, name) for name in ("force", "pressure"))


def _change(parts: Sequence[tuple[Test, Mask]], forces: Sequence[Array]) -> Terms:
    """Line through `forces` [N] (one array per test): least squares is linear in F, so it is the change of the line."""
    P = np.concatenate([test.P[mask] for test, mask in parts])
    line = line_of(P, np.concatenate([F[mask] for (_, mask), F in zip(parts, forces, strict=True)]))
    return (line.m, line.c) if line is not None else (0.0, 0.0)


def _blocks(t: Array, P: Array) -> tuple[Array, Array]:
    """Means of times [s] and pressures [Pa] along a test."""
    parts = np.array_split(np.arange(len(t)), max(1, min(BLOCKS, len(t) // 3)))
    return np.array([t[part].mean() for part in parts]), np.array([P[part].mean() for part in parts])


def _rate(test: Test) -> Array:
    """Rate of the pressure [Pa/s] at each sample of a test."""
    t, P = _blocks(test.t, test.P)
    return np.interp(test.t, t, np.gradient(P, t)) if len(t) > 1 else np.zeros(len(test.t))


def legs(test: Test) -> Array:
    """1 for samples of a rising branch, -1 of a falling one, 0 near the turns between them; shape (n,)."""
    t, P = _blocks(test.t, test.P)
    span = float(np.ptp(P))
    turns, way = [0], 0
    for i in range(1, len(P)):
        gone = P[i] - P[turns[-1]]
        if gone * way > 0:
            turns[-1] = i  # further in the same direction
        elif abs(gone) > LEAST_LEG * span:
            turns, way = [*turns, i], int(np.sign(gone))
    found = np.zeros(len(test.t))
    for a, b in pairwise(turns):
        low, high = sorted((P[a], P[b]))
        inside = (test.t >= t[a]) & (test.t <= t[b]) & (test.P > low + TURN * span) & (test.P < high - TURN * span)
        found[inside] = np.sign(P[b] - P[a])
    return found


def even(tests: Sequence[Test], used: Used, line: Terms) -> Terms:
    """Mean of the lines through all rising and all falling samples; `line` where there is one branch only.

    This weights both branches equally. The line through all samples leans towards the branch with more of them.
    """
    P, F, way = (
        np.concatenate([of(test)[used(test)] for test in tests]) for of in (lambda one: one.P, lambda one: one.F, legs)
    )
    sides = [way > 0, way < 0]
    if any(rows.sum() < FEWEST_OF_SIDE or np.ptp(P[rows]) == 0 for rows in sides):
        return line
    mean = np.mean([np.polyfit(P[rows], F[rows], 1) for rows in sides], axis=0)
    m, c = (line + BEYOND * (mean - line)).tolist()
    return m, c


def gone_since(test: Test) -> tuple[float, float, float] | None:
    """Change of the cell's reading at rest from before to after the ramps [N], enlarged by two standard errors, and the
    middle times of these rests [s].

    At rest there is no pressure and no muscle force. None where a rest is missing or the muscle is stretched.
    """
    trial, F = test.trial, test.trial.channels["force"]
    good = trial.usable & np.isfinite(trial.channels["pressure"]) & np.isfinite(F)
    t, F = trial.t[good], F[good]
    at, P = _blocks(t, trial.channels["pressure"][good])
    under = np.flatnonzero(P > WITHOUT * P.max())
    if trial.point["contraction"] <= -STRETCHED or not len(under) or under[0] == 0 or under[-1] == len(P) - 1:
        return None
    begin, over = at[under[0] - 1], at[under[-1] + 1]
    before, after = t < begin, t > over + SETTLING * (t[-1] - over)
    if min(before.sum(), after.sum()) < FEWEST_OF_SIDE:
        return None
    gone = float(F[after].mean() - F[before].mean())
    error = noise_of(F) * sqrt(1 / before.sum() + 1 / after.sum())
    return gone + copysign(2 * error, gone), float(t[before].mean()), float(t[after].mean())


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

    All usable samples with force above `force_above` [N] in the wanted `phases`, by `Test.above`; the tests of one
    contraction pooled into one least-squares line (equal weight of samples). The repeats part is Student's t on the
    scatter of the sessions' mean slopes, for one session on that of the tests: samples within a test are no repeats.
    Thresholds `also_at` [N] are shown as separate methods, since a threshold on the fitted quantity biases the fit. The
    method part is the largest change by one of them, by the upper half of the force, or by equal weights of the
    sessions or of rising and falling pressure; and the uncertainty of the sensors' lags.

    `options` (else the rule of the import map, else these defaults): `force_above` (reading of a slack muscle),
    `also_at` (`RANGE` of the largest force above `force_above`), `phases` [] (all).
    """
    runs = [on_time_run(run, "pressure", "force") for run in runs]
    rule, findings = rule_of(runs, options or {})
    phases = [str(name) for name in rule.get("phases") or ()]
    above = float(rule.get("force_above") or 0.0) or _above_slack(runs, phases)
    groups, dropped = isometric_lines.tests_of(runs, phases, lambda test: _refuse(test, above))
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
        whole = lambda test: test.above(above), (first.line.m, first.line.c)
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
        by_phase = isometric_lines.branches(tests, lambda test: test.above(above), phases)
        findings += [*_sentences(contraction, fits, above), *found.findings(_where(contraction))]
        forces = isometric_lines.forces_of(first, tests, [*lines, *found.lines((line.m, line.c))])
        cells.append({**_facts(contraction, tests, fits, above), "forces": forces, "slopes_of_phases": by_phase})
        traces.append(_trace(contraction, tests, line, above))
    if estimates:
        scales = Scales.of([test.run for tests in groups.values() for test in tests])
        findings += scales.findings(estimates, ("force", "pressure"))
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
    tests, _ = measured_trials(runs, lambda run, trial: isometric_lines.as_test(run, trial, phases))
    found = [0.0]
    for test in (one for one in tests if len(one.F) >= FEWEST):
        least = test.P <= test.P.min() + AT_REST * np.ptp(test.P)
        level = max(float(np.median(part)) for part in np.array_split(test.F[least], 2) if len(part))
        slack = level if 0 < level < AT_REST * float(test.F.max()) else 0.0
        found.append(slack + NOISE * noise_of(test.F))
    return max(found)


def _fits(tests: Sequence[Test], above: float, asked: Sequence[float]) -> dict[float, Pooled]:
    """Threshold of force [N] -> line above it: the rule's, those asked for, and shares of the largest force."""
    largest = max(float(test.F[test.above(above)].max()) for test in tests)
    also = [above + share * (largest - above) for share in (RANGE[-1:] if asked else RANGE)]
    fits = {least: pool(tests, lambda test, least=least: test.above(least)) for least in (above, *asked, *also)}  # type: ignore[misc]
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


def _refuse(test: Test, above: float) -> None:
    """Raise `NotUsable` for a test that has too few samples above the threshold."""
    used = test.above(above)
    count = int(np.count_nonzero(used))
    if count < FEWEST or np.ptp(test.P[used]) <= 0:
        seen = f"{count} usable samples above {show(above, 'force')} (flagged: {unusable_because(test.trial)})"
        raise NotUsable(f"{seen}, {FEWEST} are needed")


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
    used = np.concatenate([test.above(above) for test in tests])
    columns = {"pressure": P, "force": F, "fit": np.where(used, line(P), np.nan), "test": number}
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
