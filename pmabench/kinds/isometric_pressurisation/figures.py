"""Sentences and figures of isometric pressurisation; computes no estimate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import degrees
from typing import Any

import numpy as np

from pmabench.analysis.shared.trials import thinned
from pmabench.base.quantities import show
from pmabench.kinds.isometric_pressurisation.braid import ALPHAS, NAMES, Section
from pmabench.kinds.isometric_pressurisation.curve import REST, Cell, pulling
from pmabench.kinds.isometric_pressurisation.sections import Across
from pmabench.plotting.chart import BLUE, Chart, Series
from pmabench.plotting.pictures import Picture, column, has, of_traces, unit_of
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Trace

CURVE = 60
"""Points of a drawn curve."""
MOVED = 0.01
"""Change of the force because the driven end moves, as a share of its span, from which on it is a doubt."""
BENT = 0.05
"""A distance from the line over contractions that is reported, as a share of the span of the forces."""
NEAR = 0.01
"""Contractions that count as 0, as a share of the nominal length."""


def of_cells(cells: Sequence[Cell]) -> list[Finding]:
    """For each contraction the straight part, its residual and both branches; doubts where there is none."""
    found = []
    for cell in cells:
        where = f"contraction {show(cell.contraction, 'length', 4)}"
        if cell.pooled is None or cell.low is None:
            why = f"even its upper half leaves a line by {show(cell.off, 'force', 3)}"
            why = why if cell.off > 0 else "filling and emptying have too few pressures in common for a line"
            found.append(Finding("doubt", f"{where}: F(P) has no straight part: {why}; no slope is reported"))
            continue
        ends = f"{show(cell.low, 'pressure', 4)} to {show(cell.pooled.line.high, 'pressure', 4)}"
        off, rms, gap = (show(v, "force", 2) for v in (cell.off, cell.pooled.rms, float(cell.gaps.mean())))
        text = f"straight from {ends} within {off}, residual {rms} rms"
        found.append(Finding("note", f"{where}: {text}; emptying minus filling {gap}"))
        found += _moved(cell, where)
    return found


def _moved(cell: Cell, where: str) -> Iterator[Finding]:
    """A doubt if the driven end gave way while the force rose."""
    pulled = [test.x[np.isfinite(test.x) & pulling(test)] for test in cell.tests]
    most = max((float(np.ptp(x)) for x in pulled if len(x)), default=0.0)
    off = cell.place - cell.contraction
    if most > 2e-4 and most > MOVED * max(abs(cell.contraction), 10e-3):
        span = show(float(np.nanmax(cell.mean.force) - np.nanmin(cell.mean.force)), "force", 3)
        text = f"the driven end moved by up to {show(most, 'length', 2)} while the force changed by {span}"
        yield Finding("doubt", f"{where}: {text}; it is not isometric")
    if np.abs(off).max() > 5e-4:
        text = f"it was measured {show(float(off[np.argmax(np.abs(off))]), 'length', 2)} off; what was measured counts"
        yield Finding("note", f"{where}: {text}")


def of_threshold(begun: Sequence[Estimate], given: Mapping[str, Any]) -> list[Finding]:
    """The dead band: the pressure at which the force begins at the nominal length."""
    known = [e for e in begun if e.value is not None]
    if not known:
        return []
    at = min((e.at["contraction"] for e in known), key=abs)
    if abs(at) > NEAR * float(given.get("nominal_length", 0.25)):
        return [Finding("note", "the dead band of pressure is that at contraction 0, which is not among the tests")]
    found = []
    for e in (e for e in known if e.at["contraction"] == at):
        half = e.parts.combined
        interval = f" +- {show(half, 'pressure', 2)}" if half is not None else ""
        found.append(f"{show(e.value or 0.0, 'pressure', 4)}{interval} ({e.method})")
    where = f"contraction {show(at, 'length', 3)}"
    return [Finding("note", f"dead band: at {where} the force begins at {', '.join(found)}")]


def of_sections(sections: Mapping[str, Section], given: Mapping[str, Any]) -> list[Finding]:
    """S(eps): the result, its quality, and parameters that these slopes do not determine."""
    if "nominal_length" not in given:
        return [Finding("doubt", "S(eps) is not reported: the specimen has no nominal length")]
    if not sections:
        text = "S(eps) is not reported: fewer than three contractions with a slope, or slopes that no braid gives"
        return [Finding("note", text)]
    found = []
    for method, one in sections.items():
        largest = float(np.abs(one.slopes.S).max())
        off = float(np.max(np.abs(one.slopes.S - one.at(one.slopes.eps)))) / largest
        text = f"{method}: slopes within {off:.2%} of the curve"
        if one.freedom > 0:
            text += f", the curve known to +-{float(one.band(one.slopes.eps).max()) / largest:.2%} of its largest value"
        found.append(Finding("note", text))
        if one.open and not one.other_form:
            found.append(Finding("doubt", f"{method}: {_open(one)}"))
        if one.other_form:
            text = "slopes lie further from the curve than they scatter: S(eps) has another form here"
            level = "note" if one.free != NAMES else "doubt"
            found.append(Finding(level, f"{method}: {text}; no parameters are reported"))
    return found


def _open(one: Section) -> str:
    """Parameters that are not determined, and their ranges."""
    text = f"{', '.join(one.open)} cannot be determined separately from these contractions"
    if one.freedom < 1:
        return f"{text}: as many parameters as slopes. Measure at more contractions"
    sets = [
        f"alpha {values[2]:.3g} with D_0 {show(float(values[0]), 'length', 3)}"
        for values in sorted(one.as_good or [one.values], key=lambda values: float(values[2]))
    ]
    if len(sets) > 1:
        text += f": {' and '.join(sets)} fit alike"
    if min(abs(one.alpha - end) for end in ALPHAS) < 1e-3:
        text += f"; alpha runs to the end of its range, {one.alpha:.3g}"
    return f"{text}. Give inner_diameter in the specimen file, or measure a wider range"


def of_across(found: Sequence[Across]) -> list[Finding]:
    """Whether the three-element model holds over the contractions."""
    if not found:
        return [Finding("note", "F_ce and K are not reported: fewer than three contractions pull at the same pressure")]
    worst = max(found, key=lambda one: one.off / one.span if one.span else 0.0)
    share = worst.off / worst.span if worst.span else 0.0
    where = show(worst.pressure, "pressure")
    text = f"F over contraction leaves a straight line by up to {show(worst.off, 'force', 2)} ({share:.1%}) at {where}"
    if share <= BENT:
        return [Finding("note", f"{text}: the three-element model holds over these contractions")]
    low, high = min(worst.between), max(worst.between)
    between = f"{show(low, 'stiffness', 3)} to {show(high, 'stiffness', 3)}"
    text += f": -dF/dx between neighbours is {between}; F_ce and K are those of a straight line through that"
    return [Finding("doubt", text)]


def traces(cells: Sequence[Cell], sections: Mapping[str, Section], given: Mapping[str, Any]) -> list[Trace]:
    """F over P at each contraction, S over eps, and both over time for the contraction nearest to 0."""
    found = [_isometric(cell) for cell in cells]
    if sections:
        found.append(_section_trace(next(iter(sections.values())), cells, float(given["nominal_length"])))
    if cells:
        found.append(_over_time(min(cells, key=lambda cell: abs(cell.contraction))))
    return found


def _isometric(cell: Cell) -> Trace:
    P, F, phase = (np.concatenate([getattr(test, name) for test in cell.tests]) for name in ("P", "F", "phase"))
    marks = {"contraction": cell.contraction}
    fitted = np.full(len(P), np.nan)
    if cell.pooled is not None and cell.low is not None:
        line = cell.pooled.line
        fitted = np.where(cell.low <= P, line(P), np.nan)
        marks |= {"m": line.m, "c": line.c, "low": cell.low, "high": line.high}
    title = f"Force over pressure at a contraction of {show(cell.contraction, 'length', 3)}, and its straight part"
    columns = {"pressure": P, "force": F, "fit": fitted, "branch": phase}
    quantities = {"pressure": "pressure", "force": "force", "fit": "force", "branch": "count"}
    return Trace(f"isometric-{cell.contraction * 1e3:g}mm", "isometric", title, thinned(columns), quantities, marks)


def _section_trace(one: Section, cells: Sequence[Cell], length: float) -> Trace:
    """Measured slopes first, with their half widths; then the curve with its band."""
    half = np.array([cell.pooled.half("m") or np.nan for cell in cells if cell.pooled is not None])
    eps = np.linspace(one.slopes.eps.min(), one.slopes.eps.max(), CURVE)
    none, blank = np.full(len(one.slopes.S), np.nan), np.full(CURVE, np.nan)
    curve, band = one.at(eps), one.band(eps)
    both = {
        "contraction": (one.slopes.eps, eps), "slope": (one.slopes.S, blank), "half": (half, blank),
        "curve": (none, curve), "low": (none, curve - band), "high": (none, curve + band),
    }  # fmt: skip
    columns = {name: np.concatenate(pair) for name, pair in both.items()}
    quantities = dict.fromkeys(columns, "force per pressure") | {"contraction": "ratio"}
    marks = {name: getattr(one, name) for name in NAMES} | {"length": length}
    title = "S over contraction: slopes of force over pressure, and the curve of the modified Daerden model"
    return Trace("section", "section", title, columns, quantities, marks)


def _over_time(cell: Cell) -> Trace:
    """Pressure and force of the first test over time (paper 4)."""
    test = cell.tests[0]
    trial = test.trial
    during = np.flatnonzero((trial.t >= test.t[0] - REST) & (trial.t <= test.t[-1] + REST))
    columns = {"t": trial.t[during] - trial.t[during[0]]}
    columns |= {name: trial.channels[name][during] for name in ("pressure", "force")}
    title = f"Pressure and force over time at a contraction of {show(cell.contraction, 'length', 3)}"
    quantities, marks = {"t": "time", "pressure": "pressure", "force": "force"}, {"contraction": cell.contraction}
    return Trace(
        f"over-time-{cell.contraction * 1e3:g}mm", "pressurisation", title, thinned(columns), quantities, marks
    )


COLUMNS = ("contraction", "slope", "half", "curve", "low", "high")


def sections(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for each trace: slopes and the curve."""
    return [_section(trace, analysis) for trace in traces if has(trace, *COLUMNS)]


def _section(trace: Trace, analysis: Analysis) -> Picture:
    eps, slope, half, curve, low, high = (column(trace, name) for name in COLUMNS)
    point, line = np.isfinite(slope), np.isfinite(curve)
    band = np.where(np.isfinite(high - low), 0.5 * (high - low), 0.0)
    fitted_line = Series("", eps[line], curve[line], BLUE, half=band[line])
    points = Series("", eps[point], slope[point], BLUE, "o", half[point])
    labels = (unit_of(trace, "contraction").label("contraction ε"), unit_of(trace, "slope").label("S"))
    length, fitted = shown("length"), "its parameters are in the table"
    if {*NAMES} <= set(trace.marks):
        D_0, theta_0, alpha = (trace.marks[name] for name in NAMES)
        fitted = f"D0 {D_0 / length.scale:.4g} {length.unit}, θ0 {degrees(theta_0):.4g}°, α {alpha:.4g}"
    caption = (
        "Marks: slopes of force over pressure with their 95 % intervals; line: S(ε) = (π/4) D0² [3 (1 − ε)^α / tan² θ0 "
        f"− 1 / sin² θ0] of paper 3 through them, with its 95 % band ({fitted}). The curve may be known well where its "
        "parameters are not."
    )
    charts = [[Chart(*labels, (fitted_line, points))]]
    return of_traces(charts, "Force by pressure, S, over contraction", caption, analysis, [trace])


def volumes(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Volume by mass flow over contraction."""
    found = []
    for trace in (one for one in traces if has(one, "contraction", "volume", "half")):
        x, V, half = (column(trace, name) for name in ("contraction", "volume", "half"))
        labels = (unit_of(trace, "contraction").label("contraction x"), unit_of(trace, "volume").label("V"))
        caption = "Volumes from the mass of air that a slow ramp of pressure lets in, with their 95 % intervals."
        chart = Chart(*labels, (Series("", x, V, BLUE, "o", half),))
        found.append(of_traces([[chart]], "Volume by mass flow", caption, analysis, [trace]))
    return found
