"""Blocked force: what a muscle pulls with at no contraction, over pressure; and its force at every other contraction.

Knows the mean curves of isometric tests (`isometric_sections.Cell`); the mean of filling and emptying counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot

import numpy as np

from pmabench.analysis.results import Estimate, Parts, Trace
from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.isometric_lines import by_repeat, spread
from pmabench.kinds.isometric_pressurisation.sections import APART, GRID, Cell
from pmabench.store.records import Array

METHOD = "blocked"
FIGURE = "characteristic"
NEAR = 0.01
"""Contractions so near to 0 count as 0, as a share of the nominal length."""
LENGTH = 0.25
"""Nominal length that is taken for that where none is told [m]."""
EXACT = 1e-4
"""Contractions nearer to 0 are 0 [m]."""
MOST = 5.0
"""The contraction on the other side may be so many times further away."""
STEP = 0.02
"""Half width of the line that tells dF/dP, as a share of the range of pressures."""


def pressures(cells: Sequence[Cell]) -> Array:
    """Multiples of `GRID` up to the highest pressure of the tests [Pa], from the first one on."""
    top = max(float(1.5 * cell.mean.P[-1] - 0.5 * cell.mean.P[-2]) for cell in cells)
    return GRID * np.arange(1, int(np.floor(top / GRID + 0.05)) + 1, dtype=np.float64)


def estimates(cells: Sequence[Cell], given: Mapping[str, float], scales: Scales) -> list[Estimate]:
    """F_b [N] at each pressure, where tests at no contraction are among the cells.

    Where contractions on both sides of 0 were tested: on a parabola through three of them, and what a line would give
    is in the method part. Else that is K times what the muscle was off its nominal length; and what a bend between the
    means over pressure may hide. Calibration, to first order: gains and offsets of force, of pressure by dF/dP, of
    displacement by K.
    """
    near = NEAR * given.get("nominal_length", LENGTH)
    blocked = min(cells, key=lambda cell: abs(cell.contraction), default=None)
    if blocked is None or abs(blocked.contraction) > near:
        return []
    others = [cell for cell in cells if cell.contraction > blocked.contraction + near]
    nearest = min(others, key=lambda cell: cell.contraction, default=None)
    off = float(np.abs(blocked.place).max())
    late = max((c.data.get("rate", 0.0) for test in blocked.tests for c in test.trial.commands), default=0.0)
    late *= skew.apart([test.run for test in blocked.tests], ("pressure", "force"))
    found = []
    for P in pressures(cells):
        each = blocked.force_at(float(P))
        known = np.isfinite(each)
        if not known.any():
            continue
        tests = [test for test, usable in zip(blocked.tests, known, strict=True) if usable]
        values = by_repeat(tests, each[known])
        F = float(values.mean())
        K = 0.0
        if nearest is not None and np.isfinite(F_nearest := float(np.mean(nearest.force_at(float(P))))):
            apart = float(nearest.place.mean() - blocked.place.mean())
            K = (F - F_nearest) / apart if apart > APART else 0.0
        between = _between(cells, blocked, float(P))
        shift, doubt = (0.0, K * off) if between is None else between
        F += shift
        slope = _slope(blocked, float(P))
        gains = {"force": F, "pressure": slope * float(P)}
        offsets = {"force": 1.0, "pressure": slope} | ({"displacement": K} if K else {})
        half = spread(values)
        found.append(
            Estimate(
                "F_b",
                F,
                "N",
                "force",
                METHOD,
                {"pressure": float(P)},
                Parts(half, hypot(doubt, _bend(blocked, float(P))), scales.part(gains, offsets), abs(slope) * late),
                len(values),
                note=sentences(
                    "no repeats part: one test only" if half is None else "",
                    "" if between is None else "between the contractions on both sides of 0",
                    scales.lack(gains, offsets),
                ),
                trials=tuple(test.name for test in tests),
            )
        )
    return found


def _between(cells: Sequence[Cell], blocked: Cell, P: float) -> tuple[float, float] | None:
    """What a parabola with the nearest contractions adds to the force of `blocked`, and what a line is off it [N].

    None where `blocked` is at 0, or no other side was tested; with two contractions it is the line.
    """
    known = {float(cell.place.mean()): float(np.mean(F)) for cell in cells if np.isfinite(F := cell.force_at(P)).all()}
    x_0 = float(blocked.place.mean())
    near = sorted((x for x in known if abs(x - x_0) > APART), key=abs)
    beyond = [x for x in near if x * x_0 < 0]
    if abs(x_0) < EXACT or x_0 not in known or not beyond or abs(beyond[0]) > MOST * abs(x_0):
        return None
    x_1 = beyond[0]
    slope = (known[x_1] - known[x_0]) / (x_1 - x_0)
    shift = -slope * x_0
    third = [x for x in near if abs(x - x_1) > APART]
    if not third:
        return shift, abs(shift)
    x_2 = third[0]
    bend = ((known[x_2] - known[x_1]) / (x_2 - x_1) - slope) / (x_2 - x_0)
    return shift + bend * x_0 * x_1, abs(bend * x_0 * x_1)


def _slope(cell: Cell, P: float) -> float:
    """DF/dP of the mean curve about a pressure [N/Pa]."""
    known = np.isfinite(cell.mean.force)
    at, F = cell.mean.P[known], cell.mean.force[known]
    width = max(STEP * float(np.ptp(at)), 1.5 * float(cell.mean.P[1] - cell.mean.P[0]))
    near = np.abs(at - P) <= width
    return float(np.polyfit(at[near], F[near], 1)[0]) if near.sum() > 1 else 0.0


def _bend(cell: Cell, P: float) -> float:
    """What a bend of F(P) at a pressure changes of the means next to it [N]: an eighth of their second difference."""
    at, F = cell.mean.P, cell.mean.force
    i = int(np.clip(np.searchsorted(at, P), 1, len(at) - 2))
    near = F[max(0, i - 2) : i + 3]
    bends = np.abs(np.diff(near[np.isfinite(near)], n=2))
    return float(bends.max()) / 8 if len(bends) else 0.0


def trace(cells: Sequence[Cell]) -> list[Trace]:
    """Force at each pressure of the grid and each contraction; none with a single contraction."""
    if len(cells) < 2:
        return []
    rows = [
        (float(P), float(cell.place.mean()), float(np.mean(F[np.isfinite(F)])))
        for P in pressures(cells)
        for cell in cells
        if np.isfinite(F := cell.force_at(float(P))).any()
    ]
    if len(rows) < 2:
        return []
    P, x, force = np.array(rows).T
    return [
        Trace(
            name=FIGURE,
            figure=FIGURE,
            title="Force over contraction at set pressures, held at one length",
            columns={"pressure": P, "displacement": x, "force": force},
            quantities={"pressure": "pressure", "displacement": "length", "force": "force"},
        )
    ]
