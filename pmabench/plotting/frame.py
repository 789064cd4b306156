"""A table of text for people, before any format. In place of pandas, whose import takes longer than most reductions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import compress
from typing import Any


class Frame:
    """Named columns and rows of cells; a cell that a row lacks is empty text."""

    def __init__(self, rows: Iterable[Mapping[str, Any]] = (), columns: Sequence[str] | None = None) -> None:
        """Rows as column -> cell; columns in the order in which they come, or as given."""
        given = list(rows)
        self.columns = list(dict.fromkeys(name for row in given for name in row) if columns is None else columns)
        self.rows = [{name: "" if row.get(name) is None else row[name] for name in self.columns} for row in given]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, column: str) -> list[Any]:
        """The cells of a column."""
        return [row[column] for row in self.rows]

    def select(self, columns: Sequence[str]) -> Frame:
        """Some columns, in the order given."""
        return Frame(self.rows, columns)

    def without(self, column: str) -> Frame:
        """All columns but one."""
        return self.select([name for name in self.columns if name != column])

    def where(self, keep: Iterable[bool]) -> Frame:
        """Some rows: whether to keep each of them."""
        return Frame(compress(self.rows, keep), self.columns)

    def filled(self) -> Frame:
        """The columns in which some cell is not empty."""
        return self.select([name for name in self.columns if any(cell != "" for cell in self[name])])

    def renamed(self, column: str, name: str) -> Frame:
        """With another name for a column."""
        rows = [{name if key == column else key: cell for key, cell in row.items()} for row in self.rows]
        return Frame(rows, [name if key == column else key for key in self.columns])

    def cells(self) -> list[list[str]]:
        """All cells as text, row by row."""
        return [[str(cell) for cell in row.values()] for row in self.rows]
