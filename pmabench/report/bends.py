"""The bend of a fitted muscle, as its analysis wrote it down: where K is the slope, and what it pulls more there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from pmabench.report.document.tables import is_number, mappings
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import Array


def slopes_of(analyses: Sequence[Analysis], methods: Iterable[str]) -> dict[float, tuple[float, float]]:
    """Of a muscle that is bent, where K of one of the methods is the slope: contraction [m] and the force there [N], by
    pressure [Pa]; empty of a straight one.
    """
    found = {}
    for form in _forms(analyses, methods):
        for one in mappings(form.get("K_at")):
            P, x, F = (one.get(name) for name in ("pressure", "contraction", "force"))
            if is_number(P) and is_number(x) and is_number(F) and isfinite(P * x * F) and x > 0:
                found[float(P)] = float(x), float(F)
    return found


def _forms(analyses: Sequence[Analysis], methods: Iterable[str]) -> Iterable[Mapping[str, object]]:
    known = {*methods}
    for analysis in analyses:
        form = analysis.facts.get("form")
        if isinstance(form, Mapping) and any(e.symbol == "K" and e.method in known for e in analysis.estimates):
            yield form


@dataclass(frozen=True, eq=False)
class Bend:
    """What a fitted muscle pulls more than F_ce - K x [N], shape (pressures, contractions)."""

    P: Array
    """Pressures [Pa], rising."""
    x: Array
    """Contractions [m], rising."""
    force: Array

    def at(self, P: float) -> Array:
        """Its force [N] over `x` at a pressure [Pa]: on straight lines between those tested, and held beyond."""
        return np.array([np.interp(P, self.P, column) for column in self.force.T])


def bend_of(analyses: Sequence[Analysis], methods: Iterable[str]) -> Bend | None:
    """The bend that belongs to K of one of the methods; None of a straight muscle, or where its record is damaged."""
    for form in _forms(analyses, methods):
        known = form.get("bend")
        try:
            P, x, force = (np.asarray(known[name], dtype=np.float64) for name in ("pressure", "contraction", "force"))  # type: ignore[index]
        except (KeyError, TypeError, ValueError):
            continue
        sound = force.ndim == 2 and force.shape == (P.size, x.size) and min(force.shape) > 0
        if sound and np.isfinite(force).all() and np.all(np.diff(P) > 0) and np.all(np.diff(x) > 0):
            return Bend(P, x, force)
    return None
