"""What the mean curve of one pressure and stroke gives: K, F_ce, and force and stiffness along the stroke."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.ramp_loop import Loop
from pmabench.kinds.isobaric_ramp.cell import CURVE, LOCAL, OF_MEAN, RAW, Cell, each_local
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import Array

BENT_NOTE = "the mean curve is bent: the interval reaches to the slope at any place of the stroke"
AT_SPEED = "one speed only: the two dampings may differ, so that the force at rest may be anywhere in the gap"
IN_A_RAMP = "one speed only: nothing shows what creeps in less than a ramp, and K holds some of it"


def of_curve(cell: Cell, scales: Scales, near: Cell | None) -> list[Estimate]:
    """K and F_ce of the mean curve, its force and stiffness along the stroke.

    Calibration, to first order: forces ~ F, K ~ F/x; both are given for a contraction and a pressure that may
    be off, too. `near`: the cell of the pressure next to this one, None without another pressure.
    """
    x = cell.x
    lower, upper = cell.ends
    found: list[Estimate] = []

    def estimate(
        symbol: str, kind: tuple[str, str], method: str, of: Callable[[Loop], Array], over_P: float | None, *,
        place: float | None = None, extra: float = 0.0, note: str = "",
    ) -> None:  # fmt: skip
        line, force = cell.over_speed(of), symbol != "K"
        over_x = 0.0 if place is None else cell.over_x(place)[0 if force else 1]
        gains = {"force": line.start, "displacement": over_x * (place or 0.0) - (0.0 if force else line.start)}
        offsets = {"force": 1.0 if force else 0.0, "displacement": over_x}
        part = cell.part(scales, gains, offsets, over_P)
        alone = (AT_SPEED if force else IN_A_RAMP) if cell.one_speed and method in OF_MEAN else ""
        within = abs(cell.gap.start) / 2 if alone and force else 0.0
        parts = Parts(line.half_start, hypot(extra, within), part, 0.0)
        at = cell.at if method != LOCAL else {**cell.at, "contraction": round(float(place or 0.0), 7)}
        found.append(cell.estimate(symbol, line.start, kind, method, at, parts, sentences(note, alone)))

    newton, stiffness = ("N", "force"), ("N/m", "stiffness")
    by_turns = cell.of_turns(lambda curve: float(np.polyfit(x, curve, 1)[0]))
    kinds = [(CURVE, lambda loop: loop.mean), (RAW, lambda loop: loop.raw_mean)]
    for method, curve in kinds if any(m.loop.turns is not None for m in cell.members) else kinds[:1]:
        if cell.many_slopes:
            found.append(cell.estimate("K", None, stiffness, method, cell.at, Parts(), cell.many_slopes))
        else:
            estimate(
                "K", stiffness, method, lambda loop, of=curve: -np.polyfit(x, of(loop).T, 1)[0],  # type: ignore[misc]
                cell.over_pressure(near, lambda cell: -cell.straight),
                extra=hypot(cell.change, by_turns, cell.slow_turns(0.0)[1]), note=BENT_NOTE if cell.bent else "",
            )  # fmt: skip
        if lower <= 0 <= upper and cell.pressure > 0:
            estimate(
                "F_ce", newton, method, lambda loop, of=curve: each_local(x, of(loop), 0.0)[0],  # type: ignore[misc]
                cell.over_pressure(near, lambda cell: cell.force_at(0.0)), place=0.0,
                extra=cell.window_error(0.0)[0], note="force of the mean curve at x = 0",
            )  # fmt: skip
    for place in cell.places:
        error = cell.window_error(place)
        for i, (symbol, kind) in enumerate((("F", newton), ("K", stiffness))):

            def here(x: Array, curves: Array, place: float = place, i: int = i) -> Array:
                return (1 - 2 * i) * each_local(x, curves, place)[i]

            over_P = cell.over_pressure(near, lambda cell, of=here: float(of(cell.x, cell.curve[None])[0]))  # type: ignore[misc]
            estimate(
                symbol, kind, LOCAL, lambda loop, of=here: of(x, loop.mean), over_P, place=place, extra=error[i]  # type: ignore[misc]
            )  # fmt: skip
    return found
