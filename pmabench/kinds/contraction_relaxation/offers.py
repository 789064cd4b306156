"""What tests of contraction say of quantities that other tests measure, too: F within what was lifted, K, B, F_c."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pmabench.analysis.results import Analysis, Estimate
from pmabench.analysis.verdict.offers import Offer, anywhere, at_pressures, everywhere, straight, weighted
from pmabench.kinds.contraction_relaxation.reduction import METHOD

ASKED = {METHOD: "", "joint": "joint fit", "output-error": "output-error fit"}
"""Method -> its words; all but the first are there only where somebody asked for them."""


def offers(analysis: Analysis) -> Iterator[Offer]:
    """By the primary method and by those that were asked for; B is the mean of both directions, as others see it."""
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
        yield straight(F_ce, K, lambda P: reached.get(round(P), 0.0), words)
        yield from (everywhere(symbol, known, words) for symbol, known in (("K", K), ("B", B), ("x", x)))
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
