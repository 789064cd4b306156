"""K and B_c from contractions under one load, with F_ce(P) known: the pressure that was measured drives the model.

One load cannot tell F_ce from K x: every solution of F_L = F_ce - K x - B x' can be scaled. F_ce from elsewhere settles
it; K and B are then fitted to all contractions at once as in `pooled`. Knows no trial kind and no interval.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pmabench.analysis.shared.samples import Samples
from pmabench.kinds.contraction_relaxation.pooled import FLOOR, SYMBOLS, design_of, first_knots, prior_of
from pmabench.kinds.contraction_relaxation.segments import Gate, cut
from pmabench.store.records import Array

FEWEST = 3
"""Fewest segments near a pressure for a coefficient there."""


def fit_known_force(
    samples: Sequence[Samples], rate: float, tested: Array, force: Callable[[Array], Array]
) -> dict[float, tuple[float, float]]:
    """K [N/m] and B_c [N.s/m] at the tested pressures [Pa] where samples move near them, from contractions alone.

    `force` gives F_ce [N] at pressures [Pa]. Friction, which always points one way here, is held for less F_ce.
    """
    knots = first_knots(tested, np.empty(0))
    gate = Gate()
    segments = cut(samples, rate, gate)
    low, high = knots[0] - 1e3, knots[-1] + (knots[-1] - knots[-2])
    segments = segments.where((segments.way > 0) & (segments.P.min(axis=1) >= low) & (segments.P.max(axis=1) <= high))
    if len(segments) < FEWEST:
        return {}
    design = design_of(segments, knots)
    k = len(knots)
    wanted = slice(SYMBOLS.index("K") * k, (SYMBOLS.index("B_c") + 1) * k)
    known = force(segments.P) @ segments.weights
    noise = FLOOR * float(np.sqrt(np.mean(known**2)))
    prior = prior_of(segments, design, knots, noise)
    rows = prior[np.any(prior[:, wanted] != 0, axis=1)][:, wanted]
    columns = np.vstack([design[:, wanted], rows])
    target = np.concatenate([segments.force - known, np.zeros(len(rows))])
    theta = np.linalg.lstsq(columns, target, rcond=None)[0]
    found = {}
    for P in tested:
        knot = int(np.argmin(np.abs(knots - P)))
        near = np.abs(segments.pressure - P) <= 0.5 * float(np.min(np.abs(np.delete(knots, knot) - P)))
        if near.sum() >= FEWEST:
            found[float(P)] = float(theta[knot]), float(theta[k + knot])
    return found
