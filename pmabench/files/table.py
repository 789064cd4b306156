"""CSV tables with units in the header: numbers with their places; independent of models and reports.

A header is `pressure [kPa]`, `pressure (kPa)` or `P_kPa`; lines that begin with `#` before it state the source of the
table.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import InvalidFile, Problem, invalid, reading
from pmabench.files.quantity import NUMBER, unit_factor

Array = NDArray[np.float64]
LARGEST = 50_000_000
"""Largest file that is read [bytes]."""
MOST_ROWS = 200_000
MOST_PROBLEMS = 50
BEYOND = 1e30
"""Limit above which a value cannot be a measured one [SI]."""
_NUMBER = re.compile(NUMBER)
_BRACKETS = re.compile(r"(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))\s*")


@dataclass(frozen=True)
class Cell:
    """A text with its place; line and column count from 1."""

    text: str
    line: int
    column: int


@dataclass(frozen=True)
class Column:
    """One column: the whole header, the part before its unit, the unit (None if not given), the cells."""

    head: Cell
    name: str
    unit: str | None
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Table:
    """A table as it is written."""

    path: Path
    source: str
    """Text of the lines with `#` before the header."""
    columns: tuple[Column, ...]

    def problem(self, cell: Cell, message: str) -> Problem:
        """A `Problem` at a cell."""
        return Problem(str(self.path), cell.line, cell.column, message)


def read_table(path: Path) -> Table:
    """Read the table in `path`; the separator is comma, semicolon or tab, the most frequent in the header.

    Raises InvalidFile with every row whose number of cells differs from the header's.
    """
    lines = [(number, line) for number, line in enumerate(_text(path).splitlines(), 1) if line.strip()]
    source = []
    while lines and lines[0][1].lstrip().startswith("#"):
        source.append(lines.pop(0)[1].lstrip("# \t").strip())
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise invalid(path, 'holds no table; a head like "pressure [kPa], force [N]" and rows of numbers are expected')
    if len(lines) > MOST_ROWS:
        raise invalid(path, f"has {len(lines) - 1} rows; at most {MOST_ROWS} are read")
    mark = max(",;\t", key=lines[0][1].count)
    heads = _split(*lines[0], mark)
    problems, rows = [], []
    for number, line in lines[1:]:
        cells = _split(number, line, mark)
        if len(cells) == len(heads):
            rows.append(cells)
            continue
        hint = "; a decimal comma? write a point" if mark == "," and len(cells) > len(heads) else ""
        problem = f"{len(cells)} cells, {len(heads)} are expected as in the head{hint}"
        problems.append(Problem(str(path), number, 1, problem))
    for place, head in enumerate(heads):
        if head.text and any(head.text == before.text for before in heads[:place]):
            problems.append(Problem(str(path), head.line, head.column, f'a second column "{head.text}"'))
    if problems:
        raise InvalidFile(problems[:MOST_PROBLEMS])
    by_column = zip(*rows, strict=True)
    columns = tuple(Column(head, *split_head(head.text), mine) for head, mine in zip(heads, by_column, strict=True))
    return Table(path, " ".join(source), columns)


def _text(path: Path) -> str:
    try:
        with reading(path):
            if path.is_file() and path.stat().st_size > LARGEST:
                raise invalid(path, f"is larger than {LARGEST // 1_000_000} MB; give a table, not a record")
            return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        raise invalid(path, "is no text in UTF-8; save it as CSV in UTF-8") from None


def split_head(head: str) -> tuple[str, str | None]:
    """`pressure [kPa]` to ("pressure", "kPa"); without brackets the unit is None."""
    match = _BRACKETS.fullmatch(head)
    if match is None:
        return head.strip(), None
    unit = match["square"] if match["square"] is not None else match["round"]
    return match["name"].strip(), unit.strip()


def _split(number: int, line: str, mark: str) -> list[Cell]:
    """Cells of a line; a separator `mark` inside double quotes is part of the cell."""
    cells, start, quoted = [], 0, False
    for place, sign in enumerate(line + mark):
        if sign == '"':
            quoted = not quoted
        elif sign == mark and (not quoted or place == len(line)):
            raw = line[start:place]
            text = raw.strip()
            if len(text) > 1 and text[0] == text[-1] == '"':
                text = text[1:-1].replace('""', '"').strip()
            cells.append(Cell(text, number, start + len(raw) - len(raw.lstrip()) + 1))
            start = place + 1
    return cells


@dataclass(frozen=True)
class Wanted:
    """A quantity that a column may contain: its names (the first is used in messages) and its key in `QUANTITIES`."""

    names: tuple[str, ...]
    quantity: str


def meaning(column: Column, wanted: Sequence[Wanted]) -> tuple[Wanted, str | None] | None:
    """Entry of `wanted` that a header names, and its unit, else None; `P_kPa` is P in kPa unless it is a name."""
    for item in wanted:
        if column.name in item.names:
            return item, column.unit
    name, line, unit = column.name.rpartition("_")
    if line and unit and column.unit is None:
        for item in wanted:
            if name in item.names and item.quantity and _is_unit(unit, item.quantity):
                return item, unit
    return None


def _is_unit(unit: str, quantity: str) -> bool:
    with suppress(ValueError):
        return bool(unit_scale(unit, quantity))
    return False


def unit_scale(unit: str | None, quantity: str) -> float:
    """SI units in one `unit` of `quantity`; a ratio or a count needs none. Raises ValueError."""
    if unit in (None, "", "1", "-") and quantity in ("ratio", "count"):
        return 1.0
    if unit is None or unit in ("", "-"):
        raise ValueError(f"the head needs a unit of {quantity}")
    if re.search(r"\((?:g|a|abs|gauge)\)|abs", unit) and quantity == "pressure":
        raise ValueError(f'"{unit}": pressures are gauge; take the atmosphere off and write "kPa"')
    return unit_factor(unit, quantity)


def numbers(
    table: Table,
    columns: Sequence[tuple[Column, str, str | None]],
    check: Callable[[int, float], str] | None = None,
    within: Callable[[int, float], bool] | None = None,
    *,
    blank: bool = False,
) -> tuple[list[Array], list[int]]:
    """Values of the columns (column, quantity, unit) [SI], and the indices of their rows, without empty cells.

    `check` returns what is wrong with a value [SI] in a column (by index); rows with a false `within` are left out.
    With `blank` an empty cell is NaN and its row is kept. Raises InvalidFile with every cell that is no number.
    """
    problems, wide, found = list[Problem](), set[int](), list[Array]()
    rows = range(len(table.columns[0].cells))
    kept = [row for row in rows if blank or all(column.cells[row].text for column, _, _ in columns)]
    for place, (column, quantity, unit) in enumerate(columns):
        try:
            scale = unit_scale(unit, quantity)
        except ValueError as error:
            problems.append(table.problem(column.head, f"{column.head.text}: {error}"))
            continue
        values = np.full(len(kept), nan)
        for at, cell in enumerate(column.cells[row] for row in kept):
            if not cell.text:
                continue
            number = float(cell.text) * scale if _NUMBER.fullmatch(cell.text) else float("nan")
            wrong = "" if abs(number) < BEYOND else _no_number(cell.text)
            if not wrong and within is not None and not within(place, number):
                wide.add(at)
            elif not wrong and check is not None:
                wrong = check(place, number)
            if wrong:
                problems.append(table.problem(cell, f"{column.name}: {wrong}"))
            values[at] = number
        found.append(values)
    if problems:
        raise InvalidFile(problems[:MOST_PROBLEMS])
    inside = [at for at in range(len(kept)) if at not in wide]
    return [values[inside] for values in found], [kept[at] for at in inside]


def _no_number(text: str) -> str:
    if re.fullmatch(r"[+-]?\d+,\d+", text):
        return f'"{text}" has a decimal comma; write a point'
    return f'"{text}" is {"out of all range" if _NUMBER.fullmatch(text) else "no number"}'
