"""Figures of steps of a platform: attitude with its reference, and the three pressures."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING

from pmabench.kinds.platform_step import MUSCLES
from pmabench.plotting.pictures import Picture, bound, has, head, how_many, label, numbers, panel, picture, spread
from pmabench.plotting.plots import (
    BLUE,
    BROWN,
    FULL,
    INK,
    PALETTE,
    Panel,
    blank,
    few_ticks,
    grid,
    legend_above,
)
from pmabench.store.analyses.results import Analysis, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DASHED = (0, (4, 3))
COLUMNS, MOST = 3, 6
SHOWN = ("t", "phi", "psi", "reference_phi", "reference_psi", *MUSCLES, "wanted_1", "wanted_2", "wanted_3")


def attitudes(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One trial of each attitude and chain."""
    able = [trace for trace in traces if has(trace, *SHOWN)]
    if not able:
        return []
    chosen = spread(able, MOST)
    panels = [panel(trace, {name: name for name in SHOWN}, head(trace)) for trace in chosen]
    labels = {"t": label(chosen[0], "t"), "angle": "phi, psi [deg]", "pressure": "pressure [kPa]"}
    caption = (
        "Above: attitude from the accelerometer without what its height adds, and the reference that it is to follow "
        "(dashed). Below: pressures of muscles 1 to 3, and what was wanted (dashed). The step is at 0 s."
        f"{how_many(chosen, able)}"
    )
    alt = f"Attitude and pressures over time: {'; '.join(one.title for one in panels)}."
    table = numbers([(head(trace), trace) for trace in chosen], SHOWN[:8])
    draw = bound(_drawn, panels, labels)
    return [picture(draw, "Attitude of the platform", caption, alt, table, wide=True, simulated=analysis.simulated)]


def _drawn(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    columns = min(COLUMNS, len(panels))
    rows = ceil(len(panels) / columns)
    figure = blank(FULL, 0.55 + 2.7 * rows)
    outer = grid(figure, rows, columns, top=0.5, left=0.75, across=0.5, down=0.6)
    for i, one in enumerate(panels):
        inner = outer[i].subgridspec(2, 1, height_ratios=(1.6, 1.2), hspace=0.14)
        upper, lower = (figure.add_subplot(inner[place]) for place in range(2))
        t, first = one.columns["t"], i % columns == 0
        for axis, color in (("phi", BLUE), ("psi", BROWN)):
            upper.plot(t, one.columns[axis], color=color, linewidth=1.0, label=axis)
            upper.plot(t, one.columns[f"reference_{axis}"], color=INK, linewidth=0.7, linestyle=DASHED)
        for number, name in enumerate(MUSCLES, start=1):
            color = PALETTE[number - 1]
            lower.plot(t, one.columns[name], color=color, linewidth=0.8)
            lower.plot(t, one.columns[f"wanted_{number}"], color=color, linewidth=0.5, linestyle=DASHED)
        upper.set_title(one.title)
        upper.tick_params(labelbottom=False)
        for axes in (upper, lower):
            few_ticks(axes, y=4)
            axes.set_xlim(float(t[0]), float(t[-1]))
        if first:
            upper.set_ylabel(labels["angle"])
            lower.set_ylabel(labels["pressure"])
            figure.align_ylabels([upper, lower])
        lower.set_xlabel(labels["t"])
    legend_above(figure, 2)
    return figure
