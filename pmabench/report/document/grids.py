"""Tables ready for a page: cut where too wide, columns aligned, `a ± b` split, rows grouped; knows no format."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

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
    notes: list[str] = field(default_factory=list)
    """What the numbers in the column of notes mean; the first is 1."""

    @property
    def width(self) -> int:
        """Number of HTML columns."""
        return sum(2 if column.align == "pair" else 1 for column in self.columns)

    @property
    def short(self) -> bool:
        """Whether it can be kept on one page."""
        return sum(len(rows) for _, rows in self.groups) <= SHORT


def grid(frame: Frame, caption: str = "", *, group: bool | None = None, notes: str = "") -> Grid:
    """A frame of text as a table: columns of `a ± b` split, empty columns left out.

    Methods become headings of groups of rows with `group`, or where it is None and that makes few headings. The column
    named `notes` holds sentences, separated by semicolons: each goes below the table once, its number into the cells.
    """
    if len(frame) > MOST_ROWS:
        caption = f"{caption}; the first {MOST_ROWS} of {len(frame)}, all lie in the analysis folder".lstrip("; ")
        frame = Frame(frame.rows[:MOST_ROWS], frame.columns)
    frame, below = _numbered(frame, notes)
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
    return Grid(columns, groups, caption, below)


def _numbered(frame: Frame, name: str) -> tuple[Frame, list[str]]:
    """The frame with numbers in place of the sentences of one column, and the sentences."""
    if name not in frame.columns:
        return frame, []
    numbers: dict[str, int] = {}
    rows = []
    for row in frame.rows:
        said = (one for one in str(row[name]).split("; ") if one)
        rows.append(row | {name: ", ".join(str(numbers.setdefault(one, len(numbers) + 1)) for one in said)})
    return Frame(rows, frame.columns), list(numbers)


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
    tries = [_chunks(table.frame, values, most) for most in (MOST, 6.0, 5.0, 4.0)]
    even = (found for found in tries if len(found) == len(tries[0]) and min(map(len, found)) > 1)
    chunks = next(even, tries[0])  # if possible, none of a single column
    captions = [table.caption, *[f"{table.caption} (continued)".lstrip()] * (len(chunks) - 1)]
    return [_part(table, keys, chunk, caption) for chunk, caption in zip(chunks, captions, strict=True)]


def _chunks(frame: Frame, values: Sequence[str], most: float) -> list[list[str]]:
    """Columns of values, in order, in groups up to a width; those of one symbol together where they fit."""
    chunks: list[list[str]] = []
    for symbol in dict.fromkeys(value.partition(" [")[0] for value in values):
        alike = [value for value in values if value.partition(" [")[0] == symbol]
        if chunks and _width(frame, [*chunks[-1], *alike]) <= most:
            chunks[-1] += alike
            continue
        for value in alike:
            if value == alike[0] or _width(frame, [*chunks[-1], value]) > most:
                chunks.append([])
            chunks[-1].append(value)
    return chunks


def _width(frame: Frame, columns: Sequence[str]) -> float:
    """Width of columns together, counted in columns with intervals."""
    return sum(1.0 if any("±" in str(cell) for cell in frame[c]) else PLAIN for c in columns)


def _part(table: Table, keys: Sequence[str], values: Sequence[str], caption: str) -> Table:
    """Some columns of values with the rows that have any, and what of the operating point these rows have."""
    frame = table.frame.where(any(row[value] != "" for value in values) for row in table.frame.rows)
    return Table(caption, frame.select([*frame.select(keys).filled().columns, *values]))
