"""Bounded least squares of all trials of a muscle, from sums over each trial, so that leaving out trials is fast.

Trials whose length was set by hand have an unknown constant force, a priori of the size `SETTING` times the stiffness;
it is eliminated from the sums.
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
"""Weight of the second differences of the straight form, relative to the curvature of the surface."""
STILL = 0.01
"""Share of the range of pressure and contraction within which a muscle counts as held."""
HOLD = 1.0
"""Time after which the weights of the rows of a hold decrease [s]."""
SETTING = 0.3e-3
"""Scatter of a length set by hand [m]; recorded tests show 0.25 to 0.5 mm."""
BEGIN = 0.1
"""Share of the range of contraction after which the direction of friction is known."""
FRICTION = 0.02
"""Half the width of a typical loop over the largest force."""
NOISE = 0.003
"""A priori misfit over the largest force, for the weight of the constant of a trial."""


@dataclass(frozen=True, eq=False)
class Data:
    """All records of a muscle, with its memory at each row."""

    records: tuple[Record, ...]
    frame: Frame
    past: muscle.Memory
    rows: Rows
    weight: Array
    """Weight of each row, shape (n,)."""
    careful: bool
    """Whether rows before the direction of friction is known are left out, see `sure` and `level_of`."""

    @classmethod
    def of(cls, records: Sequence[Record], frame: Frame | None = None, *, careful: bool = False) -> Data:
        """The data of records; without a frame, over their own ranges."""
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
    """Weight of each row, shape (n,): 1, and in a hold decreasing as 1 / time; 0 where it does not count."""
    places = np.column_stack([record.P / max(frame.P.span, 1.0), record.x / max(frame.x.span, 1e-6)]) / STILL
    found = np.ones(len(record.t))
    since, start = places[0], float(record.t[0])
    for row, (place, t) in enumerate(zip(places, record.t, strict=True)):
        if max(abs(place - since)) > 1.0:
            since, start = place, float(t)
        found[row] = HOLD / max(HOLD, t - start)
    return found * record.used


def sure(record: Record, frame: Frame) -> NDArray[np.bool_]:
    """Mask of rows with known direction of friction: those after a motion of `BEGIN` of the range; all without one."""
    so_far = np.maximum.accumulate(record.x) - np.minimum.accumulate(record.x)
    moved = so_far >= BEGIN * frame.x.span
    return moved if moved.any() else np.ones(len(moved), dtype=bool)


def level_of(record: Record, data: Data, stiffness: float) -> float:
    """Standard deviation of the constant force of a record [N]: from its length, or from unknown friction."""
    if record.by_hand:
        return SETTING * stiffness
    still = np.ptp(record.x) < BEGIN * data.frame.x.span
    return FRICTION * data.largest if data.careful and still else 0.0


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums of products over the rows of each record, for p columns and the force as last column.

    The p columns are those of all terms.
    """

    products: Array
    """Sums of products, with the constant of each record eliminated, shape (records, p + 1, p + 1)."""
    n: Array
    """Sum of the weights of each record, shape (records,)."""
    places: dict[str, slice]
    """Term -> its columns."""
    penalty: Array
    """Quadratic penalty of the weights, shape (p, p)."""

    @cached_property
    def _whole(self) -> Array:
        return np.asarray(self.products.sum(axis=0))

    def of(self, used: Array) -> Array:
        """Sum of `products` over the records with `used` 1, shape (p + 1, p + 1); `used` is (records,) of 0 and 1."""
        few = used.sum() < 0.5 * len(used)
        part = self.products[(used > 0) == few].sum(axis=0)
        return np.asarray(part if few else self._whole - part)

    def part(self, terms: Collection[str]) -> NDArray[np.int64]:
        """Indices of the columns of terms."""
        every = np.arange(len(self.penalty))
        return np.concatenate([every[self.places[term]] for term in self.places if term in terms])


def sums(data: Data, stiffness: Stiffness, terms: Sequence[str] = TERMS) -> Sums:
    """Sums for terms, with the stiffness [N/m] through which creep of contraction acts."""
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
    """Penalty (p, p) of the curvature of the surface, and of second differences of the straight form."""
    found = np.zeros((len(diagonal) - 1, len(diagonal) - 1))
    if surface := places.get(muscle.SURFACE):
        bends = frame.bends()
        found[surface, surface] = bends * diagonal[surface].mean() / max(float(np.trace(bends)) / len(bends), 1e-300)
    if lines := places.get(muscle.STRAIGHT):
        turns = np.kron(np.eye(2), np.diff(np.eye((lines.stop - lines.start) // 2), n=2, axis=0))
        found[lines, lines] = TURNS * turns.T @ turns * np.sqrt(np.outer(diagonal[lines], diagonal[lines]))
    return found


def solve(sums: Sums, terms: Collection[str], used: Array, smooth: float) -> Array:
    """Weights (p,) of the columns of terms from the records with `used` 1; 0 for all other columns."""
    part = sums.part(terms)
    whole = sums.of(used)
    H = whole[np.ix_(part, part)] + smooth * sums.penalty[np.ix_(part, part)]
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H / np.outer(size, size) + RIDGE * np.eye(len(part))
    found = np.zeros(len(sums.penalty))
    found[part] = bounded(H, whole[part, -1] / size, np.isin(part, sums.part(muscle.FREE))) / size
    return found


def bounded(H: Array, b: Array, free: NDArray[np.bool_]) -> Array:
    """Minimise y.H.y / 2 - b.y where all y but the `free` ones are at least 0; H (n, n) is positive definite."""
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
    """The muscle with the weights from `solve`."""
    return Muscle(frame, split(sums, [term for term in TERMS if term in terms], weights))


def split(sums: Sums, terms: Collection[str], weights: Array) -> dict[str, Array]:
    """Term -> its weights."""
    return {term: weights[sums.places[term]] for term in terms}


def misfit(sums: Sums, weights: Array, of: Array) -> float:
    """Rms residual [N] of the records with `of` 1, with the constant of each record eliminated."""
    both = np.append(weights, -1.0)
    left = float(both @ sums.of(of) @ both)
    return float(np.sqrt(max(left, 0.0) / max(float(of @ sums.n), 1e-300)))


def fitted(data: Data, stiffness: Stiffness, terms: Collection[str], smooth: float) -> Muscle:
    """The muscle fitted to all records with the given terms; creep acts through the given stiffness."""
    known = sums(data, stiffness)
    return muscle_of(known, data.frame, terms, solve(known, terms, np.ones(len(data.records)), smooth))


def first_stiffness(data: Data) -> Stiffness:
    """Stiffness of the surface from a fit without creep of contraction."""
    steep = data.largest / max(data.frame.x.span, 1e-3)
    terms = [term for term in TERMS if term != muscle.CREEP_X]
    return fitted(data, lambda P, x: np.full_like(P, steep), terms, FIRST_SMOOTH).stiffness
