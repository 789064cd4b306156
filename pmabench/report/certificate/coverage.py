"""Which operating points the results rest on: a matrix of trials used over two coordinates of the sweep.

Counts come from the runs where these are at hand, else from the free runs that the analysis holds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from pmabench.plotting.wording import POINTS, in_order, number, point_shown
from pmabench.report.document.tables import is_number, mappings
from pmabench.report.foremost import left_out
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import RunData

MOST_ROWS, MOST_COLUMNS = 9, 12
FOLLOWING = ("mass", "cycles", "speed")
"""Coordinates that follow from others."""
Point = Mapping[str, float]


@dataclass(frozen=True)
class Box:
    """Trials of one operating point: how many are used, and how many were left out."""

    used: int
    left: int

    @property
    def text(self) -> str:
        """What is printed: `2`, `1 !` where others were left out, nothing where none was planned."""
        return f"{self.used or ''}{' !' if self.left and self.used else ''}".strip()

    @property
    def look(self) -> str:
        """`used`, `none` (all were left out) or `empty`."""
        return "used" if self.used else "none" if self.left else "empty"


@dataclass(frozen=True)
class Coverage:
    """The matrix; `down` and `across` name its sides with their units."""

    down: str
    across: str
    columns: list[str]
    rows: list[tuple[str, list[Box]]]
    used: int
    left: int
    words: str
    """Why trials were left out; empty where none was."""


def coverage(analysis: Analysis, runs: Sequence[RunData]) -> Coverage | None:
    """The matrix of one analysis; None where its trials name no operating point."""
    used, left = _counts(analysis, runs)
    every = [dict(point) for point in (*used, *left)]
    names = [
        name
        for name in in_order((key for point in every for key in point), POINTS)
        if name not in FOLLOWING and len({point.get(name) for point in every}) > 1
    ]
    names = names or in_order((key for point in every for key in point if key not in FOLLOWING), POINTS)[:1]
    if not names:
        return None
    across = "pressure" if "pressure" in names else names[0]
    down = next((name for name in names if name != across), "")
    columns = sorted({point[across] for point in every if across in point})
    rows = sorted({point[down] for point in every if down in point}, reverse=True) if down else [0.0]
    if not columns or not rows:
        return None
    columns, rows = columns[:: -(-len(columns) // MOST_COLUMNS)], rows[:: -(-len(rows) // MOST_ROWS)]

    def box(row: float, column: float) -> Box:
        here = [
            sum(n for key, n in counts.items() if dict(key).get(across) == column and _matches(key, down, row))
            for counts in (used, left)
        ]
        return Box(*here)

    return Coverage(
        _head(down) if down else "",
        _head(across),
        [_value(across, column) for column in columns],
        [(_value(down, row) if down else "all", [box(row, column) for column in columns]) for row in rows],
        used.total(),
        left.total(),
        left_out(analysis.dropped),
    )


Key = tuple[tuple[str, float], ...]


def _counts(analysis: Analysis, runs: Sequence[RunData]) -> tuple[Counter[Key], Counter[Key]]:
    """Trials that are used and left out, by operating point."""
    left = Counter(_key(one.point) for one in analysis.dropped)
    out = {one.trial for one in analysis.dropped}
    mine = [t for run in runs if run.id in analysis.runs for t in run.trials]
    if mine:
        return Counter(_key(t.point) for t in mine if t.name not in out and t.status == "finished"), left
    return Counter(dict(_free_runs(analysis))), left


def _free_runs(analysis: Analysis) -> Iterator[tuple[Key, int]]:
    for row in mappings(analysis.facts.get("free_run")):
        point = {name: row[name] for name in ("pressure", "load") if is_number(row.get(name))}
        if point and is_number(row.get("trials")):
            yield _key(point), int(row["trials"])


def _key(point: Point) -> Key:
    return tuple(sorted((k, float(f"{v:.6g}")) for k, v in point.items() if k not in FOLLOWING))


def _matches(key: Key, name: str, value: float) -> bool:
    return not name or dict(key).get(name) == value


def _head(name: str) -> str:
    label, unit = point_shown(name)
    return unit.label(label)


def _value(name: str, value: float) -> str:
    return number(float(f"{value / point_shown(name)[1].scale:.4g}"))
