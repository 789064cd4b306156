"""Forces at the pressure of the operating point, and not at that which the regulator left at rest.

A regulator with a dead band rests to one side after a contraction and to the other after a stretch, so that a pressure
that is not looked at becomes stiffness. dF/dP is taken from the same rest at another pressure, else from the way back,
where the length is still and the pressure moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.samples import noise_of
from pmabench.base.quantities import show
from pmabench.kinds.step_displacement.step import Relaxation, Steps

Cell = tuple[tuple[str, float], ...]
"""A cell: names and values of its point."""
APART = 0.05
"""Two pressures are apart by at least this share, or they give no dF/dP."""
KNOWN = 0.15
"""Share to which dF/dP is known: between two pressures it bends, and a filter delays force and pressure."""
LEFT = 0.3
"""Share of the force that moves with the pressure on the way back, above which something else moves it, too."""
SHOWN = 5.0
"""Standard deviations of its noise by which the pressure moves on a way back that gives dF/dP."""
LIKELY = 2.0
"""dF/dP is below so many times what a force gives that is proportional to the pressure at the length at rest."""
SURE = 5.0
"""Standard errors from which on a pressure counts as another one."""
NAME = "pressure at rest"
FEW = 25
"""Samples of a rest whose noise is independent, at least."""


@dataclass(frozen=True)
class Shift:
    """What the pressures at rest make of a force [N]: `known` is to be taken off."""

    known: float
    left: Doubt


@dataclass(frozen=True)
class Slope:
    """dF/dP of one rest [N/Pa]; `half` is None where the value is only the most that is likely."""

    value: float
    half: float | None


Slopes = tuple[Slope, Slope]
"""Of the rest before a step and of that after it."""


def shift(steps: Sequence[Relaxation], slopes: Slopes, pressure: float, rests: tuple[int, int]) -> Shift:
    """What the pressures at rest add to a force [N], which is that before, times `rests[0]`, and after, `rests[1]`.

    Known where dF/dP is, else doubted where the pressure is another one for certain.
    """
    off = np.array([one.pressures for one in steps]) - pressure
    if not np.isfinite(off).all():
        return Shift(0.0, Doubt(NAME, "method", 0.0, seen=False))
    mean = off.mean(axis=0) * rests
    worth = float(mean @ [slope.value for slope in slopes])
    if all(slope.half is not None for slope, part in zip(slopes, rests, strict=True) if part):
        open_ = mean * [slope.half or 0.0 for slope in slopes]
        half = max(float(np.linalg.norm(open_)), abs(float(open_.sum())))
        return Shift(worth, Doubt(NAME, "method", half, seen=False))
    size, apart = abs(worth), abs(float(mean.sum()))
    noise = max(one.pressure_noise for one in steps) / sqrt(FEW)
    error = hypot(noise, float(np.std(off @ rests))) / sqrt(len(steps))
    where = "before and after the steps" if all(rests) else "at rest and that of the operating point"
    text = f"the pressures {where} differ by {show(apart, 'pressure', 2)}, which may be worth {show(size, 'force', 2)}"
    reason = f"{text}: the record gives no dF/dP. Do the steps at two pressures, or with a finer regulator"
    return Shift(0.0, Doubt(NAME, "method", size, apart > SURE * error and size > 0, reason))


def slopes_of(key: Cell, cells: Mapping[Cell, Sequence[Steps]], back: bool) -> Slopes:
    """dF/dP around the steps of a cell, away from the start or `back`."""

    def of(group: Sequence[Steps], other: bool) -> list[Relaxation]:
        return [one for steps in group for one in (steps.back if other != back else steps.there)]

    at, mine = dict(key), of(cells[key], False)
    pressure, rest = at.get("pressure", 0.0), [(n, v) for n, v in key if n != "pressure"]
    others = {
        dict(cell)["pressure"]: of(group, False)
        for cell, group in cells.items()
        if "pressure" in dict(cell) and [(n, v) for n, v in cell if n != "pressure"] == rest
    }
    apart = [P for P in others if abs(P - pressure) > APART * max(P, pressure)]
    nearest = others[min(apart, key=lambda P: abs(P - pressure))] if apart else None

    def slope(side: int, still: Sequence[Relaxation]) -> Slope:
        place = at.get("start", 0.0) + (at.get("step", 0.0) if (side == 1) != back else 0.0)
        here = _rest(mine, side)
        K = abs(float(np.mean([one.static for one in mine])))
        most = LIKELY * (abs(here[1]) + K * abs(place)) / pressure if pressure > 0 else 0.0
        chord = None if nearest is None else _chord(here, _rest(nearest, side))
        return next((one for one in (chord, _on_the_way(still)) if one and 0 < one.value < most), Slope(most, None))

    return slope(0, of(cells[key], True)), slope(1, mine)


def _rest(steps: Sequence[Relaxation], side: int) -> tuple[float, float]:
    """Mean pressure [Pa] and force [N] of the rests before (0) or after (1) steps."""
    forces = [(one.before, one.relaxed)[side] for one in steps]
    return float(np.mean([one.pressures[side] for one in steps])), float(np.mean(forces))


def _chord(here: tuple[float, float], there: tuple[float, float]) -> Slope:
    value = (there[1] - here[1]) / (there[0] - here[0])
    return Slope(value, KNOWN * abs(value))


def _on_the_way(steps: Sequence[Relaxation]) -> Slope | None:
    """dF/dP of ways back at one length, or None where the pressure moves too little, or something else does."""
    if not steps:
        return None
    p, f = (np.concatenate([one.together[i] for one in steps]) for i in (0, 1))
    swing = float(np.std(p)) if len(p) > 2 else 0.0
    if swing <= SHOWN * max(noise_of(one.together[0]) for one in steps):
        return None
    value = float(p @ f) / float(p @ p)
    off = float(np.std(f - value * p)) / (abs(value) * swing or 1.0)
    return Slope(value, float(np.hypot(KNOWN, off)) * abs(value)) if off < LEFT else None
