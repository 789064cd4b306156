"""A chart as data, with its colours and axes; `drawing` makes SVG of it, a page's script draws the same with zoom.

A figure is rows of charts (`pictures.of_charts`). A `Chart` has `Series` (a line, or marks of a shape of `SHAPES`; x
need not rise, so that loops close) and `Level`s (a named line across the axes, or a shaded span). Names of series are
at their ends, or, with `legend`, in one strip above all charts of the figure, each name once. Several charts become a
figure by `small_multiples`: each item is one chart, or several above each other with one x axis; it sets widths, common
limits, where labels are, and linked cursors. `of_charts` puts the word SIMULATED in the corner of a figure.

Contains no page or result. Lengths are points of print (1/72 in).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, isfinite, log10

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INK, QUIET, FAINT = "#16202a", "#52606d", "#a3b1be"
"""Colours of text, of secondary text, and of measured data under a model's line."""
GRID, UNTESTED = "#e8edf2", "#eef1f5"
BLUE, BROWN, GREEN, FAULT = "#0b5394", "#8a4b00", "#0a6c51", "#b3261e"
DARK, TEAL, BRIGHT = "#271102", "#28a0bd", "#0b35da"
PALETTE = (BLUE, BROWN, GREEN, DARK, TEAL, BRIGHT)
"""Colours of series: any two are 30 Lab units apart, also for red-green blindness, with contrast 3 : 1 to paper."""
MARKS, CROSSES = ("o", "s", "^", "D", "v", "<"), ("x", "+", "*")
"""Shapes of own values, and of published ones."""
SHAPES = {
    "s": (((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),),
    "^": (((0.0, -1.2), (1.15, 0.9), (-1.15, 0.9)),),
    "v": (((0.0, 1.2), (1.15, -0.9), (-1.15, -0.9)),),
    "<": (((-1.2, 0.0), (0.9, -1.15), (0.9, 1.15)),),
    "D": (((0.0, -1.25), (1.25, 0.0), (0.0, 1.25), (-1.25, 0.0)),),
    "x": (((-1.1, -1.1), (1.1, 1.1)), ((-1.1, 1.1), (1.1, -1.1))),
    "+": (((-1.3, 0.0), (1.3, 0.0)), ((0.0, -1.3), (0.0, 1.3))),
    "*": (((-1.2, 0.0), (1.2, 0.0)), ((-0.6, -1.0), (0.6, 1.0)), ((-0.6, 1.0), (0.6, -1.0))),
}
"""Outlines of marks, in radii; besides there are `o`, a dot, and `.`, a small dot for many samples."""

TICK, NAME = 7.4, 8.0
"""Sizes of text at ticks and curves [pt]."""
WIDE, BOLD = 0.55, 0.62
"""Mean width of a letter, and of a bold one, as a fraction of the font size."""
ROW = 11.0
"""Height of a row of names above the axes [pt]."""
GAP = 12.0
"""Gap between charts in a row [pt]."""
INNER = 4.0
"""Room left of axes whose labels are at the chart on their left [pt]."""
DIGITS, STEPS = 5, 6
"""Significant digits of the marks and ticks of a page; fewest steps of the last one on an axis."""
COLUMN, PAGE, HIGH = 249.0, 510.0, 160.0
"""Widths of narrow and of wide pictures, and their usual height [pt]."""


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
    positive: bool = False
    """Whether its intervals end at 0: the quantity is never below."""
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

    @property
    def ends(self) -> tuple[Array, Array]:
        """Lower and upper ends of the intervals; NaN where there is none."""
        half = np.full(len(self.y), np.nan) if self.half is None else self.half
        low = self.y - half
        return np.where(self.y >= 0, np.maximum(low, 0.0), low) if self.positive else low, self.y + half


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
    """Limits x0, x1, y0, y1 where they are not to follow from the data; lines are cut at y0 and y1."""
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
    ends = [end for s in series for end in (s.y, *(() if s.mark and s.hollow else s.ends))]
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
    """Range of an axis: least and largest of its numbers, with room about them where they are all the same."""
    every = np.concatenate([*values, np.zeros(0)])
    every = every[np.isfinite(every) & ((every > 0) | (not log))]
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.1, 1.0)
    largest = max(abs(low), abs(high), 1e-300)
    if high - low > 1e-9 * largest:
        least = 0.0 if log else STEPS * 10.0 ** (floor(log10(largest)) - DIGITS + 1)
        room = max(0.0, least - (high - low)) / 2
        return low - room, high + room
    room = 0.1 * abs(low) or 0.5
    return (low / 2, high * 2) if log else (low - room, high + room)


class Axes:
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
        """Texts of ticks."""
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
    frame = Axes(chart)
    return frame.left, frame.right, frame.top, frame.bottom


def _sides(charts: Sequence[Chart]) -> tuple[float, float]:
    frames = [Axes(chart) for chart in charts]
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


def in_words(charts: Sequence[Chart]) -> str:
    """What charts show, for whoever cannot see them: axes with the range of y, panels, and names of lines."""
    ranges: dict[str, list[Array]] = {}
    for chart in charts:
        values = [s.y[np.isfinite(s.y)] for s in chart.shown or chart.series]
        ranges.setdefault(f"{chart.y_label} over {chart.x_label}".strip(), [np.zeros(0)]).extend(values)
    whole = {axes: np.concatenate(values) for axes, values in ranges.items()}
    axes = [f"{words}, {y.min():.4g} to {y.max():.4g}" if len(y) else words for words, y in whole.items()]
    panels = dict.fromkeys(chart.title for chart in charts)
    names = dict.fromkeys(
        one for c in charts for one in (*(s.label for s in c.shown), *(level.name for level in c.levels))
    )
    parts = ["; ".join(axes), ", ".join(filter(None, panels)), ", ".join(filter(None, names))]
    return "".join(f"{part}. " for part in parts if part).rstrip()
