"""Figures of slow ramps at constant pressure: loops, mean curves, gap, force of the rubber.

`measure`: values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pmabench.analysis.shared.ramp_loop import measure_as_planned
from pmabench.analysis.shared.samples import NotUsable
from pmabench.analysis.shared.trials import grouped
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.plotting.chart import BROWN, INK, PALETTE, ZERO, Chart, Series, small_multiples
from pmabench.plotting.pictures import (
    Picture,
    column,
    crosses,
    curve,
    has,
    head,
    label,
    of_traces,
    reach,
    spread,
)
from pmabench.plotting.wording import shown
from pmabench.store.analyses.results import Analysis, Trace
from pmabench.store.records import RunData, TrialData

RUBBER = (("model", "fitted", BROWN), ("force", "measured", INK, "o"))
PANELS, SPEEDS, MARKED = 6, 4, 25
"""Most panels of a figure, loops of a panel, and marks of a measured curve."""


def loops(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """The loops at each pressure, colours by speed, with the mean curve."""
    able = [t for t in traces if has(t, "displacement", "force")]
    single = [t for t in able if t.figure == "isobaric"]
    groups = grouped(single, lambda trace: trace.name.rpartition("-")[0].removeprefix("isobaric-"))
    if not groups:
        return []
    means = {t.name.removeprefix("mean-curve-"): t for t in able if t.figure == "mean-curve"}
    keys = sorted(groups, key=lambda key: groups[key][0].marks.get("pressure", 0.0))
    chosen = spread(keys, PANELS)
    unit = shown("speed")
    speeds = {key: spread(groups[key], SPEEDS) for key in chosen}
    said = {t.name: f"{t.marks['speed'] / unit.scale:.3g} {unit.unit}" for key in chosen for t in speeds[key]}
    colors = {name: PALETTE[n % len(PALETTE)] for n, name in enumerate(dict.fromkeys(said.values()))}
    titles = [head(groups[key][0]) for key in chosen]
    first = groups[chosen[0]][0]
    labels = label(first, "displacement"), label(first, "force")
    theirs = crosses([means.get(key, speeds[key][0]) for key in chosen], "displacement", "force")
    charts = []
    for key, title, published in zip(chosen, titles, theirs, strict=True):
        lines = [_line(t, said[t.name], colors[said[t.name]]) for t in speeds[key]]
        lines += [_line(means[key], "mean", INK, dashed=True)] if key in means else []
        charts.append(Chart(*labels, (*lines, *published), height=170.0, title=title, legend=True))
    black = ", and in black the mean of its branches, taken to speed 0: what a model without hysteresis is to give"
    black = black if any(key in means for key in chosen) else ""
    gaps = [t.marks["H"] for key in chosen for t in groups[key] if "H" in t.marks]
    caption = f"The last cycle at each speed{black}. Gap at mid stroke, expanding minus contracting: {reach(gaps)} N."
    caption += f" {len(chosen)} of {len(keys)} are shown." if len(chosen) < len(keys) else ""
    drawn = [t for key in chosen for t in speeds[key]]
    figure = small_multiples(charts, 3), "Isobaric loops", caption, analysis, drawn
    return [
        of_traces(*figure, columns=("displacement", "force"), titles=[f"{head(t)}, {said[t.name]}" for t in drawn]),
        *_means([means[key] for key in chosen if key in means], analysis),
    ]


def _line(trace: Trace, name: str, color: str, **looks: Any) -> Series:
    return curve(trace, "displacement", "force", name, color, width=1.0, **looks)


def _means(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Mean curves and gaps of all pressures, over contraction."""
    able = [t for t in traces if has(t, "displacement", "force", "gap")]
    if len(able) < 2:
        return []
    unit, x = shown("force").unit, label(able[0], "displacement")
    forces, gaps = [], []
    for n, t in enumerate(able):
        color = PALETTE[n % len(PALETTE)]
        forces.append(curve(t, "displacement", "force", head(t), color))
        gaps.append(curve(t, "displacement", "gap", "", color))
    upper = Chart(x, f"mean force [{unit}]", forces, height=150.0)
    lower = Chart(x, f"gap [{unit}]", gaps, height=96.0, y_ticks=3, levels=(ZERO,))
    caption = (
        "Above: mean of the branches at each pressure. Below: the gap between them at the lowest speed; it closes at "
        "the ends of the stroke, where one branch turns into the other."
    )
    rows, columns = small_multiples([(upper, lower)], 1), ("displacement", "force", "gap")
    return [of_traces(rows, "Mean curves and gap over contraction", caption, analysis, able, columns=columns)]


def rubber(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """The force without pressure compared with the fitted rubber term."""
    found = []
    for trace in (t for t in traces if has(t, "displacement", "force", "model")):
        fitted, measured = (curve(trace, "displacement", name, *look) for name, *look in RUBBER)
        off = float(np.sqrt(np.nanmean((column(trace, "force") - column(trace, "model")) ** 2)))
        caption = (
            "Marks: mean of the branches without pressure. Line: F_e = A ε (ε − B1)/(ε + B2) (paper 3, eq. 8), rms "
            f"difference {off:.2g} {shown('force').unit}."
        )
        every = max(1, len(measured.x) // MARKED)
        marks = replace(measured, x=measured.x[::every], y=measured.y[::every], hollow=True)
        theirs = crosses([trace], "displacement", "force")[0]
        labels = label(trace, "displacement"), label(trace, "force")
        chart = Chart(*labels, (fitted, marks, *theirs), legend=True)
        found.append(of_traces([[chart]], "Force of the rubber at 0 kPa", caption, analysis, [trace]))
    return found


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K of the mean curve, the gap of its branches at mid stroke, and the pressure."""
    P, speed = trial.point.get("pressure"), trial.point.get("speed", 0.0)
    try:
        loop = measure_as_planned(run, trial)
    except NotUsable as reason:
        return [Measured("K", "stiffness", None), Measured("H", "force", None)], [str(reason)]
    gap = float(loop.middle_gap.mean())
    K_e = gap_e = None
    if expected is not None and P is not None:
        K_e, B_c, B_r = (expected.at(name, P) for name in ("K", "B_c", "B_r"))
        if B_c is not None and B_r is not None:
            gap_e = 2 * expected.F_c + (B_c + B_r) * speed
    doubts = []
    if gap < -max(loop.noise, 1e-3):
        doubts.append("the contracting branch is the upper one: a wrong sign, or force and displacement apart in time")
    return [
        Measured("K", "stiffness", -float(np.polyfit(loop.x, loop.mean.mean(axis=0), 1)[0]), K_e),
        Measured("H", "force", gap, gap_e, tolerance=0.25 * gap_e if gap_e else 0.0, noise=loop.noise),
        Measured("P", "pressure", None if np.isnan(loop.pressure) else loop.pressure, P or None),
    ], doubts
