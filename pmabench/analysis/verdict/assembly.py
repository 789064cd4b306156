"""Results of several like muscles side by side, as those of one of them; knows estimates, no specimen file.

Side by side, forces and volumes add up while contraction and pressure are shared (paper 2: the arm's force is 4 f).
Friction between the muscles, or one that is longer than the others, shows as a difference from a single muscle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis, Curve, Estimate, Parts

ADDED = ("force", "stiffness", "damping", "work", "volume", "mass flow", "impulse", "force rate")
"""Quantities that add up side by side, and what is given per pressure of them."""


def side_by_side(specimen: object) -> int:
    """How many muscles side by side a manifest's specimen is; 1 where nothing says more."""
    assembly = specimen.get("assembly") if isinstance(specimen, Mapping) else None
    return int(assembly.get("parallel", 1)) if isinstance(assembly, Mapping) else 1


def without_diameter(analysis: Analysis, count: int) -> Analysis:
    """The analysis of `count` muscles side by side without a diameter, which would be that of a single muscle."""
    if count == 1:
        return analysis
    note = f"{count} muscles side by side: the diameter would be that of one muscle with their force or volume"
    estimates = tuple(
        replace(e, value=None, parts=Parts(), bias=None, budget=(), bound=None, note=note) if e.symbol == "D_0" else e
        for e in analysis.estimates
    )
    return replace(analysis, estimates=estimates)


def adds_up(quantity: str) -> bool:
    """Whether a quantity of `QUANTITIES` is the sum over muscles side by side."""
    return quantity.split(" per ")[0] in ADDED


def of_one(analysis: Analysis, count: int) -> Analysis:
    """The analysis of `count` like muscles side by side with all that adds up divided by it; traces are left out."""

    def curve(one: Curve) -> Curve:
        share = 1 / count if any(adds_up(term.quantity) for term in one.terms) else 1.0
        terms = tuple(_of_one(term, count) for term in one.terms)
        return replace(one, terms=terms, residual_rms=share * one.residual_rms)

    estimates = tuple(_of_one(e, count) for e in analysis.estimates)
    return replace(analysis, estimates=estimates, curves=tuple(map(curve, analysis.curves)), traces=())


def _of_one(e: Estimate, count: int) -> Estimate:
    at = {name: value / count if adds_up(POINT_QUANTITIES.get(name, "")) else value for name, value in e.at.items()}
    if not adds_up(e.quantity):
        return replace(e, at=at)

    def share(value: float | None) -> float | None:
        return None if value is None else value / count

    parts: Mapping[str, Any] = {name: share(value) for name, value in vars(e.parts).items()}
    budget = tuple(replace(source, half=share(source.half)) for source in e.budget)
    return replace(
        e, at=at, value=share(e.value), parts=Parts(**parts), bias=share(e.bias), bound=share(e.bound), budget=budget
    )
