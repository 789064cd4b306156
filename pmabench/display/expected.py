"""What a run's specimen file already believes of the muscle, for comparison beside the measured; fits nothing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmabench.base.errors import InvalidFile
from pmabench.store.records import Array


@dataclass(frozen=True, eq=False)
class Expected:
    """Coefficients at rising `pressure` [Pa], all of shape (n,), with straight lines between: F_ce [N], K [N/m],
    B_c, B_r [N.s/m]; F_c [N].
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
        """Whether the muscle does not lift `load` [N] at `pressure` [Pa], its friction included."""
        pull = self.at("F_ce", pressure)
        return pull is not None and pull - load <= 2 * self.F_c

    def lifts(self, force: float) -> float | None:
        """Pressure [Pa] at which F_ce is `force` [N]; None outside the points."""
        if not float(self.F_ce[0]) <= force <= float(self.F_ce[-1]) or np.any(np.diff(self.F_ce) <= 0):
            return None
        return float(np.interp(force, self.F_ce, self.pressure))


def read_expected(folder: Path) -> Expected | None:
    """`expected` of the specimen file that a run was made from; None where there is none that can be read."""
    from pmabench.bench.files import SpecimenFile
    from pmabench.files.document import read_document, validate

    try:
        told = validate(SpecimenFile, read_document(folder / "specimen.yaml")).expected
    except InvalidFile:
        return None
    if told is None:
        return None
    points = sorted(told.points, key=lambda point: point.pressure)
    columns = {name: np.array([getattr(p, name) for p in points]) for name in ("pressure", "F_ce", "K", "B_c", "B_r")}
    return Expected(source=told.source, F_c=told.F_c, **columns)
