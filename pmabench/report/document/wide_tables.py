"""Tables too wide for a page, cut into several.

Rows at points of another kind (with an amplitude) are split off first, then methods with other columns; what is still
too wide is cut by columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from pmabench.plotting.wording import POINTS, clean, point_shown
from pmabench.report.document.tables import Table

MOST = 7.0
"""Most columns of values next to those of the operating point; one without intervals counts as `PLAIN` of one."""
PLAIN = 0.6


def narrow(table: Table) -> list[Table]:
    """The table, or tables whose cells are together those of it; every row of them has a value."""
    keys, values = _columns(table.frame)
    if _width(table.frame, values) <= MOST:
        return [table]
    for key in (key for key in keys if key != "method"):
        filled = table.frame[key] != ""
        if filled.any() and not filled.all():
            parts = [replace(table, frame=table.frame[rows]) for rows in (~filled, filled)]
            return [one for part in parts for one in narrow(_part(part, keys, _used(part.frame, values), part.caption))]
    if "method" in keys and table.frame["method"].nunique() > 1:
        groups: dict[tuple[str, ...], list[str]] = {}
        for method in dict.fromkeys(table.frame["method"]):
            rows = table.frame[table.frame["method"] == method]
            groups.setdefault(tuple(_used(rows, values)), []).append(str(method))
        if len(groups) > 1:
            return [
                part
                for used, methods in groups.items()
                for part in narrow(_part(table, keys, used, f"{table.caption}: {clean(', '.join(methods))}", methods))
            ]
    chunks: list[list[str]] = []
    for symbol in dict.fromkeys(_symbol(value) for value in values):
        alike = [value for value in values if _symbol(value) == symbol]
        if chunks and _width(table.frame, [*chunks[-1], *alike]) <= MOST:
            chunks[-1] += alike
            continue
        for value in alike:
            if value == alike[0] or _width(table.frame, [*chunks[-1], value]) > MOST:
                chunks.append([])
            chunks[-1].append(value)
    captions = [table.caption, *[f"{table.caption} (continued)".lstrip()] * (len(chunks) - 1)]
    return [_part(table, keys, chunk, caption) for chunk, caption in zip(chunks, captions, strict=True)]


def _columns(frame: pd.DataFrame) -> tuple[list[str], list[str]]:
    """Heads of method and operating point, and those of values."""
    heads = {"method", *(point_shown(name)[1].label(point_shown(name)[0]) for name in POINTS)}
    return [c for c in frame.columns if c in heads], [c for c in frame.columns if c not in heads]


def _used(frame: pd.DataFrame, values: Sequence[str]) -> list[str]:
    """Columns that have a cell."""
    return [c for c in values if (frame[c] != "").any()]


def _width(frame: pd.DataFrame, columns: Sequence[str]) -> float:
    """Of columns together, in columns with intervals."""
    return sum(1.0 if frame[c].astype(str).str.contains("±").any() else PLAIN for c in columns)


def _symbol(head: str) -> str:
    return head.partition(" [")[0]


def _part(
    table: Table, keys: Sequence[str], values: Sequence[str], caption: str, methods: Sequence[str] | None = None
) -> Table:
    """Some columns of values with the rows that have any, and what of the operating point these rows have."""
    frame = table.frame if methods is None else table.frame[table.frame["method"].isin(methods)]
    frame = frame[(frame[list(values)] != "").any(axis=1)]
    kept = [key for key in keys if (frame[key] != "").any()]
    return Table(caption, frame[[*kept, *values]].reset_index(drop=True))
