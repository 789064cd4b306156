"""A chart as data, and as static SVG with labelled curves; a page's script may draw the same data with zoom.

Contains no page or result. Lengths of the drawing are points of print (1/72 in); the page sets text in its own font,
so only the length of a text is estimated here. No element has a `style`: attributes only.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from math import ceil, floor, isfinite, log10

import numpy as np

from pmabench.plotting.plots import BROWN, GRID, INK, QUIET, UNTESTED, Array
from pmabench.plotting.svg import marked, shortened

TICK, LABEL, NAME = 7.4, 7.8, 8.0
"""Sizes of text at ticks, axis titles and curves [pt]."""
WIDE, BOLD = 0.55, 0.62
"""Mean width of a letter, and of a bold one, as a fraction of the font size."""
ROW = 11.0
"""Height of a row of names above the axes [pt]."""
RADIUS = 2.3
GAP = 12.0
"""Gap between charts in a row [pt]."""
COLUMN, PAGE, HIGH = 249.0, 510.0, 160.0
"""Widths of narrow and of wide pictures, and their usual height [pt]."""
MOST_POINTS = 2000
"""Most points of a line in the data of the page."""
STATIC = 700
"""Most points of a line in the static SVG."""


@dataclass(frozen=True)
class Series:
    """A line, or dots with their intervals."""

    label: str
    """Name at its last point, or left of its first; empty: none."""
    x: Array
    y: Array
    color: str
    dots: bool = False
    half: Array | None = None
    """Half widths of the intervals: error bars of dots, band of a line; NaN: none."""
    width: float = 1.3
    dashed: bool = False
    hollow: bool = False
    method: str = ""
    """Method whose switch shows it; empty: always shown. The static SVG has only what is always shown."""
    cross: bool = False
    """Draw dots as crosses: values from the literature."""
    name_color: str = ""
    """Colour of the label, if that of the series is too pale for text."""
    said: str = ""
    """Name in the line of values below the chart, if it differs from the label."""
    named_first: bool = False
    """Whether the name is left of the first point: for lines that are farther apart at their beginning."""
    hidden: bool = False
    """Whether it is left out of the line of values below the chart."""


@dataclass(frozen=True)
class Chart:
    """Axes with their series; sizes in points."""

    x_label: str
    y_label: str
    series: tuple[Series, ...]
    width: float
    height: float
    alt: str
    tested: Array | None = None
    """Corners of the tested zone, shape (n, 2); the rest is grey."""
    words: str = ""
    """A remark in the upper right corner."""
    zero: bool = False
    """Whether the y axis begins at 0."""
    y_ticks: int = 5
    together: str = ""
    """Charts with the same name have linked cursors."""
    stamp: str = ""
    x_named: bool = True
    """Whether ticks and title of the x axis are written: not above another chart with the same axis."""
    sides: tuple[float, float] | None = None
    """Room left and right of the axes; None: as needed by the chart's own texts."""
    legend: bool = False
    """Whether names are in rows above the axes, with their marks: for names too long to stand at curves."""

    @property
    def shown(self) -> list[Series]:
        """Series of the static SVG."""
        return [s for s in self.series if not s.method]


def of_points(series: Sequence[Series], x_label: str, y_label: str, alt: str, *, simulated: bool) -> Chart:
    """A narrow chart of dots and lines, with names above its axes."""
    stamp = "SIMULATED" if simulated else ""
    return Chart(x_label, y_label, tuple(series), COLUMN, HIGH, alt, stamp=stamp, legend=True)


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers (1, 2, 2.5, 5 times a power of ten) from low to high, at most `most` + 1."""
    span = high - low
    if not (isfinite(span) and span > 0):
        return [low] if isfinite(low) else []
    power = 10.0 ** floor(log10(span / most))
    step = next(power * s for s in (1.0, 2.0, 2.5, 5.0, 10.0) if power * s >= span / most * (1 - 1e-9))
    return [float(n * step) for n in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]


def tick_text(value: float, step: float) -> str:
    """Text of a tick with the decimals of its step, a true minus, thin spaces in thousands from 10 000."""
    decimals = max(0, -floor(log10(step) + 1e-9)) if step > 0 else 0
    if step > 0 and abs(round(step, decimals) - step) > 1e-9 * step:
        decimals += 1
    if max(abs(value), step) >= 1e7 or (0 < step < 1e-6):
        return f"{value:.3g}".replace("-", "−")
    text = f"{abs(value):,.{decimals}f}".replace(",", "\u2009" if abs(value) >= 1e4 else "")
    return f"−{text}" if value < 0 and float(text.replace("\u2009", "")) != 0 else text


def limits(chart: Chart) -> tuple[float, float, float, float]:
    """Ends of the axes (x0, x1, y0, y1), with some room, for the series that are always shown.

    Bars of hollow dots may reach beyond: wide ones of another method would squash the others.
    """
    series = chart.shown or list(chart.series)
    xs = np.concatenate([s.x for s in series] or [np.zeros(1)])
    halves = [0.0 if s.half is None or (s.dots and s.hollow) else np.nan_to_num(s.half) for s in series]
    ends = [s.y + way * half for s, half in zip(series, halves, strict=True) for way in (-1, 1)]
    ys = np.concatenate(ends or [np.zeros(1)])
    xs, ys = xs[np.isfinite(xs)], ys[np.isfinite(ys)]
    x0, x1 = (float(xs.min()), float(xs.max())) if len(xs) else (0.0, 1.0)
    y0, y1 = (float(ys.min()), float(ys.max())) if len(ys) else (0.0, 1.0)
    if x1 <= x0:
        x0, x1 = x0 - (0.5 * abs(x0) or 0.5), x1 + (0.5 * abs(x1) or 0.5)
    if y1 - y0 <= 1e-9 * max(abs(y0), abs(y1), 1e-300):
        y0, y1 = y0 - (0.1 * abs(y0) or 0.5), y1 + (0.1 * abs(y1) or 0.5)
    room = 0.06 * (y1 - y0)
    below = 0.0 if chart.zero and y0 >= -1e-6 * y1 else y0 - room
    aside = 0.0 if any(not s.dots and len(s.x) > 100 for s in series) else 0.03 * (x1 - x0)
    return x0 - (aside if x0 != 0 else 0.0), x1 + aside, below, y1 + room


class _Frame:
    """Coordinates of the drawing."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        self.x0, self.x1, self.y0, self.y1 = limits(chart)
        self.x_ticks = ticks(self.x0, self.x1, 6 if chart.width > 300 else 4)
        self.y_ticks = ticks(self.y0, self.y1, chart.y_ticks)
        longest = max((len(text) for text in self.texts(self.y_ticks)), default=1)
        names = max((len(s.label) for s in chart.shown if not (s.named_first or chart.legend)), default=0)
        sides = chart.sides or (7 + longest * TICK * WIDE * 1.08, 6 + names * NAME * BOLD if names else 8)
        firsts = max((len(s.label) for s in chart.shown if s.named_first), default=0)
        self.gutter = firsts * NAME * BOLD + 8 if firsts else 0.0
        """Room for names between the ticks and the curves."""
        self.left, self.right = sides[0] + self.gutter, chart.width - sides[1]
        self.keys = _keys(chart) if chart.legend else []
        self.top = (17.0 if chart.y_label else 5.0) + (ROW * (self.keys[-1][1] + 1) if self.keys else 0.0)
        self.bottom = chart.height - (26.0 if chart.x_named else 5.0)

    @staticmethod
    def texts(values: Sequence[float]) -> list[str]:
        step = values[1] - values[0] if len(values) > 1 else abs(values[0]) if values else 1.0
        return [tick_text(value, step) for value in values]

    def at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Data to coordinates of the drawing."""
        across = self.left + (np.asarray(x) - self.x0) / (self.x1 - self.x0) * (self.right - self.left)
        down = self.bottom - (np.asarray(y) - self.y0) / (self.y1 - self.y0) * (self.bottom - self.top)
        return across, down


def with_common_sides(charts: Sequence[Chart]) -> tuple[Chart, ...]:
    """Charts one below the other, with axes aligned to the narrowest."""
    frames = [_Frame(chart) for chart in charts]
    left, right = max(f.left - f.gutter for f in frames), max(f.chart.width - f.right for f in frames)
    return tuple(replace(chart, sides=(left, right)) for chart in charts)


def to_svg(chart: Chart) -> str:
    """The chart as one `<svg>` element; the same bytes for the same chart."""
    return _whole(chart.width, chart.height, chart.alt, chart.stamp, _drawn(chart))


def joined(rows: Sequence[Sequence[Chart]], alt: str) -> str:
    """Rows of charts as one `<svg>` element."""
    inner, width, down = [], 0.0, 0.0
    for row in rows:
        across = 0.0
        for chart in row:
            inner.append(f'<g transform="translate({_n(across)} {_n(down)})">\n{_drawn(chart)}\n</g>')
            across += chart.width + GAP
        width, down = max(width, across - GAP), down + max(chart.height for chart in row)
    stamp = "".join(chart.stamp for row in rows for chart in row)
    return _whole(width, down, alt, stamp, "\n".join(inner))


def _whole(width: float, height: float, alt: str, stamp: str, inner: str) -> str:
    name = f"c{hashlib.sha256((alt + inner).encode()).hexdigest()[:8]}"
    described = escape(f"{'Simulated. ' if stamp else ''}{alt}")
    head = f'viewBox="0 0 {_n(width)} {_n(height)}" role="img" aria-labelledby="{name}"'
    return f'<svg {head}><desc id="{name}">{described}</desc>\n{inner}\n</svg>'


def _drawn(chart: Chart) -> str:
    """All SVG elements of a chart."""
    frame = _Frame(chart)
    body = [*_ground(frame), *_axes(frame)]
    body += [band for series in chart.shown for band in _band(frame, series)]
    for series in chart.shown:
        body += _dots(frame, series) if series.dots else _line(frame, series)
    body += [part for key in frame.keys for part in _key(*key)] if chart.legend else _names(frame)
    corner = [t for t in (chart.words, chart.stamp) if t]
    for n, text in enumerate(corner):
        color = BROWN if text == chart.stamp else QUIET
        body.append(_text(chart.width - 1, 8 + 9 * n, text, 7, color, "end", bold=text == chart.stamp))
    return "\n".join(body)


def _ground(frame: _Frame) -> list[str]:
    """Grey background where nothing was tested."""
    if frame.chart.tested is None or len(frame.chart.tested) < 3:
        return []
    wide, high = frame.right - frame.left, frame.bottom - frame.top
    across, down = frame.at(*frame.chart.tested.T)
    across, down = np.clip(across, frame.left, frame.right), np.clip(down, frame.top, frame.bottom)
    return [
        f'<rect x="{_n(frame.left)}" y="{_n(frame.top)}" width="{_n(wide)}" height="{_n(high)}" fill="{UNTESTED}"/>',
        f'<path d="{_path(across, down)}z" fill="#fff"/>',
        _text(frame.right - 5, frame.top + 11, "grey: not tested", 7.4, QUIET, "end"),
    ]


def _axes(frame: _Frame) -> list[str]:
    """Horizontal grid, axis lines, ticks, titles with units; the title of y is above its axis."""
    chart, out = frame.chart, []
    for value, text in zip(frame.y_ticks, frame.texts(frame.y_ticks), strict=True):
        y = float(frame.at(np.zeros(1), np.array([value]))[1][0])
        out.append(_rule(frame.left, y, frame.right, y, GRID, 0.75))
        out.append(_text(frame.left - frame.gutter - 4, y + 2.6, text, TICK, QUIET, "end"))
    out.append(_rule(frame.left, frame.bottom, frame.right, frame.bottom, QUIET, 0.9))
    for value, text in zip(frame.x_ticks, frame.texts(frame.x_ticks), strict=True):
        x = float(frame.at(np.array([value]), np.zeros(1))[0][0])
        out.append(_rule(x, frame.bottom, x, frame.bottom + 2.5, QUIET, 0.9))
        if chart.x_named:
            out.append(_text(x, frame.bottom + 10.5, text, TICK, QUIET, "middle"))
    if chart.x_named:
        out.append(_text((frame.left + frame.right) / 2, chart.height - 4, chart.x_label, LABEL, INK, "middle"))
    if chart.y_label:
        out.append(_text(1, 8.5, chart.y_label, LABEL, INK, "start"))
    return out


def _band(frame: _Frame, series: Series) -> list[str]:
    """The interval of a line, as a band."""
    if series.dots or series.half is None or not np.isfinite(series.half).any():
        return []
    known = np.isfinite(series.half) & np.isfinite(series.y)
    x, y, half = (values[known] for values in (series.x, series.y, series.half))
    across, up = frame.at(x, y + half)
    _, down = frame.at(x, y - half)
    whole = _path(np.append(across, across[::-1]), np.append(up, down[::-1]))
    return [f'<path d="{whole}z" fill="{series.color}" fill-opacity="0.16"/>']


def _line(frame: _Frame, series: Series) -> list[str]:
    stride = max(1, -(-len(series.x) // STATIC))
    x, y = series.x[::stride], series.y[::stride]
    parts = []
    known = np.isfinite(x) & np.isfinite(y)
    for piece in np.split(np.arange(len(x)), np.flatnonzero(~known)):
        piece = piece[known[piece]]
        if len(piece) > 1:
            parts.append(_path(*frame.at(x[piece], y[piece])))
    dash = ' stroke-dasharray="3.5 2.5"' if series.dashed else ""
    look = f'fill="none" stroke="{series.color}" stroke-width="{_n(series.width)}" stroke-linejoin="round"'
    return [f'<path d="{"".join(parts)}" {look}{dash}/>'] if parts else []


def _dots(frame: _Frame, series: Series) -> list[str]:
    """Dots with error bars, or crosses."""
    out = []
    across, down = frame.at(series.x, series.y)
    halves = np.full(len(series.x), np.nan) if series.half is None else series.half
    _, ups = frame.at(series.x, series.y + halves)
    _, lows = frame.at(series.x, series.y - halves)
    for x, y, up, low in zip(across, down, ups, lows, strict=True):
        if not isfinite(y):
            continue
        if isfinite(up) and abs(low - up) > 2 * RADIUS:
            out.append(_rule(x, max(up, frame.top - 4), x, min(low, frame.bottom), series.color, 1.4))
        if series.cross:
            out += _cross(x, y, series.color)
            continue
        out.append(_dot(x, y, series))
    return out


def _dot(x: float, y: float, series: Series) -> str:
    look = f'fill="#fff" stroke="{series.color}" stroke-width="1"' if series.hollow else f'fill="{series.color}"'
    return f'<circle cx="{_n(x)}" cy="{_n(y)}" r="{_n(RADIUS)}" {look}/>'


Key = tuple[float, int, Series]
"""Place across [pt], row, series."""


def _keys(chart: Chart) -> list[Key]:
    """Names above the axes, from left to right in as many rows as they need."""
    found: list[Key] = []
    across, row = 1.0, 0
    for series in (s for s in chart.shown if s.label):
        wide = 20.0 + len(series.label) * NAME * WIDE
        if found and across + wide > chart.width:
            across, row = 1.0, row + 1
        found.append((across, row, series))
        across += wide
    return found


def _key(across: float, row: int, series: Series) -> list[str]:
    """The mark of a series and its name."""
    y = 19.0 + ROW * row
    if series.cross:
        mark = _cross(across + 5, y - 2.8, series.color)
    elif series.dots:
        mark = [_dot(across + 5, y - 2.8, series)]
    else:
        mark = [_rule(across, y - 2.8, across + 9, y - 2.8, series.color, series.width)]
    return [*mark, _text(across + 12, y, series.label, NAME, INK, "start")]


def _cross(x: float, y: float, color: str) -> list[str]:
    return [_rule(x - 2.6, y - 2.6 * way, x + 2.6, y + 2.6 * way, color, 1.1) for way in (1, -1)]


def _names(frame: _Frame) -> list[str]:
    """Names at the last points, or left of the first, moved apart where they would overlap."""
    found = []
    for first in (False, True):
        named: list[tuple[float, float, Series]] = []
        for series in frame.chart.shown:
            known = np.flatnonzero(np.isfinite(series.y))
            if series.label and len(known) and series.named_first == first:
                place = known[[int(np.argmin(series.x[known]) if first else np.argmax(series.x[known]))]]
                across, down = frame.at(series.x[place], series.y[place])
                named.append((float(down[0]), float(across[0]), series))
        named.sort(key=lambda place: place[0])
        for y, (_, x, s) in zip(_apart(named, frame), named, strict=True):
            side, anchor = (-5, "end") if first else (5, "start")
            color = s.name_color or s.color
            found.append(_text(min(x, frame.right) + side, y + 2.8, s.label, NAME, color, anchor, bold=True))
    return found


def _apart(named: Sequence[tuple[float, float, Series]], frame: _Frame) -> list[float]:
    """Heights of names: at least a line apart, otherwise as near to their curves as possible."""
    places = [down for down, _, _ in named]
    for _ in range(80):
        for n in range(len(places) - 1):
            across = named[n + 1][1] - named[n][1]
            longest = max(len(named[n][2].label), len(named[n + 1][2].label))
            lack = NAME + 1.2 - (places[n + 1] - places[n])
            if lack > 0 and abs(across) < longest * NAME * BOLD:
                places[n], places[n + 1] = places[n] - lack / 2, places[n + 1] + lack / 2
        places = [min(max(place, frame.top + 2), frame.bottom - 1) for place in places]
    return places


def _path(x: Array, y: Array) -> str:
    points = " L ".join(f"{a:.2f} {b:.2f}" for a, b in zip(x, y, strict=True))
    return shortened(f"M {points}")


def _rule(x1: float, y1: float, x2: float, y2: float, color: str, width: float) -> str:
    return f'<path d="M{_n(x1)} {_n(y1)}L{_n(x2)} {_n(y2)}" stroke="{color}" stroke-width="{_n(width)}"/>'


def _text(x: float, y: float, text: str, size: float, color: str, anchor: str, *, bold: bool = False) -> str:
    weight = ' font-weight="600"' if bold else ""
    place = f'x="{_n(x)}" y="{_n(y)}" text-anchor="{anchor}" font-size="{_n(size)}" fill="{color}"{weight}'
    return f"<text {place}>{marked(escape(text))}</text>"


def _n(number: float) -> str:
    return f"{float(number):.2f}".rstrip("0").rstrip(".")
