"""Tables ready for a page: cut where too wide, columns aligned, `a ± b` split, rows grouped; knows no format."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from pmabench.plotting.wording import AT_MOST, POINTS, UNRESOLVED, WITHHELD, Frame, point_head
from pmabench.report.document.tables import Table

MOST_ROWS = 600
BRIEF = 32
"""Letters of a text that is kept on one line."""
SHORT = 16
"""Rows of a table that is not broken across pages."""
FEWEST_IN_GROUP = 3
"""Rows a method, from which on methods become headings of groups of rows instead of a column."""
MUTED = ("not identifiable", UNRESOLVED, WITHHELD)
"""Texts in place of a number."""
_PAIR = re.compile(r"(−?[\d.]+) ± ([\d.]+)")
_NUMBER = re.compile(r"[−-]?[\d.,]+(×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")


@dataclass(frozen=True)
class Cell:
    """A cell: its text, or value and half width apart so that columns align at the sign."""

    text: str
    half: str = ""
    muted: bool = False


@dataclass(frozen=True)
class Column:
    """Head and alignment of a column."""

    head: str
    align: str
    """`pair`, `number`, `brief` (not to be broken into lines) or `text`."""


@dataclass(frozen=True)
class Grid:
    """A table ready for the template; `groups` are (heading or empty, rows)."""

    columns: list[Column]
    groups: list[tuple[str, list[list[Cell]]]]
    caption: str = ""

    @property
    def width(self) -> int:
        """Number of HTML columns."""
        return sum(2 if column.align == "pair" else 1 for column in self.columns)

    @property
    def short(self) -> bool:
        """Whether it can be kept on one page."""
        return sum(len(rows) for _, rows in self.groups) <= SHORT


def grid(frame: Frame, caption: str = "", *, group: bool | None = None) -> Grid:
    """A frame of text as a table: columns of `a ± b` split, empty columns left out.

    Methods become headings of groups of rows with `group`, or where it is None and that makes few headings.
    """
    if len(frame) > MOST_ROWS:
        caption = f"{caption}; the first {MOST_ROWS} of {len(frame)}, all lie in the analysis folder".lstrip("; ")
        frame = Frame(frame.rows[:MOST_ROWS], frame.columns)
    shown_columns = frame.filled().columns if len(frame) else frame.columns
    methods = len(set(frame["method"])) if "method" in shown_columns else 0
    few = methods == 1 or len(frame) >= FEWEST_IN_GROUP * methods
    grouped = methods > 0 and (few if group is None else group)
    columns = []
    for name in shown_columns:
        if grouped and name == "method":
            continue
        values = [str(v) for v in frame[name] if str(v) not in ("", *MUTED) and not str(v).startswith(AT_MOST)]
        align = "text"
        if values and all(_PAIR.fullmatch(v) for v in values):
            align = "pair"
        elif values and all(_NUMBER.fullmatch(v) for v in values) and name not in ("run", "trial"):
            align = "number"
        elif all(len(str(v)) <= BRIEF for v in frame[name]):
            align = "brief"
        columns.append(Column(str(name), align))
    groups: list[tuple[str, list[list[Cell]]]] = []
    for record in frame.rows:
        heading = str(record["method"]) if grouped else ""
        if not groups or groups[-1][0] != heading:
            groups.append((heading, []))
        groups[-1][1].append([_cell(str(record[c.head]), c.align) for c in columns])
    return Grid(columns, groups, caption)


def _cell(text: str, align: str) -> Cell:
    pair = _PAIR.fullmatch(text) if align == "pair" else None
    return Cell(pair[1], pair[2]) if pair else Cell(text, muted=text in MUTED)


MOST = 7.0
"""Most columns of values next to those of the operating point; one without intervals counts as `PLAIN` of one."""
PLAIN = 0.6


def narrow(table: Table) -> list[Table]:
    """The table, or tables whose cells are together those of it; every row of them has a value."""
    heads = {"method", *(point_head(name) for name in POINTS)}  # of method and operating point; the others are values
    keys = [c for c in table.frame.columns if c in heads]
    values = [c for c in table.frame.columns if c not in heads]
    if _width(table.frame, values) <= MOST:
        return [table]
    chunks: list[list[str]] = []
    for symbol in dict.fromkeys(value.partition(" [")[0] for value in values):
        alike = [value for value in values if value.partition(" [")[0] == symbol]
        if chunks and _width(table.frame, [*chunks[-1], *alike]) <= MOST:
            chunks[-1] += alike
            continue
        for value in alike:
            if value == alike[0] or _width(table.frame, [*chunks[-1], value]) > MOST:
                chunks.append([])
            chunks[-1].append(value)
    captions = [table.caption, *[f"{table.caption} (continued)".lstrip()] * (len(chunks) - 1)]
    return [_part(table, keys, chunk, caption) for chunk, caption in zip(chunks, captions, strict=True)]


def _width(frame: Frame, columns: Sequence[str]) -> float:
    """Width of columns together, counted in columns with intervals."""
    return sum(1.0 if any("±" in str(cell) for cell in frame[c]) else PLAIN for c in columns)


def _part(table: Table, keys: Sequence[str], values: Sequence[str], caption: str) -> Table:
    """Some columns of values with the rows that have any, and what of the operating point these rows have."""
    frame = table.frame.where(any(row[value] != "" for value in values) for row in table.frame.rows)
    return Table(caption, frame.select([*frame.select(keys).filled().columns, *values]))
