"""Coefficients at the tested pressures from a solved fit, and what they predict for quantities of other tests.

Also polynomials through coefficients at several pressures, with interval parts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, log, sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import skew, student
from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.samples import Samples
from pmabench.analysis.verdict.agreement import Offer, anywhere, at_pressures, everywhere, exactly, straight, weighted
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.intervals import Pooled, Trust
from pmabench.kinds.contraction_relaxation.pooled import FLOOR, SYMBOLS, design_of, first_knots, least_squares, prior_of
from pmabench.kinds.contraction_relaxation.segments import Gate, Segments, cut
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Parts, Source, without_value
from pmabench.store.records import Array

METHOD = "measured-pressure"
OPEN_FORCE = "not identifiable: K is not at this pressure, and F_ce and K x stand for one another"
OPEN_FRICTION = "not identifiable: K is at no pressure"
FEWEST = 3
"""Fewest segments near a pressure for a coefficient there."""
WIDE = 0.25
"""A coefficient whose repeats part is wider than this share of its size is not identifiable."""
NUMERICS = 2e-4
"""Smallest method part as a share of a coefficient, since replays are integrated numerically."""
QUANTITY = {
    "F_ce": ("N", "force"),
    "K": ("N/m", "stiffness"),
    "B_c": ("N.s/m", "damping"),
    "B_r": ("N.s/m", "damping"),
    "F_c": ("N", "force"),
}
"""Symbol -> unit and quantity."""
NOWHERE: Mapping[str, float] = {}


def values(pooled: Pooled) -> list[Estimate]:
    """F_ce [N], K [N/m], B_c, B_r [N.s/m] at every tested pressure, and F_c [N]; None with a note where there is no
    value.
    """
    found = [_at(pooled, symbol, P) for symbol in SYMBOLS for P in pooled.campaign.tested]
    stiff = {e.at["pressure"] for e in found if e.symbol == "K" and e.value is not None}
    found = [
        without_value(e, OPEN_FORCE)
        if e.symbol == "F_ce" and e.value is not None and e.at["pressure"] not in stiff
        else e
        for e in found
    ]
    friction = _blank(pooled, "F_c", np.ones(len(pooled.segments), bool))
    if pooled.fit.friction:
        row = pooled.fit.row("F_c", 0.0)
        friction = _given(pooled, friction, row, pooled.trust.budget(row))
    else:
        note = "not identifiable: the samples move one way only, and F_ce carries the friction"
        friction = replace(friction, note=note)
    return [*found, friction if stiff or friction.value is None else without_value(friction, OPEN_FRICTION)]


def name_of(symbol: str, P: float | None) -> str:
    """`K at 300 kPa`; the symbol alone where it has no pressure."""
    return symbol if P is None else f"{symbol} at {show(P, 'pressure', 4)}"


def with_bias(e: Estimate, known: Estimate) -> Estimate:
    """With the difference to the value by measured pressure as bias, not subtracted, and in the method part.

    The method part also includes the interval of that value, except the calibration part, which both share.
    """
    bias = (e.value or 0.0) - (known.value or 0.0)
    of_known = replace(known.parts, calibration=None).combined or 0.0
    parts = replace(e.parts, method=hypot(abs(bias) + of_known, e.parts.method or 0.0))
    return replace(e, bias=bias, parts=parts, note=sentences(e.note, "bias: against measured-pressure"))


def biases(estimates: Sequence[Estimate], symbols: Sequence[str]) -> list[str]:
    """Range of the bias of each symbol, as a share of the value without it, in words."""
    shares = {
        symbol: [
            100 * e.bias / (e.value - e.bias)
            for e in estimates
            if e.symbol == symbol and e.bias is not None and e.value is not None
        ]
        for symbol in symbols
    }
    return [f"{symbol} {min(off):+.2g} to {max(off):+.2g} %" for symbol, off in shares.items() if off]


def near(segments: Segments, knots: Array, symbol: str, P: float) -> NDArray[np.bool_]:
    """Segments that determine a coefficient at P [Pa], shape (n,): half way to the next knots, for B in one direction
    only.
    """
    others = knots[np.abs(knots - P) > 1e-6 * P]
    found = np.abs(segments.pressure - P) <= 0.5 * float(np.min(np.abs(others - P)))
    return np.asarray(found & ((segments.way > 0) == (symbol == "B_c")) if symbol in ("B_c", "B_r") else found)


def fit_known_force(
    samples: Sequence[Samples], rate: float, tested: Array, force: Callable[[Array], Array]
) -> dict[float, tuple[float, float]]:
    """K [N/m] and B_c [N.s/m] at those tested pressures [Pa] near which samples move, from contractions alone.

    `force` gives F_ce [N] at pressures [Pa]. Friction, which has one direction here, acts like a smaller F_ce and is
    not separated.
    """
    knots = first_knots(tested, np.empty(0))
    segments = cut(samples, rate, Gate()).within(knots)
    segments = segments.where(segments.way > 0)
    if len(segments) < FEWEST:
        return {}
    design = design_of(segments, knots)
    k = len(knots)
    wanted = slice(SYMBOLS.index("K") * k, (SYMBOLS.index("B_c") + 1) * k)
    known = force(segments.P) @ segments.weights
    noise = FLOOR * float(np.sqrt(np.mean(known**2)))
    prior = prior_of(segments, knots, noise)
    rows = prior[np.any(prior[:, wanted] != 0, axis=1)][:, wanted]
    theta = least_squares(design[:, wanted], segments.force - known, rows)
    found = {}
    for P in tested:
        knot = int(np.argmin(np.abs(knots - P)))
        if near(segments, knots, "K", float(P)).sum() >= FEWEST:
            found[float(P)] = float(theta[knot]), float(theta[k + knot])
    return found


def _blank(pooled: Pooled, symbol: str, rows: NDArray[np.bool_], at: Mapping[str, float] = NOWHERE) -> Estimate:
    """An estimate, without a value yet, of a coefficient that these rows of the segments determine."""
    names = tuple(pooled.campaign.name(int(number)) for number in np.unique(pooled.segments.trial[rows]))
    note = sentences(pooled.diagnosis.note, pooled.diagnosis.stiffness_is(at["pressure"]) if symbol == "K" else "")
    return Estimate(symbol, None, *QUANTITY[symbol], METHOD, at, n=len(names), note=note, trials=names)


def _given(pooled: Pooled, blank: Estimate, row: Array, known: tuple[Parts, float, tuple[Source, ...]]) -> Estimate:
    """A linear combination of the unknowns with its parts, bias and budget; no value where the clock error is too
    large.
    """
    parts, bias, budget = known
    value = float(row @ pooled.fit.theta) - bias
    found = replace(blank, value=value, parts=parts, bias=bias, corrected=True, budget=budget)
    return skew.settled(found, "the channels", pooled.campaign.skew)


def _at(pooled: Pooled, symbol: str, P: float) -> Estimate:
    """One coefficient at one pressure [Pa]; without a value and with a note where it is not identifiable."""
    solved = pooled.fit
    rows = near(pooled.segments, solved.knots, symbol, P)
    blank = _blank(pooled, symbol, rows, {"pressure": P})
    moving = {"B_c": "contracting", "B_r": "relaxing"}.get(symbol, "moving")
    if rows.sum() < FEWEST:
        return replace(blank, note=f"not identifiable: no {moving} samples near this pressure")
    row = solved.row(symbol, P)
    value = float(row @ solved.theta)
    known = pooled.trust.budget(row, NUMERICS * abs(value))
    size = float(np.median(np.abs(solved.values(symbol, solved.knots))))
    if (known[0].repeats or 0.0) > WIDE * max(abs(value), size):
        return replace(blank, note=f"not identifiable: the {moving} samples near this pressure leave it open")
    return _given(pooled, blank, row, known)


def offers(analysis: Analysis) -> Iterator[Offer]:
    """Offers by the primary method; B is the mean of both directions, as in other tests.

    With a bent force-contraction curve, K holds at one contraction only, and no straight line gives the force.
    """
    places = {one["pressure"]: one["contraction"] for one in analysis.facts.get("form", {}).get("K_at", ())}
    reached: dict[int, float] = {}
    unloaded = set[int]()
    for step in analysis.facts.get("steps", ()):
        P = round(step["pressure"])
        if step["phase"] == "contract":
            reached[P] = max(step["x_inf"], reached.get(P, 0.0))
            unloaded |= {P} if step["load"] <= 0 else set()
    F_ce, K, B_c, B_r = (at_pressures(analysis, symbol, METHOD) for symbol in ("F_ce", "K", "B_c", "B_r"))
    B = {P: weighted([(one, 0.5), (B_r[P], 0.5)], "B") for P, one in B_c.items() if P in B_r}
    x = {P: _without_load(one, K[P]) for P, one in F_ce.items() if P in K and round(P) in unloaded}
    if places:
        yield exactly("F", {(P, 0.0): one for P, one in F_ce.items()})
        yield replace(exactly("K", {(P, places.get(P)): one for P, one in K.items()}), bent=True)
    else:
        yield straight(F_ce, K, lambda P: reached.get(round(P), 0.0))
        yield from (everywhere(symbol, known) for symbol, known in (("K", K), ("x", x)))
    yield everywhere("B", B)
    for e in analysis.estimates:
        if (e.symbol, e.method, dict(e.at)) == ("F_c", METHOD, {}) and e.value is not None:
            yield anywhere("F_c", e)


def _without_load(F_ce: Estimate, K: Estimate) -> Estimate:
    """X = F_ce / K [m], the contraction without load, where such contractions are among the tests."""
    stiffness, x = K.value or np.inf, (F_ce.value or 0.0) / (K.value or np.inf)
    found = weighted([(F_ce, 1 / stiffness), (K, -x / stiffness)], "x")
    return replace(found, value=x, unit="m", quantity="length")


def by_paper_1(analysis: Analysis) -> Iterator[Offer]:
    """K of the convention that the protocol puts first; F_ce comes from geometry, B_r belongs to another pressure."""
    first = next((e.method for e in analysis.estimates if e.symbol == "K"), "")
    yield everywhere("K", at_pressures(analysis, "K", first), "paper 1's way")


TERMS = ("intercept", "slope", "quadratic")
MOST_ORDER = 6
"""Highest order that is tried where none is given."""
EXACT = 1e-9
"""Residual, as a share of the largest value, below which it counts as zero when orders are compared."""
FORMS = {1: "line", 2: "quadratic"}
LEAST_ERROR = 5e-3
"""Smallest error for the weight of a point of a curve, as a share of the largest value, so that no point dominates."""
POWERS = (("", ""), ("/Pa", " per pressure"), ("/Pa2", " per pressure squared"))
"""Suffixes of unit and quantity for the powers of a curve over pressure."""


@dataclass(frozen=True)
class Polynomial:
    """Least squares y = sum c_i P^i: coefficients, and the matrix that gives them from y, shape (order + 1, n)."""

    terms: Array
    rows: Array
    r2: float
    rms: float
    """Rms residual, with n - order - 1 degrees of freedom."""
    scatter: Array
    """Half width of each term from the residual by Student's t."""


def polynomial(P: Array, y: Array, half: Array, order: int, normal: tuple[float, float] | None = None) -> Polynomial:
    """Fit over pressures P (n,) [Pa], weighted by the half widths (n,) with at least `LEAST_ERROR`.

    The terms are powers of P, or with `normal` = (centre, scale) [Pa] of z = (P - centre) / scale.
    """
    centre, scale = normal or (0.0, float(np.max(np.abs(P))))
    weight = 1.0 / np.hypot(half, LEAST_ERROR * float(np.max(np.abs(y))))
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
    scatter = float(student.ppf(0.975, left)) * sqrt(power / left) * np.sqrt(np.sum(rows**2, axis=1))
    r2 = 1.0 - power / total if total > 0 else 1.0
    return Polynomial(terms, rows, r2, sqrt(power / left), scatter)


def normal_of(P: Array) -> tuple[float, float]:
    """Centre and scale [Pa] of z = (P - centre) / scale: mean and sample standard deviation of P (n,), as paper 1."""
    return float(np.mean(P)), float(np.std(P, ddof=1))


def best_orders(P: Array, y: Array) -> list[int]:
    """Orders of polynomials through y (n,) over P (n,), best first by the corrected Akaike criterion.

    From 1 to `MOST_ORDER`, those for which the criterion is defined: at least order + 4 points.
    """
    floor = EXACT * float(np.max(np.abs(y), initial=0.0))
    n, even = len(P), np.zeros(len(P))
    found = {}
    for order in range(1, min(MOST_ORDER, n - 4) + 1):
        fitted = polynomial(P, y, even, order, normal_of(P))
        z = (P - normal_of(P)[0]) / normal_of(P)[1]
        residual = y - z[:, None] ** np.arange(order + 1) @ fitted.terms
        found[order] = aicc(max(float(residual @ residual) / n, floor**2), n, order + 2)
    return sorted(found, key=found.__getitem__)


def aicc(power: float, n: int, p: int) -> float:
    """Corrected Akaike criterion for p unknowns, including the noise; `power`: mean square residual of n values."""
    return n * log(power) + 2 * p + 2 * p * (p + 1) / max(1, n - p - 1)


def least(terms: Array, ends: tuple[float, float]) -> float:
    """Smallest value of a polynomial between `ends`; `terms` from the constant up."""
    turns = np.roots((terms[1:] * np.arange(1, len(terms)))[::-1])
    inside = [float(t.real) for t in turns if abs(t.imag) < 1e-9 and ends[0] < t.real < ends[1]]
    return float(np.min(np.polyval(terms[::-1], [*ends, *inside])))


def curve(
    estimates: Sequence[Estimate],
    order: int,
    trust: Trust | None = None,
    places: Sequence[int] = (),
    *,
    normalised: bool = False,
) -> Curve | None:
    """A polynomial over the estimates' pressures; None with fewer than `order` + 2 of them.

    A curve with as many terms as points would pass through all of them and leave no residual. With `trust` and
    `places`, the indices of the estimates in its fit, correlations between them count; else they are taken as
    independent. The scatter of the points about the curve is the method part. `normalised`: the terms are those of
    z = (P - centre) / scale, with the unit of the coefficient (paper 1 eqs. 17-20).
    """
    if len(estimates) < order + 2:
        return None
    known = estimates[0]
    P = np.array([e.at["pressure"] for e in estimates])
    y = np.array([e.value for e in estimates], dtype=np.float64)
    known_half = [e.parts.combined for e in estimates]
    widest = max((half for half in known_half if half is not None), default=0.0)
    half = np.array([widest if one is None else one for one in known_half])
    normal = normal_of(P) if normalised else None
    found = polynomial(P, y, half, order, normal)
    trials = tuple(dict.fromkeys(trial for e in estimates for trial in e.trials))
    terms = []
    for power, value in enumerate(found.terms):
        parts, bias = _parts_of(found, power, estimates, trust, places)
        unit, quantity = ("", "") if normalised else POWERS[power]
        note = "" if parts.repeats is not None else "no repeats part: points of the curve have none"
        coordinate = f"z^{power}" if normalised else TERMS[power]
        terms.append(
            Estimate(
                known.symbol, float(value), known.unit + unit, known.quantity + quantity, known.method, {}, parts,
                len(trials), bias, bias is not None, note, trials, coordinate,
            )
        )  # fmt: skip
    form = f"order {order} in z" if normalised else FORMS[order]
    ends = float(P.min()), float(P.max())
    return Curve(
        known.symbol, form, tuple(terms), "pressure", ends, found.r2, found.rms, known.method, *(normal or (0.0, 1.0))
    )


def _parts_of(
    found: Polynomial, power: int, estimates: Sequence[Estimate], trust: Trust | None, places: Sequence[int]
) -> tuple[Parts, float | None]:
    """Interval parts of one term, and its bias where it comes from a fit."""
    scatter = float(found.scatter[power])
    if trust is None:
        return _independent(estimates, found.rows[power], scatter), None
    combination = np.zeros(len(trust.bias))
    combination[list(places)] = found.rows[power]
    return trust.parts(combination, scatter)


def _independent(estimates: Sequence[Estimate], row: Array, scatter: float) -> Parts:
    """Parts of sum(row y) for independent y; an error of calibration, or of the clocks, is the same in all of them."""
    parts = weighted(list(zip(estimates, row.tolist(), strict=True)), estimates[0].symbol).parts
    known = [e.parts.calibration for e in estimates]
    return replace(
        parts,
        method=hypot(parts.method or 0.0, scatter),
        calibration=None if None in known else abs(float(row @ np.array(known))),
        skew=float(np.abs(row) @ [e.parts.skew for e in estimates]),
    )
