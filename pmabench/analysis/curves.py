"""A line or a quadratic through coefficients at several pressures, with intervals in parts; knows no test kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from scipy.stats import t as student

from pmabench.analysis.intervals import Trust
from pmabench.analysis.results import Curve, Estimate, Parts
from pmabench.store.records import Array

TERMS = ("intercept", "slope", "quadratic")
FORMS = {1: "line", 2: "quadratic"}
FLOOR = 5e-3
"""Least weight-giving error of a point, as a share of the largest value: no point of a curve counts for all."""
QUANTITIES_OF = {
    "force": ("N", ("force", "force per pressure", "force per pressure squared")),
    "stiffness": ("N/m", ("stiffness", "stiffness per pressure", "stiffness per pressure squared")),
    "damping": ("N.s/m", ("damping", "damping per pressure", "damping per pressure squared")),
}
"""Quantity of a coefficient -> its unit, and the quantities of the powers of a curve of it over pressure."""
UNITS = ("", "/Pa", "/Pa2")


@dataclass(frozen=True)
class Polynomial:
    """Least squares y = sum c_i P^i: coefficients, and the rows that give them from y, shape (order + 1, n)."""

    terms: Array
    rows: Array
    r2: float
    rms: float
    """Of the residual, with n - order - 1 degrees of freedom."""
    scatter: Array | None
    """Half width of each term from the residual by Student's t; None without a degree of freedom."""


def polynomial(P: Array, y: Array, half: Array, order: int) -> Polynomial:
    """Fit over pressures P (n,) [Pa]; points weigh as their half widths (n,) say, none better than `FLOOR`."""
    scale = float(np.max(np.abs(P)))
    weight = 1.0 / np.hypot(half, FLOOR * float(np.max(np.abs(y))))
    design = (P[:, None] / scale) ** np.arange(order + 1)
    inverse = np.linalg.inv((design * weight[:, None] ** 2).T @ design)
    rows = (inverse @ (design * weight[:, None] ** 2).T) / scale ** np.arange(order + 1)[:, None]
    terms = rows @ y
    residual = y - np.polyval(terms[::-1], P)
    total = float(np.sum((y - y.mean()) ** 2))
    left = len(P) - order - 1
    power = float(residual @ residual)
    scatter = None
    if left > 0:
        scatter = float(student.ppf(0.975, left)) * sqrt(power / left) * np.sqrt(np.sum(rows**2, axis=1))
    r2 = 1.0 - power / total if total > 0 else 1.0
    return Polynomial(terms, rows, r2, sqrt(power / max(1, left)), scatter)


def curve(
    estimates: Sequence[Estimate], order: int, trust: Trust | None = None, places: Sequence[int] = ()
) -> Curve | None:
    """A polynomial over the estimates' pressures; None with fewer than `order` + 1 of them.

    With `trust` and the `places` of the estimates in its fit, correlations between them are carried through; else they
    count as independent. What the points scatter about the curve enters as method.
    """
    if len(estimates) < order + 1:
        return None
    known = estimates[0]
    P = np.array([e.at["pressure"] for e in estimates])
    y = np.array([e.value for e in estimates], dtype=np.float64)
    known_half = [e.parts.combined for e in estimates]
    widest = max((half for half in known_half if half is not None), default=0.0)
    half = np.array([widest if one is None else one for one in known_half])
    found = polynomial(P, y, half, order)
    unit, quantities = QUANTITIES_OF[known.quantity]
    trials = tuple(dict.fromkeys(trial for e in estimates for trial in e.trials))
    terms = []
    for power, value in enumerate(found.terms):
        scatter = 0.0 if found.scatter is None else float(found.scatter[power])
        row = found.rows[power]
        bias = None
        if trust is not None:
            combination = np.zeros(len(trust.bias))
            combination[list(places)] = row
            parts, bias = trust.parts(combination, scatter)
        else:
            parts = _independent(estimates, row, scatter)
        terms.append(
            Estimate(
                symbol=known.symbol,
                value=float(value),
                unit=unit + UNITS[power],
                quantity=quantities[power],
                method=known.method,
                parts=parts,
                n=len(trials),
                bias=bias,
                corrected=bias is not None,
                note="" if parts.repeats is not None else "no repeats part: points of the curve have none",
                trials=trials,
                coordinate=TERMS[power],
            )
        )
    return Curve(
        symbol=known.symbol,
        form=FORMS[order],
        terms=tuple(terms),
        against="pressure",
        domain=(float(P.min()), float(P.max())),
        r2=found.r2,
        residual_rms=found.rms,
        method=known.method,
    )


def _independent(estimates: Sequence[Estimate], row: Array, scatter: float) -> Parts:
    """Parts of sum(row y) for independent y; one error of calibration is in all of them, with one sign."""

    def of(name: str) -> list[float] | None:
        parts = [getattr(e.parts, name) for e in estimates]
        return None if any(part is None for part in parts) else parts

    repeats, method, calibration = of("repeats"), of("method"), of("calibration")
    return Parts(
        repeats=None if repeats is None else float(np.linalg.norm(row * repeats)),
        method=hypot(0.0 if method is None else float(np.linalg.norm(row * method)), scatter),
        calibration=None if calibration is None else abs(float(row @ calibration)),
        skew=float(np.abs(row) @ [e.parts.skew for e in estimates]),
    )
