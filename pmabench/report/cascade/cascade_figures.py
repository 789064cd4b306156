"""Figures of a simulated chain in the style of reports: contraction, sum of F_ce, and the chain's force, kept apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pmabench.plotting import plots
from pmabench.plotting.plots import FAINT, FULL, HALF, INK, PALETTE, QUIET, RED, Array, blank, few_ticks, grid
from pmabench.plotting.svg import drawing, to_svg
from pmabench.report.cascade.cascade_record import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_NAMED = 6
"""Muscles that get a colour and a name of their own."""
POINTS = 900
LEFT, RIGHT, TOP, BOTTOM = 0.62, 0.12, 0.42, 0.38
"""Room around the curves over time [in]."""
HIGH = 3.6
"""Height of that figure [in]."""
PT = 72.0


@dataclass(frozen=True)
class Drawn:
    """One figure: name of its file, title, what it says, and the SVG element."""

    name: str
    title: str
    caption: str
    svg: str


def figures(result: Result) -> list[Drawn]:
    """All figures of a result."""
    return [
        _drawn(
            result, "displacement", "Contraction of the chain over time, with the pressures",
            "Contractions add: each band is one muscle's.", time_figure,
        ),
        _drawn(
            result, "pressure", "Contraction of the chain over the mean pressure",
            "Mean of the muscles' pressures; the way up and the way down.", pressure_figure,
        ),
        _drawn(
            result, "force-ce-sum", "Sum of F_ce over the contraction of the chain",
            "What paper 1 calls total F_ce: a sum of coefficients. No end of the chain feels it.", sum_figure,
        ),
        _drawn(
            result, "chain-force", "Force of the chain over its contraction",
            "What the chain pulls with if it is held where it is, and its F_ce: that of one muscle, however many there "
            "are. 0 where it is shorter than it would hold itself.", force_figure,
        ),
    ]  # fmt: skip


def _drawn(result: Result, name: str, title: str, caption: str, draw: Callable[[Result], Figure]) -> Drawn:
    with drawing():
        figure = draw(result)
        plots.stamp(figure, "SIMULATED")
        most = 1e3 * max(result.displacement)
        svg = to_svg(figure, f"Simulated. {title}, {len(result.muscles)} muscles, up to {most:.4g} mm. {caption}")
    return Drawn(name, title, caption, svg)


def _rows(result: Result) -> Array:
    """Samples that are drawn: even in time, and the one before and after each jump of a pressure."""
    count = len(result.time)
    even = np.linspace(0, count - 1, min(count, POINTS)).round().astype(int)
    pressures = np.array([link.pressure for link in result.muscles])
    jumps = np.flatnonzero((np.abs(np.diff(pressures, axis=1)) > 0.02 * max(pressures.max(), 1.0)).any(axis=0))
    return np.unique(np.concatenate((even, jumps[:POINTS], jumps[:POINTS] + 1)))


def colours(count: int) -> list[str]:
    """A colour for each muscle; shades of one where there are many."""
    if count <= MOST_NAMED:
        return list(PALETTE[:count])
    return [("#0b5fa5", "#6aa9dc")[i % 2] for i in range(count)]


def time_figure(result: Result) -> Figure:
    """Contraction over time as bands, one for each muscle, and the pressures below."""
    rows = _rows(result)
    t = np.array(result.time)[rows]
    named = len(result.muscles) <= MOST_NAMED
    figure = blank(FULL, HIGH)
    cells = grid(figure, 2, 1, left=LEFT, right=RIGHT, top=TOP, bottom=BOTTOM, down=0.16, height_ratios=(1.9, 1))
    upper, lower = figure.add_subplot(cells[0]), figure.add_subplot(cells[1])
    base = np.zeros(len(rows))
    for link, colour in zip(result.muscles, colours(len(result.muscles)), strict=True):
        top = base + 1e3 * np.array(link.displacement)[rows]
        upper.fill_between(t, base, top, color=colour, alpha=0.28, linewidth=0, label=link.name if named else None)
        upper.plot(t, top, color=colour, linewidth=0.8)
        lower.plot(t, 1e-3 * np.array(link.pressure)[rows], color=colour, linewidth=1.0, alpha=0.9)
        base = top
    upper.plot(t, base, color=INK, linewidth=1.3, label="chain")
    for axes in (upper, lower):
        axes.set_xlim(t[0], t[-1])
        few_ticks(axes, x=10, y=5)
    lower.set_ylim(bottom=0)
    upper.set_ylim(bottom=0)
    upper.tick_params(labelbottom=False)
    upper.set_ylabel("x [mm]")
    lower.set_ylabel("P [kPa]")
    lower.set_xlabel("time [s]")
    figure.align_ylabels([upper, lower])
    _legend(figure, named)
    return figure


def cursor_track() -> tuple[float, float, float, float]:
    """Where the curves over time begin and end in their SVG: left, right, upper, lower [px of its view box]."""
    return LEFT * PT, (FULL - RIGHT) * PT, TOP * PT, (HIGH - BOTTOM) * PT


def _legend(figure: Figure, wanted: bool) -> None:
    """Above the axes, where it covers nothing."""
    width, height = figure.get_size_inches()
    handles, labels = figure.axes[0].get_legend_handles_labels()
    if wanted or len(labels) > 1:
        figure.legend(
            handles,
            labels,
            loc="upper left",
            bbox_to_anchor=(0.5 / width, 1 - (0.08 if width > HALF else 0.2) / height),
            ncols=min(7 if width > HALF else 2, len(labels)),
        )


def pressure_figure(result: Result) -> Figure:
    """Contraction over the mean pressure."""
    rows = _rows(result)
    mean = 1e-3 * np.mean([link.pressure for link in result.muscles], axis=0)[rows]
    x = 1e3 * np.array(result.displacement)[rows]
    figure = blank(HALF, 2.7)
    axes = figure.add_subplot(grid(figure, 1, 1, left=0.56, top=0.42)[0])
    top = int(np.argmax(x))
    axes.plot(mean[: top + 1], x[: top + 1], color=PALETTE[0], linewidth=1.1, label="until it is shortest")
    axes.plot(mean[top:], x[top:], color=PALETTE[1], linewidth=1.1, label="after")
    axes.set_xlabel("mean pressure [kPa]")
    axes.set_ylabel("x [mm]")
    axes.set_ylim(bottom=0)
    few_ticks(axes)
    _legend(figure, True)
    return figure


def sum_figure(result: Result) -> Figure:
    """Sum of F_ce over contraction, dashed: it is no force."""
    rows = _rows(result)
    figure = blank(HALF, 2.7)
    axes = figure.add_subplot(grid(figure, 1, 1, left=0.62)[0])
    x, total = 1e3 * np.array(result.displacement)[rows], np.array(result.force_ce_sum)[rows]
    axes.plot(x, total, color=QUIET, linewidth=1.1, linestyle=(0, (5, 2)))
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("sum of coefficients F_ce [N]")
    axes.set_ylim(bottom=0)
    few_ticks(axes)
    return figure


def force_figure(result: Result) -> Figure:
    """Force of the chain over its contraction, with its F_ce and the load."""
    rows = _rows(result)
    figure = blank(HALF, 2.7)
    axes = figure.add_subplot(grid(figure, 1, 1, left=0.62, top=0.58)[0])
    x = 1e3 * np.array(result.displacement)[rows]
    axes.plot(x, np.array(result.force_ce)[rows], color=FAINT, linewidth=1.0, label="F_ce of the chain")
    axes.plot(x, np.array(result.force)[rows], color=RED, linewidth=1.2, label="force if it is held")
    if result.load > 0:
        axes.axhline(result.load, color=INK, linewidth=0.7, linestyle=(0, (4, 3)), label="load")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("F [N]")
    axes.set_ylim(bottom=0)
    few_ticks(axes)
    _legend(figure, True)
    return figure
