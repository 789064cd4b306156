"""Isometric pressurisation: F(P) at each contraction, S(eps), dead band, hysteresis; F_ce and K as a cross-check.

`curve`: lines at one contraction, and where the force begins; `braid`: S(eps); `sections`: several contractions at one
pressure. Each has its sentences and figures. Also the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import isometric_lines, skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import MOST_HIDDEN, Doubt, weighed
from pmabench.analysis.shared.isometric_lines import METHOD, Groups, Test, as_test, by_repeat
from pmabench.analysis.shared.samples import NotUsable, noise_of, on_time_run
from pmabench.analysis.shared.trials import mean_of_trials
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.analysis.verdict.agreement import Offer, Place, at_pressures, everywhere, exactly, straight, values_of
from pmabench.base.quantities import show
from pmabench.kinds.isometric_pressurisation import RESULTS, curve, form, sections
from pmabench.kinds.isometric_pressurisation.braid import (
    Section,
    of_sections,
    section_estimates,
    section_trace,
    sections_of,
)
from pmabench.kinds.isometric_pressurisation.curve import ONE_TEST, PHASES, THRESHOLD, Cell
from pmabench.kinds.isometric_pressurisation.flow import by_flow
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Parts, Trace
from pmabench.store.records import RunData, TrialData

KIND = "isometric-pressurisation"
SECTIONS, SIDES = "isometric-sections", "isometric-sides"
TURN = "turn of the loop"
CHANNELS = ("pressure", "force")
ONE_REPEAT = "no repeats part: one repeat only"
PULLED = 5 * curve.LEAST
"""Smallest change of the force of a muscle that is not slack [N]."""
LATE = 0.25
"""Effect of a delay of the force on the loop, as a share of its width, from which on the width is withheld."""
MOST_DRIFT = 0.5
"""The same for a drift of the cell."""
SEEN = 4.0
"""Standard errors from which on a delay is significant."""
SENSELESS = 1e9
"""Pressures [Pa] and forces [N] above this are invalid."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Slope m [N/Pa], intercept c [N], H [N] and p_0 [Pa] at each contraction [m]; D0 [m], theta0 [rad], alpha [1].

    F = m P + c: m is S(eps) of paper 3 and c its rubber force, from all samples of the straight part (`straight_from`)
    of both ramps. p_0 is the pressure at which the force begins, by its onset (papers 2 and 4) and as -c / m. At each
    multiple of 50 kPa, F_ce and K of the three-element model from the forces over contractions (paper 0), and the
    blocked force F_b from the tests at zero contraction.

    `options`: `nominal_length`, `inner_diameter` [m]; else those of the specimen.
    """
    options, runs = options or {}, [on_time_run(run, *CHANNELS) for run in runs]
    groups, dropped = isometric_lines.tests_of(runs, PHASES, refuse)
    scales = Scales.of(runs)
    groups, opened, zeros = form.zeroed(groups, scales)
    given = {**sections.given_of(runs[0].manifest.get("specimen") if runs else None), **options}
    found = _found(groups, given, scales)
    estimates, cells = _weighed(found, groups, given, scales, opened), found.cells
    volumes, words, without = by_flow(runs, scales)
    estimates += volumes
    findings = [
        *curve.of_threshold([e for e in estimates if e.symbol == "p_0"], given),
        *of_sections(found.through, given),
        *sections.of_across(found.across),
        *curve.of_cells(cells),
        *sections.size_findings(cells, given),
        *skew.findings(runs, CHANNELS, skew.apart(runs, CHANNELS), estimates),
        *zeros,
        *words,
        *scales.findings(estimates, CHANNELS),
    ]
    if cells and not estimates:
        findings.append(Finding("fault", "no straight part of F(P) at any contraction"))
    facts = {"options": dict(options), "specimen": given, "tests": sum(len(cell.tests) for cell in cells)}
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates, curves=_curves(cells, estimates),
        dropped=[*dropped, *without], findings=findings, traces=_traces(cells, found.through, given), facts=facts,
    )  # fmt: skip


def _traces(cells: Sequence[Cell], through: Mapping[str, Section], given: Mapping[str, Any]) -> list[Trace]:
    """F over P at each contraction, S over eps, both over time for the contraction nearest to 0, F over contraction."""
    found = list(map(curve.force_trace, cells))
    found += [section_trace(one, cells, float(given["nominal_length"])) for one in list(through.values())[:1]]
    found += [curve.over_time(min(cells, key=lambda cell: abs(cell.contraction)))] if cells else []
    return [*found, *sections.blocked_trace(cells)]


@dataclass(frozen=True, eq=False)
class _Found:
    """Results of the tests, before effects of departures from their form."""

    cells: Sequence[Cell]
    across: Sequence[sections.Across]
    through: Mapping[str, Section]
    estimates: Sequence[Estimate]


def _found(groups: Groups, given: Mapping[str, Any], scales: Scales) -> _Found:
    """All values of tests by contraction [m]."""
    cells = [curve.cell_of(contraction, tests) for contraction, tests in sorted(groups.items())]
    estimates: list[Estimate] = []
    begun: list[Estimate] = []
    for cell in cells:
        begun += curve.begin_estimates(cell, scales)
        if cell.pooled is None:
            continue
        others = [cell.pooled.mean] if cell.upper is None else [cell.pooled.mean, (cell.upper.m, cell.upper.c)]
        m, c = isometric_lines.estimates_of(cell.pooled, cell.tests, {"contraction": cell.contraction}, others=others)
        estimates += [m, c, _width(cell, scales)]
    estimates = _placed(estimates, cells, scales)
    over = sections.across(cells)
    through = sections_of(cells, given)
    estimates += [*begun, *_sides(cells), *sections.blocked_estimates(cells, given, scales)]
    estimates += [*_three_elements(over, scales), *section_estimates(through, scales, given)]
    return _Found(cells, over, through, estimates)


def _placed(estimates: Sequence[Estimate], cells: Sequence[Cell], scales: Scales) -> list[Estimate]:
    """The lines F = m P + c with the uncertainty of the muscle's position, from their change over contraction."""
    known = [(c.contraction, float(c.place.mean()), c.pooled.line) for c in cells if c.pooled is not None]
    x = np.array([place for _, place, _ in known])
    if len(x) < 2 or np.diff(x).min() < sections.APART:
        return list(estimates)
    by_place: dict[tuple[str, float], float | None] = {}
    for coordinate, name in (("slope", "m"), ("intercept", "c")):
        over = np.gradient([getattr(line, name) for _, _, line in known], x).tolist()
        for (contraction, place, _), change in zip(known, over, strict=True):
            part = scales.part({"displacement": change * place}, {"displacement": change})
            by_place[coordinate, contraction] = part

    def placed(e: Estimate) -> Estimate:
        parts = [e.parts.calibration, by_place.get((e.coordinate, e.at["contraction"]))]
        halves = [part for part in parts if part is not None]
        return replace(e, parts=replace(e.parts, calibration=hypot(*halves) if halves else None))

    return [placed(e) for e in estimates]


def _curves(cells: Sequence[Cell], estimates: Sequence[Estimate]) -> list[Curve]:
    """The lines F = m P + c."""
    terms = {(e.coordinate, e.at.get("contraction")): e for e in estimates if e.method == METHOD}
    return [
        Curve("F", "line", (terms["intercept", cell.contraction], terms["slope", cell.contraction]), "pressure",
              (line.low, line.high), line.r2, line.rms, METHOD)
        for cell in cells if cell.pooled is not None for line in [cell.pooled.line]
    ]  # fmt: skip


def _weighed(
    found: _Found, groups: Groups, given: Mapping[str, Any], scales: Scales, opened: Sequence[form.Departure]
) -> list[Estimate]:
    """The estimates, widened or withheld for departures from the form of the tests."""
    doubts: dict[Key, list[Doubt]] = {_key(e): [] for e in found.estimates}
    values = {_key(e): e.value for e in found.estimates}
    for one in [*form.departures(found.cells), *opened]:
        without = {x: [replace(test, F=test.F - one.force(test)) for test in tests] for x, tests in groups.items()}
        changed = {_key(e): e.value for e in _found(without, given, scales).estimates}
        for e in found.estimates:
            # the onset is read from the samples themselves: the effect of a moving muscle is that on the line
            key = (e.symbol, METHOD, "", _key(e)[3]) if e.method == THRESHOLD and one.moves else _key(e)
            value, other = values.get(key), changed.get(key)
            if e.value is not None and value is not None and other is not None:
                half = abs(other - value)
                most = MOST_DRIFT if e.symbol == "H" and one.name == form.DRIFT else MOST_HIDDEN
                doubts[_key(e)].append(Doubt(one.name, one.part, half, one.seen, one.reason, most))
    for line in found.across:
        for symbol in ("F_ce", "K"):
            doubts[symbol, SECTIONS, "", line.pressure].append(line.bend.doubt(symbol))
    cells = {cell.contraction: cell for cell in found.cells}
    nearest, scatter = min(cells, key=abs, default=None), form.scatter_of(found.cells)
    # the turns at each contraction with a straight part, and at the one nearest to 0, which gives F_b
    turns = {x: c.mean.turned for x, c in cells.items() if c.pooled is not None or x == nearest}
    turned = [one for one in turns.values() if len(one[0])]
    delay, error = form.late(found.cells)
    judged = []
    for e in found.estimates:
        mine, cell = doubts[_key(e)], cells.get(e.at.get("contraction", float("nan")))
        if e.symbol == "H" and np.isfinite(delay) and cell is not None:
            mine.append(_late(e, cell, delay, error))
        if e.symbol == "H" and cell is not None:
            mine.append(_drifted(e, cell, scales.offsets.get("force", inf)))
            mine.append(Doubt(TURN, "method", abs(cell.mean.opened[2] - float(cell.gaps.mean())), seen=True))
        if e.symbol in ("F_b", "F_ce") and turned:
            lacks = max(abs(float(np.interp(e.at["pressure"], *one))) for one in turned)
            mine.append(Doubt(TURN, "method", curve.BEYOND * lacks, seen=True))
        if e.method == METHOD and e.symbol in ("m", "c", "p_0") and cell is not None:
            mine.append(_turned(e, cell))
        if e.symbol == "F_b" and scatter is not None:
            more = max(0.0, (scatter * (e.value or 0.0)) ** 2 / e.n - (e.parts.repeats or 0.0) ** 2)
            mine.append(Doubt("scatter at the other contractions", "repeats", sqrt(more), seen=False))
        scale = float(np.nanmax(np.abs(cell.mean.force))) if e.symbol == "c" and cell is not None else None
        judged.append(weighed(e, mine, scale))
    return judged


def _turned(e: Estimate, cell: Cell) -> Doubt:
    """Effect of the loop's turns on the line, or on its zero, there beyond the method part."""
    P, off = cell.mean.turned
    rows = P >= (cell.low or 0.0)
    m, c = (np.polyfit(P[rows], off[rows], 1) if rows.sum() > 1 else np.zeros(2)).tolist()
    if e.symbol != "p_0" or cell.pooled is None or e.value is None:
        return Doubt(TURN, "method", abs(m if e.symbol == "m" else c), seen=True)
    half = abs(c + m * e.value) / cell.pooled.line.m
    return Doubt(TURN, "method", max(0.0, half - (e.parts.method or 0.0)), seen=True)


Key = tuple[str, str, str, float | None]


def _key(e: Estimate) -> Key:
    """Key of an estimate: symbol, method, coordinate, and the first coordinate of its point."""
    return e.symbol, e.method, e.coordinate, next(iter(e.at.values()), None)


def _late(H: Estimate, cell: Cell, delay: float, error: float) -> Doubt:
    """Effect of a late force on the loop width [N]: a delay opens the loop."""
    per_second = 2 * cell.rate * abs(cell.pooled.line.m if cell.pooled is not None else 0.0)
    worth = show(per_second * abs(delay), "force", 2)
    reason = (
        f"as the ramps end the force comes {show(delay, 'time', 2)} after the pressure, which is worth {worth} of the "
        "loop: a filter of the cell or of the gauge, or creep. Ramp more slowly, or declare the `sensor_lag`"
    )
    half = per_second * (curve.BEYOND * abs(delay) + 2 * error)
    return Doubt("delay of the force", "method", half, abs(delay) > SEEN * error, reason, LATE)


def _drifted(H: Estimate, cell: Cell, most: float) -> Doubt:
    """Effect of a drift of the cell's zero within the tests on the loop width [N]: all of it, in case it was a step.

    `most` is the uncertainty of the zero from the record [N]; a larger change at rest is attributed to the muscle.
    """
    gone = float(np.mean([np.clip(form.gone_since(test) or 0.0, -most, most) for test in cell.tests]))
    reason = (
        f"the force cell drifts: at rest it reads {show(abs(gone), 'force', 2)} {'more' if gone > 0 else 'less'} after "
        "the ramps than before. Let it warm up, and measure again, or declare the `expanded_uncertainty` of the force"
    )
    seen = abs(gone) > max(noise_of(test.F) for test in cell.tests)  # noise of one sample; rests are means of many
    return Doubt(form.DRIFT, "drift", abs(gone), seen, reason, MOST_DRIFT)


def refuse(test: Test) -> None:
    """Raise `NotUsable` for a test that gives no result."""
    if not all(np.count_nonzero(test.phase == index) > 1 for index in range(len(PHASES))):
        raise NotUsable("it lacks one of the two ramps")
    if max(np.abs(test.P).max(), np.abs(test.F).max()) > SENSELESS:
        raise NotUsable("its pressure or force is beyond all sense")
    if np.ptp(test.P) <= 0:
        raise NotUsable("its pressure does not change")
    if np.ptp(test.F) < PULLED:
        top, by = show(float(test.P.max()), "pressure", 3), show(float(np.ptp(test.F)), "force", 2)
        raise NotUsable(f"slack: up to {top} the force changes by {by} only")


def _width(cell: Cell, scales: Scales) -> Estimate:
    """Loop width: force while emptying minus while filling at the same pressure, mean over the straight part [N]."""
    gaps = by_repeat(cell.tests, cell.gaps)
    at, names = {"contraction": cell.contraction}, tuple(test.name for test in cell.tests)
    commands = [c for test in cell.tests for c in test.trial.commands if c.output == "pressure" and c.phase in PHASES]
    if not cell.mean.held and any(not c.data.get("rate") for c in commands):  # the pressure changes in a step
        why = "a loop on the way from one pressure to the next is as wide as the force is late: ramp, or hold at five"
        return Estimate("H", None, "N", "force", METHOD, at, n=len(gaps), note=why, trials=names)
    apart = 2 * cell.rate * skew.apart([test.run for test in cell.tests], CHANNELS)
    slope = cell.pooled.line.m if cell.pooled else 0.0
    scale, said = scales.part({"force": float(gaps.mean())}), "emptying minus filling"
    H = mean_of_trials("H", ("N", "force"), METHOD, at, names, gaps, None, scale, ONE_TEST, said)
    return replace(H, parts=replace(H.parts, skew=abs(slope) * apart))


def _sides(cells: Sequence[Cell]) -> Iterator[Estimate]:
    """Half the force after an approach from above minus after one from below [N]: friction in the muscle."""
    for cell in cells:
        each = cell.mean.each[:, cell.mean.P >= (cell.low or 0.0)]
        by: dict[object, dict[float, float]] = {}
        for test, F in zip(cell.tests, each, strict=True):
            side = test.trial.point.get("side")
            if side and len(F) and np.isfinite(F).all():
                by.setdefault((test.run.id, test.trial.repeat), {})[side] = float(F.mean())
        halves = [0.5 * (sides[1.0] - sides[-1.0]) for sides in by.values() if {1.0, -1.0} <= set(sides)]
        if halves:
            at, names = {"contraction": cell.contraction}, tuple(test.name for test in cell.tests)
            yield mean_of_trials("F_f", ("N", "force"), SIDES, at, names, halves, None, 0.0, ONE_REPEAT)


def _three_elements(found: Sequence[sections.Across], scales: Scales) -> list[Estimate]:
    """F_ce [N] and K [N/m] at each pressure."""
    estimates: list[Estimate] = []
    P = np.array([one.pressure for one in found])
    columns = [np.array([one.line.start for one in found]), np.array([-one.line.slope for one in found])]
    over = [np.gradient(values, P) if len(P) > 1 else np.zeros(len(P)) for values in columns]
    for one, dF, dK in zip(found, over[0].tolist(), over[1].tolist(), strict=True):
        F_ce, K, at = one.line.start, -one.line.slope, {"pressure": one.pressure}
        scale_F = scales.part(
            {"force": F_ce, "pressure": dF * one.pressure}, {"force": 1.0, "pressure": dF, "displacement": K}
        )
        scale_K = scales.part({"force": K, "displacement": K, "pressure": dK * one.pressure}, {"pressure": dK})
        each = [scales.offsets.get(name, 0.0) * changed for name, changed in one.zeros.items()]
        of_days = np.linalg.norm(each, axis=0)
        scale_K, scale_F = (
            None if part is None else hypot(part, own) for part, own in zip((scale_K, scale_F), of_days, strict=True)
        )
        how: dict[str, Any] = {"n": len(one.names), "trials": one.names}
        how["note"] = "" if one.line.half_slope is not None else "no repeats part: too few contractions"
        of_F, of_K = Parts(one.line.half_start, calibration=scale_F), Parts(one.line.half_slope, calibration=scale_K)
        estimates.append(Estimate("F_ce", F_ce, "N", "force", SECTIONS, at, of_F, **how))
        estimates.append(Estimate("K", K, "N/m", "stiffness", SECTIONS, at, of_K, **how))
    return estimates


def offers(analysis: Analysis) -> Iterator[Offer]:
    """F between the tested contractions, K, blocked force; contraction without load from where the force begins."""
    F_ce, K = (at_pressures(analysis, symbol, SECTIONS) for symbol in ("F_ce", "K"))
    furthest = max((e.at["contraction"] for e in analysis.estimates if "contraction" in e.at), default=0.0)
    yield straight(F_ce, K, lambda P: furthest)
    yield everywhere("K", K)
    yield exactly("F", {(e.at["pressure"], 0.0): e for e in values_of(analysis, "F_b", sections.BLOCKED)}, "blocked")
    begun = [(e, e.value) for e in analysis.estimates if (e.symbol, e.method) == ("p_0", THRESHOLD) and e.value]
    pressures = [P for _, P in begun]
    if len(begun) > 1 and (np.diff(pressures) > 0).all():
        places = [e.at["contraction"] for e, _ in begun]
        points: dict[Place, Estimate] = {}
        for (e, P), x, slope in zip(begun, places, np.gradient(places, pressures), strict=True):
            # at the pressure p_0 a muscle at this contraction has no force
            parts = e.parts.times(float(slope))
            points[P, None] = replace(e, symbol="x", value=x, unit="m", quantity="length", parts=parts)
        yield exactly("x", points)


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Slope of force over pressure, pressure at which the force begins, gap between the ramps, force at the top."""
    try:
        test = as_test(run, trial, PHASES)
        refuse(test)
    except NotUsable as reason:
        return [Measured("m", "force per pressure", None), Measured("p_0", "pressure", None)], [str(reason)]
    cell = curve.cell_of(trial.point["contraction"], [test])
    found = [one.pressure for one in curve.begins(trial) if one is not None]
    top = float(test.P.max())
    F_e, K_e = (expected.at(name, top) if expected else None for name in ("F_ce", "K"))
    pull = F_e - K_e * cell.contraction if F_e is not None and K_e is not None else None
    doubts = [] if cell.pooled is not None else ["force over pressure has no straight part"]
    line = cell.pooled.line if cell.pooled else None
    return [
        Measured("m", "force per pressure", line.m if line else None),
        Measured("p_0", "pressure", float(np.mean(found)) if found else None, noise=1e3),
        Measured("H", "force", float(cell.gaps[0]), noise=1.0),
        Measured("F", "force", float(test.F.max()), pull, tolerance=2 * expected.F_c if expected else 0.0),
    ], doubts
