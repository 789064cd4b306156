"""Quantities of a single trial, and their prediction from the specimen file."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pmabench.store.records import Array

DRIFT = 0.02
"""Largest motion in the last fifth of a hold, over the step."""


@dataclass(frozen=True)
class Measured:
    """One quantity of a trial [SI]."""

    symbol: str
    quantity: str
    value: float | None
    expected: float | None = None
    tolerance: float = 0.0
    """Largest difference from the prediction that friction can cause [SI]."""
    noise: float = 0.0
    """Difference between repeats below which they count as equal [SI]."""
    assumed: bool = False
    pooled: bool = False
    """Whether it contains earlier trials, so that it cannot be compared with them."""
    half: float | None = None
    """95 % half width from the scatter of trials alone [SI]; None where it is not known."""


Found = tuple[list[Measured], list[str]]
"""Quantities of a trial, and doubts about its samples."""


@dataclass
class Quick:
    """State between trials: load [N] and final contraction [m] of each trial, by pressure [Pa]."""

    ends: dict[float, dict[int, tuple[float, float]]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected coefficients at rising `pressure` [Pa], all of shape (n,), interpolated linearly.

    F_ce [N], K [N/m], B_c, B_r [N.s/m]; one F_c [N].
    """

    source: str
    pressure: Array
    F_ce: Array
    K: Array
    B_c: Array
    B_r: Array
    F_c: float

    def at(self, symbol: str, pressure: float) -> float | None:
        """A coefficient [SI] at a pressure [Pa]; None outside the points."""
        low, high = float(self.pressure[0]), float(self.pressure[-1])
        if not low - 1.0 <= pressure <= high + 1.0:
            return None
        return float(np.interp(pressure, self.pressure, getattr(self, symbol)))

    def holds(self, pressure: float, load: float) -> bool:
        """Whether the muscle, with its friction, does not lift `load` [N] at `pressure` [Pa]; False where unknown."""
        pull = self.at("F_ce", pressure)
        return pull is not None and pull - load <= 2 * self.F_c

    def lifts(self, force: float) -> float | None:
        """Pressure [Pa] at which F_ce is `force` [N]; None outside the points, or where F_ce does not rise."""
        if not float(self.F_ce[0]) <= force <= float(self.F_ce[-1]) or np.any(np.diff(self.F_ce) <= 0):
            return None
        return float(np.interp(force, self.F_ce, self.pressure))
