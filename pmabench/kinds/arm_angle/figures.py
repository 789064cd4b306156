"""Sentences and figure about the bending angle of an arm, compared with paper 2's formula and Table 1.

The figure: bending angle over pressure at each load, paper 2's curve, and the gap between both branches.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pmabench.analysis.model_fit import ModelFit
from pmabench.analysis.shared.samples import NotUsable, settings_of
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.arm_angle.stairs import Loaded
from pmabench.kinds.arm_angle.stairs import measure as stair_of
from pmabench.model.library import MODELS
from pmabench.plotting.chart import GAP, INK, PAGE, PALETTE, QUIET, Chart, Level, Series
from pmabench.plotting.pictures import Picture, column, crosses, curve, has, label, of_traces, spread
from pmabench.store.analyses.results import Analysis, Finding, Trace
from pmabench.store.records import Array, RunData, TrialData

if TYPE_CHECKING:
    from pmabench.kinds.arm_angle.reduction import Fitted

NAMES = ("pressure", "angle", "below", "above", "fit", "model")
CURVE = 121
"""Points of a drawn curve."""
PARAMETERS = {p.name: p for p in MODELS["arm-angle"].parameters}
HIGHEST, LOWEST, MOST = PARAMETERS["pressure"].high, PARAMETERS["pressure"].low, PARAMETERS["load"].high
"""Range in which paper 2's formula holds [Pa, Pa, kg]."""
BARELY = 1.01
"""A measured pressure outside the formula's range by at most this factor is evaluated at the end of the range."""
TABLE_1 = {0.0: 84.333, 0.1: 84.0, 0.2: 75.5, 0.3: 66.0, 0.4: 57.0, 0.5: 47.0}
"""Load [kg] -> largest angle [deg], Table 1 of paper 2."""
DRIFTS = 0.005
"""Drift at the end of a hold, as a share of the largest angle, from which on it is reported as a doubt."""
SAME = np.radians(0.01)
"""Gap between both branches that is too small to measure [rad]."""
BENT = np.radians(1.0)
"""Angle at the preload without load from which on it is reported; paper 2 calls the arm straight there [rad]."""
APART = 0.02
"""Difference between measured angle and angle from displacement that is reported, as a share of the largest."""


def of_rests(loads: Sequence[Loaded], settings: Mapping[str, Any]) -> list[Finding]:
    """Findings on the angles alone: their direction, drift, bend at the preload, hysteresis and zeros."""
    if not loads:
        return []
    rests = [(stair, rest) for one in loads for stair in one.stairs for rest in stair.rests]
    largest = max(abs(rest.angle) for _, rest in rests)
    found = []
    turned = [one for one in loads if one.up[:, -1].mean() < one.up[:, 0].mean()]
    if turned:
        at = ", ".join(f"{one.mass:g} kg" for one in turned)
        text = f"with {at} the angle falls where the pressure rises: a wrong sign, or another muscle bends the arm"
        found.append(Finding("fault", text))
    stair, drifting = max(rests, key=lambda pair: abs(pair[1].drift))
    if abs(drifting.drift) > max(DRIFTS * largest, 6 * drifting.noise):
        where = f"{show(drifting.set, 'pressure', 3)} of trial {stair.trial.name}"
        text = f"the angle still changes by {show(drifting.drift, 'angle', 2)} at {where}: hold longer"
        found.append(Finding("doubt", text))
    free = next((one for one in loads if one.mass == 0), None)
    if free is not None and abs(free.up[:, 0].mean()) > BENT:
        text = f"without load the arm is bent by {show(float(free.up[:, 0].mean()), 'angle', 2)} at the preload"
        found.append(Finding("note", f"{text}, where paper 2 calls it straight: creep, or a zero that is off"))
    found += _gaps(loads)
    if (worst := max(loads, key=lambda one: abs(one.zero))).zero:
        found.append(Finding("doubt", worst.zero_off))
    if (worst := max(loads, key=lambda one: abs(one.apart))).apart:
        text = f"with {worst.mass:g} kg the displacement gives {show(worst.apart, 'angle', 2)} more than the angle"
        text += " at all pressures alike: one of their zeros is off. Zero both with the arm straight"
        found.append(Finding("doubt", text))
    if drift := loads[0].drift:
        text = (
            f"vented, the angle before the trials changes by {show(drift, 'angle', 2)} from the first to the last: the "
        )
        text += "zero of its sensor drifts, or the muscle creeps. The angles hold it; look for the cause"
        found.append(Finding("doubt", text))
    if settings.get("angle") != "from-displacement":
        found += _arcs(rests, largest, settings)
    return found


def _gaps(loads: Sequence[Loaded]) -> list[Finding]:
    """Hysteresis in words; a doubt where the descending branch lies on the wrong side."""
    known = [(one, one.widest) for one in loads if one.widest is not None]
    if not known:
        return []
    one, place = max(known, key=lambda pair: abs(pair[0].gaps[:, pair[1]].mean()))
    gap, P, noise = float(one.gaps[:, place].mean()), show(float(one.pressure[place]), "pressure", 3), one.noise
    if abs(gap) <= (least := max(6 * noise, SAME)):
        return [Finding("note", f"both ways agree within {show(least, 'angle', 2)}: no hysteresis is seen")]
    text = f"from above the angle is up to {show(abs(gap), 'angle', 2)} {'larger' if gap >= 0 else 'smaller'}"
    level = "doubt" if gap < -6 * noise else "note"
    why = ": hysteresis and creep make it larger" if level == "doubt" else ""
    return [Finding(level, f"{text} than from below ({P}, {one.mass:g} kg){why}")]


def _arcs(rests: Sequence[Any], largest: float, settings: Mapping[str, Any]) -> list[Finding]:
    """Comparison of the angle with the contraction of the bending muscle divided by the radius."""
    pairs = np.array([(rest.angle, rest.arc) for _, rest in rests if np.isfinite(rest.arc)])
    if not len(pairs):
        return []
    off = pairs[:, 1] - pairs[:, 0]
    most = float(off[np.argmax(np.abs(off))])
    radius = show(float(settings["radius"]), "length", 3)
    text = f"the displacement of the bending muscle by its radius of {radius} gives"
    if abs(most) <= max(APART * largest, np.radians(0.5)):
        return [Finding("note", f"{text} the same angle within {show(max(abs(most), SAME), 'angle', 2)}")]
    way = "the arm is no arc of one curvature, its middle is pressed together, or the radius is another"
    return [Finding("doubt", f"{text} another angle by up to {show(most, 'angle', 2)}: {way}")]


def of_fits(fits: Sequence[Fitted]) -> list[Finding]:
    """How well paper 2's form fits at each load."""
    found = []
    for reason in dict.fromkeys(one.why for one in fits if one.why):
        masses = ", ".join(f"{one.of.mass:g} kg" for one in fits if one.why == reason)
        found.append(Finding("note", f"{masses}: {reason}"))
    wrong = [f"{one.of.mass:g} kg" for one in fits if one.up is not None and not one.up.converged]
    if wrong:
        found.append(Finding("doubt", f"{', '.join(wrong)}: the form of paper 2 does not converge on these angles"))
    good = [(one.of, one.up) for one in fits if one.up is not None and one.up.converged]
    if good:
        one, fit = max(good, key=lambda pair: float(np.abs(pair[1].computed - pair[1].measured).max()))
        off = float(np.abs(fit.computed - fit.measured).max())
        text = f"a, b, c, d of each load follow the way up within {show(off, 'angle', 2)}"
        found.append(Finding("note", f"{text} (largest with {one.mass:g} kg)"))
    return found


def of_matrix(fit: ModelFit | None, why: str, fits: Sequence[Fitted]) -> list[Finding]:
    """How well the powers of the load fit at the tested loads."""
    if fit is None:
        return [Finding("note", why)] if fits else []
    off = float(np.abs(fit.computed - fit.measured).max())
    if not fit.converged:
        return [Finding("doubt", "a to d as powers of the load: the fit does not converge")]
    return [Finding("note", f"a to d as powers of the load (paper 2's 20 numbers): within {show(off, 'angle', 2)}")]


def paper_angle(P: Array, mass: float) -> Array:
    """Paper 2's angle [rad] at P [Pa] and a load [kg]; nan outside its range."""
    there = (LOWEST / BARELY <= P) & (HIGHEST * BARELY >= P) & (mass <= MOST * (1 + 1e-9))
    found = np.full(P.shape, np.nan)
    if there.any():
        inside = np.clip(P[there], LOWEST, HIGHEST)
        found[there] = MODELS["arm-angle"].evaluate({"pressure": inside, "load": min(mass, MOST)})["angle"]
    return found


def printed(mass: float) -> float | None:
    """Largest angle of Table 1 at a load [kg], in rad; None for a load that is not in the table."""
    return next((float(np.radians(angle)) for load, angle in TABLE_1.items() if abs(load - mass) < 1e-6), None)


def of_paper(fits: Sequence[Fitted]) -> list[Finding]:
    """Paper 2's formula and Table 1 compared with what was measured."""
    found = []
    off = [(one.of, one.of.mean - paper_angle(one.of.pressure, one.of.mass)) for one in fits]
    known = [(one, values, int(np.nanargmax(np.abs(values)))) for one, values in off if np.isfinite(values).any()]
    if known:
        one, values, place = max(known, key=lambda item: abs(item[1][item[2]]))
        where = f"{show(float(one.pressure[place]), 'pressure', 3)}, {one.mass:g} kg"
        text = f"measured less paper 2's formula: up to {show(float(values[place]), 'angle', 2)} ({where})"
        found.append(Finding("note", text))
    tables = [(fitted.of, table) for fitted in fits if (table := printed(fitted.of.mass)) is not None]
    less = {one.mass: float(one.up.mean(axis=0).max()) - table for one, table in tables}
    if less:
        rows = ", ".join(f"{np.degrees(by):+.2f} ({mass:g} kg)" for mass, by in less.items())
        found.append(Finding("note", f"largest angles less Table 1 of paper 2, in deg: {rows}"))
    return found


def trace(fitted: Fitted, *, compare: bool) -> Trace:
    """Points first, then the curves."""
    one = fitted.of
    P = np.linspace(max(float(one.pressure[0]), 0.0), float(one.pressure[-1]), CURVE)
    points = {"pressure": one.pressure, "angle": one.mean, "below": one.up.mean(axis=0), "above": one.down.mean(axis=0)}
    curves = {"pressure": P}
    if fitted.up is not None and fitted.up.converged:
        curves["fit"] = fitted.up.band({"pressure": np.clip(P, 0.0, HIGHEST)})[0]
    if compare:
        curves["model"] = paper_angle(P, one.mass)
    none, blank = np.full(len(one.pressure), np.nan), np.full(CURVE, np.nan)
    columns = {name: np.concatenate([points.get(name, none), curves.get(name, blank)]) for name in NAMES}
    marks = {"tip_mass": one.mass}
    if compare and (table := printed(one.mass)) is not None:
        marks["table"] = table
    title = f"Bending angle over pressure, {one.mass:g} kg"
    quantities = {name: "pressure" if name == "pressure" else "angle" for name in NAMES}
    return Trace(f"arm-angle-{1000 * one.mass:.0f}-g", "arm-angle", title, columns, quantities, marks)


LOADS, HEIGHT = 6, 190.0


def angles(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for all loads."""
    able = [t for t in traces if has(t, "pressure", "angle")]
    chosen = spread(able, LOADS)
    if not chosen:
        return []
    titles = [show(t.marks["tip_mass"], "mass", 4) if "tip_mass" in t.marks else t.name for t in chosen]
    labels = label(chosen[0], "pressure"), label(chosen[0], "angle")
    kinds = {name for t in chosen for name in NAMES if has(t, name)}
    caption = "Angle of the arm's end at rest over the pressure of the bending muscle, at each load."
    if "above" in kinds:
        caption += " △ reached from below, ▽ from above; right: from above less from below."
    if "fit" in kinds:
        caption += " Lines: α = a + b / [1 + (p/c)^d] through the way up (paper 2, second eqs. 10)."
    if "model" in kinds:
        caption += " Dashed: the same with paper 2's 20 numbers."
    if any("table" in t.marks for t in chosen):
        caption += " Short lines at the right end: the largest angles of its Table 1."
    charts = [_charts(chosen, titles, labels)]
    return [of_traces(charts, "Bending angle of the arm", caption, analysis, chosen, able, titles=titles)]


def _charts(traces: Sequence[Trace], titles: Sequence[str], labels: tuple[str, str]) -> list[Chart]:
    """Left the angles; right the gap between both branches, if there are two."""
    lines, marks, gaps = [], [], []
    for i, (trace, title) in enumerate(zip(traces, titles, strict=True)):
        color = PALETTE[i % len(PALETTE)]
        for name in ("fit", "model"):
            if has(trace, name):
                dashed = name == "model"
                lines.append(curve(trace, "pressure", name, "", color, width=0.9, dashed=dashed, hidden=True))
        for name, mark, word in (("below", "^", title), ("above", "v", "")):
            if has(trace, name):
                said = f"{title} {name}"
                marks.append(curve(trace, "pressure", name, word, color, mark, hollow=True, said=said))
        if "table" in trace.marks:
            ends = np.array([0.985, 1.015]) * np.nanmax(column(trace, "pressure"))
            marks.append(Series("", ends, np.degrees(np.full(2, trace.marks["table"])), INK, hidden=True))
        if has(trace, "below", "above"):
            gap = column(trace, "above") - column(trace, "below")
            known = np.isfinite(gap)
            look = column(trace, "pressure")[known], gap[known], color
            gaps += [Series("", *look, width=0.7, hidden=True), Series("", *look, "o", said=title)]
    marks += [one for theirs in crosses(traces, "pressure", "angle") for one in theirs]
    share = 0.6 if gaps else 1.0
    charts = [Chart(*labels, (*lines, *marks), share * PAGE, HEIGHT, legend=True)]
    if gaps:
        zero, rest = (Level(0.0, color=QUIET, dashed=False),), (1 - share) * PAGE - GAP
        charts.append(Chart(labels[0], "above − below [deg]", tuple(gaps), rest, HEIGHT, levels=zero))
    return charts


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Angle at the preload, the largest angle, and the largest gap between both branches."""
    try:
        stair = stair_of(trial, settings_of(run))
    except NotUsable as reason:
        return [Measured("alpha_0", "angle", None), Measured("alpha_max", "angle", None)], [str(reason)]
    sets = [rest.set for rest in stair.rests if rest.side < 0]
    up, down = stair.column(sets, -1), stair.column(sets, 1)
    noise = 6 * max(rest.noise for rest in stair.rests)
    worst = max(stair.rests, key=lambda rest: abs(rest.drift))
    drifts = abs(worst.drift) > max(DRIFT * float(np.ptp(up)) / 4, noise)
    doubts = [f"the angle still changes by {show(worst.drift, 'angle', 2)}"] if drifts else []
    if up[-1] < up[0]:
        doubts.append("the angle falls where the pressure rises")
    gaps = (down - up)[np.isfinite(down)]
    apart = [Measured("alpha_H", "angle", float(gaps[np.argmax(np.abs(gaps))]), noise=noise)] if len(gaps) else []
    return [
        Measured("alpha_0", "angle", float(up[0]), noise=noise),
        Measured("alpha_max", "angle", float(up.max()), noise=noise),
        *apart,
    ], doubts
