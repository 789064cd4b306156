"""Parts of every figure of a report: a drawing with number-free title, caption, alternative text and its numbers.

Helpers that figures share: display units of traces, thinning, data tables. For any kind of figure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pmabench.plotting.chart import COLUMN, CROSSES, INK, Array, Chart, Series, in_words, stamped
from pmabench.plotting.drawing import joined
from pmabench.plotting.wording import COLUMNS, Frame, Shown, clean, shown
from pmabench.store.analyses.results import Analysis, Estimate, Trace

Item = TypeVar("Item")
TABLE_ROWS = 24
"""Rows per panel in the table of numbers below its figure."""
LARGEST = 1e30
"""Numbers from this size cannot be measurements and would break a drawing."""
NOTHING = 1e-9
"""Fraction of a column's largest number below which another one is written as 0."""


@dataclass(frozen=True)
class Picture:
    """One figure for a page; drawn when its SVG is first requested, since a report uses only some of many."""

    title: str
    caption: str
    table: Frame
    rows: tuple[tuple[Chart, ...], ...]
    """The charts it consists of: the page of a report draws them again, with zoom."""

    @property
    def wide(self) -> bool:
        """Whether it is as wide as a page."""
        return sum(chart.width for chart in self.longest) > COLUMN

    @property
    def longest(self) -> tuple[Chart, ...]:
        """Its row of most charts."""
        return max(self.rows, key=len)

    @property
    def charts(self) -> list[Chart]:
        """All charts, row by row."""
        return [chart for row in self.rows for chart in row]

    @property
    def height(self) -> float:
        """Its height where it is as wide as it is drawn [pt]."""
        return sum(max(chart.height for chart in row) for row in self.rows)

    @property
    def layout(self) -> str:
        """How its charts may be arranged where there is little room: only those with all their labels one by one."""
        if len(self.longest) == 1:
            return "column"
        return "across" if len(self.rows) == 1 and all(chart.y_named for chart in self.charts) else "grid"

    @property
    def alt(self) -> str:
        """The same in words."""
        return f"{self.title}. {in_words(self.charts)}"

    @cached_property
    def svg(self) -> str:
        """The drawing, as an SVG element."""
        return joined(self.rows, self.alt)


def of_charts(rows: Sequence[Sequence[Chart]], title: str, caption: str, table: Frame, *, simulated: bool) -> Picture:
    """A picture of charts in rows, with a stamp in its corner if simulated."""
    return Picture(title, caption, table, tuple(map(tuple, stamped(rows) if simulated else rows)))


def of_traces(
    rows: Sequence[Sequence[Chart]], title: str, caption: str, analysis: Analysis, chosen: Sequence[Trace],
    able: Sequence[object] = (), columns: Sequence[str] = (), titles: Sequence[str] = (),
) -> Picture:  # fmt: skip
    """A picture of the `chosen` ones of the traces that are `able`, with their numbers in `columns` (else all)."""
    more = f" {len(chosen)} of {len(able)} are shown." if len(chosen) < len(able) else ""
    return of_charts(rows, title, caption + more, numbers(chosen, columns, titles), simulated=analysis.simulated)


Drawn = tuple[Sequence[Sequence[Chart]], str]
"""Rows of charts, and a caption."""


def of_some(
    title: str, most: int, *needed: str, marks: Sequence[str] = (), columns: Sequence[str] = ()
) -> Callable[[Callable[[Sequence[Trace]], Drawn]], Callable[[Sequence[Trace], Analysis], list[Picture]]]:
    """Decorator: one picture of at most `most` traces that have the columns `needed` and the `marks`, if there are any.

    The function draws those that are chosen, evenly. `columns` are those in the table, all if none are named.
    """

    def of(draw: Callable[[Sequence[Trace]], Drawn]) -> Callable[[Sequence[Trace], Analysis], list[Picture]]:
        @wraps(draw)
        def pictures(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
            able = [t for t in traces if has(t, *needed) and t.marks.keys() >= set(marks)]
            if not (chosen := spread(able, most)):
                return []
            rows, caption = draw(chosen)
            return [of_traces(rows, title, caption, analysis, chosen, able, columns)]

        return pictures

    return of


def drawable(analysis: Analysis) -> Analysis:
    """The analysis without parts that cannot be drawn: numbers not finite or beyond `LARGEST`, empty domains."""
    return replace(
        analysis,
        estimates=tuple(e for e in analysis.estimates if _sound(e)),
        curves=tuple(
            c
            for c in analysis.curves
            if all(_sound(term) for term in c.terms) and _small(*c.domain, c.residual_rms) and c.domain[0] < c.domain[1]
        ),
        traces=tuple(
            replace(t, marks={name: value for name, value in t.marks.items() if _small(value)})
            for t in analysis.traces
            if usable(t)
        ),
    )


def _sound(e: Estimate) -> bool:
    parts = (e.parts.repeats, e.parts.method, e.parts.calibration, e.parts.skew)
    return _small(e.value or 0.0, *(part or 0.0 for part in parts), *e.at.values())


def _small(*values: float) -> bool:
    return all(abs(value) < LARGEST for value in values)


def usable(trace: Trace) -> bool:
    """Whether a trace can be drawn: numeric columns of equal length, with finite values."""
    columns = [np.asarray(trace.columns[name]) for name in trace.columns]
    if not all(values.ndim == 1 and np.issubdtype(values.dtype, np.number) for values in columns):
        return False
    if len(columns) < 2 or not all(len(values) == len(columns[0]) >= 2 for values in columns):
        return False
    first, *others = (np.isfinite(column(trace, name)).any() for name in trace.columns)
    return bool(first and any(others))


def unit_of(trace: Trace, column: str) -> Shown:
    """Display unit of a column."""
    return shown(trace.quantities.get(column, ""))


def column(trace: Trace, name: str) -> Array:
    """A column in its display unit; NaN if it is too large to draw."""
    values = np.asarray(trace.columns[name], dtype=np.float64) / unit_of(trace, name).scale
    return np.where(np.abs(values) < LARGEST, values, np.nan)


def label(trace: Trace, name: str) -> str:
    """Words and unit of a column, for an axis."""
    return unit_of(trace, name).label(COLUMNS.get(name) or clean(name, 40))


def curve(trace: Trace, x: str, y: str, name: str, color: str, mark: str = "", **looks: Any) -> Series:
    """Column y over column x in display units, as a line or as marks, from the first to the last row that has both."""
    across, up = column(trace, x), column(trace, y)
    known = np.flatnonzero(np.isfinite(across + up))
    rows = slice(known[0], known[-1] + 1) if len(known) else slice(0)
    return Series(name, across[rows], up[rows], color, mark, **looks)


def crosses(traces: Sequence[Trace], x: str, y: str) -> list[list[Series]]:
    """Published points of y over x of each trace, a kind of cross for each table."""
    found = [[(clean(b.label, 60), b.columns) for b in t.published if {x, y} <= set(b.columns)] for t in traces]
    names = list(dict.fromkeys(name for theirs in found for name, _ in theirs))
    return [
        [
            Series(name, of[x] / unit_of(t, x).scale, of[y] / unit_of(t, y).scale, INK, CROSSES[names.index(name) % 3])
            for name, of in theirs
        ]
        for t, theirs in zip(traces, found, strict=True)
    ]


def numbers(traces: Sequence[Trace], wanted: Sequence[str] = (), titles: Sequence[str] = ()) -> Frame:
    """The numbers of traces as text, evenly thinned; of several with the title of each (its `head`) first."""
    cells: list[dict[str, str]] = []
    for title, trace in zip(titles or map(head, traces), traces, strict=True):
        names = [name for name in (wanted or tuple(trace.columns)) if name in trace.columns]
        length = len(trace.columns[names[0]]) if names else 0
        rows = np.unique(np.linspace(0, length - 1, min(length, TABLE_ROWS)).astype(int))
        texts = {label(trace, name): _texts(column(trace, name), rows) for name in names}
        panel = {"panel": clean(title, 80)} if len(traces) > 1 else {}
        cells += [{**panel, **dict(zip(texts, row, strict=True))} for row in zip(*texts.values(), strict=True)]
    return Frame(cells)


def _texts(values: Array, rows: NDArray[np.intp]) -> list[str]:
    """Numbers of a column at some rows, as text; 0 if negligible against the largest."""
    known = np.abs(values[np.isfinite(values)])
    least = NOTHING * float(known.max()) if len(known) else 0.0
    return [
        "" if not np.isfinite(value) else "0" if abs(value) <= least else f"{value:.5g}".replace("-", "−")
        for value in values[rows]
    ]


def spread(items: Sequence[Item], most: int) -> list[Item]:
    """At most `most` of the items, evenly selected."""
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.unique(np.linspace(0, len(items) - 1, most).astype(int))]


def has(trace: Trace, *names: str) -> bool:
    """Whether these columns exist, each with a finite value."""
    return all(name in trace.columns and np.isfinite(column(trace, name)).any() for name in names)


def head(trace: Trace) -> str:
    """Title of a panel: that of the trace up to its colon."""
    return clean(trace.title.partition(":")[0], 60)


def reach(values: Sequence[float]) -> str:
    """Range of some numbers with two digits: `0.12 to 3.4`."""
    low, high = (f"{value:.2g}" if value < 99 else f"{value:.0f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
