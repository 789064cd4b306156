"""The most of something that cycles allow: its size by least squares next to what else they show, and its error.

Knows no muscle: what creeps, and a friction that falls with the speed, are bounded so, and can only be above 0.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.shared.form import SURE
from pmabench.store.records import Array

ONE_SIDE = 0.95
"""Probability below the most: only that side is open."""


@dataclass(frozen=True)
class Bound:
    """A size, and its standard error times Student's t for `ONE_SIDE` and for `SURE`; what is left [square]."""

    size: float
    open: float
    sure: float
    left: float = 0.0
    likely: float = 1.0
    """Another form is as likely that leaves up to so many times as much."""

    @property
    def most(self) -> float:
        """The largest size that is allowed; what is seen the other way may hide as much."""
        return max(self.size, 0.0) + self.open if self.size > -self.sure else self.open - self.size

    @property
    def seen(self) -> bool:
        """Whether it is significant."""
        return self.size > self.sure


def bound_of(columns: Sequence[Array], unit: Array, shown: Array) -> Bound | None:
    """How many times `unit` is in what is `shown`, next to `columns`, shape (n,) each; None where they do not tell."""
    design = np.column_stack([*columns, unit])
    freedom = len(shown) - design.shape[1]
    terms, _, rank, _ = np.linalg.lstsq(design, shown, rcond=None)
    if freedom < 1 or rank < design.shape[1]:
        return None
    left = shown - design @ terms
    error = float(np.sqrt(left @ left / freedom * np.linalg.inv(design.T @ design)[-1, -1]))
    once, both, sure = (float(student.ppf(share, freedom)) for share in (ONE_SIDE, 0.975, SURE))
    return Bound(float(terms[-1]), once * error, sure * error, float(left @ left), 1 + both**2 / freedom)


def joined(bounds: Collection[Bound]) -> Iterator[Bound]:
    """The mean of several by the squares of their errors."""
    if len(bounds) > 1 and min(bound.open for bound in bounds) > 0:
        weights = np.array([bound.open**-2 for bound in bounds])
        mean = float(weights @ [bound.size for bound in bounds] / weights.sum())
        yield Bound(mean, float(weights.sum() ** -0.5), float(np.sum([one.sure**-2 for one in bounds]) ** -0.5))
