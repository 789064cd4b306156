"""The page of a simulated chain: its figures, and a drawing that moves, with a slider; one self-contained HTML file."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pmabench import __version__
from pmabench.base.quantities import show
from pmabench.plotting import plots
from pmabench.plotting.plots import BROWN, FAINT, FULL, HALF, INK, PALETTE, QUIET, Array, blank, few_ticks, grid
from pmabench.plotting.svg import drawing, to_svg
from pmabench.report.cascade_drawing import (
    FITTING,
    LEFT,
    WIDTH,
    Scene,
    chain,
    moments_of,
    opacity,
    pressure_words,
    snapshots,
    standalone,
)
from pmabench.report.cascade_record import Result
from pmabench.report.writing import render, write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FRAME = 1 / 30
"""Time between frames [s], longer where there would be too many."""
MOST_FRAMES, MOST_SHAPES = 1800, 30_000


def write_drawings(result: Result, folder: Path, moments: Sequence[float] = ()) -> list[Path]:
    """Write the page `cascade.html`, the still `snapshots.svg` and each figure as SVG. Raises RecordError."""
    drawn = figures(result)
    chosen = moments or moments_of(result)
    files = {"cascade.html": page(result, drawn, chosen), "snapshots.svg": snapshots(result, chosen)}
    for figure in drawn:
        files[f"{figure.name}.svg"] = _file(figure)
    return [write_file(folder / name, text, "the drawing") for name, text in files.items()]


def _file(figure: Drawn) -> str:
    """The figure's element as a separate file, twice the size."""
    left, top, width, height = (float(part) for part in figure.svg.split('viewBox="')[1].split('"')[0].split())
    inner = figure.svg.replace("<svg ", f'<svg x="{left}" y="{top}" width="{width}" height="{height}" ', 1)
    return standalone(inner, width, height, figure.title).replace(
        f'width="{width:g}" height="{height:g}" role', f'width="{2 * width:g}" height="{2 * height:g}" role', 1
    )


def page(result: Result, drawn: Sequence[Drawn], moments: Sequence[float]) -> str:
    """The page as text; every name is escaped."""
    scene = Scene(result)
    rows = frame_rows(result)
    height = 2 * scene.low + 84
    first, *others = drawn
    context = {
        "version": __version__,
        "name": result.name,
        "source": result.source,
        "width": WIDTH,
        "height": round(height, 1),
        "axis": round(scene.low + 57, 1),
        "key": pressure_words(scene),
        "chain": chain(scene, 0, names=True, live=True),
        "frames": len(rows) - 1,
        "first": {
            "t": f"{result.time[0]:.2f} s",
            "x": f"{1e3 * result.displacement[0]:.1f} mm",
            "f": f"{result.force[0]:.0f} N",
            "s": f"{result.force_ce_sum[0]:.0f} N",
        },
        "over_time": first.svg,
        "still": snapshots(result, moments, head=False),
        "figures": others,
        "muscles": [
            {
                "name": link.name,
                "law": link.law,
                "length": show(link.length, "length"),
                "pressure": show(max(link.pressure), "pressure", 4),
                "most": f"{show(max(link.displacement), 'length', 4)}, "
                f"{100 * max(link.displacement) / link.length:.1f} %",
                "shape": f"radius {show(link.radius, 'length')}, braid {degrees(link.braid_angle):.1f} deg",
            }
            for link in result.muscles
        ],
        "load": show(result.load, "force"),
        "fce_eval": result.fce_eval,
        "data": json.dumps(frames(result, scene, rows), allow_nan=False, separators=(",", ":")),
    }
    return render("cascade.html.j2", context)


def frame_rows(result: Result) -> list[int]:
    """Samples that are frames, evenly spaced in time, first and last among them."""
    t = np.array(result.time)
    most = max(2, min(MOST_FRAMES, MOST_SHAPES // len(result.muscles)))
    count = int(min(max((t[-1] - t[0]) / FRAME + 1, 2), most))
    rows = np.searchsorted(t, np.linspace(t[0], t[-1], count) - 0.5 * float(np.median(np.diff(t))))
    return [int(row) for row in np.unique(np.clip(rows, 0, len(t) - 1))]


def frames(result: Result, scene: Scene, rows: Sequence[int]) -> dict[str, Any]:
    """All numbers of the animation, in pixels of its drawing, and in s, mm and N; numbers only, no texts."""
    shapes = [scene.shapes(row) for row in rows]
    muscles = []
    for i, link in enumerate(result.muscles):
        mine = [shape[i] for shape in shapes]
        numbers: dict[str, Any] = {
            name: [round(getattr(shape, name), 2) for shape in mine]
            for name in ("begin", "length", "radius", "meet", "body")
        }
        numbers["tint"] = [round(opacity(shape.tint), 3) for shape in mine]
        numbers |= {
            "fitting": round(mine[0].fitting, 3),
            "gap": round(FITTING * link.length * scene.scale, 3),
        }
        muscles.append(numbers)
    return {
        "muscles": muscles,
        "t": [round(result.time[row], 6) for row in rows],
        "x": [round(1e3 * result.displacement[row], 3) for row in rows],
        "f": [round(result.force[row], 2) for row in rows],
        "s": [round(result.force_ce_sum[row], 2) for row in rows],
        "end": round(scene.end, 2),
        "low": round(scene.low, 2),
        "left": LEFT,
        "track": [round(value, 2) for value in cursor_track()],
    }


MOST_NAMED = 6
"""Muscles that get a colour and a name of their own."""
POINTS = 900
ROOM_LEFT, ROOM_RIGHT, ROOM_TOP, ROOM_BOTTOM = 0.62, 0.12, 0.42, 0.38
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
    room = {"left": ROOM_LEFT, "right": ROOM_RIGHT, "top": ROOM_TOP, "bottom": ROOM_BOTTOM}
    cells = grid(figure, 2, 1, **room, down=0.16, height_ratios=(1.9, 1))
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
        axes.set_ylim(bottom=0)
    upper.tick_params(labelbottom=False)
    upper.set_ylabel("x [mm]")
    lower.set(ylabel="P [kPa]", xlabel="time [s]")
    figure.align_ylabels([upper, lower])
    _legend(figure, named)
    return figure


def cursor_track() -> tuple[float, float, float, float]:
    """Left, right, upper and lower end of the curves over time in their SVG [px of its view box]."""
    return ROOM_LEFT * PT, (FULL - ROOM_RIGHT) * PT, ROOM_TOP * PT, (HIGH - ROOM_BOTTOM) * PT


def _legend(figure: Figure, wanted: bool) -> None:
    """Put the legend above the axes, where it covers nothing."""
    count, wide = len(figure.axes[0].get_legend_handles_labels()[1]), figure.get_size_inches()[0] > HALF
    if wanted or count > 1:
        plots.legend_above(figure, min(7 if wide else 2, count), at=(0.5, 0.08 if wide else 0.2))


def _half(x_label: str, y_label: str, *, left: float = 0.62, top: float = 0.28) -> tuple[Figure, Axes]:
    """A figure of half width with one pair of axes, which begin at 0 upwards."""
    figure, axes = plots.one_axes(HALF, 2.7, left=left, top=top)
    axes.set(xlabel=x_label, ylabel=y_label)
    return figure, axes


def pressure_figure(result: Result) -> Figure:
    """Contraction over the mean pressure."""
    rows = _rows(result)
    mean = 1e-3 * np.mean([link.pressure for link in result.muscles], axis=0)[rows]
    x = 1e3 * np.array(result.displacement)[rows]
    figure, axes = _half("mean pressure [kPa]", "x [mm]", left=0.56, top=0.42)
    top = int(np.argmax(x))
    axes.plot(mean[: top + 1], x[: top + 1], color=PALETTE[0], linewidth=1.1, label="until it is shortest")
    axes.plot(mean[top:], x[top:], color=PALETTE[1], linewidth=1.1, label="after")
    return _finished(figure, axes, legend=True)


def sum_figure(result: Result) -> Figure:
    """Sum of F_ce over contraction, dashed: it is no force."""
    rows = _rows(result)
    figure, axes = _half("x [mm]", "sum of coefficients F_ce [N]")
    x, total = 1e3 * np.array(result.displacement)[rows], np.array(result.force_ce_sum)[rows]
    axes.plot(x, total, color=QUIET, linewidth=1.1, linestyle=(0, (5, 2)))
    return _finished(figure, axes, legend=False)


def force_figure(result: Result) -> Figure:
    """Force of the chain over its contraction, with its F_ce and the load."""
    rows = _rows(result)
    figure, axes = _half("x [mm]", "F [N]", top=0.58)
    x = 1e3 * np.array(result.displacement)[rows]
    axes.plot(x, np.array(result.force_ce)[rows], color=FAINT, linewidth=1.0, label="F_ce of the chain")
    axes.plot(x, np.array(result.force)[rows], color=BROWN, linewidth=1.2, label="force if it is held")
    if result.load > 0:
        axes.axhline(result.load, color=INK, linewidth=0.7, linestyle=(0, (4, 3)), label="load")
    return _finished(figure, axes, legend=True)


def _finished(figure: Figure, axes: Axes, *, legend: bool) -> Figure:
    axes.set_ylim(bottom=0)
    few_ticks(axes)
    if legend:
        _legend(figure, True)
    return figure
