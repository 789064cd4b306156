"""Drawings over time and over contraction: overlays, lift-off, oscillations, slow ramps, steps, plain lines.

All are called inside `svg.drawing()`. Numbers come in display units, with their labels; no wording, no page.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from pmabench.plotting.plots import (
    BLUE,
    BROWN,
    CROSSES,
    FAINT,
    FULL,
    GREEN,
    HALF,
    INK,
    PALETTE,
    QUIET,
    Array,
    Panel,
    above_each_other,
    blank,
    few_ticks,
    grid,
    legend_above,
    one_axes,
    published,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NOTE: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "fontsize": 7.5}
"""Style of a text at a line."""


def lifts(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Pressure and contraction over time while a load lifts off and sets down; marks `lift` and `set-down`."""
    columns = min(3, len(panels))
    rows = ceil(len(panels) / columns)
    figure = blank(FULL if columns > 1 else HALF, 0.35 + 2.25 * rows)
    outer = grid(figure, rows, columns, top=0.3, left=0.56, across=0.46, down=0.55)
    for i, panel in enumerate(panels):
        upper, lower = above_each_other(figure, outer[i], (1.2, 1), 0.14)
        t = panel.columns["t"]
        upper.plot(t, panel.columns["pressure"], color=BLUE, linewidth=1.0)
        for line, (name, color) in enumerate((("set-down", GREEN), ("lift", BROWN))):
            if name in panel.marks:
                upper.axhline(panel.marks[name], color=color, linewidth=0.8, linestyle=(0, (4, 3)))
                text, place = f"{name} {panel.marks[name]:.4g}", (-2, 9 * line)
                upper.annotate(text, (1, 0.04), xycoords="axes fraction", xytext=place, color=color, **NOTE)
        lower.plot(t, panel.columns["displacement"], color=QUIET, linewidth=0.9)
        upper.set_title(panel.title)
        few_ticks(upper)
        few_ticks(lower, y=3)
        if i % columns == 0:
            upper.set_ylabel(labels["pressure"])
            lower.set_ylabel(labels["displacement"])
            figure.align_ylabels([upper, lower])
        lower.set_xlabel(labels["t"])
    return figure


def oscillations(rows: Sequence[tuple[Panel | None, Panel | None]], labels: dict[str, str]) -> Figure:
    """Left: oscillation at the gain nearest to the ultimate one; right: growth over gain with its line."""
    figure = blank(FULL, 0.5 + 1.95 * len(rows))
    cells = grid(figure, len(rows), 2, top=0.36, left=0.56, across=0.75, down=0.62, width_ratios=(1.75, 1))
    for i, (swing, growth) in enumerate(rows):
        if swing is not None:
            axes = figure.add_subplot(cells[i, 0])
            axes.plot(swing.columns["t"], swing.columns["measured"], color=BLUE, linewidth=0.9)
            if "setpoint" in swing.marks:
                axes.axhline(swing.marks["setpoint"], color=QUIET, linewidth=0.8, linestyle=(0, (4, 3)))
            axes.set(title=swing.title, xlabel=labels["t"], ylabel=labels["measured"])
            few_ticks(axes, x=8, y=5)
        if growth is not None:
            growth_axes(figure.add_subplot(cells[i, 1]), growth, labels)
    return figure


def growth_axes(axes: Axes, growth: Panel, labels: dict[str, str]) -> None:
    """Logarithm of the ratio of successive swings over gain; line through the filled points, its zero is K_u."""
    gain, ratio = growth.columns["gain"], growth.columns["log_ratio"]
    used = growth.columns["used"] > 0.5
    axes.axhline(0, color=QUIET, linewidth=0.8)
    if "fit" in growth.columns and used.any():
        near = gain >= np.min(gain[used])
        axes.plot(gain[near], growth.columns["fit"][near], color=BROWN, linewidth=1.0)
    axes.plot(gain[~used], ratio[~used], "o", color=BLUE, markerfacecolor="white", markeredgewidth=0.9)
    axes.plot(gain[used], ratio[used], "o", color=BLUE)
    if "K_u" in growth.marks:
        axes.axvline(growth.marks["K_u"], color=BROWN, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.annotate(growth.title, (growth.marks["K_u"], 0.06), xycoords=("data", "axes fraction"), xytext=(-3, 0),
                      color=BROWN, **NOTE)  # fmt: skip
    axes.set(xlabel=labels["gain"], ylabel=labels["log_ratio"])
    few_ticks(axes, x=5, y=5)


def lines(title: str, x: Array, x_label: str, columns: Sequence[tuple[str, str, Array]]) -> Figure:
    """Columns over the first one, one panel for each axis label; `columns` are (label, axis label, values)."""
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


def loops(panels: Sequence[tuple[str, Sequence[tuple[str, Panel]], Panel | None]], labels: dict[str, str]) -> Figure:
    """One panel for each (title, loops with their names, mean curve); columns x, y."""
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
            color = PALETTE[(list(named).index(name) if name in named else len(named)) % len(PALETTE)]
            (drawn,) = axes.plot(line.columns["x"], line.columns["y"], color=color, linewidth=0.9)
            named.setdefault(name, drawn)
        if mean is not None:
            axes.plot(mean.columns["x"], mean.columns["y"], color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
        published(axes, mean or lines[0][1], marks)
        axes.set_title(title)
        axes.tick_params(labelleft=i % columns == 0)
        axes.set_ylabel(labels["y"] if i % columns == 0 else "")
        axes.set_xlabel(labels["x"] if i + columns >= len(panels) else "")
        few_ticks(axes, x=5)
    from matplotlib.lines import Line2D

    named["mean"] = Line2D([], [], color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    legend_above(figure, 3 if alone else 6, (list(named.values()), list(named)))
    return figure


def means(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Curves y over x above, gap over x below, one colour for each panel; columns x, y, gap."""
    rows = ceil(len(panels) / 4)
    figure = blank(HALF, 3.1 + 0.15 * rows)
    cell = grid(figure, 1, 1, left=0.6, top=0.16 + 0.15 * rows)[0]
    upper, lower = above_each_other(figure, cell, (2, 1), 0.12, shared=True)
    for i, panel in enumerate(panels):
        color = PALETTE[i % len(PALETTE)]
        upper.plot(panel.columns["x"], panel.columns["y"], color=color, linewidth=1.1, label=panel.title)
        lower.plot(panel.columns["x"], panel.columns["gap"], color=color, linewidth=1.0)
    upper.set_ylabel(labels["y"])
    lower.set(ylabel=labels["gap"], xlabel=labels["x"])
    lower.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
    few_ticks(upper)
    few_ticks(lower, y=3)
    figure.align_ylabels([upper, lower])
    legend_above(figure, 4, at=(0.1, 0.12), columnspacing=0.8)
    return figure


def marks_and_line(panel: Panel, labels: dict[str, str]) -> Figure:
    """Markers y and the line `model` over x."""
    figure, axes = one_axes(HALF, 2.55, left=0.56)
    x = panel.columns["x"]
    stride = max(1, len(x) // 25)
    axes.plot(x, panel.columns["model"], color=BROWN, linewidth=1.1, label="fitted", zorder=1)
    axes.plot(x[::stride], panel.columns["y"][::stride], "o", color=INK, markerfacecolor="white", label="measured")
    for i, (name, at, y) in enumerate(panel.published):
        axes.plot(at, y, CROSSES[i % len(CROSSES)], color=INK, label=name)
    axes.set(xlabel=labels["x"], ylabel=labels["y"])
    axes.legend(loc="best")
    few_ticks(axes)
    return figure


def sine_pressure(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Loops over x of y and of the models `set` and `model`; below each the loop of `error`."""
    alone = len(panels) == 1
    figure = blank(HALF if alone else FULL, 3.6)
    cells = grid(figure, 1, len(panels), top=0.5, left=0.62, across=0.22)
    first: tuple[Axes, Axes] | None = None
    for i, panel in enumerate(panels):
        inner = cells[i].subgridspec(2, 1, height_ratios=(1.7, 1), hspace=0.12)
        upper = figure.add_subplot(inner[0], sharex=first and first[0], sharey=first and first[0])
        lower = figure.add_subplot(inner[1], sharex=upper, sharey=first and first[1])
        first, x = first or (upper, lower), panel.columns["x"]
        upper.plot(x, panel.columns["y"], color=FAINT, linewidth=2.4, label="measured")
        upper.plot(x, panel.columns["set"], color=PALETTE[0], linewidth=0.9, label="set pressure")
        upper.plot(x, panel.columns["model"], color=BROWN, linewidth=0.9, label="measured pressure")
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
    legend_above(figure, 3)
    return figure


def steps(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Columns x, y and P over t below each other, one column of axes for each panel; marks as dashed lines on y."""
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
                color = {"x": QUIET, "y": PALETTE[0], "P": BROWN}[row]
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
