"""Figure of S(eps): slopes of force over pressure at each contraction, and the fitted curve with its band."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

import numpy as np

from pmabench.analysis.results import Analysis, Trace
from pmabench.plotting import plots
from pmabench.plotting.pictures import Picture, bound, column, has, numbers, picture, unit_of
from pmabench.plotting.plots import Points
from pmabench.plotting.wording import shown

NAMES = ("contraction", "slope", "half", "curve", "low", "high")


def sections(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for each trace with slopes first and the curve after them."""
    return [_section(trace, analysis.simulated) for trace in traces if has(trace, *NAMES)]


def _section(trace: Trace, simulated: bool) -> Picture:
    eps, slope, half, curve, low, high = (column(trace, name) for name in NAMES)
    point, line = np.isfinite(slope), np.isfinite(curve)
    band = np.where(np.isfinite(high - low), 0.5 * (high - low), 0.0)
    half = np.where(np.isfinite(half), half, np.nan)
    points = Points(
        label="slopes of F(P)",
        x=eps[point],
        y=slope[point],
        below=half[point],
        above=half[point],
        primary=True,
        group=0,
        mark=0,
        curve=(eps[line], curve[line], band[line]),
    )
    labels = (unit_of(trace, "contraction").label("contraction ε"), unit_of(trace, "slope").label("S"))
    length = shown("length")
    fitted = (
        f"D0 {trace.marks['D_0'] / length.scale:.4g} {length.unit}, θ0 {degrees(trace.marks['theta_0']):.4g}°, "
        f"α {trace.marks['alpha']:.4g}"
        if {"D_0", "theta_0", "alpha"} <= set(trace.marks)
        else "its parameters are in the table"
    )
    caption = (
        "Marks: slopes of force over pressure with their 95 % intervals; line: S(ε) = (π/4) D0² [3 (1 − ε)^α / tan² θ0 "
        f"− 1 / sin² θ0] of paper 3 through them, with its 95 % band ({fitted}). The curve may be known well where its "
        "parameters are not."
    )
    alt = (
        f"{labels[1]} over {labels[0]}: {int(point.sum())} slopes from {slope[point].max():.4g} down to "
        f"{slope[point].min():.4g}, and a curve through them with a band."
    )
    draw = bound(plots.coefficients, [points], *labels)
    title = "Force by pressure, S, over contraction"
    return picture(draw, title, caption, alt, numbers([("", trace)]), wide=False, simulated=simulated)
