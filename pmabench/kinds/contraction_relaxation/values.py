"""Coefficients of contraction runs at the tested pressures, out of a solved fit and its trust; fits nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmabench.analysis.results import Estimate, Parts
from pmabench.analysis.shared import skew
from pmabench.kinds.contraction_relaxation import free_run
from pmabench.kinds.contraction_relaxation.intervals import Trust
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS, Solved
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array

OPEN_FORCE = "not identifiable: K is not at this pressure, and F_ce and K x stand for one another"
OPEN_FRICTION = "not identifiable: K is at no pressure"
FEWEST = 3
"""Fewest segments near a pressure for a coefficient there."""
NUMERICS = 2e-4
"""The method part is no smaller than this share of a coefficient: replays are integrated, too."""
QUANTITY = {"F_ce": ("N", "force"), "K": ("N/m", "stiffness"), "B_c": ("N.s/m", "damping"), "B_r": ("N.s/m", "damping")}


@dataclass(frozen=True, eq=False)
class Told:
    """A fit and what can be told of it."""

    campaign: Campaign
    segments: Segments
    fit: Solved
    knots: Array
    """Pressures [Pa], tested ones among them, half way between which the samples near one of them end."""
    trust: Trust
    method: str
    note: str = ""


def values(told: Told) -> list[Estimate]:
    """F_ce [N], K [N/m], B_c, B_r [N.s/m] at every tested pressure and F_c [N], or why there is none."""
    estimates: list[Estimate] = []
    tested = told.campaign.tested
    stiff = {P: _estimate(told, "K", P) for P in tested}
    for symbol in SYMBOLS:
        found = [_estimate(told, symbol, P) for P in tested]
        if symbol == "F_ce":
            found = [_open(e, OPEN_FORCE) if stiff[e.at["pressure"]].value is None else e for e in found]
        estimates += found
    friction = _friction(told)
    estimates.append(friction if any(e.value is not None for e in stiff.values()) else _open(friction, OPEN_FRICTION))
    return estimates


def _open(estimate: Estimate, note: str) -> Estimate:
    """The estimate without its value, and why."""
    if estimate.value is None:
        return estimate
    return replace(estimate, value=None, parts=Parts(), bias=None, corrected=False, budget=(), note=note)


def _estimate(told: Told, symbol: str, P: float) -> Estimate:
    """One coefficient at one pressure [Pa], or why there is none."""
    solved, segments, campaign = told.fit, told.segments, told.campaign
    others = told.knots[np.abs(told.knots - P) > 1e-6 * P]
    near = np.abs(segments.pressure - P) <= 0.5 * float(np.min(np.abs(others - P)))
    if symbol in ("B_c", "B_r"):
        near &= (segments.way > 0) == (symbol == "B_c")
    numbers = np.unique(segments.trial[near])
    unit, quantity = QUANTITY[symbol]
    base: dict[str, Any] = {
        "symbol": symbol,
        "unit": unit,
        "quantity": quantity,
        "method": told.method,
        "note": told.note,
        "at": {"pressure": P},
        "n": len(numbers),
        "trials": tuple(campaign.name(int(number)) for number in numbers),
    }
    moving = {"B_c": "contracting", "B_r": "relaxing"}.get(symbol, "moving")
    if near.sum() < FEWEST:
        return Estimate(value=None, **base | {"note": f"not identifiable: no {moving} samples near this pressure"})
    combination = solved.row(symbol, P)
    value = float(combination @ solved.theta)
    parts, bias, budget = told.trust.budget(combination, NUMERICS * abs(value))
    size = float(np.median(np.abs(solved.values(symbol, told.knots))))
    if (parts.repeats or 0.0) > free_run.WIDE * max(abs(value), size):
        note = f"not identifiable: the {moving} samples near this pressure leave it open"
        return Estimate(value=None, **base | {"note": note})
    found = Estimate(value=value - bias, parts=parts, bias=bias, corrected=True, budget=budget, **base)
    return _settled(campaign, found)


def _settled(campaign: Campaign, estimate: Estimate) -> Estimate:
    """The estimate, without a value where the clocks do not allow one."""
    return skew.settled(estimate, "the channels", campaign.skew)


def _friction(told: Told) -> Estimate:
    """F_c over the whole campaign."""
    campaign, numbers = told.campaign, np.unique(told.segments.trial)
    base: dict[str, Any] = {
        "symbol": "F_c",
        "unit": "N",
        "quantity": "force",
        "method": told.method,
        "note": told.note,
        "n": len(numbers),
        "trials": tuple(campaign.name(int(number)) for number in numbers),
    }
    if not told.fit.friction:
        note = "not identifiable: the samples move one way only, and F_ce carries the friction"
        return Estimate(value=None, **base | {"note": note})
    combination = np.zeros(len(told.fit.theta))
    combination[told.fit.columns("F_c")] = 1.0
    parts, bias, budget = told.trust.budget(combination)
    value = told.fit.coulomb - bias
    return _settled(campaign, Estimate(value=value, parts=parts, bias=bias, corrected=True, budget=budget, **base))
