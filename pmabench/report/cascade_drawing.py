"""A chain of muscles drawn to scale as SVG: outlines with Bezier ends, load; snapshots as a still.

Knows the result of a simulation, not how it came about. Every number of the geometry is made here; an animation only
puts them in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from pmabench.model.muscle import Outline, outline
from pmabench.plotting.looks import BLUE, BROWN, FAINT, INK, QUIET
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
