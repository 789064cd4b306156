"""Drawings: one function per kind of figure, from plain columns to a matplotlib figure; no page and no wording.

All are called inside `svg.drawing()`. Numbers come in display units, with their labels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from pmabench.plotting.chart import BLUE, BROWN, FAINT, FAULT, GREEN, INK, MARKS, PALETTE, QUIET, Array  # noqa: F401

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HALF, FULL = 3.5, 7.2
"""Widths of figures [in]."""
MARKERS = MARKS
CROSSES = ("x", "+", "1", "2", "3", "4")
"""Markers of published values."""
WARN = BROWN
"""Colour of the word SIMULATED."""


@dataclass(frozen=True)
class Panel:
    """One panel of a figure: title and named columns."""

    title: str
    columns: dict[str, Array]
    marks: dict[str, float]
    published: tuple[tuple[str, Array, Array], ...] = ()
    """Published points: label, x, y."""


def blank(width: float, height: float) -> Figure:
    """An empty figure [in]."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height))


def grid(figure: Figure, rows: int, columns: int, **options: Any) -> Any:
    """A grid inside margins in inches: left, right, bottom, top, and gaps `across` and `down`."""
    width, height = figure.get_size_inches()
    left, right = options.pop("left", 0.52), options.pop("right", 0.1)
    bottom, top = options.pop("bottom", 0.38), options.pop("top", 0.28)
    across, down = options.pop("across", 0.5), options.pop("down", 0.5)
    wide = (width - left - right - (columns - 1) * across) / columns
    high = (height - bottom - top - (rows - 1) * down) / rows
    options |= {"left": left / width, "right": 1 - right / width, "bottom": bottom / height, "top": 1 - top / height}
    return figure.add_gridspec(rows, columns, wspace=across / wide, hspace=down / high, **options)


def one_axes(width: float, height: float, **margins: Any) -> tuple[Figure, Axes]:
    """A figure [in] with one pair of axes inside margins as in `grid`."""
    figure = blank(width, height)
    return figure, figure.add_subplot(grid(figure, 1, 1, **margins)[0])


def above_each_other(
    figure: Figure, cell: Any, ratios: tuple[float, float], gap: float, shared: bool = False
) -> tuple[Axes, Axes]:
    """Two pairs of axes in a cell with the same x axis, labelled at the lower one; `shared`: also its ticks."""
    inner = cell.subgridspec(2, 1, height_ratios=ratios, hspace=gap)
    upper = figure.add_subplot(inner[0])
    upper.tick_params(labelbottom=False)
    return upper, figure.add_subplot(inner[1], sharex=upper if shared else None)


def fit_labels(figure: Figure) -> None:
    """Move the left ends of axes to the right if their labels would be cut off or overlap neighbouring axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    renderer, width = canvas.get_renderer(), figure.bbox.width
    places = [(axes, axes.get_position(), axes.yaxis.get_tightbbox(renderer)) for axes in figure.axes]
    columns: dict[float, float] = {}
    for _, place, box in places:
        if box is None:
            continue
        neighbours = [p.x1 * width for _, p, _ in places if p.x1 < place.x0 and p.y0 < place.y1 and place.y0 < p.y1]
        lack = max(neighbours, default=0.0) + 2.0 - box.x0
        key = round(place.x0, 4)
        columns[key] = max(columns.get(key, 0.0), lack)
    for axes, place, _ in places:
        move = columns.get(round(place.x0, 4), 0.0) / width
        if 0 < move < 0.5 * place.width:
            axes.set_position((place.x0 + move, place.y0, place.width - move, place.height))


def stamp(figure: Figure, text: str) -> None:
    """A word in the upper right corner: SIMULATED."""
    width, height = figure.get_size_inches()
    look: dict[str, Any] = {"ha": "right", "va": "top", "fontsize": 6.5, "color": WARN, "weight": "bold"}
    figure.text(1 - 0.06 / width, 1 - 0.04 / height, text, **look)


def legend_above(
    figure: Figure, columns: int, named: tuple[Any, Any] | None = None, at: Sequence[float] = (0.5, 0.06), **look: Any
) -> None:
    """Labels of the first axes (or `named`: handles, labels) in rows above them, `at` [in] from the upper left."""
    width, height = figure.get_size_inches()
    handles, labels = named or figure.axes[0].get_legend_handles_labels()
    place = (at[0] / width, 1 - at[1] / height)
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=place, ncols=columns, **look)


def multiples(
    figure: Figure, cells: Any, panels: Sequence[Panel], columns: int, labels: dict[str, str], ticks: int
) -> Iterator[tuple[Axes, Panel]]:
    """Axes with a common scale for each panel; title and labels are set after the caller has drawn."""
    first: Axes | None = None
    for i, panel in enumerate(panels):
        axes = figure.add_subplot(cells[i], sharex=first, sharey=first)
        first = first or axes
        yield axes, panel
        axes.set_title(panel.title)
        axes.tick_params(labelleft=i % columns == 0)
        axes.set(xlabel=labels["x"], ylabel=labels["y"] if i % columns == 0 else "")
        few_ticks(axes, x=ticks)


def published(axes: Axes, panel: Panel, marks: dict[str, int]) -> None:
    """Published points of a panel as crosses, named in the first panel that has them; `marks` numbers the labels."""
    new = []
    for name, x, y in panel.published:
        first, mark = name not in marks, CROSSES[marks.setdefault(name, len(marks)) % len(CROSSES)]
        drawn = axes.plot(x, y, mark, color=INK, markersize=4.5, markeredgewidth=1.0, label=name, zorder=4)
        new += drawn if first else []
    if new:
        axes.legend(handles=new, loc="best", handletextpad=0.2)


def few_ticks(axes: Axes, x: int = 6, y: int = 6) -> None:
    """Limit the number of tick intervals, at round numbers."""
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(x, steps=[1, 2, 2.5, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(y, steps=[1, 2, 2.5, 5, 10]))


def loops(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Closed curves of y over x, measured and model, one panel each on common axes; columns x, measured, model."""
    alone = len(panels) == 1
    columns = min(4, len(panels))
    rows = ceil(len(panels) / columns)
    figure = blank(HALF if alone else FULL, 2.55 if alone else 0.43 + 1.97 * rows)
    cells = grid(figure, rows, columns, top=0.5, left=0.56, across=0.18, down=0.62)
    marks: dict[str, int] = {}
    for axes, panel in multiples(figure, cells, panels, columns, labels, 4):
        x, y = panel.columns["x"], panel.columns["measured"]
        axes.plot(_closed(x), _closed(y), color=FAINT, linewidth=2.4, label="measured")
        if "model" in panel.columns:
            axes.plot(_closed(x), _closed(panel.columns["model"]), color=BROWN, linewidth=1.0, label="model")
        published(axes, panel, marks)
    handles, names = figure.axes[0].get_legend_handles_labels()
    legend_above(figure, 2, (handles[:2], names[:2]))
    return figure


def _closed(values: Array) -> Array:
    return np.append(values, values[0]) if len(values) else values


def against_frequency(panels: Sequence[Panel], labels: dict[str, str], names: Sequence[str]) -> Figure:
    """Named columns over frequency on a logarithmic axis, one panel each; fitted lines from columns `<name> fit`."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    columns = 4 if max(len(panel.title) for panel in panels) < 16 else 3
    rows = ceil(len(panels) / columns)
    figure = blank(FULL, 2.45 + 0.15 * rows)
    cells = grid(figure, 1, len(names), top=0.27 + 0.15 * rows, left=0.56, across=0.62)
    frequencies = sorted({float(f) for panel in panels for f in panel.columns["frequency"] if f > 0})
    for place, name in enumerate(names):
        axes = figure.add_subplot(cells[place])
        for i, panel in enumerate(panels):
            color, look = PALETTE[i % len(PALETTE)], MARKERS[i % len(MARKERS)]
            f, y = panel.columns["frequency"], panel.columns[name]
            axes.plot(f, y, look, color=color, label=panel.title, linestyle="none")
            if f"{name} fit" in panel.columns:
                axes.plot(panel.columns["frequency fit"], panel.columns[f"{name} fit"], color=color, linewidth=0.9)
        axes.set_xscale("log")
        axes.set_xticks(frequencies)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set(xlabel=labels["frequency"], ylabel=labels[name])
        low, high = axes.get_ylim()
        middle = abs(low + high) / 2
        if high - low < 0.06 * middle:
            axes.set_ylim(0.97 * middle * np.sign(low + high), 1.03 * middle * np.sign(low + high))
    legend_above(figure, columns)
    return figure


def scatter_and_line(panels: Sequence[Panel], labels: dict[str, str]) -> Figure:
    """Samples of y over x, coloured by test, with the fitted line; columns x, measured, fit, group."""
    alone = len(panels) == 1
    columns = 1 if alone else min(3, len(panels))
    rows = ceil(len(panels) / columns)
    figure = blank(HALF if alone else FULL, 2.55 if alone else 0.3 + 2.15 * rows)
    cells = grid(figure, rows, columns, left=0.56, across=0.3, down=0.65)
    marks: dict[str, int] = {}
    for axes, panel in multiples(figure, cells, panels, columns, labels, 5):
        x, y = panel.columns["x"], panel.columns["measured"]
        group = panel.columns.get("group", np.zeros(len(x)))
        for number, member in enumerate(np.unique(group)):
            mine = group == member
            axes.plot(x[mine], y[mine], ".", color=PALETTE[number % len(PALETTE)], markersize=1.6, alpha=0.6)
        if "fit" in panel.columns:
            known = np.flatnonzero(np.isfinite(panel.columns["fit"]) & np.isfinite(x))
            if len(known):
                ends = known[[np.argmin(x[known]), np.argmax(x[known])]]
                axes.plot(x[ends], panel.columns["fit"][ends], color=INK, linewidth=1.3)
        published(axes, panel, marks)
    return figure


def load_points(points: Panel, curves: Sequence[tuple[str, Array, Array]], labels: dict[str, str]) -> Figure:
    """Load over the pressures at which it lifts off and sets down, with fitted lines (name, x, y)."""
    figure, axes = one_axes(HALF, 2.7, left=0.56)
    for i, (name, x, y) in enumerate(curves):
        axes.plot(x, y, color=(INK, BROWN, GREEN)[i % 3], linewidth=1.0 if i == 0 else 0.8, label=name, zorder=1)
    load = points.columns["load"]
    for name, key, color, marker in (("lift-off", "lift", BROWN, "^"), ("set-down", "set_down", GREEN, "v")):
        if key in points.columns:
            look: dict[str, Any] = {"color": color, "markerfacecolor": "white", "markeredgewidth": 0.9}
            axes.plot(points.columns[key], load, marker, label=name, **look)
    axes.set(xlabel=labels["x"], ylabel=labels["y"])
    axes.legend(loc="upper left")
    few_ticks(axes)
    return figure
