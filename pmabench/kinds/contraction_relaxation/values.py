"""Coefficients at the tested pressures, out of a solved fit; what they say of quantities that other tests measure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.verdict.agreement import Offer, anywhere, at_pressures, everywhere, exactly, straight, weighted
from pmabench.kinds.contraction_relaxation.checks import WIDE
from pmabench.kinds.contraction_relaxation.intervals import Trust
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS, Solved
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign
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
