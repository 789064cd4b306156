"""A chart as static SVG with labelled curves, and which points of a line a drawing needs.

Lengths are points of print (1/72 in); the page sets text in its own font, so only the length of a text is estimated.
No element has a `style`: attributes only.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from html import escape
from math import ceil, isfinite

import numpy as np
from numpy.typing import NDArray

from pmabench.plotting.chart import (
    BOLD,
    BROWN,
    CROSSES,
    GAP,
    GRID,
    INK,
    NAME,
    QUIET,
    ROW,
    SHAPES,
    TICK,
    UNTESTED,
    WIDE,
    Array,
    Axes,
    Chart,
    Level,
    Series,
    inside,
)  # fmt: skip
from pmabench.plotting.svg import marked, shortened

LABEL, RADIUS = 7.8, 2.3
"""Size of axis titles, and radius of marks [pt]."""
DASHES = ' stroke-dasharray="3.5 2.5"'
NEAR = 0.15
"""Distance from its line up to which a point of the drawing is left out [pt]."""
POINTS, MOST_DOTS = 3, 300
"""Most points of a line for each point of width, and most small dots of a series, in the data of the page."""
STATIC = 700
"""Most points of a line in the static SVG."""


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
    frame = Axes(chart)
    body = [*_ground(frame), *_axes(frame), *_levels(frame)]
    body += [band for series in chart.shown for band in _band(frame, series)]
    for series in chart.shown:
        body += _marks(frame, series) if series.mark else _line(frame, series)
    body += [] if chart.legend else _names(frame)
    for level, x, y, right, _ in level_names(chart):
        body.append(_text(x, y, level.name, TICK, level.color, "start" if right else "end", halo=True))
    body.append(_text(chart.width - 1, frame.head + 8, chart.stamp, 7, BROWN, "end", bold=True) if chart.stamp else "")
    return "\n".join(filter(None, body))


def _ground(frame: Axes) -> list[str]:
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


def _axes(frame: Axes) -> list[str]:
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


def _levels(frame: Axes) -> list[str]:
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
    frame, found = Axes(chart), []
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


def _band(frame: Axes, series: Series) -> list[str]:
    """The interval of a line, as a band."""
    if series.mark or series.half is None or not np.isfinite(series.half).any():
        return []
    known = np.isfinite(series.half) & np.isfinite(series.y)
    x, low, high = (values[known] for values in (series.x, *series.ends))
    across, up = frame.at(x, high)
    _, down = frame.at(x, low)
    whole = _path(np.append(across, across[::-1]), np.append(up, down[::-1]))
    return [f'<path d="{whole}z" fill="{series.color}" fill-opacity="0.16"/>']


def _line(frame: Axes, series: Series) -> list[str]:
    parts = [_path(*piece) for piece in pieces(frame.chart, series)]
    look = f'fill="none" stroke="{series.color}" stroke-width="{_n(series.width)}" stroke-linejoin="round"'
    return [f'<path d="{"".join(parts)}" {look}{DASHES if series.dashed else ""}/>'] if parts and series.width else []


def pieces(chart: Chart, series: Series, most: int = STATIC, near: float = NEAR) -> list[tuple[Array, Array]]:
    """The parts of a line, inside the axes, in coordinates of the drawing, without points that lie on it anyway."""
    frame, rows = Axes(chart), _thinned(len(series.x), most)
    x, y = _inside(series.x[rows], series.y[rows], frame.y0, frame.y1)
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
    rows = _thinned(len(series.x), most)
    if series.mark or series.half is not None:
        return rows
    return rows[needed(*Axes(chart).at(series.x[rows], series.y[rows]), NEAR / 3)]


def _thinned(count: int, most: int) -> NDArray[np.intp]:
    """Every nth of `count` rows, at most so many, and the last one."""
    rows = np.arange(0, count, max(1, -(-count // most)))
    return np.unique(np.append(rows, count - 1)) if count else rows


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
    if len(x) < 3:
        return every
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


def _marks(frame: Axes, series: Series) -> list[str]:
    """Marks of a series with its error bars."""
    out = []
    known = np.isfinite(series.x) & np.isfinite(series.y) & (series.y >= frame.y0) & (series.y <= frame.y1)
    if series.mark == ".":
        known = known & (np.arange(len(known)) % max(1, -(-len(known) // (STATIC // 2))) == 0)
    x, y = series.x[known], series.y[known]
    across, down = frame.at(x, y)
    (_, lows), (_, ups) = (frame.at(x, end[known]) for end in series.ends)
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


def _names(frame: Axes) -> list[str]:
    """Names at the last points, or left of the first, moved apart where they would overlap."""
    found = []
    for first in (False, True):
        named: list[tuple[float, float, Series]] = []
        for series in frame.chart.shown:
            known = np.flatnonzero(np.isfinite(series.x + series.y))
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


def _apart(named: Sequence[tuple[float, float, Series]], frame: Axes) -> list[float]:
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
