"""Coefficients at the tested pressures, out of a solved fit; what they say of quantities that other tests measure.

And polynomials through coefficients at several pressures, with intervals in parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, log, sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import skew, student
from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.verdict.agreement import Offer, anywhere, at_pressures, everywhere, exactly, straight, weighted
from pmabench.kinds.contraction_relaxation.checks import WIDE
from pmabench.kinds.contraction_relaxation.intervals import Trust
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS, Solved
from pmabench.kinds.contraction_relaxation.segments import Campaign, Segments
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Parts
from pmabench.store.records import Array

METHOD = "measured-pressure"
OPEN_FORCE = "not identifiable: K is not at this pressure, and F_ce and K x stand for one another"
OPEN_FRICTION = "not identifiable: K is at no pressure"
FEWEST = 3
"""Fewest segments near a pressure for a coefficient there."""
NUMERICS = 2e-4
"""The method part is no smaller than this share of a coefficient: replays are integrated, too."""
QUANTITY = {"F_ce": ("N", "force"), "K": ("N/m", "stiffness"), "B_c": ("N.s/m", "damping"), "B_r": ("N.s/m", "damping")}


@dataclass(frozen=True)
class Further:
    """Results of a method next to the primary one."""

    estimates: tuple[Estimate, ...] = ()
    curves: tuple[Curve, ...] = ()
    findings: tuple[Finding, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Solution:
    """A fit and what follows from it."""

    campaign: Campaign
    segments: Segments
    fit: Solved
    knots: Array
    """Pressures [Pa], tested ones among them, half way between which the samples near one of them end."""
    trust: Trust
    method: str
    note: str = ""
    stiffness_is: Callable[[float], str] = lambda P: ""
    """Pressure [Pa] -> which K it is, in words; empty where there is one only."""


def values(solution: Solution) -> list[Estimate]:
    """F_ce [N], K [N/m], B_c, B_r [N.s/m] at every tested pressure and F_c [N], or why there is none."""
    estimates: list[Estimate] = []
    tested = solution.campaign.tested
    stiff = {P: _estimate(solution, "K", P) for P in tested}
    for symbol in SYMBOLS:
        found = [_estimate(solution, symbol, P) for P in tested]
        if symbol == "F_ce":
            found = [_open(e, OPEN_FORCE) if stiff[e.at["pressure"]].value is None else e for e in found]
        estimates += found
    friction = _friction(solution)
    estimates.append(friction if any(e.value is not None for e in stiff.values()) else _open(friction, OPEN_FRICTION))
    return estimates


def _open(estimate: Estimate, note: str) -> Estimate:
    """The estimate without its value, and why."""
    if estimate.value is None:
        return estimate
    return replace(estimate, value=None, parts=Parts(), bias=None, corrected=False, budget=(), note=note)


def _estimate(solution: Solution, symbol: str, P: float) -> Estimate:
    """One coefficient at one pressure [Pa], or why there is none."""
    solved, segments, campaign = solution.fit, solution.segments, solution.campaign
    others = solution.knots[np.abs(solution.knots - P) > 1e-6 * P]
    near = np.abs(segments.pressure - P) <= 0.5 * float(np.min(np.abs(others - P)))
    if symbol in ("B_c", "B_r"):
        near &= (segments.way > 0) == (symbol == "B_c")
    numbers = np.unique(segments.trial[near])
    unit, quantity = QUANTITY[symbol]
    base: dict[str, Any] = {
        "symbol": symbol,
        "unit": unit,
        "quantity": quantity,
        "method": solution.method,
        "note": sentences(solution.note, solution.stiffness_is(P) if symbol == "K" else ""),
        "at": {"pressure": P},
        "n": len(numbers),
        "trials": tuple(campaign.name(int(number)) for number in numbers),
    }
    moving = {"B_c": "contracting", "B_r": "relaxing"}.get(symbol, "moving")
    if near.sum() < FEWEST:
        return Estimate(value=None, **base | {"note": f"not identifiable: no {moving} samples near this pressure"})
    combination = solved.row(symbol, P)
    value = float(combination @ solved.theta)
    parts, bias, budget = solution.trust.budget(combination, NUMERICS * abs(value))
    size = float(np.median(np.abs(solved.values(symbol, solution.knots))))
    if (parts.repeats or 0.0) > WIDE * max(abs(value), size):
        note = f"not identifiable: the {moving} samples near this pressure leave it open"
        return Estimate(value=None, **base | {"note": note})
    found = Estimate(value=value - bias, parts=parts, bias=bias, corrected=True, budget=budget, **base)
    return _settled(campaign, found)


def _settled(campaign: Campaign, estimate: Estimate) -> Estimate:
    """The estimate, without a value where the clocks do not allow one."""
    return skew.settled(estimate, "the channels", campaign.skew)


def _friction(solution: Solution) -> Estimate:
    """F_c over the whole campaign."""
    campaign, numbers = solution.campaign, np.unique(solution.segments.trial)
    base: dict[str, Any] = {
        "symbol": "F_c",
        "unit": "N",
        "quantity": "force",
        "method": solution.method,
        "note": solution.note,
        "n": len(numbers),
        "trials": tuple(campaign.name(int(number)) for number in numbers),
    }
    if not solution.fit.friction:
        note = "not identifiable: the samples move one way only, and F_ce carries the friction"
        return Estimate(value=None, **base | {"note": note})
    combination = np.zeros(len(solution.fit.theta))
    combination[solution.fit.columns("F_c")] = 1.0
    parts, bias, budget = solution.trust.budget(combination)
    value = solution.fit.coulomb - bias
    return _settled(campaign, Estimate(value=value, parts=parts, bias=bias, corrected=True, budget=budget, **base))


ASKED = {METHOD: "", "joint": "joint fit", "output-error": "output-error fit"}
"""Method -> its words; all but the first are there only where somebody asked for them."""


def offers(analysis: Analysis) -> Iterator[Offer]:
    """By the primary method and by those that were asked for; B is the mean of both directions, as others see it.

    Where the muscle is bent, K is that of one contraction, and no straight line gives the force.
    """
    places = {one["pressure"]: one["contraction"] for one in analysis.facts.get("form", {}).get("K_at", ())}
    reached: dict[int, float] = {}
    unloaded = set[int]()
    for step in analysis.facts.get("steps", ()):
        P = round(step["pressure"])
        if step["phase"] == "contract":
            reached[P] = max(step["x_inf"], reached.get(P, 0.0))
            unloaded |= {P} if step["load"] <= 0 else set()
    for method, words in ASKED.items():
        F_ce, K, B_c, B_r = (at_pressures(analysis, symbol, method) for symbol in ("F_ce", "K", "B_c", "B_r"))
        B = {P: weighted([(one, 0.5), (B_r[P], 0.5)], "B") for P, one in B_c.items() if P in B_r}
        x = {P: _without_load(one, K[P]) for P, one in F_ce.items() if P in K and round(P) in unloaded}
        if places:
            yield exactly("F", {(P, 0.0): one for P, one in F_ce.items()}, words)
            yield replace(exactly("K", {(P, places.get(P)): one for P, one in K.items()}, words), bent=True)
        else:
            yield straight(F_ce, K, lambda P: reached.get(round(P), 0.0), words)
            yield from (everywhere(symbol, known, words) for symbol, known in (("K", K), ("x", x)))
        yield everywhere("B", B, words)
        for e in analysis.estimates:
            if (e.symbol, e.method, dict(e.at)) == ("F_c", method, {}) and e.value is not None:
                yield anywhere("F_c", e, words)


def _without_load(F_ce: Estimate, K: Estimate) -> Estimate:
    """X = F_ce / K [m], where contractions without load are among the tests."""
    stiffness, x = K.value or np.inf, (F_ce.value or 0.0) / (K.value or np.inf)
    found = weighted([(F_ce, 1 / stiffness), (K, -x / stiffness)], "x")
    return replace(found, value=x, unit="m", quantity="length")


def by_paper_1(analysis: Analysis) -> Iterator[Offer]:
    """K of the way that the protocol names, the first: its F_ce is geometry, and its B_r carries another pressure."""
    first = next((e.method for e in analysis.estimates if e.symbol == "K"), "")
    yield everywhere("K", at_pressures(analysis, "K", first), "paper 1's way")


TERMS = ("intercept", "slope", "quadratic")
MOST_ORDER = 6
"""Highest order that is chosen where none is given."""
EXACT = 1e-9
"""Residual below this share of the largest value counts as none when orders are compared."""
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


def polynomial(P: Array, y: Array, half: Array, order: int, normal: tuple[float, float] | None = None) -> Polynomial:
    """Fit over pressures P (n,) [Pa]; points weigh as their half widths (n,) say, none better than `FLOOR`.

    The terms are those of P, with `normal` = (centre, scale) [Pa] those of z = (P - centre) / scale.
    """
    centre, scale = normal or (0.0, float(np.max(np.abs(P))))
    weight = 1.0 / np.hypot(half, FLOOR * float(np.max(np.abs(y))))
    design = ((P[:, None] - centre) / scale) ** np.arange(order + 1)
    inverse = np.linalg.inv((design * weight[:, None] ** 2).T @ design)
    rows = inverse @ (design * weight[:, None] ** 2).T
    residual = y - design @ (rows @ y)
    if normal is None:
        rows = rows / scale ** np.arange(order + 1)[:, None]
    terms = rows @ y
    total = float(np.sum((y - y.mean()) ** 2))
    left = len(P) - order - 1
    power = float(residual @ residual)
    scatter = None
    if left > 0:
        scatter = float(student.ppf(0.975, left)) * sqrt(power / left) * np.sqrt(np.sum(rows**2, axis=1))
    r2 = 1.0 - power / total if total > 0 else 1.0
    return Polynomial(terms, rows, r2, sqrt(power / max(1, left)), scatter)


def normal_of(P: Array) -> tuple[float, float]:
    """Centre and scale [Pa] of z = (P - centre) / scale: mean and sample standard deviation of P (n,), as paper 1."""
    return float(np.mean(P)), float(np.std(P, ddof=1))


def compare_orders(P: Array, y: Array) -> dict[int, tuple[float, float]]:
    """Order -> corrected Akaike criterion, and rms of what each point is missed by when it is left out [unit of y].

    Orders from 1 to `MOST_ORDER` for which the criterion is defined: at least order + 4 points.
    """
    floor = EXACT * float(np.max(np.abs(y)))
    n, even = len(P), np.zeros(len(P))
    found = {}
    for order in range(1, min(MOST_ORDER, n - 4) + 1):
        fitted = polynomial(P, y, even, order, normal_of(P))
        z = (P - normal_of(P)[0]) / normal_of(P)[1]
        design = z[:, None] ** np.arange(order + 1)
        residual = y - design @ fitted.terms
        lever = np.sum(design * fitted.rows.T, axis=1)
        power = max(float(residual @ residual) / n, floor**2)
        p = order + 2
        aicc = n * log(power) + 2 * p + 2 * p * (p + 1) / (n - p - 1)
        found[order] = aicc, sqrt(float(np.mean((residual / np.maximum(1 - lever, EXACT)) ** 2)))
    return found


def least(terms: Array, ends: tuple[float, float]) -> float:
    """Least value of a polynomial between `ends`; `terms` from the constant up."""
    turns = (
        np.roots(np.trim_zeros((terms[1:] * np.arange(1, len(terms)))[::-1], "f")) if len(terms) > 1 else np.empty(0)
    )
    inside = [float(t.real) for t in np.atleast_1d(turns) if abs(t.imag) < 1e-9 and ends[0] < t.real < ends[1]]
    return float(np.min(np.polyval(terms[::-1], [*ends, *inside])))


def curve(
    estimates: Sequence[Estimate],
    order: int,
    trust: Trust | None = None,
    places: Sequence[int] = (),
    *,
    normalised: bool = False,
) -> Curve | None:
    """A polynomial over the estimates' pressures; None with fewer than `order` + 1 of them.

    With `trust` and the `places` of the estimates in its fit, correlations between them are carried through; else they
    count as independent. What the points scatter about the curve enters as method. `normalised`: the terms are those of
    z = (P - centre) / scale, with the unit of the coefficient (paper 1 eqs. 17-20).
    """
    if len(estimates) < order + 1:
        return None
    known = estimates[0]
    P = np.array([e.at["pressure"] for e in estimates])
    y = np.array([e.value for e in estimates], dtype=np.float64)
    known_half = [e.parts.combined for e in estimates]
    widest = max((half for half in known_half if half is not None), default=0.0)
    half = np.array([widest if one is None else one for one in known_half])
    normal = normal_of(P) if normalised else None
    found = polynomial(P, y, half, order, normal)
    unit, quantities = QUANTITIES_OF[known.quantity]
    trials = tuple(dict.fromkeys(trial for e in estimates for trial in e.trials))
    terms = []
    for power, value in enumerate(found.terms):
        parts, bias = _parts_of(found, power, estimates, trust, places)
        terms.append(
            Estimate(
                symbol=known.symbol,
                value=float(value),
                unit=unit if normalised else unit + UNITS[power],
                quantity=known.quantity if normalised else quantities[power],
                method=known.method,
                parts=parts,
                n=len(trials),
                bias=bias,
                corrected=bias is not None,
                note="" if parts.repeats is not None else "no repeats part: points of the curve have none",
                trials=trials,
                coordinate=f"z^{power}" if normalised else TERMS[power],
            )
        )
    return Curve(
        symbol=known.symbol,
        form=f"order {order} in z" if normalised else FORMS[order],
        terms=tuple(terms),
        against="pressure",
        domain=(float(P.min()), float(P.max())),
        r2=found.r2,
        residual_rms=found.rms,
        method=known.method,
        centre=normal[0] if normal else 0.0,
        scale=normal[1] if normal else 1.0,
    )


def _parts_of(
    found: Polynomial, power: int, estimates: Sequence[Estimate], trust: Trust | None, places: Sequence[int]
) -> tuple[Parts, float | None]:
    """The interval of one term in parts, and its bias where the trust of a fit tells one."""
    scatter = 0.0 if found.scatter is None else float(found.scatter[power])
    if trust is None:
        return _independent(estimates, found.rows[power], scatter), None
    combination = np.zeros(len(trust.bias))
    combination[list(places)] = found.rows[power]
    return trust.parts(combination, scatter)


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
