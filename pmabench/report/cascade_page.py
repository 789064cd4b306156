"""The page of a simulated chain: its figures, and a drawing that moves, with a slider; one self-contained HTML file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from pmabench import __version__
from pmabench.base.quantities import show
from pmabench.plotting.chart import PAGE, Array, Chart, Level, Series, inside, joined, small_multiples, stamped
from pmabench.plotting.looks import BLUE, BROWN, FAINT, INK, PALETTE, QUIET
from pmabench.plotting.svg import as_file
from pmabench.report.cascade_drawing import (
    FITTING,
    FONT,
    LEFT,
    WIDTH,
    Scene,
    chain,
    moments_of,
    opacity,
    pressure_words,
    snapshots,
)
from pmabench.report.cascade_record import Result
from pmabench.report.writing import render, write_file

FRAME = 1 / 30
"""Time between frames [s], longer where there would be too many."""
MOST_FRAMES, MOST_SHAPES = 1800, 30_000


def write_drawings(result: Result, folder: Path, moments: Sequence[float] = ()) -> list[Path]:
    """Write the page `cascade.html`, the still `snapshots.svg` and each figure as SVG. Raises RecordError."""
    drawn = figures(result)
    chosen = moments or moments_of(result)
    files = {"cascade.html": page(result, drawn, chosen), "snapshots.svg": snapshots(result, chosen)}
    for figure in drawn:
        files[f"{figure.name}.svg"] = as_file(figure.svg, FONT)
    return [write_file(folder / name, text, "the drawing") for name, text in files.items()]


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
        "data": json.dumps(frames(result, scene, rows, first), allow_nan=False, separators=(",", ":")),
    }
    return render("cascade.html.j2", context)


def frame_rows(result: Result) -> list[int]:
    """Samples that are frames, evenly spaced in time, first and last among them."""
    t = np.array(result.time)
    most = max(2, min(MOST_FRAMES, MOST_SHAPES // len(result.muscles)))
    count = int(min(max((t[-1] - t[0]) / FRAME + 1, 2), most))
    rows = np.searchsorted(t, np.linspace(t[0], t[-1], count) - 0.5 * float(np.median(np.diff(t))))
    return [int(row) for row in np.unique(np.clip(rows, 0, len(t) - 1))]


def frames(result: Result, scene: Scene, rows: Sequence[int], curves: Drawn) -> dict[str, Any]:
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
        "track": [round(value, 2) for value in curves.track()],
    }


MOST_NAMED = 6
"""Muscles that get a colour and a name of their own."""
POINTS, JUMPS = 300, 200
UPPER, LOWER, HALF = 150.0, 95.0, 185.0
"""Heights of the charts over time, and of those of half width [pt]."""


@dataclass(frozen=True)
class Drawn:
    """One figure: name of its file, title, what it says, and its charts."""

    name: str
    title: str
    caption: str
    alt: str
    rows: Sequence[Sequence[Chart]]

    @cached_property
    def svg(self) -> str:
        """The drawing, as an SVG element."""
        return joined(self.rows, self.alt)

    def track(self) -> tuple[float, float, float, float]:
        """Left, right, upper and lower end of all its axes, one above the other [px of the view box]."""
        height = float(self.svg.split('viewBox="')[1].split('"')[0].split()[3])
        left, right, top, _ = inside(self.rows[0][0])
        _, _, _, bottom = inside(self.rows[-1][0])
        return left, right, height - sum(row[0].height for row in self.rows) + top, height - LOWER + bottom


def figures(result: Result) -> list[Drawn]:
    """All figures of a result."""
    drawn = (
        (
            "displacement", "Contraction of the chain over time, with the pressures",
            "Contractions add: each band is one muscle's.", over_time(result),
        ),
        (
            "pressure", "Contraction of the chain over the mean pressure",
            "Mean of the muscles' pressures; the way up and the way down.", over_pressure(result),
        ),
        (
            "force-ce-sum", "Sum of F_ce over the contraction of the chain",
            "What paper 1 calls total F_ce: a sum of coefficients. No end of the chain feels it.", force_sum(result),
        ),
        (
            "chain-force", "Force of the chain over its contraction",
            "What the chain pulls with if it is held where it is, and its F_ce: that of one muscle, however many there "
            "are. 0 where it is shorter than it would hold itself.", force(result),
        ),
    )  # fmt: skip
    most = f"{len(result.muscles)} muscles, up to {1e3 * max(result.displacement):.4g} mm"
    return [Drawn(name, title, words, f"{title}, {most}. {words}", stamped(rows)) for name, title, words, rows in drawn]


def _rows(result: Result) -> Array:
    """Samples that are drawn: even in time, and the one before and after each jump of a pressure."""
    count = len(result.time)
    even = np.linspace(0, count - 1, min(count, POINTS)).round().astype(int)
    pressures = np.array([link.pressure for link in result.muscles])
    jumps = np.flatnonzero((np.abs(np.diff(pressures, axis=1)) > 0.02 * max(pressures.max(), 1.0)).any(axis=0))
    return np.unique(np.concatenate((even, jumps[:JUMPS], jumps[:JUMPS] + 1)))


def colours(count: int) -> list[str]:
    """A colour for each muscle; shades of one where there are many."""
    if count <= MOST_NAMED:
        return list(PALETTE[:count])
    return [("#0b5fa5", "#6aa9dc")[i % 2] for i in range(count)]


def over_time(result: Result) -> list[list[Chart]]:
    """Contraction over time as bands, one for each muscle, and the pressures below."""
    rows = _rows(result)
    t = np.array(result.time)[rows]
    base = np.zeros(len(rows))
    bands, tops, pressures = [], [], []
    for link, colour in zip(result.muscles, colours(len(result.muscles)), strict=True):
        top = base + 1e3 * np.array(link.displacement)[rows]
        name = link.name if len(result.muscles) <= MOST_NAMED else ""
        bands.append(Series("", t, (base + top) / 2, colour, half=(top - base) / 2, width=0.0))
        tops.append(Series(name, t, top, colour, width=0.8))
        pressures.append(Series("", t, 1e-3 * np.array(link.pressure)[rows], colour, width=1.0))
        base = top
    tops.append(Series("chain", t, base, INK))
    upper = _chart("time [s]", "x [mm]", (*bands, *tops), UPPER)
    return small_multiples([(upper, _chart("time [s]", "P [kPa]", pressures, LOWER))], 1, width=PAGE)


def _chart(x_label: str, y_label: str, series: Sequence[Series], height: float = HALF, **more: Any) -> Chart:
    """A chart that begins at 0 upwards."""
    return Chart(x_label, y_label, tuple(series), height=height, zero=True, legend=True, **more)


def over_pressure(result: Result) -> list[list[Chart]]:
    """Contraction over the mean pressure."""
    rows = _rows(result)
    mean = 1e-3 * np.mean([link.pressure for link in result.muscles], axis=0)[rows]
    x = 1e3 * np.array(result.displacement)[rows]
    top = int(np.argmax(x))
    up = Series("until it is shortest", mean[: top + 1], x[: top + 1], BLUE)
    return [[_chart("mean pressure [kPa]", "x [mm]", (up, Series("after", mean[top:], x[top:], BROWN)))]]


def force_sum(result: Result) -> list[list[Chart]]:
    """Sum of F_ce over contraction, dashed: it is no force."""
    rows = _rows(result)
    x, total = 1e3 * np.array(result.displacement)[rows], np.array(result.force_ce_sum)[rows]
    return [[_chart("x [mm]", "sum of coefficients F_ce [N]", (Series("", x, total, QUIET, dashed=True),))]]


def force(result: Result) -> list[list[Chart]]:
    """Force of the chain over its contraction, with its F_ce and the load."""
    rows = _rows(result)
    x = 1e3 * np.array(result.displacement)[rows]
    lines = (
        Series("F_ce of the chain", x, np.array(result.force_ce)[rows], FAINT),
        Series("force if it is held", x, np.array(result.force)[rows], BROWN),
    )
    load = (Level(result.load, "load", INK),) if result.load > 0 else ()
    return [[_chart("x [mm]", "F [N]", lines, levels=load)]]
