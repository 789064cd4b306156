"""Differences as text, and those of a comparison as one HTML file; no estimate.

The page of a comparison has both sides over pressure, and the table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pmabench.analysis.verdict import comparison
from pmabench.analysis.verdict.comparison import Change, Difference, Side, percent
from pmabench.plotting.pictures import drawable
from pmabench.plotting.wording import Frame, clean, point_text, shown, symbol_text
from pmabench.report.coefficient_figures import over_pressure
from pmabench.report.document.special_tables import change_rows
from pmabench.report.overlays import Comparison, comparison_table
from pmabench.report.terminal import print_grid
from pmabench.report.words import declared
from pmabench.report.writing import Page, TextTable, write_page
from pmabench.store.analyses.results import PUBLISHED, Analysis

if TYPE_CHECKING:
    from rich.console import Console


def write_comparison(
    a: Side,
    b: Side,
    found: comparison.Comparison,
    curves: Sequence[Comparison],
    failed: Sequence[str],
    path: Path,
) -> Path:
    """Write the page; raises RecordError where it cannot be."""
    simulated = a.simulated or b.simulated
    sides = [_drawn(side, found.differences, which) for which, side in (("a", a), ("b", b))]
    drawn = over_pressure(sides, declared([*a.analyses, *b.analyses]), [_named(side) for side in (a, b)])
    heads, rows = rows_of(a, b, found.differences)
    curve_heads, curve_table = curve_rows(curves)
    return write_page(
        Page(
            "Comparison",
            f"{clean(a.name, 60)} against {clean(b.name, 60)}",
            simulated,
            [(clean(side.name, 60), clean(side.about, 600)) for side in (a, b)],
            failed,
            found.findings,
            drawn,
            [
                TextTable("Coefficient by coefficient", heads, rows, 3),
                TextTable("Curves compared with published points", curve_heads, curve_table, 3),
            ],
        ),
        path,
    )


def _named(side: Side) -> str:
    """The side in a legend, where a letter alone would be taken for a symbol."""
    return side.name if len(side.name) > 1 else f"side {side.name}"


def _drawn(side: Side, differences: Sequence[Difference], which: str) -> Analysis:
    """The compared values of a side as an analysis, whose method is the name of the side."""
    estimates = [replace(getattr(d, which), method=_named(side), coordinate=d.a.coordinate) for d in differences]
    kind = PUBLISHED if side.published else "comparison"
    return drawable(Analysis(kind, (), simulated=side.simulated, estimates=tuple(estimates)))


Rows = tuple[list[str], list[list[str]]]
"""Heads, and rows of text under them."""


def rows_of(a: Side, b: Side, differences: Sequence[Difference]) -> Rows:
    """A row for each difference: both values, a - b, in % of b, E_n."""
    one, other = clean(a.name, 30), clean(b.name, 30)
    heads = ["symbol", "at", "unit", one, other, f"{one} − {other}", "[%]", "E_n", ""]
    rows = []
    for d in differences:
        unit = shown(d.a.quantity, d.a.unit)
        marks = ["~" if side in d.between else "" for side in ("a", "b")]
        rows.append(
            [
                symbol_text(d.a.symbol, d.a.coordinate),
                point_text({name: float(f"{value:.6g}") for name, value in d.a.at.items()}),
                unit.unit,
                marks[0] + unit.rounded(d.a.value, d.a.parts.combined),
                marks[1] + unit.rounded(d.b.value, d.b.parts.combined),
                unit.rounded(d.value, d.half, 3),
                "" if d.relative is None else percent(d.relative).replace("-", "−"),
                "" if d.score is None else f"{d.score:+.2f}".replace("-", "−"),
                {True: "", False: "differs, or its scale" if d.lacks else "differs", None: "no interval"}[d.agrees],
            ]
        )
    return heads, rows


def curve_rows(curves: Sequence[Comparison]) -> Rows:
    """A row for each curve compared with published points."""
    frame = comparison_table(curves)
    return frame.columns, frame.cells()


HEADS = ("coefficient", "at", "unit", "as recorded", "as reduced here", "difference", "%")


def print_changes(changes: Sequence[Change], console: Console) -> None:
    """A table for each kind and method; the half width of the difference is that of the calibrations."""
    from rich.text import Text

    rows = []
    for change in changes:
        sides = (("as recorded", change.before), ("as reduced here", change.after))
        known = [(head, e, shown(e.quantity, e.unit)) for head, e in sides if e is not None and e.value is not None]
        values = {head: unit.rounded(e.value, e.parts.combined) for head, e, unit in known}
        rows += [{"kind": change.kind, **row, **values} for row in change_rows([change.to_dict()])]
    for kind, method in dict.fromkeys((row["kind"], row["method"]) for row in rows):
        console.print(Text(f"{kind}, {method}", style="italic"))
        mine = [row for row in rows if (row["kind"], row["method"]) == (kind, method)]
        print_grid(console, HEADS, Frame(mine, HEADS).cells(), ("coefficient", "at", "unit"), keys=2)
