"""Columns of values as a table for people, in the units that they read, or as comma-separated values in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pmabench.cli.common import Ui

Column = Mapping[str, Any]
"""`name`, `quantity`, `values` (numbers in SI, None where not finite, or names); `unit` for CSV."""


def print_table(ui: Ui, columns: Sequence[Column], keys: int) -> None:
    """The columns in display units; the first `keys` of them are repeated in every part of a table that is too wide."""
    from pmabench.report.terminal import print_grid

    heads = [f"{column['name']} {display_unit(column['quantity'])}".strip() for column in columns]
    cells = [_cells(column) for column in columns]
    texts = [head for head, column in zip(heads, columns, strict=True) if not column["quantity"]]
    print_grid(ui.console(), heads, [list(row) for row in zip(*cells, strict=True)], texts, keys)


def _cells(column: Column) -> list[str]:
    """Each value; what is negligible against the largest of the column is 0."""
    numbers = [abs(value) for value in column["values"] if isinstance(value, float)]
    least = 1e-9 * max(numbers, default=0.0)
    return [
        cell(column["quantity"], 0.0 if isinstance(value, float) and abs(value) < least else value)
        for value in column["values"]
    ]


def cell(quantity: str, value: float | str | None) -> str:
    """One value without its unit."""
    from pmabench.base.quantities import QUANTITIES

    if value is None or isinstance(value, str):
        return value or ""
    return f"{value / QUANTITIES[quantity].scale:.6g}"


def display_unit(quantity: str) -> str:
    """The unit that people read."""
    from pmabench.base.quantities import QUANTITIES

    return QUANTITIES[quantity].shown_in if quantity else ""


def si_unit(quantity: str) -> str:
    """The SI unit; "1" for a pure number."""
    from pmabench.base.quantities import QUANTITIES

    return QUANTITIES[quantity].unit if quantity else ""


def print_csv(columns: Sequence[Column]) -> None:
    """All digits, SI; the head is `name [unit]`."""
    import csv
    import sys

    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow([f"{c['name']} [{c['unit']}]" if c["unit"] else c["name"] for c in columns])
    for row in zip(*(c["values"] for c in columns), strict=True):
        writer.writerow(["" if value is None else value if isinstance(value, str) else repr(value) for value in row])
