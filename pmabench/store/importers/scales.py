"""Compares columns of one file that say the same, each in its own unit: what was measured, and commanded or set.

Where they differ by the factor of a unit, the unit of one of them is wrong; the file does not say of which.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import log

import numpy as np

from pmabench.store.importers.found import Bools, Checked, Report, correlation, slope
from pmabench.store.records import Array

UNITS = (
    {"Pa": 1.0, "mbar": 1e2, "hPa": 1e2, "kPa": 1e3, "psi": 6894.757, "bar": 1e5, "MPa": 1e6},
    {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "m": 1.0},
)
"""Units that are mistaken for each other, with their sizes [SI]."""
ALIKE = 0.1
"""Relative difference from the factor of a unit [1]."""
FOLLOWS = 0.9
"""Least correlation of a length with that which sets it."""
PAIRS = (("pressure", "pressure_command"), ("displacement", "displacement_command"), ("displacement", "set length"))


def compare(report: Report, channels: Mapping[str, Checked], good: Bools) -> None:
    """Withhold what rests on two columns that differ by the factor of a unit; `good`: usable samples, shape (n,)."""
    for one, other in ((channels[a], channels[b]) for a, b in PAIRS if a in channels and b in channels):
        size = _times(one.si[good], other.si[good], pressure=one.rule.role == "pressure")
        asked = [
            f"is {which.rule.column} in {unit}, not {said}?"
            for which, factor in ((one, 1 / size), (other, size))
            for units in UNITS if (said := which.rule.raw_unit) in units
            for unit, SI in units.items()
            if unit != said and abs(log(SI / units[said] / factor)) < ALIKE
        ] if size > 0 else []  # fmt: skip
        if asked:
            text = f"reads {size:.3g} times what {other.rule.column} says: {' or '.join(asked)}"
            report.withhold("scale", text, one.rule.role)


def _times(measured: Array, said: Array, *, pressure: bool) -> float:
    """How many times the measured values are those that were set; 0 where that is not known.

    A regulator answers fast commands by less, and on the mean by all; the zero of a length is free.
    """
    known = np.isfinite(measured) & np.isfinite(said)
    measured, said = measured[known], said[known]
    if pressure:
        level = float(np.mean(said)) if len(said) else 0.0
        return float(np.mean(measured)) / level if level > 0 else 0.0
    return (slope(said, measured) or 0.0) if correlation(measured, said) > FOLLOWS else 0.0
