"""A chain of muscles drawn to scale as SVG, and its page: figures, and a drawing that moves, with a slider.

Every number of the geometry is made here; the animation only puts them in. One self-contained HTML file.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from itertools import cycle
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from pmabench import __version__
from pmabench.base.quantities import show
from pmabench.model.muscle import Outline, outline
from pmabench.plotting.chart import (
    BLUE,
    BROWN,
    FAINT,
    INK,
    PAGE,
    PALETTE,
    QUIET,
    Array,
    Chart,
    Level,
    Series,
    inside,
    small_multiples,
    stamped,
)
from pmabench.plotting.drawing import joined
from pmabench.plotting.svg import as_file
from pmabench.report.cascade_record import Link, Result
from pmabench.report.writing import render, write_file

WIDTH = 1000.0
LEFT, RIGHT = 84.0, 112.0
"""Room next to the chain: moment and wall; load and contraction [px]."""
FITTING = 0.085
"""Length of a fitting in nominal lengths of its muscle."""
THICKEST = 58.0
"""Largest half width of a muscle in the drawing [px]."""
SNAPSHOTS = 8
FONT = "'Inter','Segoe UI','Helvetica Neue',Arial,'DejaVu Sans','Liberation Sans',sans-serif"


def px(value: float) -> str:
    """Text of a coordinate with two decimals."""
    return f"{round(value, 2) + 0.0:g}" if abs(value) < 1e4 else f"{value:.0f}"


@dataclass(frozen=True)
class Shape:
    """One muscle in pixels: its position, its length and the sizes of its outline; `tint` 0..1 shows its pressure."""

    begin: float
    length: float
    fitting: float
    radius: float
    meet: float
    body: float
    tint: float

    @property
    def path(self) -> str:
        """The closed outline from (0, 0), both ends with the tangent of the body where they join it."""
        L, f, r, m, b = (px(v) for v in (self.length, self.fitting, self.radius, self.meet, self.body))
        lm, lb = px(self.length - self.meet), px(self.length - self.body)
        return (
            f"M0 -{f}Q{m} -{r} {b} -{r}L{lb} -{r}Q{lm} -{r} {L} -{f}L{L} {f}Q{lm} {r} {lb} {r}L{b} {r}Q{m} {r} 0 {f}Z"
        )


class Scene:
    """The scale of a chain's drawing and its shapes at any row of the result."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self.x = np.array([link.displacement for link in result.muscles])
        whole = sum(link.length * (1 + 2 * FITTING) for link in result.muscles)
        widest = max(self._outline(link, float(self.x[i].max())).radius for i, link in enumerate(result.muscles))
        self.scale = min((WIDTH - LEFT - RIGHT) / whole, THICKEST / widest)
        """Pixels per metre."""
        self.half = max(widest, max(link.radius for link in result.muscles)) * self.scale
        """Largest half width of all muscles at all times [px]."""
        self.low = max(self.half, 16.0) + 5
        """How far below the axis the contraction is shown [px]."""
        self.end = LEFT + whole * self.scale
        """Where the free end rests without contraction [px]."""
        self.highest = max((max(link.pressure) for link in result.muscles), default=0.0)

    @staticmethod
    def _outline(link: Link, x: float) -> Outline:
        return outline(link.length, x / link.length, link.radius, link.braid_angle)

    def shapes(self, row: int) -> list[Shape]:
        """Every muscle at a row of the result, from the fixed end on."""
        found, place = [], LEFT
        for i, link in enumerate(self.result.muscles):
            line, s = self._outline(link, float(self.x[i, row])), self.scale
            fitting = FITTING * link.length * s
            tint = link.pressure[row] / self.highest if self.highest else 0.0
            sizes = {name: getattr(line, name) * s for name in ("length", "fitting", "radius", "meet", "body")}
            found.append(Shape(begin=place + fitting, **sizes, tint=tint))
            place += 2 * fitting + line.length * s
        return found


def chain(scene: Scene, row: int, *, names: bool = False, live: bool = False) -> str:
    """The chain at a row, its axis at y = 0; `live`: its parts carry classes that an animation looks for."""
    shapes = scene.shapes(row)
    muscles = (
        _muscle(link, shape, scene, names=names) for link, shape in zip(scene.result.muscles, shapes, strict=True)
    )
    tip = shapes[-1].begin + shapes[-1].length + FITTING * scene.result.muscles[-1].length * scene.scale
    h = px(scene.half + 8)
    wall = f'<path d="M{px(LEFT)} -{h}V{h}" stroke="{INK}" stroke-width="3"/>'
    return "".join((wall, *muscles, _tip(scene, tip, row, live=live)))


def _muscle(link: Link, shape: Shape, scene: Scene, *, names: bool) -> str:
    name, out = "", px(FITTING * link.length * scene.scale)
    line = f'stroke="{QUIET}" stroke-width="{px(1.2 * shape.fitting)}"'
    if names and link.length * scene.scale > 70:
        name = (
            f'<text class="name" x="{px(shape.length / 2)}" y="{px(-scene.half - 9)}" text-anchor="middle" '
            f'font-size="12" fill="{QUIET}">{escape(link.name)}</text>'
        )
    return (
        f'<g class="muscle" transform="translate({px(shape.begin)} 0)"><path d="M-{out} 0H0" {line}/>'
        f'<path class="outline" d="{shape.path}" fill="{BLUE}" fill-opacity="{opacity(shape.tint):.3f}" '
        f'stroke="{INK}"/>'
        f'<g class="far" transform="translate({px(shape.length)} 0)"><path d="M0 0H{out}" {line}/></g>{name}</g>'
    )


def opacity(tint: float) -> float:
    """How strongly a pressure colours the muscle: lower ones more than their share, so that they are seen."""
    return 0.08 + 0.85 * float(min(max(tint, 0.0), 1.0) ** 0.6)


def _tip(scene: Scene, tip: float, row: int, *, live: bool) -> str:
    """The free end: an eye or the arrow of the load, its position without contraction, and how far it has moved."""
    load, x = scene.result.load, scene.result.displacement[row]
    mark = (
        f'<path d="M4 0H30M23 -5L31 0L23 5" fill="none" stroke="{INK}" stroke-width="2" stroke-linejoin="round"/>'
        f'<text x="6" y="-9" font-size="12" fill="{INK}">{load:.4g} N</text>'
        if load > 0
        else f'<circle cx="5" r="4" fill="#fff" stroke="{INK}" stroke-width="2"/>'
    )
    low = scene.low

    def own(name: str) -> str:
        return f' class="{name}"' if live else ""

    return (
        f'<g{own("tip")} transform="translate({px(tip)} 0)">{mark}'
        f'<path d="M0 {px(0.5 * low)}V{px(low + 5)}" stroke="{BROWN}" stroke-width="1"/></g>'
        f'<path d="M{px(scene.end)} {px(-low)}V{px(low + 5)}" stroke="{FAINT}" stroke-dasharray="4 3"/>'
        f'<path{own("come")} d="{come(tip, scene.end, low)}" fill="none" stroke="{BROWN}" stroke-width="1.4"/>'
        f'<text{own("amount")} x="{px(scene.end + 8)}" y="{px(low + 4)}" font-size="13" '
        f'font-weight="600" fill="{BROWN}">{1e3 * x:.1f} mm</text>'
    )


def come(tip: float, end: float, y: float) -> str:
    """The path of the arrow from the free end's position without contraction to its position now."""
    head = min(6.0, max(end - tip, 0.0))
    barb = px(tip + head)
    return f"M{px(end)} {px(y)}H{px(tip)}M{barb} {px(y - 0.6 * head)}L{px(tip)} {px(y)}L{barb} {px(y + 0.6 * head)}"


def moments_of(result: Result) -> list[float]:
    """Times [s] for snapshots, chosen so that about the same motion lies between each and the next."""
    t = np.array(result.time)
    moved = np.abs(np.diff(np.array([link.displacement for link in result.muscles]), axis=1)).sum(axis=0)
    gone = np.concatenate(([0.0], np.cumsum(moved / (moved.sum() or 1.0) + 0.25 * np.diff(t) / (t[-1] - t[0]))))
    rows = np.searchsorted(gone, np.linspace(0, gone[-1], SNAPSHOTS) * (1 - 1e-12))
    return [float(t[row]) for row in np.unique(np.minimum(rows, len(t) - 1))]


def row_at(result: Result, moment: float) -> int:
    """The sample that is nearest to a moment [s]."""
    return int(np.argmin(np.abs(np.array(result.time) - moment)))


def snapshots(result: Result, moments: Sequence[float], *, head: bool = True) -> str:
    """The chain at several moments below each other; one complete `<svg>`."""
    scene = Scene(result)
    step, top = 2 * scene.low + 24, 82.0 if head else 18.0
    height = top + step * len(moments) + 12
    parts = [_head(result, scene)] if head else []
    for place, moment in enumerate(moments):
        row = row_at(result, moment)
        y = top + step * (place + 0.5)
        parts.append(
            f'<g transform="translate(0 {px(y)})">'
            f'<text x="{px(LEFT - 18)}" y="4" text-anchor="end" font-size="13" font-weight="600" fill="{INK}">'
            f"{result.time[row]:.2f} s</text>{chain(scene, row, names=place == 0)}</g>"
        )
    alt = f"Simulated. {result.name}: the chain at {len(moments)} moments, from {moments[0]:g} s on."
    return standalone("".join(parts), WIDTH, height, alt)


def _head(result: Result, scene: Scene) -> str:
    about = result.source[:150]
    return (
        f'<text x="24" y="28" font-size="17" font-weight="650" fill="{INK}">{escape(result.name)}</text>'
        f'<text x="24" y="48" font-size="12" fill="{QUIET}">{escape(about)}</text>'
        f'<text x="{px(WIDTH - 24)}" y="26" text-anchor="end" font-size="11" font-weight="700" fill="{BROWN}">'
        "SIMULATED</text>"
        f'<text x="{px(WIDTH - 24)}" y="48" text-anchor="end" font-size="12" fill="{QUIET}">'
        f"{pressure_words(scene)}</text>"
    )


def pressure_words(scene: Scene) -> str:
    """What the colour of a muscle says."""
    return f"the darker, the more pressure: 0 to {scene.highest / 1e3:.0f} kPa"


def standalone(body: str, width: float, height: float, alt: str) -> str:
    """A complete SVG file with a white background, a font and a description."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {px(width)} {px(height)}" width="{px(width)}" '
        f'height="{px(height)}" role="img" aria-labelledby="alt" font-family="{FONT}">'
        f'<desc id="alt">{escape(alt)}</desc><rect width="100%" height="100%" fill="#fff"/>{body}</svg>\n'
    )


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
        gap = round(FITTING * link.length * scene.scale, 3)
        muscles.append(numbers | {"fitting": round(mine[0].fitting, 3), "gap": gap})
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
SHADES = ("#0b5fa5", "#6aa9dc")
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
    rows = _rows(result)
    names = ("displacement", "force", "force_ce", "force_ce_sum")
    x, force, F_ce, total = (np.array(getattr(result, name))[rows] for name in names)
    x = 1e3 * x
    mean = 1e-3 * np.mean([link.pressure for link in result.muscles], axis=0)[rows]
    top = int(np.argmax(x))
    up = Series("until it is shortest", mean[: top + 1], x[: top + 1], BLUE)
    held = Series("F_ce of the chain", x, F_ce, FAINT), Series("force if it is held", x, force, BROWN)
    load = (Level(result.load, "load", INK),) if result.load > 0 else ()
    drawn = (
        (
            "displacement", "Contraction of the chain over time, with the pressures",
            "Contractions add: each band is one muscle's.", _over_time(result, rows),
        ),
        (
            "pressure", "Contraction of the chain over the mean pressure",
            "Mean of the muscles' pressures; the way up and the way down.",
            [[_chart("mean pressure [kPa]", "x [mm]", (up, Series("after", mean[top:], x[top:], BROWN)))]],
        ),
        (
            "force-ce-sum", "Sum of F_ce over the contraction of the chain",
            "What paper 1 calls total F_ce: a sum of coefficients. No end of the chain feels it.",
            [[_chart("x [mm]", "sum of coefficients F_ce [N]", (Series("", x, total, QUIET, dashed=True),))]],
        ),
        (
            "chain-force", "Force of the chain over its contraction",
            "What the chain pulls with if it is held where it is, and its F_ce: that of one muscle, however many there "
            "are. 0 where it is shorter than it would hold itself.", [[_chart("x [mm]", "F [N]", held, levels=load)]],
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


def _over_time(result: Result, rows: Array) -> list[list[Chart]]:
    """Contraction over time as bands, one for each muscle, and the pressures below; many muscles in two shades."""
    t = np.array(result.time)[rows]
    base = np.zeros(len(rows))
    many = len(result.muscles) > MOST_NAMED
    bands, tops, pressures = [], [], []
    for link, colour in zip(result.muscles, cycle(SHADES if many else PALETTE), strict=False):
        top = base + 1e3 * np.array(link.displacement)[rows]
        bands.append(Series("", t, (base + top) / 2, colour, half=(top - base) / 2, width=0.0))
        tops.append(Series("" if many else link.name, t, top, colour, width=0.8))
        pressures.append(Series("", t, 1e-3 * np.array(link.pressure)[rows], colour, width=1.0))
        base = top
    tops.append(Series("chain", t, base, INK))
    upper = _chart("time [s]", "x [mm]", (*bands, *tops), UPPER)
    return small_multiples([(upper, _chart("time [s]", "P [kPa]", pressures, LOWER))], 1, width=PAGE)


def _chart(x_label: str, y_label: str, series: Sequence[Series], height: float = HALF, **more: Any) -> Chart:
    """A chart that begins at 0 upwards."""
    return Chart(x_label, y_label, tuple(series), height=height, zero=True, legend=True, **more)
