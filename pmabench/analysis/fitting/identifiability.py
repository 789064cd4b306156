"""What a fit can tell of each unknown: errors and correlations from the Jacobian, doubts in words; knows no model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from pmabench.analysis.results import Finding
from pmabench.store.records import Array

RANK = 1e-6
"""Singular value of the Jacobian with columns of length 1, by the largest, below which nothing is told."""
TOGETHER = 0.99
"""Correlation from which on two unknowns move together."""
MOST = 4
"""Pairs that are named."""


@dataclass(frozen=True)
class Spread:
    """How well the unknowns are known [SI]; shapes (p,), (p, p)."""

    errors: tuple[float | None, ...]
    """Standard errors; None where not identifiable or without degrees of freedom."""
    covariance: Array
    """NaN in rows and columns that are not identifiable."""
    correlation: Array
    rank: int
    condition: float
    """Of the Jacobian with columns of length 1."""
    tied: tuple[tuple[int, ...], ...]
    """Unknowns of which only combinations are told, a tuple for each combination that is not."""


def spread_of(slopes: Array, squares: float, freedom: int) -> Spread:
    """From derivatives of the output (n, p) and the sum of squares at the best values [squares of the output]."""
    count = slopes.shape[1]
    lengths = np.linalg.norm(slopes, axis=0)
    dead = lengths == 0
    unit = slopes / np.where(dead, 1.0, lengths)
    _, singular, rows = np.linalg.svd(unit, full_matrices=False)
    kept = singular > RANK * singular[0] if singular[0] > 0 else np.zeros(len(singular), dtype=bool)
    tied = [tuple(int(j) for j in np.flatnonzero(np.abs(row) > 0.1)) for row in rows[~kept]]
    lost = {j for group in tied for j in group} | set(np.flatnonzero(dead).tolist())
    inverse = rows[kept].T @ np.diag(1 / singular[kept] ** 2) @ rows[kept]
    scale = np.where(dead, 1.0, lengths)
    covariance = np.full((count, count), np.nan)
    correlation = np.full((count, count), np.nan)
    good = [j for j in range(count) if j not in lost]
    part = np.ix_(good, good)
    shape = inverse / np.outer(scale, scale)
    width = np.sqrt(np.diag(shape))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation[part] = (shape / np.outer(width, width))[part]
    if freedom > 0:
        covariance[part] = (squares / freedom * shape)[part]
    errors = tuple(None if j in lost or freedom < 1 else sqrt(max(float(covariance[j, j]), 0.0)) for j in range(count))
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
    return Spread(errors, covariance, correlation, int(kept.sum()), condition, tuple(tied))


def told_apart(
    names: Sequence[str],
    spread: Spread,
    intervals: Sequence[tuple[float | None, float | None] | None],
    at_end: Sequence[str],
) -> list[Finding]:
    """Doubts on single unknowns: no effect, tied to others, open intervals, an end of the domain; then pairs."""
    found = []
    for group in spread.tied:
        members = _list([names[j] for j in group])
        if len(group) == 1:
            found.append(Finding("doubt", f"{members} is not identifiable: it changes nothing at these rows"))
        else:
            text = f"{members} are not identifiable separately: these rows tell only a combination of them"
            found.append(Finding("doubt", f"{text}; give one of them with --set"))
    for name, interval, place in zip(names, intervals, at_end, strict=True):
        if place:
            text = f"{name} ended {place}: the data pull it further, or do not tell it"
            found.append(Finding("doubt", text))
        elif interval is not None and None in interval:
            side = "either side" if interval == (None, None) else "below" if interval[0] is None else "above"
            found.append(
                Finding("doubt", f"{name} is not identifiable to {side}: no value of its domain there is excluded")
            )
    pairs = [
        (abs(float(spread.correlation[i, j])), i, j)
        for i in range(len(names))
        for j in range(i)
        if abs(float(spread.correlation[i, j])) > TOGETHER
    ]
    if pairs:
        pairs.sort(reverse=True)
        named = [f"{names[j]} and {names[i]} ({spread.correlation[i, j]:+.4f})" for _, i, j in pairs[:MOST]]
        more = f" and {len(pairs) - MOST} other pairs" if len(pairs) > MOST else ""
        text = f"correlated: {', '.join(named)}{more}"
        found.append(
            Finding("doubt", f"{text}: the curve is known better than each value; more range of the inputs parts them")
        )
    return found


def _list(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
