"""Bounded least squares of all trials of a muscle together, from sums over each trial, so that leaving out is quick.

Trials whose length was set by hand have a constant of their own, which a priori is of the size `SETTING` times the
stiffness; it is eliminated before the sums are used.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from pmabench.analysis.surface import muscle
from pmabench.analysis.surface.muscle import TERMS, Frame, Muscle, Stiffness
from pmabench.analysis.surface.trials import Record, Rows
from pmabench.store.records import Array

FIRST_SMOOTH = 0.1
RIDGE = 1e-9
TURNS = 1e-3
"""Weight of the turns of the polygons of the straight form, of that of the bends of the surface."""
STILL = 0.01
"""Share of the range of pressure or contraction within which a muscle counts as held."""
HOLD = 1.0
"""Time [s] after which the rows of a hold begin to count less."""
SETTING = 0.3e-3
"""Scatter of a length that is set by hand [m]; recorded tests show 0.25 to 0.5 mm."""
BEGIN = 0.1
"""Share of the range of contraction that a muscle must move before it is known how friction acts in it."""
FRICTION = 0.02
"""Half of the width of a usual loop, as a share of the largest force."""
NOISE = 0.003
"""A priori misfit as a share of the largest force: against it the constant of a trial is weighed."""


@dataclass(frozen=True, eq=False)
class Data:
    """All records of a muscle, and what its past is at each row."""

    records: tuple[Record, ...]
    frame: Frame
    past: muscle.Memory
    rows: Rows
    weight: Array
    """Of each row."""
    careful: bool
    """Nothing is taken from a record before it is known which way friction acts in it, see `sure` and `level_of`."""

    @classmethod
    def of(cls, records: Sequence[Record], frame: Frame | None = None, *, careful: bool = False) -> Data:
        """The data of records, over their own ranges where no frame is given."""
        rows = Rows.of_records(records)
        P, x = rows.P[rows.used], rows.x[rows.used]
        frame = frame or Frame.over((P.min(), P.max()), (x.min(), x.max()))
        weight = np.concatenate([weights_of(record, frame) for record in records])
        if careful:
            weight = weight * np.concatenate([sure(record, frame) for record in records])
        return cls(tuple(records), frame, muscle.memory(records, frame), rows, weight, careful)

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


def sure(record: Record, frame: Frame) -> NDArray[np.bool_]:
    """Rows at which it is known how friction acts: those after a move of `BEGIN` of the range, if there is one."""
    so_far = np.maximum.accumulate(record.x) - np.minimum.accumulate(record.x)
    moved = so_far >= BEGIN * frame.x.span
    return moved if moved.any() else np.ones(len(moved), dtype=bool)


def level_of(record: Record, data: Data, stiffness: float) -> float:
    """How far the force of a whole record may be off by a constant [N]: by its length, or by unknown friction in it."""
    if record.by_hand:
        return SETTING * stiffness
    still = np.ptp(record.x) < BEGIN * data.frame.x.span
    return FRICTION * data.largest if data.careful and still else 0.0


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums over the rows of each record of products of columns with each other; the last column is the force.

    Shapes (records, p + 1, p + 1), for p columns.
    """

    products: Array
    """Without what a constant of the record may be."""
    n: Array
    """Sum of the weights of each record."""
    places: dict[str, slice]
    """Term -> its columns."""
    penalty: Array
    """Shape (p, p)."""

    @cached_property
    def _whole(self) -> Array:
        return np.asarray(self.products.sum(axis=0))

    def of(self, used: Array) -> Array:
        """Sum of `products` over the records with `used` (n,) 1 and not 0."""
        few = used.sum() < 0.5 * len(used)
        part = self.products[(used > 0) == few].sum(axis=0)
        return np.asarray(part if few else self._whole - part)

    def part(self, terms: Collection[str]) -> NDArray[np.int64]:
        """Numbers of the columns of terms."""
        every = np.arange(len(self.penalty))
        return np.concatenate([every[self.places[term]] for term in self.places if term in terms])


def sums(data: Data, stiffness: Stiffness, terms: Sequence[str] = TERMS) -> Sums:
    """The sums of terms, with the stiffness [N/m] that creep of contraction acts through."""
    rows, number = data.rows, len(data.records)
    blocks = [muscle.columns_of(term, data.frame, rows, data.past, stiffness) for term in terms]
    ends = np.cumsum([0, *(block.shape[1] for block in blocks)])
    places = {term: slice(first, last) for term, first, last in zip(terms, ends, ends[1:], strict=False)}
    A = np.hstack([*blocks, rows.F[:, None]])
    products = np.empty((number, A.shape[1], A.shape[1]))
    n = np.empty(number)
    cuts = np.searchsorted(rows.of, np.arange(number + 1))
    steep = float(np.median(np.maximum(stiffness(rows.P, rows.x), 0.0)))
    for i, record in enumerate(data.records):
        part = slice(cuts[i], cuts[i + 1])
        weighted = data.weight[part, None] * A[part]
        n[i] = data.weight[part].sum()
        whole, total = weighted.T @ A[part], weighted.sum(axis=0)
        variance = level_of(record, data, steep) ** 2
        share = variance / max(n[i] * variance + (NOISE * data.largest) ** 2, 1e-300)
        products[i] = whole - share * np.outer(total, total)
    return Sums(products, n, places, _penalty(data.frame, np.einsum("rii->i", products), places))


def _penalty(frame: Frame, diagonal: Array, places: Mapping[str, slice]) -> Array:
    """What bends of the surface cost, and turns of the polygons of the straight form."""
    found = np.zeros((len(diagonal) - 1, len(diagonal) - 1))
    if surface := places.get(muscle.SURFACE):
        bends = frame.bends()
        found[surface, surface] = bends * diagonal[surface].mean() / max(float(np.trace(bends)) / len(bends), 1e-300)
    if lines := places.get(muscle.STRAIGHT):
        turns = np.kron(np.eye(2), np.diff(np.eye((lines.stop - lines.start) // 2), n=2, axis=0))
        found[lines, lines] = TURNS * turns.T @ turns * np.sqrt(np.outer(diagonal[lines], diagonal[lines]))
    return found


def solve(sums: Sums, terms: Collection[str], used: Array, smooth: float) -> Array:
    """Weights of the columns of terms, by the records with `used` (n,) 1 and not 0; 0 for all other columns."""
    part = sums.part(terms)
    whole = sums.of(used)
    H = whole[np.ix_(part, part)] + smooth * sums.penalty[np.ix_(part, part)]
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H / np.outer(size, size) + RIDGE * np.eye(len(part))
    found = np.zeros(len(sums.penalty))
    found[part] = bounded(H, whole[part, -1] / size, np.isin(part, sums.part(muscle.FREE))) / size
    return found


def bounded(H: Array, b: Array, free: NDArray[np.bool_]) -> Array:
    """Minimum of y.H.y / 2 - b.y where all y but the `free` ones are at least 0; H (n, n) positive definite."""
    inner = H[np.ix_(free, free)]
    cross = H[np.ix_(free, ~free)]
    through = np.linalg.solve(inner, np.column_stack([b[free], cross]))
    found = np.zeros(len(b))
    if not free.all():
        rest = H[np.ix_(~free, ~free)] - cross.T @ through[:, 1:]
        lower = np.linalg.cholesky(rest + 1e-13 * np.trace(rest) * np.eye(len(rest)))
        found[~free], _ = nnls(lower.T, np.linalg.solve(lower, b[~free] - cross.T @ through[:, 0]))
    found[free] = through[:, 0] - through[:, 1:] @ found[~free]
    return found


def muscle_of(sums: Sums, frame: Frame, terms: Collection[str], weights: Array) -> Muscle:
    """The muscle of the weights that `solve` gave."""
    return Muscle(frame, split(sums, [term for term in TERMS if term in terms], weights))


def split(sums: Sums, terms: Collection[str], weights: Array) -> dict[str, Array]:
    """The weights of each term."""
    return {term: weights[sums.places[term]] for term in terms}


def misfit(sums: Sums, weights: Array, of: Array) -> float:
    """Root mean square of what weights leave of the records with `of` (n,) 1 [N], their own constants taken off."""
    both = np.append(weights, -1.0)
    left = float(both @ sums.of(of) @ both)
    return float(np.sqrt(max(left, 0.0) / max(float(of @ sums.n), 1e-300)))


def fitted(data: Data, stiffness: Stiffness, terms: Collection[str], smooth: float) -> Muscle:
    """The muscle of all records with given terms; creep acts through a stiffness that is known before."""
    known = sums(data, stiffness)
    return muscle_of(known, data.frame, terms, solve(known, terms, np.ones(len(data.records)), smooth))


def first_stiffness(data: Data) -> Stiffness:
    """The stiffness of the surface without creep."""
    steep = data.largest / max(data.frame.x.span, 1e-3)
    terms = [term for term in TERMS if term != muscle.CREEP_X]
    return fitted(data, lambda P, x: np.full_like(P, steep), terms, FIRST_SMOOTH).stiffness
