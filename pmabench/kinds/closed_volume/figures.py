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
from pmabench.plotting.chart import Series, of_points
from pmabench.plotting.pictures import Picture, column, has, how_many, numbers, of_charts, spread, unit_of
from pmabench.plotting.plots import PALETTE
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
    series = [one for i, trace in enumerate(chosen) for one in _series(trace, i)]
    points = [one for one in series if one.dots]
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
    chart = of_points(series, *labels, alt, simulated=analysis.simulated)
    table = numbers([(p.label, t) for p, t in zip(points, chosen, strict=True)], NAMES)
    title, simulated = "Volume over contraction", analysis.simulated
    return [of_charts([[chart]], title, caption, alt, table, simulated=simulated, still=True)]


def _series(trace: Trace, i: int) -> list[Series]:
    """The values from one start pressure, all but the first open and a little aside; with the first the curve."""
    x, y = column(trace, "contraction"), column(trace, "volume")
    half = column(trace, "half") if "half" in trace.columns else None
    curve = [Series("", x, column(trace, "curve"), PALETTE[0])] if i == 0 and "curve" in trace.columns else []
    name = show(trace.marks["pressure"], "pressure") if "pressure" in trace.marks else f"{i + 1}"
    aside = x + 0.012 * i * np.ptp(x)
    return [*curve, Series(f"from {name}", aside, y, PALETTE[i % len(PALETTE)], True, half, hollow=i > 0)]


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
