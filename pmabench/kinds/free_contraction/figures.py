"""Figure of free contraction: length over pressure reached from both sides, the fitted sigmoid, paper 2's formula."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.results import Analysis, Trace
from pmabench.plotting.pictures import Picture, bound, has, label, numbers, panel, picture
from pmabench.plotting.plots import BLUE, CROSSES, HALF, INK, RED, Panel, blank, few_ticks, grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {"pressure": "pressure", "length": "length", "below": "below", "above": "above", "fit": "fit", "model": "model"}
STYLES = {
    "below": ("^", "reached from below"),
    "above": ("v", "reached from above"),
    "length": ("o", "measured"),
}
LINES = {"fit": (RED, "-", "sigmoid, a to e fitted"), "model": (BLUE, (0, (4, 2)), "paper 2's formula")}


def lengths(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for each trace."""
    return [_lengths(trace, analysis.simulated) for trace in traces if has(trace, "pressure", "length")]


def _lengths(trace: Trace, simulated: bool) -> Picture:
    data = panel(trace, {new: old for new, old in NAMES.items() if old == "pressure" or has(trace, old)}, "")
    labels = {"x": label(trace, "pressure"), "y": label(trace, "length")}
    sides = "below" in data.columns and "above" in data.columns
    caption = "Length at rest without load: the nominal length less the contraction" + (
        ", at each pressure reached from 0 and from the highest pressure." if sides else "."
    )
    if "fit" in data.columns:
        caption += " Red: L = a + b / [1 + (p/c)^d]^e − 0.009 L0 √p (paper 2, eq. 1) through the means of both."
    if "model" in data.columns:
        caption += (
            " Dashed: the same with a to e of paper 2 for this nominal length; its printed coefficients are rounded: "
            "compare the shape."
        )
    y = data.columns["length"][np.isfinite(data.columns["length"])]
    alt = f"{labels['y']} over {labels['x']}: {len(y)} lengths from {y.max():.4g} down to {y.min():.4g}."
    draw = bound(drawing_of, data, labels)
    return picture(draw, "Free contraction", caption, alt, numbers([("", trace)]), wide=False, simulated=simulated)


def drawing_of(data: Panel, labels: dict[str, str]) -> Figure:
    """Marks of both sides, or of the mean where there are none, and the curves there are."""
    figure = blank(HALF, 2.75)
    axes = figure.add_subplot(grid(figure, 1, 1, left=0.6)[0])
    P = data.columns["pressure"]
    for name, (color, dashes, words) in LINES.items():
        if name in data.columns:
            axes.plot(P, data.columns[name], color=color, linestyle=dashes, linewidth=1.1, label=words, zorder=1)
    both: list[str] = [name for name in ("below", "above") if name in data.columns]
    for name in both or ["length"]:
        mark, words = STYLES[name]
        axes.plot(P, data.columns[name], mark, color=INK, markerfacecolor="white", markersize=3.5, label=words)
    for i, (name, at, y) in enumerate(data.published):
        axes.plot(at, y, CROSSES[i % len(CROSSES)], color=INK, label=name)
    axes.set_xlabel(labels["x"])
    axes.set_ylabel(labels["y"])
    axes.legend(loc="best")
    few_ticks(axes)
    return figure
