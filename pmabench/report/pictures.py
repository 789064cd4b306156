"""What every figure of a report is: a drawing with number-free title, caption, alternative text and its numbers.

Helpers that figures share: display units of traces, thinning, data tables. Knows no kind of figure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pmabench.analysis.results import Trace
from pmabench.report import plots
from pmabench.report.plots import Array, Panel
from pmabench.report.svg import drawing, to_svg
from pmabench.report.wording import COLUMNS, Shown, clean, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE_ROWS = 24
"""Rows of a panel in the table of numbers below its figure."""
DRAWN = 700
"""Points of a line that are drawn."""


@dataclass(frozen=True)
class Picture:
    """One figure, ready for a page."""

    title: str
    caption: str
    alt: str
    svg: str
    table: pd.DataFrame
    wide: bool
    simulated: bool


def picture(
    draw: Callable[[], Figure],
    title: str,
    caption: str,
    alt: str,
    table: pd.DataFrame,
    *,
    wide: bool,
    simulated: bool,
) -> Picture:
    """Draw within the style of reports, stamped where simulated."""
    with drawing():
        figure = draw()
        if simulated:
            plots.stamp(figure, "SIMULATED")
        svg = to_svg(figure, f"{'Simulated. ' if simulated else ''}{alt}")
    return Picture(title, caption, alt, svg, table, wide, simulated)


def usable(trace: Trace) -> bool:
    """Columns of one length, with something finite in each."""
    columns = [np.asarray(values) for values in trace.columns.values()]
    return (
        len(columns) >= 2
        and all(column.ndim == 1 and len(column) == len(columns[0]) >= 2 for column in columns)
        and bool(np.isfinite(columns[0]).any())
        and any(np.isfinite(column).any() for column in columns[1:])
    )


def unit_of(trace: Trace, column: str) -> Shown:
    """Display unit of a column."""
    return shown(trace.quantities.get(column, ""))


def column(trace: Trace, name: str) -> Array:
    """A column in its display unit."""
    return np.asarray(trace.columns[name], dtype=np.float64) / unit_of(trace, name).scale


def label(trace: Trace, name: str) -> str:
    """Words and unit of a column, for an axis."""
    return unit_of(trace, name).label(COLUMNS.get(name) or clean(name, 40))


def panel(trace: Trace, names: Mapping[str, str], title: str) -> Panel:
    """A panel with columns renamed: `names` from the drawing's name to the trace's; thinned evenly."""
    columns = {new: column(trace, old) for new, old in names.items()}
    stride = max(1, -(-len(next(iter(columns.values()))) // DRAWN))
    return Panel(title, {new: values[::stride] for new, values in columns.items()}, dict(trace.marks))


def numbers(traces: Sequence[tuple[str, Trace]], wanted: Sequence[str] = ()) -> pd.DataFrame:
    """The numbers of traces, evenly thinned, with the panel's title in front; text."""
    frames = []
    for title, trace in traces:
        names = [name for name in (wanted or tuple(trace.columns)) if name in trace.columns]
        length = len(trace.columns[names[0]]) if names else 0
        rows = np.unique(np.linspace(0, length - 1, min(length, TABLE_ROWS)).astype(int))
        told = {label(trace, name): [_text(value) for value in column(trace, name)[rows]] for name in names}
        frames.append(pd.DataFrame({**({"panel": [clean(title, 80)] * len(rows)} if len(traces) > 1 else {}), **told}))
    return pd.concat(frames, ignore_index=True).fillna("") if frames else pd.DataFrame()


def _text(value: float) -> str:
    return f"{value:.5g}".replace("-", "−") if np.isfinite(value) else ""


def spread(items: Sequence[Trace], most: int) -> list[Trace]:
    """At most `most` of the items, evenly chosen."""
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.unique(np.linspace(0, len(items) - 1, most).astype(int))]
