"""Drawings of motion: curves of several trials on common axes, autocorrelation and quantiles of residuals.

All are called inside `svg.drawing()`. Numbers come in display units, with their labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING

from pmabench.plotting.plots import BLUE, FAINT, FULL, HALF, PALETTE, QUIET, Array, Panel, blank, few_ticks, grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def curves(panels: Sequence[Panel], x_label: str, y_label: str, height: float = 2.7) -> Figure:
    """Columns y over x, a curve for each panel on common axes."""
    figure = blank(HALF, height)
    rows = ceil(len(panels) / 2)
    axes = figure.add_subplot(grid(figure, 1, 1, top=0.2 + 0.16 * rows, left=0.56)[0])
    for i, panel in enumerate(panels):
        color = PALETTE[i % len(PALETTE)]
        axes.plot(panel.columns["x"], panel.columns["y"], color=color, linewidth=0.9, label=panel.title)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    few_ticks(axes)
    figure.legend(loc="upper left", bbox_to_anchor=(0.03, 1 - 0.13 / height), ncols=2, handletextpad=0.4)
    return figure


def residuals(lags: Array, correlations: Sequence[tuple[str, Array]], normal: Array, quantiles: Array) -> Figure:
    """Autocorrelation over lags [s], a line for each trial; quantiles over those of a normal distribution."""
    figure = blank(FULL, 2.7)
    cells = grid(figure, 1, 2, top=0.4, left=0.56, across=0.7)
    left, right = figure.add_subplot(cells[0]), figure.add_subplot(cells[1])
    left.axhline(0, color=QUIET, linewidth=0.8)
    for i, (name, values) in enumerate(correlations):
        left.plot(lags, values, color=PALETTE[i % len(PALETTE)], linewidth=0.9, label=name)
    left.set_xlabel("lag [s]")
    left.set_ylabel("autocorrelation")
    left.set_ylim(min(-0.3, 1.1 * min(float(values.min()) for _, values in correlations)), 1.05)
    few_ticks(left)
    ends = (float(normal[0]), float(normal[-1]))
    right.plot(ends, ends, color=FAINT, linewidth=1.0)
    right.plot(normal, quantiles, ".", color=BLUE, markersize=3)
    right.set_xlabel("quantile of a normal distribution")
    right.set_ylabel("quantile of residuals")
    few_ticks(right)
    figure.legend(*left.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.06, 0.985), ncols=3)
    return figure
