"""Drawings over time and of any columns: overlays, lift-off, oscillations, plain lines; knows no page and no wording.

All are called inside `svg.drawing()`. Numbers come in display units, with their labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from pmabench.plotting.plots import (
    BLUE,
    FAINT,
    FULL,
    GREEN,
    HALF,
    PALETTE,
    QUIET,
    RED,
    Array,
    Panel,
    blank,
    few_ticks,
    grid,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def overlay(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Measured and model over time with a residual strip below, in small multiples; columns t, measured, model."""
    alone = len(panels) == 1
    columns = 1 if alone else min(3, len(panels))
    cells = len(panels) + (0 if alone or len(panels) % columns == 0 else 1)
    rows = ceil(max(cells, len(panels)) / columns)
    figure = blank(HALF if alone else FULL, 2.55 if alone else 0.43 + 2.15 * rows)
    outer = grid(figure, rows, columns, top=0.3 if alone else 0.44, left=0.56, across=0.46, down=0.55)
    apart = np.concatenate([np.abs(p.columns["measured"] - p.columns["model"]) for p in panels])
    largest = float(np.max(apart, where=np.isfinite(apart), initial=0.0)) or 1.0
    for i, panel in enumerate(panels):
        t, y, model = (panel.columns[name] for name in ("t", "measured", "model"))
        inner = outer[i].subgridspec(2, 1, height_ratios=(3.2, 1), hspace=0.12)
        upper, lower = figure.add_subplot(inner[0]), figure.add_subplot(inner[1])
        upper.plot(t, y, color=FAINT, linewidth=2.6, solid_capstyle="round", label="measured")
        upper.plot(t, model, color=RED, linewidth=1.0, label="model")
        upper.set_title("" if alone else panel.title)
        upper.tick_params(labelbottom=False)
        lower.axhline(0, color=FAINT, linewidth=0.6)
        lower.plot(t, y - model, color=QUIET, linewidth=0.8)
        lower.set_ylim(-1.15 * largest, 1.15 * largest)
        few_ticks(upper)
        few_ticks(lower, y=2)
        lower.set_xlim(upper.get_xlim())
        if i % columns == 0:
            upper.set_ylabel(labels["measured"])
            lower.set_ylabel(labels["residual"])
            figure.align_ylabels([upper, lower])
        lower.set_xlabel(labels["t"])
    width, height = figure.get_size_inches()
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="upper left", bbox_to_anchor=(0.5 / width, 1 - 0.06 / height), ncols=2)
    return figure


def lifts(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Pressure and contraction over time while a load lifts off and sets down; marks `lift` and `set-down`."""
    columns = min(3, len(panels))
    rows = ceil(len(panels) / columns)
    figure = blank(FULL if columns > 1 else HALF, 0.35 + 2.25 * rows)
    outer = grid(figure, rows, columns, top=0.3, left=0.56, across=0.46, down=0.55)
    for i, panel in enumerate(panels):
        inner = outer[i].subgridspec(2, 1, height_ratios=(1.2, 1), hspace=0.14)
        upper, lower = figure.add_subplot(inner[0]), figure.add_subplot(inner[1])
        t = panel.columns["t"]
        upper.plot(t, panel.columns["pressure"], color=BLUE, linewidth=1.0)
        for line, (name, color) in enumerate((("set-down", GREEN), ("lift", RED))):
            if name in panel.marks:
                upper.axhline(panel.marks[name], color=color, linewidth=0.8, linestyle=(0, (4, 3)))
                upper.annotate(
                    f"{name} {panel.marks[name]:.4g}",
                    (1, 0.04),
                    xycoords="axes fraction",
                    xytext=(-2, 9 * line),
                    textcoords="offset points",
                    ha="right",
                    color=color,
                    fontsize=7.5,
                )
        lower.plot(t, panel.columns["displacement"], color=QUIET, linewidth=0.9)
        upper.set_title(panel.title)
        upper.tick_params(labelbottom=False)
        few_ticks(upper)
        few_ticks(lower, y=3)
        if i % columns == 0:
            upper.set_ylabel(labels["pressure"])
            lower.set_ylabel(labels["displacement"])
            figure.align_ylabels([upper, lower])
        lower.set_xlabel(labels["t"])
    return figure


def oscillations(rows: Sequence[tuple[Panel | None, Panel | None]], labels: dict[str, str]) -> Figure:
    """Left the swings at the gain nearest to the ultimate one, right growth over gain with its line; a row each."""
    figure = blank(FULL, 0.5 + 1.95 * len(rows))
    cells = grid(figure, len(rows), 2, top=0.36, left=0.56, across=0.75, down=0.62, width_ratios=(1.75, 1))
    for i, (swing, growth) in enumerate(rows):
        if swing is not None:
            axes = figure.add_subplot(cells[i, 0])
            axes.plot(swing.columns["t"], swing.columns["measured"], color=BLUE, linewidth=0.9)
            if "setpoint" in swing.marks:
                axes.axhline(swing.marks["setpoint"], color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)))
            axes.set_title(swing.title)
            axes.set_xlabel(labels["t"])
            axes.set_ylabel(labels["measured"])
            few_ticks(axes, x=8, y=5)
        if growth is not None:
            growth_axes(figure.add_subplot(cells[i, 1]), growth, labels)
    return figure


def growth_axes(axes: Axes, growth: Panel, labels: dict[str, str]) -> None:
    """Logarithm of the ratio of successive swings over gain; filled points carry the line, its zero is K_u."""
    gain, ratio = growth.columns["gain"], growth.columns["log_ratio"]
    used = growth.columns["used"] > 0.5
    axes.axhline(0, color=QUIET, linewidth=0.8)
    if "fit" in growth.columns and used.any():
        near = gain >= np.min(gain[used])
        axes.plot(gain[near], growth.columns["fit"][near], color=RED, linewidth=1.0)
    axes.plot(gain[~used], ratio[~used], "o", color=BLUE, markerfacecolor="white", markeredgewidth=0.9)
    axes.plot(gain[used], ratio[used], "o", color=BLUE)
    if "K_u" in growth.marks:
        axes.axvline(growth.marks["K_u"], color=RED, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.annotate(
            growth.title,
            (growth.marks["K_u"], 0.06),
            xycoords=("data", "axes fraction"),
            xytext=(-3, 0),
            textcoords="offset points",
            ha="right",
            color=RED,
            fontsize=7.5,
        )
    axes.set_xlabel(labels["gain"])
    axes.set_ylabel(labels["log_ratio"])
    few_ticks(axes, x=5, y=5)


def lines(title: str, x: Array, x_label: str, columns: Sequence[tuple[str, str, Array]]) -> Figure:
    """Any columns over the first one, a panel for each axis label; `columns` are (label, axis label, values)."""
    names = list(dict.fromkeys(axis for _, axis, _ in columns))
    figure = blank(FULL, 0.45 + 1.6 * max(1, len(names)))
    cells = grid(figure, max(1, len(names)), 1, left=0.62, down=0.36)
    for place, name in enumerate(names):
        axes = figure.add_subplot(cells[place])
        for i, (label, _, values) in enumerate(c for c in columns if c[1] == name):
            style = "o" if len(x) <= 30 and not np.all(np.diff(x) > 0) else "-"
            axes.plot(x, values, style, color=PALETTE[i % len(PALETTE)], label=label, linewidth=1.0, markersize=3)
        axes.set_ylabel(name)
        few_ticks(axes, x=8, y=5)
        axes.tick_params(labelbottom=place == len(names) - 1)
        if len([c for c in columns if c[1] == name]) > 1:
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6)
        if place == 0:
            axes.set_title(title)
    if figure.axes:
        figure.axes[-1].set_xlabel(x_label)
    return figure
