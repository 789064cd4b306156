"""Figure of an arm: bending angle over pressure at each load, what paper 2 has, and how far both ways are apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pmabench.base.quantities import show
from pmabench.plotting.pictures import Picture, bound, column, has, how_many, label, numbers, panel, picture, spread
from pmabench.plotting.plots import FULL, INK, PALETTE, QUIET, Panel, blank, few_ticks, grid
from pmabench.store.analyses.results import Analysis, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOADS = 6
NAMES = ("pressure", "angle", "below", "above", "fit", "model")


def angles(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for all loads."""
    able = [t for t in traces if has(t, "pressure", "angle")]
    chosen = spread(able, LOADS)
    if not chosen:
        return []
    panels = [
        panel(t, {name: name for name in NAMES if name in t.columns and has(t, name)}, _in_words(t)) for t in chosen
    ]
    first = chosen[0]
    labels = {"x": label(first, "pressure"), "y": label(first, "angle"), "gap": "above − below [deg]"}
    kinds = {name for one in panels for name in one.columns}
    caption = "Angle of the arm's end at rest over the pressure of the bending muscle, at each load."
    if "above" in kinds:
        caption += " △ reached from below, ▽ from above; right: from above less from below."
    if "fit" in kinds:
        caption += " Lines: α = a + b / [1 + (p/c)^d] through the way up (paper 2, second eqs. 10)."
    if "model" in kinds:
        caption += " Dashed: the same with paper 2's 20 numbers."
    if any("table" in one.marks for one in panels):
        caption += " Short lines at the right end: the largest angles of its Table 1."
    y = np.concatenate([column(t, "angle")[np.isfinite(column(t, "angle"))] for t in chosen])
    alt = f"{labels['y']} over {labels['x']} at {len(panels)} loads, {y.min():.4g} to {y.max():.4g}."
    table = numbers([(one.title, t) for one, t in zip(panels, chosen, strict=True)])
    draw = bound(drawing_of, panels, labels)
    title = "Bending angle of the arm"
    return [picture(draw, title, caption + how_many(chosen, able), alt, table, wide=True, simulated=analysis.simulated)]


def _in_words(trace: Trace) -> str:
    return show(trace.marks["tip_mass"], "mass", 4) if "tip_mass" in trace.marks else trace.name


def drawing_of(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Left the angles; right the difference of both ways, where there are both."""
    both = any("above" in one.columns for one in panels)
    figure = blank(FULL, 3.0)
    cells = grid(figure, 1, 3 if both else 1, left=0.55, across=0.55)
    axes = figure.add_subplot(cells[0, :2] if both else cells[0])
    gap = figure.add_subplot(cells[0, 2]) if both else None
    for i, one in enumerate(panels):
        color = PALETTE[i % len(PALETTE)]
        P = one.columns["pressure"]
        if "fit" in one.columns:
            axes.plot(P, one.columns["fit"], color=color, linewidth=0.9, zorder=1)
        if "model" in one.columns:
            axes.plot(P, one.columns["model"], color=color, linestyle=(0, (4, 2)), linewidth=0.8, zorder=1)
        for name, mark in (("below", "^"), ("above", "v")):
            if name in one.columns:
                title = one.title if name == "below" else None
                axes.plot(P, one.columns[name], mark, color=color, markerfacecolor="white", markersize=3.0, label=title)
        if "table" in one.marks:
            end = float(np.nanmax(P))
            printed = np.degrees(one.marks["table"])
            axes.plot([0.985 * end, 1.015 * end], [printed, printed], color=INK, linewidth=1.2, zorder=4)
        if gap is not None and "above" in one.columns:
            gap.plot(P, one.columns["above"] - one.columns["below"], "o-", color=color, markersize=2.5, linewidth=0.7)
        for name, at, y in one.published:
            axes.plot(at, y, "x", color=INK, markersize=4, label=name)
    axes.set_xlabel(labels["x"])
    axes.set_ylabel(labels["y"])
    axes.legend(loc="lower right", ncols=3)
    few_ticks(axes)
    if gap is not None:
        gap.axhline(0.0, color=QUIET, linewidth=0.6)
        gap.set_xlabel(labels["x"])
        gap.set_ylabel(labels["gap"])
        few_ticks(gap)
    return figure
