"""Bounded least squares of all trials of a muscle together, from sums over each trial, so that leaving out is quick.

Trials whose length was set by hand have a constant of their own, which a priori is of the size `SETTING` times the
stiffness; it is eliminated before the sums are used.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import nnls

from pmabench.analysis.surface.columns import Frame, Memory, memory
from pmabench.analysis.surface.muscle import CREEP_X, FREE, STRAIGHT, SURFACE, TERMS, Muscle, Stiffness, columns_of
from pmabench.analysis.surface.record import Record, Rows
from pmabench.store.records import Array

FIRST_SMOOTH = 0.1
RIDGE = 1e-9
STILL = 0.01
"""Share of the range of pressure or contraction within which a muscle counts as held."""
HOLD = 0.2
"""Time [s] after which the rows of a hold begin to count less."""
SETTING = 0.3e-3
"""Scatter of a length that is set by hand [m]; recorded tests show 0.25 to 0.5 mm."""
NOISE = 0.003
"""A priori misfit as a share of the largest force: against it the constant of a trial is weighed."""


@dataclass(frozen=True, eq=False)
class Data:
    """All records of a muscle, and what its past is at each row."""

    records: tuple[Record, ...]
    frame: Frame
    past: Memory
    rows: Rows
    weight: Array
    """Of each row."""

    @classmethod
    def of(cls, records: Sequence[Record], frame: Frame | None = None) -> Data:
        """The data of records, over their own ranges where no frame is given."""
        rows = Rows.of_records(records)
        P, x = rows.P[rows.used], rows.x[rows.used]
        frame = frame or Frame.over((P.min(), P.max()), (x.min(), x.max()))
        weight = np.concatenate([weights_of(record, frame) for record in records])
        return cls(tuple(records), frame, memory(records, frame), rows, weight)

    @cached_property
    def largest(self) -> float:
        """Largest force [N]."""
        return float(np.abs(self.rows.F[self.rows.used]).max())


def weights_of(record: Record, frame: Frame) -> Array:
    """Weight of each row of a record: equal ways count alike, and in a hold equal steps of the logarithm of time."""
    places = np.column_stack([record.P / max(frame.P.span, 1.0), record.x / max(frame.x.span, 1e-6)]) / STILL
    found = np.ones(len(record.t))
    since, start = places[0], float(record.t[0])
    for row, (place, t) in enumerate(zip(places, record.t, strict=True)):
        if max(abs(place - since)) > 1.0:
            since, start = place, float(t)
        found[row] = HOLD / max(HOLD, t - start)
    return found * record.used


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums over the rows of each record: of products of columns, of columns with force, of force."""

    H: Array
    """Shape (records, p, p)."""
    b: Array
    """Shape (records, p)."""
    yy: Array
    n: Array
    places: dict[str, slice]
    """Term -> its columns."""
    penalty: Array
    """Shape (p, p)."""

    @cached_property
    def _whole(self) -> Array:
        return np.asarray(self.H.sum(axis=0))

    def whole(self, used: Array) -> Array:
        """Sum of H over the records with `used` (n,) 1 and not 0; shape (p, p)."""
        few = used.sum() < 0.5 * len(used)
        part = self.H[(used > 0) == few].sum(axis=0)
        return np.asarray(part if few else self._whole - part)

    def part(self, terms: Collection[str]) -> NDArray[np.int64]:
        """Numbers of the columns of terms."""
        every = np.arange(self.H.shape[1])
        return np.concatenate([every[self.places[term]] for term in self.places if term in terms])


def sums(data: Data, stiffness: Stiffness, terms: Sequence[str] = TERMS) -> Sums:
    """The sums of terms, with the stiffness [N/m] that creep of contraction acts through."""
    rows = data.rows
    blocks = [columns_of(term, data.frame, rows, data.past, stiffness) for term in terms]
    ends = np.cumsum([0, *(block.shape[1] for block in blocks)])
    places = {term: slice(first, last) for term, first, last in zip(terms, ends, ends[1:], strict=False)}
    A = np.hstack(blocks)
    number = len(data.records)
    H, b, yy, n = (
        np.empty((number, ends[-1], ends[-1])),
        np.empty((number, ends[-1])),
        np.empty(number),
        np.empty(number),
    )
    cuts = np.searchsorted(rows.of, np.arange(number + 1))
    prior = (SETTING * float(np.median(np.maximum(stiffness(rows.P, rows.x), 0.0)))) ** 2
    for i, record in enumerate(data.records):
        part = slice(cuts[i], cuts[i + 1])
        w, a, y = data.weight[part], A[part], rows.F[part]
        wa = w[:, None] * a
        H[i], b[i], yy[i], n[i] = wa.T @ a, wa.T @ y, w @ (y * y), w.sum()
        if record.by_hand and n[i] > 0:
            mean, level = wa.sum(axis=0) / n[i], float(w @ y) / n[i]
            known = n[i] * n[i] * prior / (n[i] * prior + (NOISE * data.largest) ** 2)
            H[i] -= known * np.outer(mean, mean)
            b[i] -= known * mean * level
            yy[i] -= known * level * level
    penalty = np.zeros((ends[-1], ends[-1]))
    if surface := places.get(SURFACE):
        bends = data.frame.bends()
        diagonal = np.einsum("rii->i", H)[surface]
        penalty[surface, surface] = bends * diagonal.mean() / max(float(np.trace(bends)) / len(bends), 1e-300)
    if lines := places.get(STRAIGHT):
        half = (lines.stop - lines.start) // 2
        turns = np.kron(np.eye(2), np.diff(np.eye(half), n=2, axis=0))
        diagonal = np.einsum("rii->i", H)[lines]
        penalty[lines, lines] = turns.T @ (turns * 1e-3) * np.sqrt(np.outer(diagonal, diagonal))
    return Sums(H, b, yy, n, places, penalty)


def solve(sums: Sums, terms: Collection[str], used: Array, smooth: float) -> Array:
    """Weights of the columns of terms, by the records with `used` (n,) 1 and not 0; 0 for all other columns."""
    part = sums.part(terms)
    H = sums.whole(used)[np.ix_(part, part)] + smooth * sums.penalty[np.ix_(part, part)]
    b = used @ sums.b[:, part]
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H / np.outer(size, size) + RIDGE * np.eye(len(part))
    free = np.isin(part, sums.part(FREE))
    found = np.zeros(sums.H.shape[1])
    found[part] = bounded(H, b / size, free) / size
    return found


def bounded(H: Array, b: Array, free: NDArray[np.bool_]) -> Array:
    """Minimum of y.H.y / 2 - b.y where all y but the `free` ones are at least 0; H (n, n) positive definite."""
    inner = cho_factor(H[np.ix_(free, free)])
    if free.all():
        return np.asarray(cho_solve(inner, b))
    cross = H[np.ix_(free, ~free)]
    through = cho_solve(inner, cross)
    rest = H[np.ix_(~free, ~free)] - cross.T @ through
    lower = cholesky(rest + 1e-13 * np.trace(rest) * np.eye(len(rest)), lower=True)
    target = solve_triangular(lower, b[~free] - through.T @ b[free], lower=True)
    found = np.zeros(len(b))
    found[~free], _ = nnls(lower.T, target)
    found[free] = cho_solve(inner, b[free] - cross @ found[~free])
    return found


def muscle_of(sums: Sums, frame: Frame, terms: Collection[str], weights: Array) -> Muscle:
    """The muscle of the weights that `solve` gave."""
    return Muscle(frame, {term: weights[sums.places[term]] for term in TERMS if term in terms})


def misfit(sums: Sums, weights: Array, of: Array) -> float:
    """Root mean square of what weights leave of the records with `of` (n,) 1 [N], their own constants taken off."""
    H, b = sums.whole(of), of @ sums.b
    left = of @ sums.yy - 2.0 * b @ weights + weights @ H @ weights
    return float(np.sqrt(max(left, 0.0) / max(float(of @ sums.n), 1e-300)))


def first_stiffness(data: Data) -> Stiffness:
    """The stiffness of the surface without creep."""
    steep = data.largest / max(data.frame.x.span, 1e-3)
    known = sums(data, lambda P, x: np.full_like(P, steep))
    every = np.ones(len(data.records))
    terms = [term for term in TERMS if term != CREEP_X]
    return muscle_of(known, data.frame, terms, solve(known, terms, every, FIRST_SMOOTH)).stiffness
