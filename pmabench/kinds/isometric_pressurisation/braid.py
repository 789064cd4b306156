"""S(eps) of the modified Daerden model fitted to slopes of force over pressure: D0, theta0, alpha and their
uncertainty.

S = (pi/4) D0^2 [3 (1 - eps)^alpha / tan^2 theta0 - 1 / sin^2 theta0] (paper 3 eq. 9). For a given alpha it is linear in
(1 - eps)^alpha, so only alpha is searched, without start values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import asin, atan, degrees, hypot, pi, sqrt
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales
from pmabench.base.quantities import show
from pmabench.kinds.isometric_pressurisation.curve import Cell
from pmabench.model.library.daerden import section_factor
from pmabench.plotting.chart import BLUE, Chart, Series
from pmabench.plotting.pictures import Picture, column, has, of_traces, unit_of
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array

SECTION = "daerden-section"
QUANTITY = {"D_0": ("length", "m"), "theta_0": ("angle", "rad"), "alpha": ("count", "1")}
ALPHAS = (1.0, 5.0)
"""Search range of alpha: the domain of the model."""
FLOOR = 2e-3
"""Floor of the error of a slope, as a share of the largest: nothing on a bench is known better."""
NAMES = ("D_0", "theta_0", "alpha")
OPEN = 0.25
"""A parameter whose 95 % interval is wider than this share of its value is not separable from the others."""
FURTHEST = 3.0
"""Largest distance of a slope from the curve, in its errors."""
STEP = 1e-6
NONE = 1e30
"""Sum of squares where no braid has this alpha: the search cannot handle infinity."""


@dataclass(frozen=True)
class Slopes:
    """Slopes S [N/Pa] over contraction eps [1], and the standard error of each; shape (n,)."""

    eps: Array
    S: Array
    error: Array

    @property
    def weight(self) -> Array:
        """Inverse of the error, which is at least `FLOOR` of the largest slope."""
        return np.asarray(1.0 / np.hypot(self.error, FLOOR * np.abs(self.S).max()))


@dataclass(frozen=True)
class Section:
    """S(eps) through slopes: D0 [m], theta0 [rad], alpha [1], of which `free` were fitted."""

    slopes: Slopes
    D_0: float
    theta_0: float
    alpha: float
    free: tuple[str, ...]
    power: float
    """Weighted sum of squares."""

    @property
    def given(self) -> float | None:
        """D0 [m], where it was not fitted."""
        return None if "D_0" in self.free else self.D_0

    @property
    def values(self) -> Array:
        """D0, theta0, alpha."""
        return np.array([self.D_0, self.theta_0, self.alpha])

    def at(self, eps: Array) -> Array:
        """S [N/Pa] at eps [1]."""
        return section_factor(eps, *self.values)

    @property
    def freedom(self) -> int:
        """Number of slopes minus free parameters."""
        return len(self.slopes.S) - len(self.free)

    @property
    def other_form(self) -> bool:
        """Whether a slope is further from the curve than three times its error: S(eps) is not of this form."""
        off = self.slopes.S - self.at(self.slopes.eps)
        return self.freedom > 0 and bool(np.max(np.abs(off) * self.slopes.weight) > FURTHEST)

    def _jacobian(self, eps: Array) -> Array:
        """Change of S by the free parameters, shape (n, free)."""
        columns = []
        for name in self.free:
            step = np.where(np.array(NAMES) == name, STEP * np.abs(self.values), 0.0)
            up, down = (section_factor(eps, *(self.values + way * step)) for way in (1, -1))
            columns.append((up - down) / (2 * float(step.sum())))
        return np.column_stack(columns)

    @property
    def _variance(self) -> float:
        """Variance of weighted slopes: from the residuals, at least from the slopes' own errors."""
        return max(self.power / self.freedom, float(np.mean((self.slopes.error * self.slopes.weight) ** 2)))

    @cached_property
    def _spread(self) -> tuple[Array, float]:
        """Covariance of the free parameters and Student's t for 95 %."""
        weighted = self._jacobian(self.slopes.eps) * self.slopes.weight[:, None]
        covariance = np.asarray(np.linalg.pinv(weighted.T @ weighted) * self._variance)
        return covariance, float(student.ppf(0.975, self.freedom))

    def half(self, name: str) -> float | None:
        """Half width of the 95 % interval of a parameter, the wider of linear and profile; None without freedom."""
        if name not in self.free or self.freedom < 1:
            return None
        covariance, t = self._spread
        at = self.free.index(name)
        linear = t * sqrt(max(0.0, float(covariance[at, at])))
        ends = [abs(values[NAMES.index(name)] - getattr(self, name)) for values in self.as_good]
        return max(linear, *ends) if ends else linear

    def band(self, eps: Array) -> Array:
        """Half width of the 95 % band of S at eps [N/Pa]; NaN without freedom."""
        if self.freedom < 1:
            return np.full(len(eps), np.nan)
        covariance, t = self._spread
        rows = self._jacobian(eps)
        return np.asarray(t * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, covariance, rows), 0.0)))

    @cached_property
    def as_good(self) -> list[Array]:
        """Parameters at both ends of the range of alpha with an equally good fit (profile, 95 %)."""
        if self.freedom < 1:
            return []
        most = self.power + float(student.ppf(0.975, self.freedom)) ** 2 * self._variance
        ends = []
        for bound in ALPHAS:
            good = self
            for alpha in np.linspace(self.alpha, bound, 200)[1:]:
                one = _at_alpha(self.slopes, float(alpha), self.given)
                if one is None or one.power > most:
                    break
                good = one
            if good is not self:
                ends.append(good.values)
        return ends

    @property
    def open(self) -> tuple[str, ...]:
        """Free parameters that the slopes do not determine: interval too wide, or none."""
        halves = {name: self.half(name) for name in self.free}
        return tuple(n for n, half in halves.items() if half is None or half > OPEN * abs(getattr(self, n)))


def fit(slopes: Slopes, D_0: float | None = None) -> Section | None:
    """The curve through slopes, with all parameters free or D0 [m] given; None if there is none."""
    free = 3 if D_0 is None else 2
    if len(slopes.S) < free or len(np.unique(np.round(slopes.eps, 6))) < free or (slopes.eps >= 1).any():
        return None

    def power(value: float) -> float:
        one = _at_alpha(slopes, value, D_0)
        return NONE if one is None else one.power

    grid = np.linspace(*ALPHAS, 81)
    powers = np.array([power(float(value)) for value in grid])
    if not (powers < NONE).any():
        return None
    best = int(np.argmin(powers))
    bounds = float(grid[max(0, best - 1)]), float(grid[min(len(grid) - 1, best + 1)])
    found = float(minimize_scalar(power, bounds=bounds, method="bounded", options={"xatol": 1e-9}).x)
    return _at_alpha(slopes, found if power(found) <= powers[best] else float(grid[best]), D_0)


def _at_alpha(slopes: Slopes, alpha: float, given: float | None) -> Section | None:
    """Least squares of D0 and theta0, or of theta0 for a given D0 [m], at this alpha; None where that is no braid."""
    w, g = slopes.weight, (1 - slopes.eps) ** alpha
    if given is None:  # S = C1 g - C2, C1 = 3 C2 cos^2 theta0
        C1, C2 = np.linalg.lstsq(np.column_stack([g, -np.ones_like(g)]) * w[:, None], slopes.S * w, rcond=None)[0]
        if not 0 < C1 < 3 * C2:
            return None
        sine = 1 - C1 / (3 * C2)
        D_0, theta_0 = sqrt(4 * C2 * sine / pi), asin(sqrt(sine))
    else:  # S / A0 + 1 = (3 g - 1) / tan^2 theta0
        row, left = (3 * g - 1) * w, (slopes.S / (pi / 4 * given**2) + 1) * w
        cotangent = float(np.sum(row * left) / np.sum(row * row))
        if cotangent <= 0:
            return None
        D_0, theta_0 = given, atan(1 / sqrt(cotangent))
    off = (slopes.S - section_factor(slopes.eps, *np.array([D_0, theta_0, alpha]))) * w
    free = NAMES if given is None else NAMES[1:]
    return Section(slopes, D_0, theta_0, alpha, free, float(np.sum(off * off)))


def sections_of(cells: Sequence[Cell], given: Mapping[str, Any]) -> dict[str, Section]:
    """S(eps) by method: all parameters free, or D0 from the specimen; empty without a nominal length."""
    usable = [(cell, cell.pooled) for cell in cells if cell.pooled is not None]
    if "nominal_length" not in given or not usable:
        return {}
    halves = [pooled.half("m") or 0.0 for _, pooled in usable]
    slopes = Slopes(
        np.array([float(cell.place.mean()) for cell, _ in usable]) / given["nominal_length"],
        np.array([pooled.line.m for _, pooled in usable]),
        np.array(halves) / 1.96,
    )
    fits = {SECTION: fit(slopes)}
    if "inner_diameter" in given:
        fits[f"{SECTION}, D_0 of the specimen"] = fit(slopes, given["inner_diameter"])
    return {name: one for name, one in fits.items() if one is not None}


def section_estimates(sections: Mapping[str, Section], scales: Scales, given: Mapping[str, float]) -> list[Estimate]:
    """The free parameters of each method; without value where the slopes do not determine them.

    Calibration: the fit is repeated with the gain of force or pressure, and the zero or gain of the displacement, off
    by its uncertainty.
    """
    found = []
    for method, one in sections.items():
        again = _sections_again(one, scales, given["nominal_length"])
        for name in one.free:
            half, is_open = one.half(name), one.other_form or name in one.open
            quantity, unit = QUANTITY[name]
            value = float(getattr(one, name))
            changes = [float(getattr(other, name)) - value for other in again]
            text = f"fitted {show(value, quantity, 4)}" + (f" +- {show(half, quantity, 2)}" if half is not None else "")
            why = "S(eps) has another form" if one.other_form else "not determined separately from the others"
            note = f"{why}: {text}" if is_open else ""
            parts = Parts() if is_open else Parts(repeats=half, calibration=hypot(*changes) if changes else None)
            n = len(one.slopes.S)
            found.append(Estimate(name, None if is_open else value, unit, quantity, method, {}, parts, n, note=note))
    return found


def _sections_again(one: Section, scales: Scales, length: float) -> list[Section]:
    """Fits to the same slopes with each scale off by its uncertainty; empty where the record gives none."""
    slopes = one.slopes
    gain = hypot(scales.gains.get("force", 0.0), scales.gains.get("pressure", 0.0))
    ways = [replace(slopes, S=slopes.S * (1 + gain))] if gain else []
    if zero := scales.offsets.get("displacement", 0.0):
        ways.append(replace(slopes, eps=slopes.eps + zero / length))
    if share := scales.gains.get("displacement", 0.0):
        ways.append(replace(slopes, eps=slopes.eps * (1 + share)))
    fits = [fit(way, one.given) for way in ways]
    return [other for other in fits if other is not None]


CURVE = 60
"""Points of a drawn curve."""
COLUMNS = ("contraction", "slope", "half", "curve", "low", "high")


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


def section_trace(one: Section, cells: Sequence[Cell], length: float) -> Trace:
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


def pictures(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for each trace: slopes and the curve."""
    return [_picture(trace, analysis) for trace in traces if has(trace, *COLUMNS)]


def _picture(trace: Trace, analysis: Analysis) -> Picture:
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
