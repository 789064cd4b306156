"""Drawings of slow ramps and steps of displacement: loops with a mean curve, curves over contraction, marks and a line.

All are called inside `svg.drawing()`; numbers come in display units, with their labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING

from pmabench.plotting.plots import (
    CROSSES,
    FAINT,
    FULL,
    HALF,
    INK,
    PALETTE,
    QUIET,
    RED,
    Panel,
    blank,
    few_ticks,
    grid,
    published,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def loops(panels: Sequence[tuple[str, Sequence[tuple[str, Panel]], Panel | None]], labels: dict[str, str]) -> Figure:
    """A panel for each (title, loops with their names, mean curve); columns x, y."""
    alone = len(panels) == 1
    columns = min(3, len(panels))
    rows = ceil(len(panels) / columns)
    figure = blank(HALF if alone else FULL, 2.75 if alone else 0.55 + 2.0 * rows)
    cells = grid(figure, rows, columns, top=0.5, left=0.6, across=0.22, down=0.52)
    first: Axes | None = None
    named: dict[str, Artist] = {}
    marks: dict[str, int] = {}
    for i, (title, lines, mean) in enumerate(panels):
        axes = figure.add_subplot(cells[i], sharex=first, sharey=first)
        first = first or axes
        for name, line in lines:
            color = (
                PALETTE[list(named).index(name) % len(PALETTE)] if name in named else PALETTE[len(named) % len(PALETTE)]
            )
            (drawn,) = axes.plot(line.columns["x"], line.columns["y"], color=color, linewidth=0.9)
            named.setdefault(name, drawn)
        if mean is not None:
            axes.plot(mean.columns["x"], mean.columns["y"], color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        published(axes, mean or lines[0][1], marks)
        axes.set_title(title)
        axes.tick_params(labelleft=i % columns == 0)
        if i % columns == 0:
            axes.set_ylabel(labels["y"])
        if i + columns >= len(panels):
            axes.set_xlabel(labels["x"])
        few_ticks(axes, x=5)
    from matplotlib.lines import Line2D

    named["mean"] = Line2D([], [], color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    width, height = figure.get_size_inches()
    figure.legend(
        list(named.values()), list(named), loc="upper left", bbox_to_anchor=(0.5 / width, 1 - 0.06 / height),
        ncols=3 if alone else 6,
    )  # fmt: skip
    return figure


def means(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Curves y over x above, gap over x below, a colour for each panel; columns x, y, gap."""
    rows = ceil(len(panels) / 4)
    figure = blank(HALF, 3.1 + 0.15 * rows)
    cells = grid(figure, 1, 1, left=0.6, top=0.16 + 0.15 * rows)[0].subgridspec(2, 1, height_ratios=(2, 1), hspace=0.12)
    upper = figure.add_subplot(cells[0])
    lower = figure.add_subplot(cells[1], sharex=upper)
    for i, panel in enumerate(panels):
        color = PALETTE[i % len(PALETTE)]
        upper.plot(panel.columns["x"], panel.columns["y"], color=color, linewidth=1.1, label=panel.title)
        lower.plot(panel.columns["x"], panel.columns["gap"], color=color, linewidth=1.0)
    upper.tick_params(labelbottom=False)
    upper.set_ylabel(labels["y"])
    lower.set_ylabel(labels["gap"])
    lower.set_xlabel(labels["x"])
    lower.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
    few_ticks(upper)
    few_ticks(lower, y=3)
    figure.align_ylabels([upper, lower])
    width, height = figure.get_size_inches()
    handles = upper.get_legend_handles_labels()
    figure.legend(
        *handles, loc="upper left", bbox_to_anchor=(0.1 / width, 1 - 0.12 / height), ncols=4, columnspacing=0.8
    )
    return figure


def marks_and_line(panel: Panel, labels: dict[str, str]) -> Figure:
    """Marks y and the line `model` over x."""
    figure = blank(HALF, 2.55)
    axes = figure.add_subplot(grid(figure, 1, 1, left=0.56)[0])
    x = panel.columns["x"]
    stride = max(1, len(x) // 25)
    axes.plot(x, panel.columns["model"], color=RED, linewidth=1.1, label="fitted", zorder=1)
    axes.plot(x[::stride], panel.columns["y"][::stride], "o", color=INK, markerfacecolor="white", label="measured")
    for i, (name, at, y) in enumerate(panel.published):
        axes.plot(at, y, CROSSES[i % len(CROSSES)], color=INK, label=name)
    axes.set_xlabel(labels["x"])
    axes.set_ylabel(labels["y"])
    axes.legend(loc="best")
    few_ticks(axes)
    return figure


def sine_pressure(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Loops over x: y, and the models `set` and `model`; below each the loop of `error`."""
    alone = len(panels) == 1
    figure = blank(HALF if alone else FULL, 3.6)
    cells = grid(figure, 1, len(panels), top=0.5, left=0.62, across=0.22)
    first: tuple[Axes, Axes] | None = None
    for i, panel in enumerate(panels):
        inner = cells[i].subgridspec(2, 1, height_ratios=(1.7, 1), hspace=0.12)
        upper = figure.add_subplot(inner[0], sharex=first and first[0], sharey=first and first[0])
        lower = figure.add_subplot(inner[1], sharex=upper, sharey=first and first[1])
        first = first or (upper, lower)
        x = panel.columns["x"]
        upper.plot(x, panel.columns["y"], color=FAINT, linewidth=2.4, label="measured")
        upper.plot(x, panel.columns["set"], color=PALETTE[0], linewidth=0.9, label="set pressure")
        upper.plot(x, panel.columns["model"], color=RED, linewidth=0.9, label="measured pressure")
        lower.plot(x, panel.columns["error"], color=INK, linewidth=0.9)
        lower.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
        upper.set_title(panel.title)
        upper.tick_params(labelbottom=False, labelleft=i == 0)
        lower.tick_params(labelleft=i == 0)
        lower.set_xlabel(labels["x"])
        few_ticks(upper, x=4)
        few_ticks(lower, x=4, y=4)
        if i == 0:
            upper.set_ylabel(labels["y"])
            lower.set_ylabel(labels["error"])
            figure.align_ylabels([upper, lower])
    width, height = figure.get_size_inches()
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="upper left", bbox_to_anchor=(0.5 / width, 1 - 0.06 / height), ncols=3)
    return figure


def steps(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Columns x, y and P over t below each other, a column of axes for each panel; marks as dashed lines on y."""
    alone = len(panels) == 1
    rows = ["x", "y", *(["P"] if any("P" in panel.columns for panel in panels) else [])]
    figure = blank(HALF if alone else FULL, 1.0 + 1.2 * len(rows))
    cells = grid(figure, 1, len(panels), top=0.46, left=0.62, across=0.24)
    firsts: dict[str, Axes] = {}
    for i, panel in enumerate(panels):
        inner = cells[i].subgridspec(len(rows), 1, height_ratios=[0.7, 1.3, 1.0][: len(rows)], hspace=0.16)
        top: Axes | None = None
        for place, row in enumerate(rows):
            axes = figure.add_subplot(inner[place], sharex=top, sharey=firsts.get(row))
            top = top or axes
            firsts.setdefault(row, axes)
            if row in panel.columns:
                color = {"x": QUIET, "y": PALETTE[0], "P": RED}[row]
                axes.plot(panel.columns["t"], panel.columns[row], color=color, linewidth=1.0)
            for value in panel.marks.values() if row == "y" else ():
                axes.axhline(value, color=INK, linewidth=0.6, linestyle=(0, (4, 2)))
            axes.tick_params(labelleft=i == 0, labelbottom=row == rows[-1])
            few_ticks(axes, x=4, y=4)
            if i == 0:
                axes.set_ylabel(labels[row])
            if place == 0:
                axes.set_title(panel.title.replace(", ", "\n", 1))
        if top is not None:
            figure.axes[-1].set_xlabel(labels["t"])
    figure.align_ylabels(list(firsts.values()))
    return figure
