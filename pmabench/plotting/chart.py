"""A chart as data, and as static SVG with labelled curves; a page's script may draw the same data with zoom.

A figure is rows of charts (`pictures.of_charts`). A `Chart` has `Series` (a line, or marks of a shape of `SHAPES`; x
need not rise, so that loops close) and `Level`s (a named line across the axes, or a shaded span). Names of series are
at their ends, or, with `legend`, in one strip above all charts of the figure, each name once. Several charts become a
figure by `small_multiples`: each item is one chart, or several above each other with one x axis; it sets widths, common
limits, where labels are, and linked cursors. `of_charts` puts the word SIMULATED in the corner of a figure.

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
from numpy.typing import NDArray

from pmabench.plotting.looks import BROWN, CROSSES, FAINT, GRID, INK, QUIET, SHAPES, UNTESTED
from pmabench.plotting.svg import marked, shortened

Array = NDArray[np.float64]

TICK, LABEL, NAME = 7.4, 7.8, 8.0
"""Sizes of text at ticks, axis titles and curves [pt]."""
WIDE, BOLD = 0.55, 0.62
"""Mean width of a letter, and of a bold one, as a fraction of the font size."""
ROW = 11.0
"""Height of a row of names above the axes [pt]."""
RADIUS = 2.3
GAP = 12.0
"""Gap between charts in a row [pt]."""
DASHES = ' stroke-dasharray="3.5 2.5"'
INNER = 4.0
"""Room left of axes whose labels are at the chart on their left [pt]."""
NEAR = 0.15
"""Distance from its line up to which a point of the drawing is left out [pt]."""
COLUMN, PAGE, HIGH = 249.0, 510.0, 160.0
"""Widths of narrow and of wide pictures, and their usual height [pt]."""
POINTS, MOST_DOTS = 3, 300
"""Most points of a line for each point of width, and most small dots of a series, in the data of the page."""
STATIC = 700
"""Most points of a line in the static SVG."""


@dataclass(frozen=True)
class Series:
    """A line, or marks with their intervals."""

    label: str
    """Name at its last point, or left of its first; empty: none."""
    x: Array
    y: Array
    color: str
    mark: str = ""
    """Shape of its marks; empty: a line."""
    half: Array | None = None
    """Half widths of the intervals: error bars of marks, band of a line; NaN: none."""
    width: float = 1.3
    dashed: bool = False
    hollow: bool = False
    method: str = ""
    """Method whose switch shows it; empty: always shown. The static SVG has only what is always shown."""
    name_color: str = ""
    """Colour of the label, if that of the series is too pale for text."""
    said: str = ""
    """Name in the line of values below the chart, if it differs from the label."""
    named_first: bool = False
    """Whether the name is left of the first point: for lines that are farther apart at their beginning."""
    hidden: bool = False
    """Whether it is left out of the line of values below the chart."""


@dataclass(frozen=True)
class Level:
    """A line across the axes at a y, or at an x; with `to` the span between both, shaded."""

    at: float
    name: str = ""
    color: str = QUIET
    upright: bool = False
    """Whether `at` is an x."""
    to: float | None = None
    dashed: bool = True

    @property
    def ends(self) -> Array:
        """Both ends of a span, or twice the line."""
        return np.array([self.at, self.at if self.to is None else self.to])


ZERO = Level(0.0, color=FAINT, dashed=False)


@dataclass(frozen=True)
class Chart:
    """Axes with their series; sizes in points."""

    x_label: str
    y_label: str
    series: Sequence[Series]
    width: float = COLUMN
    height: float = HIGH
    alt: str = ""
    tested: Array | None = None
    """Corners of the tested zone, shape (n, 2); the rest is grey."""
    zero: bool = False
    """Whether the y axis begins at 0."""
    y_ticks: int = 5
    together: str = ""
    """Charts with the same name have linked cursors."""
    stamp: str = ""
    """A word in the upper right corner, bold: SIMULATED."""
    x_named: bool = True
    """Whether ticks and title of the x axis are written: not above another chart with the same axis."""
    y_named: bool = True
    """Whether those of the y axis are written: not right of another chart with the same axis."""
    sides: tuple[float, float] | None = None
    """Room left and right of the axes; None: as needed by the chart's own texts."""
    legend: bool = False
    """Whether names are in a strip above the figure, with their marks: for names too long to stand at curves."""
    title: str = ""
    levels: tuple[Level, ...] = ()
    ends: Sequence[float | None] = (None,) * 4
    """Limits x0, x1, y0, y1 where they are not to follow from the data; lines are cut at them."""
    x_ticks: tuple[float, ...] = ()
    """Ticks of the x axis; empty: round numbers."""
    log: bool = False
    """Whether the x axis is logarithmic; needs `x_ticks`."""

    @property
    def shown(self) -> list[Series]:
        """Series of the static SVG."""
        return [s for s in self.series if not s.method]


def closed(series: Series) -> Series:
    """The line with its first point again at the end: a loop."""
    return replace(series, x=np.append(series.x, series.x[:1]), y=np.append(series.y, series.y[:1]))


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
    """Ends of the axes (x0, x1, y0, y1), with some room, for the series that are always shown and the levels.

    Bars of hollow marks may reach beyond: wide ones of another method would squash the others.
    """
    series = chart.shown or list(chart.series)
    halves = [0.0 if s.half is None or (s.mark and s.hollow) else np.nan_to_num(s.half) for s in series]
    ends = [s.y + way * half for s, half in zip(series, halves, strict=True) for way in (-1, 1)]
    x0, x1 = _reach([*(s.x for s in series), *(one.ends for one in chart.levels if one.upright)], chart.log)
    y0, y1 = _reach([*ends, *(one.ends for one in chart.levels if not one.upright)], log=False)
    room = 0.06 * (y1 - y0)
    below = 0.0 if chart.zero and y0 >= -1e-6 * y1 else y0 - room
    over_time = any(not s.mark and len(s.x) > 100 and np.all(np.diff(s.x) >= 0) for s in series)
    aside = 0.0 if over_time and not any(s.mark for s in series) else 0.03
    if chart.log:
        found = x0 * (x0 / x1) ** aside, x1 * (x1 / x0) ** aside, below, y1 + room
    else:
        found = x0 - (aside * (x1 - x0) if x0 != 0 else 0.0), x1 + aside * (x1 - x0), below, y1 + room
    x0, x1, y0, y1 = (end if given is None else given for end, given in zip(found, chart.ends, strict=True))
    return x0, x1, y0, y1


def _reach(values: Sequence[Array], log: bool) -> tuple[float, float]:
    """Least and largest of some numbers, apart."""
    every = np.concatenate([*values, np.zeros(0)])
    every = every[np.isfinite(every) & ((every > 0) | (not log))]
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.1, 1.0)
    if high - low > 1e-9 * max(abs(low), abs(high), 1e-300):
        return low, high
    room = 0.1 * abs(low) or 0.5
    return (low / 2, high * 2) if log else (low - room, high + room)


class _Frame:
    """Coordinates of the drawing."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        self.x0, self.x1, self.y0, self.y1 = limits(chart)
        self.y_ticks = ticks(self.y0, self.y1, chart.y_ticks)
        longest = max((len(text) for text in self.texts(self.y_ticks)), default=1)
        names = max((len(s.label) for s in chart.shown if not (s.named_first or chart.legend)), default=0)
        sides = chart.sides or (7 + longest * TICK * WIDE * 1.08, 6 + names * NAME * BOLD if names else 8)
        firsts = max((len(s.label) for s in chart.shown if s.named_first), default=0)
        self.gutter = firsts * NAME * BOLD + 8 if firsts else 0.0
        """Room for names between the ticks and the curves."""
        self.left, self.right = sides[0] + self.gutter, chart.width - sides[1]
        most = 6 if chart.width > 300 else 4 if self.right - self.left > 90 else 3
        self.x_ticks = [x for x in chart.x_ticks if self.x0 <= x <= self.x1] or ticks(self.x0, self.x1, most)
        self.head = ROW + 4.0 if chart.title else 0.0
        self.top = self.head + (17.0 if chart.y_label else 5.0)
        self.bottom = chart.height - (26.0 if chart.x_named else 5.0)

    def across(self, x: float) -> float:
        """Place of an x."""
        return float(self.at(np.array([x]), np.zeros(1))[0][0])

    def down(self, y: float) -> float:
        """Place of a y."""
        return float(self.at(np.full(1, self.x0), np.array([y]))[1][0])

    @staticmethod
    def texts(values: Sequence[float]) -> list[str]:
        step = values[1] - values[0] if len(values) > 1 else abs(values[0]) if values else 1.0
        return [tick_text(value, step) for value in values]

    def at(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Data to coordinates of the drawing."""
        x, x0, x1 = (np.log10(value) if self.chart.log else np.asarray(value) for value in (x, self.x0, self.x1))
        across = self.left + (x - x0) / (x1 - x0) * (self.right - self.left)
        down = self.bottom - (np.asarray(y) - self.y0) / (self.y1 - self.y0) * (self.bottom - self.top)
        return across, down


def inside(chart: Chart) -> tuple[float, float, float, float]:
    """Left, right, upper and lower end of the axes in the drawing."""
    frame = _Frame(chart)
    return frame.left, frame.right, frame.top, frame.bottom


def _sides(charts: Sequence[Chart]) -> tuple[float, float]:
    frames = [_Frame(chart) for chart in charts]
    return max(frame.left - frame.gutter for frame in frames), max(f.chart.width - f.right for f in frames)


def small_multiples(
    items: Sequence[Chart | Sequence[Chart]], columns: int, *, common: str = "xy", one_x: bool = True, width: float = 0
) -> list[list[Chart]]:
    """Rows of a figure: charts side by side in up to so many columns, fewer where titles do not fit.

    An item is one chart, or several above each other, with `one_x` axis. `common` names the axes whose limits are the
    same in all; with a common y its labels are at the first column alone. One item is narrow, several are as wide as a
    page, unless a `width` is given.
    """
    stacks = [[item] if isinstance(item, Chart) else list(item) for item in items]
    total = width or (COLUMN if len(stacks) == 1 else PAGE)
    columns = max(1, min(columns, len(stacks)))
    every = np.array([[limits(chart) for chart in stack] for stack in stacks])  # by item, place and end
    for end, outer in ((0, np.min), (1, np.max), (2, np.min), (3, np.max)):
        if end < 2 and one_x:
            every[..., end] = outer(every[..., end], axis=1, keepdims=True)
        if "xxyy"[end] in common:
            every[..., end] = outer(every[..., end], axis=0)
    ends = iter(every.reshape(-1, 4).tolist())
    stacks = [[replace(chart, ends=next(ends)) for chart in stack] for stack in stacks]
    longest = max(len(chart.title) for stack in stacks for chart in stack) * NAME * BOLD
    left, right = _sides([replace(chart, width=total / columns, sides=None) for stack in stacks for chart in stack])
    inner = INNER if "y" in common else left
    while _axes_width(total, columns, left, inner, right) < longest and columns > 1:
        columns -= 1
    columns = ceil(len(stacks) / ceil(len(stacks) / columns))
    wide = _axes_width(total, columns, left, inner, right)
    rows: list[list[Chart]] = []
    for n, stack in enumerate(stacks):
        first = "y" not in common or n % columns == 0
        side = left if first else inner
        if n % columns == 0:
            rows += [[] for _ in stack]
        for place, chart in enumerate(stack):
            rows[place - len(stack)].append(
                replace(
                    chart,
                    width=side + wide + right,
                    sides=(side, right),
                    y_named=first,
                    x_named=not one_x or place == len(stack) - 1,
                    together=chart.together or (f"stack {n}" if len(stack) > 1 and one_x else ""),
                )
            )
    return rows


def _axes_width(total: float, columns: int, left: float, inner: float, right: float) -> float:
    return (total - GAP * (columns - 1) - left - (columns - 1) * inner - columns * right) / columns


def stamped(rows: Sequence[Sequence[Chart]]) -> list[list[Chart]]:
    """The same with the word SIMULATED in the upper right corner."""
    (*first, last), *others = rows
    return [[*first, replace(last, stamp="SIMULATED")], *map(list, others)]


def joined(rows: Sequence[Sequence[Chart]], alt: str) -> str:
    """The names, and rows of charts, as one `<svg>` element."""
    width, down, names = _strip(rows)
    inner = [names] if names else []
    for row in rows:
        across = 0.0
        for chart in row:
            inner.append(f'<g transform="translate({_n(across)} {_n(down)})">\n{_drawn(chart)}\n</g>')
            across += chart.width + GAP
        down += max(chart.height for chart in row)
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
    body = [*_ground(frame), *_axes(frame), *_levels(frame)]
    body += [band for series in chart.shown for band in _band(frame, series)]
    for series in chart.shown:
        body += _marks(frame, series) if series.mark else _line(frame, series)
    body += [] if chart.legend else _names(frame)
    for level, x, y, right, _ in level_names(chart):
        body.append(_text(x, y, level.name, TICK, level.color, "start" if right else "end", halo=True))
    body.append(_text(chart.width - 1, frame.head + 8, chart.stamp, 7, BROWN, "end", bold=True) if chart.stamp else "")
    return "\n".join(filter(None, body))


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
        y = frame.down(value)
        out.append(_rule(frame.left, y, frame.right, y, GRID, 0.75))
        if chart.y_named:
            out.append(_text(frame.left - frame.gutter - 4, y + 2.6, text, TICK, QUIET, "end"))
    out.append(_rule(frame.left, frame.bottom, frame.right, frame.bottom, QUIET, 0.9))
    texts = [f"{value:g}" for value in frame.x_ticks] if chart.x_ticks else frame.texts(frame.x_ticks)
    end = -GAP
    for value, text in zip(frame.x_ticks, texts, strict=True):
        x, half = frame.across(value), 0.5 * len(text) * TICK * WIDE
        out.append(_rule(x, frame.bottom, x, frame.bottom + 2.5, QUIET, 0.9))
        if chart.x_named and x - half > end + 2:
            out.append(_text(x, frame.bottom + 10.5, text, TICK, QUIET, "middle"))
            end = x + half
    if chart.x_named:
        out.append(_text((frame.left + frame.right) / 2, chart.height - 4, chart.x_label, LABEL, INK, "middle"))
    if chart.y_label and chart.y_named:
        out.append(_text(1, frame.head + 8.5, chart.y_label, LABEL, INK, "start"))
    if chart.title:
        x = 1.0 if chart.y_named else frame.left
        most = int((chart.width + GAP - 2 - x) / (NAME * BOLD))
        title = chart.title if len(chart.title) <= most else f"{chart.title[: most - 1].strip()}…"
        out.append(_text(x, 12, title, NAME, INK, "start", bold=True))
    return out


def _levels(frame: _Frame) -> list[str]:
    """Lines across the axes, and shaded spans."""
    out = []
    for level in frame.chart.levels:
        x0, x1, y0, y1 = inside(frame.chart)
        if level.upright:
            x0, x1 = sorted(map(frame.across, level.ends))
        else:
            y0, y1 = sorted(map(frame.down, level.ends))
        if level.to is None:
            out.append(_rule(x0, y0, x1, y1, level.color, 0.9, DASHES if level.dashed else ""))
        else:
            place = f'x="{_n(x0)}" y="{_n(y0)}" width="{_n(x1 - x0)}" height="{_n(y1 - y0)}"'
            out.append(f'<rect {place} fill="{level.color}" fill-opacity="0.13"/>')
    return out


def level_names(chart: Chart) -> list[tuple[Level, float, float, bool, bool]]:
    """Levels with the place of their names, at the end and on the side where they cover least.

    Whether the text begins there, and whether it is above a line, or at the bottom of an upright one.
    """
    frame, found = _Frame(chart), []
    taken = [np.array(frame.at(s.x, s.y)) for s in chart.shown]
    for level in (one for one in chart.levels if one.name):
        wide = len(level.name) * TICK * WIDE
        if level.upright:
            x = frame.across(level.at)
            places = [(x + 3 * way, y) for y in (frame.bottom - 4, frame.top + 8) for way in (-1, 1)]
        else:
            y = frame.down(level.at)
            places = [(x, y + off) for off in (-3, 8.5) for x in (frame.right - 3, frame.left + 3)]
        boxes = []
        for n, (x, y) in enumerate(places):
            first = x - wide if n % 2 == 0 else x
            box = [[first - 2], [y - 7.5]], [[first + wide + 2], [y + 2]]
            hidden = sum(int(((points > box[0]) & (points < box[1])).all(axis=0).sum()) for points in taken)
            outside = first < frame.left or first + wide > frame.right or y > frame.bottom or y < frame.top + 5
            boxes.append((hidden + 1e4 * outside, n, x, y, first))
        _, n, x, y, first = min(boxes)
        across, down = np.meshgrid(np.linspace(first, first + wide, 60), [y - 5, y - 2.5, y])
        taken.append(np.array([across.ravel(), down.ravel()]))
        found.append((level, x, y, n % 2 > 0, n < 2))
    return found


def _band(frame: _Frame, series: Series) -> list[str]:
    """The interval of a line, as a band."""
    if series.mark or series.half is None or not np.isfinite(series.half).any():
        return []
    known = np.isfinite(series.half) & np.isfinite(series.y)
    x, y, half = (values[known] for values in (series.x, series.y, series.half))
    across, up = frame.at(x, y + half)
    _, down = frame.at(x, y - half)
    whole = _path(np.append(across, across[::-1]), np.append(up, down[::-1]))
    return [f'<path d="{whole}z" fill="{series.color}" fill-opacity="0.16"/>']


def _line(frame: _Frame, series: Series) -> list[str]:
    parts = [_path(*piece) for piece in pieces(frame.chart, series)]
    look = f'fill="none" stroke="{series.color}" stroke-width="{_n(series.width)}" stroke-linejoin="round"'
    return [f'<path d="{"".join(parts)}" {look}{DASHES if series.dashed else ""}/>'] if parts and series.width else []


def pieces(chart: Chart, series: Series, most: int = STATIC, near: float = NEAR) -> list[tuple[Array, Array]]:
    """The parts of a line, inside the axes, in coordinates of the drawing, without points that lie on it anyway."""
    frame, stride = _Frame(chart), max(1, -(-len(series.x) // most))
    x, y = _inside(series.x[::stride], series.y[::stride], frame.y0, frame.y1)
    known = np.isfinite(x) & np.isfinite(y)
    found = []
    for piece in np.split(np.arange(len(x)), np.flatnonzero(~known)):
        piece = piece[known[piece]]
        if len(piece) > 1:
            across, down = frame.at(x[piece], y[piece])
            kept = needed(across, down, near)
            found.append((across[kept], down[kept]))
    return found


def rows_needed(chart: Chart, series: Series) -> NDArray[np.intp]:
    """Rows of a series for the data of a page: evenly thinned, of a line those that a reader can see."""
    most = MOST_DOTS if series.mark == "." else ceil(POINTS * chart.width)
    rows = np.arange(0, len(series.x), max(1, -(-len(series.x) // most)))
    if series.mark or series.half is not None:
        return rows
    return rows[needed(*_Frame(chart).at(series.x[rows], series.y[rows]), NEAR / 3)]


def _inside(x: Array, y: Array, low: float, high: float) -> tuple[Array, Array]:
    """A line with what is below or above cut off at the limits."""
    places = [np.arange(len(y), dtype=np.float64)]
    for end in (low, high):
        before = np.flatnonzero((y[:-1] - end) * (y[1:] - end) < 0)
        places.append(before + (end - y[before]) / (y[before + 1] - y[before]))
    if sum(map(len, places)) > len(y):
        every = np.sort(np.concatenate(places))
        x, y = (np.interp(every, places[0], values) for values in (x, y))
    beyond = 1e-9 * (high - low)
    return x, np.where((y < low - beyond) | (y > high + beyond), np.nan, y)


def needed(x: Array, y: Array, near: float) -> NDArray[np.intp]:
    """Rows of a line from which every other one is at most so far away; what is no number, and its neighbours, stay.

    Each part between two kept points is cut where it is farthest from its chord, until none is too far (Ramer 1972).
    """
    every = np.arange(len(x))
    unknown = np.flatnonzero(~np.isfinite(x + y))
    kept = np.unique(np.clip([0, len(x) - 1, *unknown, *(unknown - 1), *(unknown + 1)], 0, len(x) - 1))
    while len(kept) < len(x):
        part = np.minimum(np.searchsorted(kept, every, "right") - 1, len(kept) - 2)
        a, b = kept[part], kept[part + 1]
        along, way = (np.array([x[to] - x[a], y[to] - y[a]]) for to in (b, every))
        share = np.clip((along * way).sum(axis=0) / np.maximum((along**2).sum(axis=0), 1e-300), 0.0, 1.0)
        off = np.nan_to_num(np.hypot(*(way - share * along)))
        far = np.flatnonzero((off > near) & (off == np.maximum.reduceat(off, kept[:-1])[part]))
        if not len(far):
            break
        kept = np.sort(np.append(kept, far[np.unique(part[far], return_index=True)[1]]))
    return kept


def _marks(frame: _Frame, series: Series) -> list[str]:
    """Marks of a series with its error bars."""
    out = []
    known = np.isfinite(series.x) & np.isfinite(series.y) & (series.y >= frame.y0) & (series.y <= frame.y1)
    if series.mark == ".":
        known = known & (np.arange(len(known)) % max(1, -(-len(known) // (STATIC // 2))) == 0)
    x, y = series.x[known], series.y[known]
    halves = np.full(len(x), np.nan) if series.half is None else series.half[known]
    across, down = frame.at(x, y)
    _, ups = frame.at(x, y + halves)
    _, lows = frame.at(x, y - halves)
    for place, up, low in zip(across, ups, lows, strict=True):
        if isfinite(up) and abs(low - up) > 2 * RADIUS:
            out.append(_rule(place, max(up, frame.top - 4), place, min(low, frame.bottom), series.color, 1.4))
    return out + _shapes(across, down, series)


def _shapes(across: Array, down: Array, series: Series) -> list[str]:
    """Marks at places of the drawing; one path for all, of circles one for each."""
    if not len(across):
        return []
    look = f'fill="#fff" stroke="{series.color}" stroke-width="1"' if series.hollow else f'fill="{series.color}"'
    if series.mark == "o":
        return [
            f'<circle cx="{_n(x)}" cy="{_n(y)}" r="{_n(RADIUS)}" {look}/>' for x, y in zip(across, down, strict=True)
        ]
    if series.mark == ".":
        path = "".join(f"M{_n(x)} {_n(y)}h0" for x, y in zip(across, down, strict=True))
        return [f'<path d="{path}" stroke="{series.color}" stroke-width="1.5" stroke-linecap="round"/>']
    if series.mark in CROSSES:
        look = f'fill="none" stroke="{series.color}" stroke-width="1.1"'
    end = "" if series.mark in CROSSES else " z"
    path = "".join(
        f"M {' L '.join(f'{x + RADIUS * a:.2f} {y + RADIUS * b:.2f}' for a, b in line)}{end} "
        for x, y in zip(across, down, strict=True)
        for line in SHAPES[series.mark]
    )
    return [f'<path d="{shortened(path)}" {look}/>']


def _strip(rows: Sequence[Sequence[Chart]]) -> tuple[float, float, str]:
    """Width of a figure, and height and elements of the names above it, in as many lines as they need."""
    width = max(sum(chart.width + GAP for chart in row) - GAP for row in rows)
    named = {s.label: s for row in rows for chart in row if chart.legend for s in chart.shown if s.label}
    across, y, out = 1.0, 8.5, []
    for series in named.values():
        wide = 24.0 + len(series.label) * NAME * WIDE
        if across > 1 and across + wide > width:
            across, y = 1.0, y + ROW
        if series.mark:
            out += _shapes(np.array([across + 5]), np.array([y - 2.8]), series)
        else:
            look = series.color, series.width, DASHES if series.dashed else ""
            out.append(_rule(across, y - 2.8, across + 10, y - 2.8, *look))
        out.append(_text(across + 13, y, series.label, NAME, INK, "start"))
        across += wide
    return width, y + 4.0 if out else 0.0, "\n".join(out)


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


def _rule(x1: float, y1: float, x2: float, y2: float, color: str, width: float, dash: str = "") -> str:
    return f'<path d="M{_n(x1)} {_n(y1)}L{_n(x2)} {_n(y2)}" stroke="{color}" stroke-width="{_n(width)}"{dash}/>'


def _text(
    x: float, y: float, text: str, size: float, color: str, anchor: str, *, bold: bool = False, halo: bool = False
) -> str:
    weight = ' font-weight="600"' if bold else ""
    weight += ' paint-order="stroke" stroke="#fff" stroke-width="2"' if halo else ""
    place = f'x="{_n(x)}" y="{_n(y)}" text-anchor="{anchor}" font-size="{_n(size)}" fill="{color}"{weight}'
    return f"<text {place}>{marked(escape(text))}</text>"


def _n(number: float) -> str:
    return f"{float(number):.2f}".rstrip("0").rstrip(".")
