"""Sentences and the figure of free contraction: length over pressure from both sides, sigmoid, formula of paper 2."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from pmabench.analysis.model_fit import ModelFit
from pmabench.base.quantities import show
from pmabench.kinds.free_contraction.points import CLEAR, Point, curve_of
from pmabench.model.library import MODELS
from pmabench.plotting.chart import BLUE, BROWN, INK, Chart
from pmabench.plotting.pictures import Picture, crosses, curve, has, label, of_traces
from pmabench.store.analyses.results import Analysis, Finding, Trace
from pmabench.store.records import Array

CURVE = 121
"""Points of a drawn curve."""
DRIFTS = 0.002
"""Change still to come after a hold, as a share of the largest contraction, from which on it is a doubt."""
LEFT = 0.005
"""Contraction remaining at rest without pressure, as a share of the largest one, from which on it is a doubt."""
BARELY = 1.01
"""A measured pressure above a formula's range by at most this factor is evaluated at its end."""
CM = 1e-2


def half_pressure(P: Array, x: Array) -> float | None:
    """Lowest pressure at which x reaches half of its value at the highest pressure, by monotone cubics [Pa]; None if
    never.
    """
    if len(P) < 3 or not bool((np.diff(P) > 0).all()) or not x[-1] > 0:
        return None
    half = 0.5 * x[-1]
    after = int(np.argmax(x >= half))
    if after == 0:
        return None
    curve = PchipInterpolator(P, x)
    return float(brentq(lambda at: float(curve(at)) - half, P[after - 1], P[after], xtol=1e-12 * P[after]))


def paper_length(P: Array, length: float) -> Array | None:
    """Paper 2's length [m] at P [Pa] for a nominal length [m]; None outside its range."""
    model = MODELS["sigmoid-length"]
    known = {p.name: p for p in model.parameters}
    nominal, most = known["nominal_length"], known["pressure"].high
    if not nominal.low * (1 - 1e-9) <= length <= nominal.high * (1 + 1e-9) or P.max() > BARELY * most:
        return None
    L0 = min(max(length, nominal.low), nominal.high)
    found = model.evaluate({"pressure": np.clip(P, 0.0, most), "nominal_length": L0})
    return np.asarray(found["length"], dtype=np.float64)


def of_points(points: Sequence[Point]) -> list[Finding]:
    """Findings on the lengths themselves."""
    if not points:
        return []
    largest = max(abs(point.x) for point in points)
    rests = [rest for point in points for rest in point.rests]
    found = []
    left = max(rests, key=lambda rest: abs(rest.start))
    text = f"at rest without pressure it comes back to the nominal length within {show(abs(left.start), 'length', 2)}"
    if abs(left.start) > max(LEFT * largest, CLEAR * left.noise):
        start = show(left.start, "length", 2)
        text = f"{start} of contraction are left without pressure before trial {left.trial.name}: creep, friction,"
        found.append(Finding("doubt", f"{text} or a zero that is off; L counts from the nominal length"))
    else:
        found.append(Finding("note", text))
    worst = max(points, key=lambda point: abs(point.left.size) if point.left.seen else 0.0)
    if worst.left.seen and abs(worst.left.size) > DRIFTS * largest:
        text = f"at {show(worst.set, 'pressure')} the length would still change by {show(worst.left.size, 'length', 2)}"
        found.append(Finding("doubt", f"{text} after the hold; hold longer"))
    x = np.array([point.x for point in points])
    if len(x) > 1 and x[-1] < -CLEAR * left.noise:
        found.append(Finding("fault", "it grows longer under pressure: a sign is wrong, or it is an extensor"))
    gaps = [(float(point.gaps.mean()), point.set) for point in points if len(point.gaps)]
    if gaps:
        gap, at = max(gaps, key=lambda pair: abs(pair[0]))
        text = f"reached from above it is shorter than from below by up to {show(gap, 'length', 2)}"
        found.append(Finding("note", f"hysteresis: {text}, at {show(at, 'pressure')}"))
    else:
        text = "every pressure was reached from one side: what friction in the muscle makes of the lengths is not seen"
        found.append(Finding("doubt", f"{text}, and in no interval. Take both (`approach: from-both-sides`)"))
    return found


def of_fit(fit: ModelFit | None, why: str, other: str) -> list[Finding]:
    """How well the sigmoid fits; `other` is the reason why it is not the form of these lengths."""
    if fit is None:
        return [Finding("note", why)]
    if not fit.converged:
        return [Finding("doubt", "the sigmoid does not converge on these lengths: they have another form")]
    off = float(np.max(np.abs(fit.computed - fit.measured)))
    text = f"sigmoid with fitted a to e: rms {show(fit.residual_rms, 'length', 2)}, at most {show(off, 'length', 2)}"
    pairs = [f.text for f in fit.findings if f.text.startswith("correlated")]
    found = [Finding("note", text), *(Finding("note", f"a to e: {one}") for one in pairs)]
    return [*found, Finding("doubt", other)] if other else found


def of_paper(points: Sequence[Point], length: float) -> list[Finding]:
    """Comparison with paper 2's formula for this nominal length: of the shape, not of millimetres."""
    P, x = curve_of(points)
    paper = paper_length(P, length)
    if paper is None:
        return [Finding("note", "paper 2's formula does not hold for this length or these pressures: not compared")]
    off = length - x - paper
    at = int(np.argmax(np.abs(off)))
    where = show(float(P[at]), "pressure", 3)
    text = f"measured less paper 2's formula: up to {show(float(off[at]), 'length', 2)} at {where}"
    rounded = f"rounding of its printed coefficients alone is worth {show(rounding(length), 'length', 2)}"
    return [Finding("note", f"{text}; {rounded}")]


def rounding(length: float) -> float:
    """Sum of half a unit in the last printed digit of each part of a, at a nominal length [m]."""
    L0 = length / CM
    return 0.5e-4 * (L0 + L0**2 + L0**3) * CM


def _grid(P: Array) -> Array:
    """Pressures of a drawn curve [Pa]."""
    return np.linspace(max(float(P.min()), 0.0), float(P.max()), CURVE)


def trace(points: Sequence[Point], fit: ModelFit | None, length: float, *, compare: bool) -> Trace:
    """Points first, then the fitted curve and, to `compare`, paper 2's."""
    P, x = curve_of(points)
    grid, none, blank = _grid(P), np.full(len(P), np.nan), np.full(CURVE, np.nan)
    below, above = (length - np.array([point.reached(side) for point in points]) for side in (-1.0, 1.0))
    marked = {"pressure": P, "length": length - x, "below": below, "above": above}
    curves = {"pressure": grid}
    if fit is not None and fit.converged:
        curves["fit"] = fit.band({"pressure": np.minimum(grid, float(fit.columns["pressure"].max()))})[0]
    if compare and (model := paper_length(grid, length)) is not None:
        curves["model"] = model
    columns = {name: np.concatenate([marked.get(name, none), curves.get(name, blank)]) for name in NAMES}
    quantities = {name: "pressure" if name == "pressure" else "length" for name in NAMES}
    title = "Length without load over pressure"
    return Trace("free-contraction", "free-contraction", title, columns, quantities, {"length": length})


NAMES = ("pressure", "length", "below", "above", "fit", "model")
MARKED = {
    "below": ("^", INK, "reached from below"),
    "above": ("v", INK, "reached from above"),
    "length": ("o", INK, "measured"),
}
LINES = {"fit": ("", BROWN, "sigmoid, a to e fitted"), "model": ("", BLUE, "paper 2's formula")}


def lengths(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for each trace: markers of both sides, or of the mean for one side, and the curves."""
    return [_lengths(trace, analysis) for trace in traces if has(trace, "pressure", "length")]


def _lengths(trace: Trace, analysis: Analysis) -> Picture:
    labels = label(trace, "pressure"), label(trace, "length")
    sides = has(trace, "below", "above")
    more = ", at each pressure reached from 0 and from the highest pressure" if sides else ""
    caption = f"Length at rest without load: the nominal length less the contraction{more}."
    if has(trace, "fit"):
        caption += " Brown: L = a + b / [1 + (p/c)^d]^e − 0.009 L0 √p (paper 2, eq. 1) through the means of both."
    if has(trace, "model"):
        caption += (
            " Dashed: the same with a to e of paper 2 for this nominal length; its printed coefficients are rounded: "
            "compare the shape."
        )
    lines = [(name, *LINES[name]) for name in LINES if has(trace, name)]
    marks = [(name, *MARKED[name]) for name in (("below", "above") if sides else ("length",))]
    series = [
        curve(trace, "pressure", name, words, color, mark, hollow=True, dashed=name == "model")
        for name, mark, color, words in lines + marks
    ]
    chart = Chart(*labels, (*series, *crosses([trace], "pressure", "length")[0]), legend=True)
    return of_traces([[chart]], "Free contraction", caption, analysis, [trace])
