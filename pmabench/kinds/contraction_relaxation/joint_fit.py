"""One least squares over all trials with chosen forms over pressure; knows no trial point, no interval, no protocol.

    F_L = F_ce(P) - K(P) x - B(P) x' - F_c sign(x'),   B = B_c contracting, B_r relaxing

as in `pooled`, each coefficient in its `Form`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import log, sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.kinds.contraction_relaxation.forms import MOST_ORDER, Form, forms_of
from pmabench.kinds.contraction_relaxation.pooled import (
    BEND,
    FLOOR,
    NONE,
    SYMBOLS,
    Solved,
    bent,
    carried,
    follow,
    sizes_of,
    spread,
)
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.store.records import Array

RIDGE = 1e-12
"""Added to the normal matrix of columns of length 1: what no sample tells stays near 0."""
FALL = 6.0
"""A higher order is taken where the corrected Akaike criterion falls by more than this, and the held-out error, too:
lower ones have considerably less support then (Burnham and Anderson, Model Selection, 2.6)."""


@dataclass(frozen=True, eq=False)
class Joint(Solved):
    """`theta` holds the terms of each form in the order of `SYMBOLS`, then F_c [N]."""

    forms: Mapping[str, Form]
    least: float
    """Pressure [Pa] above which the forms hold: segments below are left out."""
    added: Array
    """Knots [Pa] of polygons that were put where a residual asked for one."""

    def columns(self, symbol: str) -> slice:
        """See `Solved`."""
        start = 0
        for name in SYMBOLS:
            if name == symbol:
                return slice(start, start + self.forms[name].size)
            start += self.forms[name].size
        return slice(start, start + 1)

    def row(self, symbol: str, P: float) -> Array:
        """See `Solved`."""
        found = np.zeros(len(self.theta))
        found[self.columns(symbol)] = self.forms[symbol].basis(np.array(P)) if symbol in SYMBOLS else 1.0
        return found

    def values(self, symbol: str, P: Array) -> Array:
        """See `Solved`."""
        return np.asarray(self.forms[symbol].basis(P) @ self.theta[self.columns(symbol)])

    def again(self, segments: Segments, noise: float) -> Joint:
        """See `Solved`."""
        return solve(segments.where(above(segments, self.least)), self.forms, noise, self.least, self.added)

    def followed(self, gain: float, offset: float) -> Joint:
        """See `Solved`."""
        there = follow(self.added, gain, offset)
        forms = {
            symbol: form if form.knots is None else replace(form, knots=carried(form.knots, self.added, there))
            for symbol, form in self.forms.items()
        }
        return replace(self, forms=forms, added=there)

    def bends(self, segments: Segments, noise: float) -> Array:
        """0: what a form leaves shows in the residual, against that of straight lines between pressures."""
        return np.zeros(len(self.theta))


def above(segments: Segments, least: float) -> NDArray[np.bool_]:
    """Which segments lie above a pressure [Pa], shape (n,)."""
    return np.asarray(segments.P.min(axis=1) >= least)


def solve(
    segments: Segments, forms: Mapping[str, Form], noise: float, least: float = 0.0, added: Array = NONE
) -> Joint:
    """Least squares, with the weak prior of `pooled` for polygons; `noise` [N] is what a residual should have."""
    design = np.hstack(_design(segments, forms))
    friction = bool((segments.way > 0).any() and (segments.way < 0).any())
    if not friction:
        design[:, sum(form.size for form in forms.values())] = 0.0
    inverse, theta = _solved(design.T @ design + _prior(segments, forms, noise), design.T @ segments.force)
    return Joint(theta, inverse, design, segments.force - design @ theta, friction, forms, least, added)


def _prior(segments: Segments, forms: Mapping[str, Form], noise: float) -> Array:
    """Normal matrix that draws each knot of a polygon weakly to the line between its neighbours; shape (p, p)."""
    p = sum(form.size for form in forms.values()) + 1
    prior, start = np.zeros((p, p)), 0
    sizes = sizes_of(segments)
    noise = max(noise, FLOOR * sizes[0])
    for form, size in zip(forms.values(), sizes, strict=True):
        if form.knots is not None and form.size > 2:
            mine = slice(start, start + form.size)
            rows = bent(form.knots) * (noise / (BEND * size))
            prior[mine, mine] = rows.T @ rows + np.eye(form.size) * (noise / (1e3 * size)) ** 2
        start += form.size
    return prior


def _solved(normal: Array, right: Array) -> tuple[Array, Array]:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    unit = normal / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    inverse = np.linalg.inv(unit) / np.outer(scale, scale)
    return inverse, inverse @ right


def _design(segments: Segments, forms: Mapping[str, Form]) -> list[Array]:
    """Regressors, a block for each symbol and one for F_c; shape (n, size) each."""
    weights = np.broadcast_to(segments.weights, segments.P.shape)
    speed = segments.v / segments.v.shape[1]
    contracting = segments.way[:, None] > 0
    return [
        _sums(segments.P, weights, forms["F_ce"]),
        -_sums(segments.P, weights * segments.x, forms["K"]),
        -np.where(contracting, _sums(segments.P_mid, speed, forms["B_c"]), 0.0),
        -np.where(contracting, 0.0, _sums(segments.P_mid, speed, forms["B_r"])),
        -segments.way[:, None],
    ]


def _sums(P: Array, by: Array, form: Form) -> Array:
    """Sums over the second axis of the form's functions at P (n, w) times `by` (n, w); shape (n, size)."""
    if form.knots is not None:
        return spread(P, by, form.knots)
    z = (P - form.centre) / form.scale
    columns = []
    for _ in range(form.size):
        columns.append(by.sum(axis=1))
        by = by * z
    return np.column_stack(columns)


@dataclass(frozen=True)
class Score:
    """How well an order does: corrected Akaike criterion, and what trials that were left out are missed by, rms [N]."""

    aicc: float
    held_out: float


def choose(
    segments: Segments, orders: Mapping[str, int | None], knots: Array, noise: float
) -> tuple[dict[str, int | None], dict[str, dict[int, Score]]]:
    """Orders with a number in place of each -1, and the scores of each symbol's orders beside the others' choice.

    From the constant up, a higher order is taken where both scores fall; symbols in turn, until none changes. At first
    the others have the highest order: what one is short of, another does not make up for.
    """
    open_ones = [symbol for symbol, order in orders.items() if order == -1]
    most = min(MOST_ORDER, len(knots) - 1)
    now = {symbol: most if order == -1 else order for symbol, order in orders.items()}
    scores: dict[str, dict[int, Score]] = {}
    for _ in range(len(open_ones) + 1):
        before = dict(now)
        for symbol in open_ones:
            scores[symbol] = _scores(segments, now, symbol, most, knots, noise)
            best = 0
            for order, score in scores[symbol].items():
                than = scores[symbol][best]
                if score.aicc < than.aicc - FALL and score.held_out < than.held_out:
                    best = order
            now[symbol] = best
        if now == before:
            break
    return now, scores


def _scores(
    segments: Segments, orders: Mapping[str, int | None], symbol: str, most: int, knots: Array, noise: float,
) -> dict[int, Score]:  # fmt: skip
    """The scores of orders 0 to `most` of one symbol; trials are left out by their normal equations."""
    forms = forms_of({**orders, symbol: most}, knots)
    blocks = _design(segments, forms)
    place = SYMBOLS.index(symbol)
    trials = [np.flatnonzero(segments.trial == trial) for trial in np.unique(segments.trial)]
    found = {}
    for order in range(most + 1):
        design = np.hstack([block[:, : order + 1] if i == place else block for i, block in enumerate(blocks)])
        lower = {**forms, symbol: replace(forms[symbol], size=order + 1)}
        normal = design.T @ design + _prior(segments, lower, noise)
        right = design.T @ segments.force
        _, theta = _solved(normal, right)
        n, p = len(segments), design.shape[1] + 1
        power = float(np.sum((segments.force - design @ theta) ** 2))
        missed = 0.0
        for rows in trials:
            mine, force = design[rows], segments.force[rows]
            _, without = _solved(normal - mine.T @ mine, right - mine.T @ force)
            missed += float(np.sum((force - mine @ without) ** 2))
        aicc = n * log(max(power, 1e-300) / n) + 2 * p + 2 * p * (p + 1) / max(1, n - p - 1)
        found[order] = Score(aicc, sqrt(missed / n))
    return found
