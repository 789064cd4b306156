"""Figure of repeats: the trials of one operating point over each other, and what each is off their mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.results import Analysis, Trace
from pmabench.plotting.pictures import Picture, bound, column, has, numbers, picture, unit_of
from pmabench.plotting.plots import FAINT, HALF, PALETTE, QUIET, RED, Array, blank, few_ticks, grid
from pmabench.plotting.wording import clean

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDS = {"length": "contraction", "force": "force"}


def repeats(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure for each trace with at least two repeats."""
    return [found for trace in traces if (found := _repeats(trace, analysis.simulated)) is not None]


def _repeats(trace: Trace, simulated: bool) -> Picture | None:
    names = [name for name in trace.columns if name.startswith("repeat ") and has(trace, "t", name)]
    if len(names) < 2:
        return None
    where, t = clean(trace.title.partition(":")[0], 140), column(trace, "t")
    values = np.array([column(trace, name) for name in names])
    mean = values.mean(axis=0)
    unit = unit_of(trace, names[0]).unit
    spread = float(np.sqrt(np.mean(values.var(axis=0, ddof=1))))
    first = float(np.sqrt(np.mean((values[0] - values[1:].mean(axis=0)) ** 2)))
    word = WORDS.get(trace.quantities.get(names[0], ""), "value")
    last = "the second" if len(names) == 2 else "the mean of the later ones"
    caption = (
        f"{len(names)} trials at {where}, the first in red. Below: each less the mean of all. Standard deviation "
        f"between repeats {spread:.2g} {unit}, over the whole time; the first is {first:.2g} {unit} rms off {last}."
    )
    alt = (
        f"{word.capitalize()} over time of {len(names)} repeats at {where}, which scatter by {spread:.2g} "
        f"{unit}; the first is {first:.2g} {unit} rms off {last}."
    )
    draw = bound(drawing_of, t, values, mean, unit_of(trace, "t").label("time"), word, unit)
    return picture(draw, "Repeats", caption, alt, numbers([("", trace)]), wide=False, simulated=simulated)


def drawing_of(t: Array, values: Array, mean: Array, x_label: str, word: str, unit: str) -> Figure:
    """Values (repeats, n) above, what they are off their mean (n,) below."""
    figure = blank(HALF, 2.9)
    cells = grid(figure, 1, 1, top=0.42, left=0.6)[0].subgridspec(2, 1, height_ratios=(1.6, 1), hspace=0.12)
    upper = figure.add_subplot(cells[0])
    lower = figure.add_subplot(cells[1], sharex=upper)
    others = [color for color in PALETTE if color != RED]
    lower.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
    for i in reversed(range(len(values))):
        color = RED if i == 0 else others[(i - 1) % len(others)] if len(values) < 4 else QUIET
        width = 1.0 if i == 0 else 0.8
        label = ("first" if i == 0 else "second" if len(values) == 2 else "later") if i < 2 else None
        upper.plot(t, values[i], color=color, linewidth=width, label=label)
        lower.plot(t, values[i] - mean, color=color, linewidth=0.8)
    upper.tick_params(labelbottom=False)
    upper.set_ylabel(f"{word} [{unit}]")
    lower.set_ylabel(f"off mean [{unit}]")
    lower.set_xlabel(x_label)
    few_ticks(upper)
    few_ticks(lower, y=3)
    figure.align_ylabels([upper, lower])
    width, height = figure.get_size_inches()
    handles, labels = upper.get_legend_handles_labels()
    figure.legend(
        handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(0.5 / width, 1 - 0.06 / height), ncols=2
    )
    return figure
