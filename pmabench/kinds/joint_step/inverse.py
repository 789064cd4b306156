"""Both pressures over the angle of a joint for the feed-forward: by the model of its muscles, or by a measured map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.errors import PmaError
from pmabench.base.quantities import show
from pmabench.protocol.driven import MUSCLES
from pmabench.store.records import Array

ROWS = 91
"""Angles in the table."""
SMALL = 1e-3
"""Torque by which the change of the pressures with the torque is found [N m]; they are linear in it."""
FEWEST = 7
"""Angles that a map needs."""
ORDER = 5
"""Of the polynomials through the map over the angle."""
Table = dict[str, list[float]]


def by_model(
    model: Mapping[str, float], ends: tuple[float, float], stiffness: float, limits: tuple[float, float]
) -> Table:
    """Pressures without a torque and their change by one, by `joint-inverse` of the library with these inputs.

    `ends` of the angle [rad], `stiffness` [N m/rad], `limits` of the pressures [Pa]. Raises ValueError in words.
    """
    from pmabench.model.library import MODELS

    angles, inverse = np.linspace(*ends, ROWS), MODELS["joint-inverse"]
    known: dict[str, Any] = {**model, "angle": angles, "stiffness": stiffness}
    held = inverse.evaluate(known | {"pressure_min": limits[0], "pressure_max": limits[1]})
    wide = known | {"pressure_min": 0.0, "pressure_max": 1e6}
    more, less = (inverse.evaluate(wide | {"torque": sign * SMALL}) for sign in (1.0, -1.0))
    gains = [(more[name] - less[name]) / (2 * SMALL) for name in MUSCLES]
    return _table(angles, [held[name] for name in MUSCLES], gains)


def by_map(folder: Path, ends: tuple[float, float], stiffness: float, limits: tuple[float, float]) -> Table:
    """The same by an analysis of kind joint-torque: tau = tau_0 + s_1 P_1 - s_2 P_2 with polynomials over the angle.

    Stiffness is minus the slope of that at constant pressures. Raises ValueError in words where the map does not reach.
    """
    from pmabench.store.analyses.folder import read_analysis

    try:
        analysis = read_analysis(folder)
    except PmaError as error:
        raise ValueError(str(error)) from error
    terms = {}
    for symbol in ("tau_0", "s_1", "s_2"):
        points = sorted(
            (e.at["angle"], e.value) for e in analysis.estimates if e.symbol == symbol and e.value is not None
        )
        if len(points) < FEWEST:
            raise ValueError(
                f"{folder} gives {symbol} at {len(points)} angles, and {FEWEST} are needed: an analysis of "
                "joint-torque with three levels of each pressure or more has them"
            )
        first, last = points[0][0], points[-1][0]
        if ends[0] < first - 1e-9 or ends[1] > last + 1e-9:
            reach = " to ".join(show(angle, "angle", 3) for angle in (first, last))
            raise ValueError(f"the map of {folder} reaches from {reach}, and the joint is to go beyond")
        table = np.array(points, dtype=np.float64)
        terms[symbol] = np.polyfit(table[:, 0], table[:, 1], ORDER)
    angles = np.linspace(*ends, ROWS)
    (t, s_1, s_2), (dt, ds_1, ds_2) = (
        [np.polyval(change(terms[symbol]), angles) for symbol in ("tau_0", "s_1", "s_2")]
        for change in (np.asarray, np.polyder)
    )
    # s_1 P_1 - s_2 P_2 = torque - tau_0 and -s_1' P_1 + s_2' P_2 = stiffness + tau_0'
    determinant = s_1 * ds_2 - s_2 * ds_1
    wanted = stiffness + dt
    held = [(-t * ds_2 + s_2 * wanted) / determinant, (s_1 * wanted - t * ds_1) / determinant]
    for name, values in zip(MUSCLES, held, strict=True):
        if not (limits[0] <= values.min() and values.max() <= limits[1]):
            needed, allowed = (
                " to ".join(show(end, "pressure", 4) for end in pair) for pair in ((values.min(), values.max()), limits)
            )
            raise ValueError(f"it takes {name} of {needed}, outside {allowed}; ask for another stiffness")
    return _table(angles, held, [ds_2 / determinant, ds_1 / determinant])


def _table(angles: Array, held: list[Array], gains: list[Array]) -> Table:
    """Plain numbers for the plan."""
    columns = dict(zip(("angle", *MUSCLES, "gain_1", "gain_2"), (angles, *held, *gains), strict=True))
    return {
        name: [float(f"{value:.9g}") for value in np.broadcast_to(values, angles.shape)]
        for name, values in columns.items()
    }
