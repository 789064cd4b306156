"""Figure of a closed volume: V over contraction from each start pressure, and the curve through all.

`measure`: the values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

import numpy as np

from pmabench.analysis.shared.samples import NotUsable, settings_of
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.closed_volume.reduction import LEAKS
from pmabench.kinds.closed_volume.stroke import Gas
from pmabench.kinds.closed_volume.stroke import measure as stroke_of
from pmabench.plotting import plots
from pmabench.plotting.pictures import Picture, bound, column, has, how_many, numbers, picture, spread, unit_of
from pmabench.plotting.plots import Points
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

NAMES = ("contraction", "volume", "half")
PRESSURES = 4


def volumes(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure with the volumes of all start pressures."""
    able = [t for t in traces if has(t, "contraction", "volume")]
    chosen = spread(able, PRESSURES)
    if not chosen:
        return []
    points = [_points(trace, i) for i, trace in enumerate(chosen)]
    labels = (unit_of(chosen[0], "contraction").label("contraction ε"), unit_of(chosen[0], "volume").label("V"))
    marks = chosen[0].marks
    curve = ""
    if {"D_0", "theta_0", "alpha"} <= set(marks):
        curve = (
            "; line: V(ε) of paper 3 through all of them, "
            f"D0 {show(marks['D_0'], 'length', 4)}, θ0 {degrees(marks['theta_0']):.4g}°, α {marks['alpha']:.4g}"
        )
    caption = (
        "Marks: volumes from the absolute pressure of the air shut in, what leaked taken out, with 95 % intervals, "
        f"from each pressure at which the valve shut{curve}. The pressures share volume at the start, dead volume and "
        f"room, so the marks differ by less than the intervals.{how_many(chosen, able)}"
    )
    every = np.concatenate([p.y for p in points])
    least, most = float(np.nanmin(every)), float(np.nanmax(every))
    alt = f"{labels[1]} over {labels[0]} from {len(points)} start pressures, {least:.4g} to {most:.4g}."
    draw = bound(plots.coefficients, points, *labels)
    table = numbers([(p.label, t) for p, t in zip(points, chosen, strict=True)], NAMES)
    return [picture(draw, "Volume over contraction", caption, alt, table, wide=False, simulated=analysis.simulated)]


def _points(trace: Trace, i: int) -> Points:
    x, y = column(trace, "contraction"), column(trace, "volume")
    half = column(trace, "half") if "half" in trace.columns else np.full(len(x), np.nan)
    curve = (x, column(trace, "curve"), np.zeros(len(x))) if i == 0 and "curve" in trace.columns else None
    name = show(trace.marks["pressure"], "pressure") if "pressure" in trace.marks else f"{i + 1}"
    return Points(f"from {name}", x, y, half, half, primary=i == 0, group=i, mark=i, curve=curve)


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The volume at the end of the stroke, and the pressure that leaks away over the trial."""
    settings = settings_of(run)
    try:
        stroke = stroke_of(run, trial, settings)
    except NotUsable as reason:
        return [Measured("V", "volume", None)], [str(reason)]
    gas = Gas.of(settings)
    V = stroke.volumes(gas, leak=True)[:, -1]
    share = stroke.lost / (stroke.before + gas.atmosphere)
    found = [Measured("V", "volume", float(V.mean())), Measured("leak", "pressure", stroke.lost, noise=stroke.noise)]
    return found, [f"{share:.1%} of the air is lost over the trial"] if share > LEAKS else []
