"""A chain of muscles drawn to scale as SVG: outlines with Bezier ends, fittings, braid, load; snapshots as a still.

Knows the result of a simulation, not how it came about. Every number of the geometry is made here; an animation only
puts them in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from pmabench.model.muscle import Outline, outline
from pmabench.plotting.plots import BROWN, FAINT, INK, QUIET, WARN
from pmabench.report.cascade_record import Link, Result

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


def definitions(scene: Scene) -> str:
    """Gradients, and for each muscle a braid that is drawn with its angle."""
    patterns = "".join(_braid(i, link, scene.scale) for i, link in enumerate(scene.result.muscles))
    return (
        "<defs>"
        + _gradient("rubber", ("#39414a", "#8d97a3", "#59626d", "#262b31"))
        + _gradient("tint", ("#084a85", "#69b8f2", "#1f7ac4", "#06325a"))
        + _gradient("steel", ("#98a2ad", "#f4f6f8", "#b4bdc7", "#6f7a86"))
        + '<pattern id="hatch" width="7" height="7" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
        f'<path d="M0 0V7" stroke="{FAINT}" stroke-width="1.6"/></pattern>' + patterns + "</defs>"
    )


def _gradient(name: str, colours: Sequence[str]) -> str:
    places = zip((0, 0.3, 0.62, 1), colours, strict=True)
    stops = "".join(f'<stop offset="{at}" stop-color="{colour}"/>' for at, colour in places)
    return f'<linearGradient id="{name}" x1="0" y1="0" x2="0" y2="1">{stops}</linearGradient>'


def _braid(number: int, link: Link, scale: float) -> str:
    """A pattern of crossing strands at the angle of the braid without contraction, stretched later with the muscle."""
    high = max(2 * link.radius * scale / 6, 4.0)
    wide = high / math.tan(link.braid_angle)
    return (
        f'<pattern id="braid{number}" width="{px(wide)}" height="{px(high)}" patternUnits="userSpaceOnUse">'
        f'<path d="M0 0L{px(wide)} {px(high)}M0 {px(high)}L{px(wide)} 0" stroke="#fff" stroke-opacity=".2" '
        'stroke-width=".8"/></pattern>'
    )


def chain(scene: Scene, row: int, tag: str = "", *, names: bool = False) -> str:
    """The chain at a row, its axis at y = 0.

    `tag` keeps its patterns apart from those of other chains in the same drawing; without one its parts carry classes
    that an animation looks for.
    """
    shapes = scene.shapes(row)
    muscles = (_muscle(i, shape, scene, tag, names=names) for i, shape in enumerate(shapes))
    tip = shapes[-1].begin + shapes[-1].length + FITTING * scene.result.muscles[-1].length * scene.scale
    return "".join((_wall(scene.half), *muscles, _tip(scene, tip, row, live=not tag)))


def _wall(half: float) -> str:
    h = px(half + 8)
    return (
        f'<path d="M{px(LEFT)} -{h}V{h}" stroke="{INK}" stroke-width="2"/>'
        f'<rect x="{px(LEFT - 9)}" y="-{h}" width="8" height="{px(2 * half + 16)}" fill="url(#hatch)"/>'
    )


def _muscle(i: int, shape: Shape, scene: Scene, tag: str, *, names: bool) -> str:
    link = scene.result.muscles[i]
    fitting = FITTING * link.length * scene.scale
    d = shape.path
    own = "" if tag else ' class="muscle"'
    wide, high = shape.length / (link.length * scene.scale), shape.radius / (link.radius * scene.scale)
    strands = f'<path class="strands" d="{d}" fill="url(#braid{i})"/>'
    if tag:  # a pattern for this muscle alone, stretched to this length and width
        local = f"braid{i}-{tag}"
        strands = f'<pattern id="{local}" href="#braid{i}" patternTransform="scale({wide:.4f} {high:.4f})"/>'
        strands += f'<path d="{d}" fill="url(#{local})"/>'
    name = ""
    if names and link.length * scene.scale > 70:
        name = (
            f'<text class="name" x="{px(shape.length / 2)}" y="{px(-scene.half - 9)}" text-anchor="middle" '
            f'font-size="12" fill="{QUIET}">{escape(link.name)}</text>'
        )
    return (
        f'<g{own} transform="translate({px(shape.begin)} 0)">'
        f'<path class="outline" d="{d}" fill="url(#rubber)" stroke="#1b1f24" stroke-opacity=".55" stroke-width=".8"/>'
        f'<path class="tint" d="{d}" fill="url(#tint)" opacity="{opacity(shape.tint):.3f}"/>{strands}'
        f"{_fitting(fitting, shape.fitting, -1)}"
        f'<g class="far" transform="translate({px(shape.length)} 0)">{_fitting(fitting, shape.fitting, 1)}</g>'
        f"{name}</g>"
    )


def opacity(tint: float) -> float:
    """How strongly a pressure colours the muscle: lower ones more than their share, so that they are seen."""
    return float(min(max(tint, 0.0), 1.0) ** 0.6)


def _fitting(length: float, radius: float, way: int) -> str:
    """Sleeve over the end of the hose and a stud; `way` -1 at the left end, 1 at the right, from x = 0 outwards."""
    sleeve, over = 0.62 * length, 1.07 * radius
    left = -sleeve if way < 0 else -0.08 * length
    wide = sleeve * 1.0 + 0.08 * length
    stud = (-length, length - sleeve) if way < 0 else (sleeve, length - sleeve)
    return (
        f'<rect x="{px(stud[0])}" y="{px(-0.42 * radius)}" width="{px(stud[1])}" height="{px(0.84 * radius)}" '
        'fill="url(#steel)" stroke="#5b6570" stroke-width=".5"/>'
        f'<rect x="{px(left)}" y="{px(-over)}" width="{px(wide)}" height="{px(2 * over)}" rx="{px(0.1 * length)}" '
        'fill="url(#steel)" stroke="#5b6570" stroke-width=".6"/>'
    )


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
    """The chain at several moments below each other, with a scale; one complete `<svg>`."""
    scene = Scene(result)
    step, top = 2 * scene.low + 24, 82.0 if head else 18.0
    height = top + step * len(moments) + 44
    parts = [_head(result, scene)] if head else []
    for place, moment in enumerate(moments):
        row = row_at(result, moment)
        y = top + step * (place + 0.5)
        parts.append(
            f'<g transform="translate(0 {px(y)})">'
            f'<text x="{px(LEFT - 18)}" y="4" text-anchor="end" font-size="13" font-weight="600" fill="{INK}">'
            f"{result.time[row]:.2f} s</text>{chain(scene, row, str(place), names=place == 0)}</g>"
        )
    parts.append(f'<g transform="translate(0 {px(top + step * len(moments) + 8)})">{ruler(scene)}</g>')
    alt = f"Simulated. {result.name}: the chain at {len(moments)} moments, from {moments[0]:g} s on."
    return standalone("".join(parts), WIDTH, height, alt, definitions(scene))


def _head(result: Result, scene: Scene) -> str:
    about = result.source[:150]
    return (
        f'<text x="24" y="28" font-size="17" font-weight="650" fill="{INK}">{escape(result.name)}</text>'
        f'<text x="24" y="48" font-size="12" fill="{QUIET}">{escape(about)}</text>'
        f'<text x="{px(WIDTH - 24)}" y="26" text-anchor="end" font-size="11" font-weight="700" fill="{WARN}">'
        "SIMULATED</text>"
        f'<g transform="translate({px(WIDTH - 24)} 48)">{pressure_key(scene)}</g>'
    )


def pressure_key(scene: Scene) -> str:
    """The legend of the colour that shows a muscle's pressure, right-aligned at x = 0."""
    steps = "".join(
        f'<rect x="{px(-152 + 12 * i)}" y="-10" width="12.3" height="12" fill="url(#rubber)"/>'
        f'<rect x="{px(-152 + 12 * i)}" y="-10" width="12.3" height="12" fill="url(#tint)" '
        f'opacity="{opacity(i / 7):.3f}"/>'
        for i in range(8)
    )
    return (
        f'<text x="-160" text-anchor="end" font-size="12" fill="{QUIET}">0</text>{steps}'
        f'<text x="0" text-anchor="end" font-size="12" fill="{QUIET}">{scene.highest / 1e3:.0f} kPa</text>'
    )


def ruler(scene: Scene) -> str:
    """Lengths from the fixed end, to the scale of the drawing."""
    whole = (scene.end - LEFT) / scene.scale
    step = next(s for s in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if whole / s <= 12)
    ticks, count = [], int(whole / step + 1e-9)
    for i in range(count + 1):
        x = px(LEFT + i * step * scene.scale)
        unit = " mm" if i == count else ""
        ticks.append(
            f'<path d="M{x} 0V5" stroke="{FAINT}"/><text x="{x}" y="18" text-anchor="middle" font-size="11" '
            f'fill="{QUIET}">{1e3 * i * step:g}{unit}</text>'
        )
    return f'<path d="M{px(LEFT)} 0H{px(scene.end)}" stroke="{FAINT}"/>' + "".join(ticks)


def standalone(body: str, width: float, height: float, alt: str, head: str = "") -> str:
    """A complete SVG file with a white background, a font and a description."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {px(width)} {px(height)}" width="{px(width)}" '
        f'height="{px(height)}" role="img" aria-labelledby="alt" font-family="{FONT}">'
        f'<desc id="alt">{escape(alt)}</desc>{head}<rect width="100%" height="100%" fill="#fff"/>{body}</svg>\n'
    )
