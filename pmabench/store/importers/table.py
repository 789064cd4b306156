"""The columns of one file that a map uses, for any format: numbers, line numbers, and data about the file.

Small columns stay in memory, large ones are kept in temporary files.
"""

from __future__ import annotations

import hashlib
import tempfile
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from io import SEEK_END
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import invalid, reading
from pmabench.base.text import printable
from pmabench.store.formats.record import TIME, Layout, formats
from pmabench.store.formats.text import Clock, Stamps, step_in
from pmabench.store.importers.apart import Answer, read_apart
from pmabench.store.importers.map_file import spelled
from pmabench.store.records import Array

KEPT = 16_000_000
"""Total size of columns that are kept in memory [bytes]."""
LINE = "line"


def _close(files: dict[str, IO[bytes]]) -> None:
    for file in files.values():
        file.close()


class Columns(Mapping[str, Array]):
    """Equally long columns by name; `columns[name]` is a whole one, `part` some rows of all."""

    def __init__(self) -> None:
        """Begin without columns; the first piece gives their names."""
        self.rows = 0
        self._files: dict[str, IO[bytes]] = {}
        weakref.finalize(self, _close, self._files)

    def append(self, piece: Mapping[str, Array]) -> None:
        """Add rows at the end. Raises OSError where the folder for temporary files is full."""
        if not self._files:
            most = max(1, KEPT // max(1, len(piece)))  # bytes of a column in memory
            self._files |= {name: tempfile.SpooledTemporaryFile(most) for name in piece}  # noqa: SIM115
        for name, values in piece.items():
            self._files[name].seek(0, SEEK_END)
            self._files[name].write(np.ascontiguousarray(values, dtype=np.float64).data)
        self.rows += len(next(iter(piece.values()), ()))

    def part(self, begin: int, end: int) -> dict[str, Array]:
        """Rows `begin` to `end` (exclusive) of all columns."""
        return {name: self._read(name, begin, end) for name in self}

    def _read(self, name: str, begin: int, end: int) -> Array:
        values = np.empty(max(0, min(end, self.rows) - begin))
        self._files[name].seek(8 * begin)
        self._files[name].readinto(values.data)  # type: ignore[attr-defined]
        return values

    def __getitem__(self, name: str) -> Array:
        return self._read(name, 0, self.rows)

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)


MAX_BYTES = 2_000_000_000
"""Largest size of a file that is read in pieces [bytes]."""
MAX_WHOLE = 200_000_000
"""Largest size of a file that is read at once [bytes]."""
PIECE = 4_000_000
"""Size of the pieces in which a file is read [bytes]."""


@dataclass(frozen=True)
class Table:
    """Columns of one file, or of one of several tests in it."""

    path: Path
    sha256: str
    """Hash of the whole file."""
    size: int
    """Size of the whole file [bytes]."""
    columns: Mapping[str, Array]
    """Name -> numbers, shape (n,); NaN for "no value". Large columns are read from disk on access."""
    lines: Columns
    """Column `LINE`: line number of each row of the file, from 1; row number where the file has no lines."""
    cut_end: bool
    """Whether the last row may be incomplete."""
    started: datetime | None
    """Start of the recording from the file, in local time of the recording computer."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Name -> unit that the file gives."""
    doubts: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    """Columns of the file that were not requested."""
    cut_row: str = ""
    """Sentence about text at the end of the file that was left out because it is not a complete row; or empty."""
    starts: tuple[int, ...] = ()
    """Rows at which another test begins, after a repeated header."""
    begin: int = 0
    """Row of the file at which this table begins."""

    def __len__(self) -> int:
        if isinstance(self.columns, Columns):
            return self.columns.rows
        return max(map(len, self.columns.values()), default=0)

    def line(self, row: int) -> int:
        """Line number in the file of a row."""
        return int(self.lines.part(self.begin + row, self.begin + row + 1)[LINE][0])

    def part(self, begin: int, end: int) -> Table:
        """Rows `begin` to `end` (exclusive), in memory."""
        if isinstance(self.columns, Columns):
            columns = self.columns.part(begin, end)
        else:
            columns = {name: values[begin:end] for name, values in self.columns.items()}
        whole = end == len(self)
        return replace(
            self,
            columns=columns,
            begin=self.begin + begin,
            cut_end=self.cut_end and whole,
            cut_row=self.cut_row if whole else "",
            doubts=self.doubts if begin == 0 else (),
            left_out=self.left_out if begin == 0 else (),
        )

    def tests(self) -> list[Table]:
        """The tests of the file, each with its own rows; the table itself if it has one test."""
        if not self.starts:
            return [self]
        return [replace(self.part(a, b), starts=()) for a, b in pairwise((0, *self.starts, len(self))) if b > a]


def read_table(
    path: Path,
    layout: Layout,
    wanted: Sequence[str],
    optional: Sequence[str] = (),
    ignored: Sequence[str] = (),
    stamps: Stamps | None = None,
    most: int | None = None,
) -> Table:
    """The `wanted` columns of a file, and existing `optional` ones, read in a separate process.

    `stamps`: form of its time; the time column is then converted to seconds, unless it has plain numbers. `most`:
    number of bytes of text to read. Raises InvalidFile with every fault, with line numbers where possible.
    """
    asked = [name for name in wanted if layout.period is None or name != TIME]
    question = {"layout": layout.model_dump(mode="json"), "wanted": asked, "optional": optional, "ignored": ignored}
    table = _read(path, question, stamps, most)
    if layout.period is None:
        return table
    if TIME in table.columns:
        raise invalid(path, f'has a column "{TIME}"; leave out "period"')
    period, starts = np.float64(layout.period), np.array((0, *table.starts))
    made = with_made(table, TIME, lambda row: (row - starts[np.searchsorted(starts, row, "right") - 1]) * period)
    return replace(made, units={**table.units, TIME: "s"})


def with_made(table: Table, name: str, make: Callable[[NDArray[np.intp]], Array]) -> Table:
    """The table with a further column, which `make` calculates from row numbers, shape (n,)."""
    columns = Columns()
    for begin in range(0, len(table), PIECE // 8):
        end = min(begin + PIECE // 8, len(table))
        columns.append({**table.part(begin, end).columns, name: make(np.arange(begin, end))})
    return replace(table, columns=columns)


def read_all(path: Path, layout: Layout) -> tuple[dict[str, Array], dict[str, str], list[str]]:
    """All columns of a file whose format names them, not all equally long; units by name; names of other parts.

    Raises InvalidFile where it cannot be read.
    """
    question = {"layout": layout.model_dump(mode="json"), "wanted": None}
    (answer,) = read_apart(layout.format, str(path), [content_of(path)], question)
    units = dict(zip(answer.columns, answer.head["units"], strict=True))
    return answer.columns, units, [printable(name) for name in answer.head["left_out"]]


def _other_matrices(columns: Mapping[str, Array], time: str) -> list[str]:
    """Doubts about channels that belong to another matrix than the time."""
    of = {name: name.partition("(:,")[0] for name in columns if "(:," in name}
    others = ", ".join(name for name, matrix in of.items() if time in of and matrix != of[time])[:200]
    text = f'the time is "{time}", and {others} of other matrices: nothing says that they go together'
    return [text] if others else []


def _read(path: Path, question: Mapping[str, Any], stamps: Stamps | None, most: int | None) -> Table:
    kind = question["layout"]["format"]
    in_pieces = formats()[kind].reader is not None
    _check_size(path, MAX_BYTES if in_pieces else MAX_WHOLE)
    if stamps is not None:
        question = {**question, "texts": stamps.texts, "order": stamps.order}
    digest, rows = hashlib.sha256(), _Rows(path, stamps)
    with reading(path), path.open("rb") as file:
        pieces = _pieces(file, digest, most, PIECE if in_pieces else MAX_WHOLE)
        for answer in read_apart(kind, str(path), pieces, question):
            rows.take(answer)
        size = file.tell()
    head = rows.head
    started = datetime.fromisoformat(head["started"]) if head.get("started") else None
    doubts = [*head.get("doubts", []), *(_other_matrices(rows.columns, stamps.column) if stamps is not None else [])]
    return Table(
        path=path,
        sha256=digest.hexdigest(),
        size=size,
        columns=rows.columns,
        lines=rows.lines,
        cut_end=bool(head.get("cut_end")),
        started=rows.started or started,
        units=dict(zip(head.get("columns", ()), head.get("units") or _line_of_units(head), strict=False)),
        doubts=tuple(printable(text) for text in doubts),
        left_out=tuple(printable(text) for text in head.get("left_out", [])),
        cut_row=printable(head.get("cut_row", "")),
        starts=tuple(rows.starts),
    )


def _line_of_units(head: Mapping[str, Any]) -> Sequence[str]:
    """The last line above the rows that has units in more than half of its columns; else empty.

    Oscilloscopes write "Volt" for any quantity.
    """
    if step_in(head.get("head", ())):
        return ()
    lines = reversed(head.get("above", ()))
    return next((line for line in lines if 2 * sum(bool(spelled(text)) for text in line) > len(line)), ())


def _pieces(file: IO[bytes], digest: Any, most: int | None, size: int) -> Iterator[bytes]:
    """The file piece by piece, while `digest` is updated; with `most` it ends at the last complete line within that."""
    left = most if most is not None else MAX_BYTES
    while left > 0 and (piece := file.read(min(size, left))):
        digest.update(piece)
        left -= len(piece)
        if left <= 0 and most is not None and file.read(1):
            piece = piece[: piece.rfind(b"\n") + 1]
        yield piece


class _Rows:
    """Collects the child's answers, and converts times to seconds, test by test."""

    def __init__(self, path: Path, stamps: Stamps | None) -> None:
        self.path, self.stamps = path, stamps
        self.columns, self.lines = Columns(), Columns()
        self.starts: list[int] = []
        self.started: datetime | None = None
        self.head: Mapping[str, Any] = {}
        """Head of the last answer, with data about the file and its end."""
        self._clock: Clock | None = None

    def take(self, answer: Answer) -> None:
        """Add the rows of the next piece."""
        columns, count = dict(answer.columns), len(answer.lines)
        starts = [int(start) for start in answer.head.get("starts", ())]
        if self.stamps is not None and self.stamps.column in columns:
            t, date = columns[self.stamps.column], columns.pop(self.stamps.date, None)
            if self._clock is None:
                self._clock = self._first_clock(self.stamps, t, answer.head.get("head", ()))
            parts = []
            for begin, end in pairwise((0, *starts, count)):
                if begin in starts:
                    self._clock = Clock(self.stamps, self._clock.step)
                parts.append(self._clock.seconds(t[begin:end], None if date is None else date[begin:end]))
                self.started = self.started or self._clock.started
            columns[self.stamps.column] = np.concatenate(parts)
        if columns or count:
            self.columns.append(columns)
        self.starts += [self.lines.rows + start for start in starts if self.lines.rows + start > 0]
        self.lines.append({LINE: answer.lines})
        self.head = answer.head

    def _first_clock(self, stamps: Stamps, t: Array, head: Sequence[str]) -> Clock:
        """The clock of the file; raises InvalidFile where the header of the file contradicts the map."""
        step = step_in(head)
        if stamps.written == "header step" and step is None:
            text = 'has no header that gives Start and Increment, which "written: header step" needs'
            raise invalid(self.path, text)
        sequence = len(t) > 2 and bool(np.all(np.diff(t) == 1.0))
        if stamps.written == "number" and step is not None and sequence:
            text = f'"{stamps.column}" counts samples, and the header gives Start {step[0]:g} s and Increment '
            raise invalid(self.path, f'{text}{step[1]:g} s: say "written: header step"')
        return Clock(stamps, step)


def _check_size(path: Path, most: int) -> None:
    """Raise InvalidFile where a path is not a file, or the file is empty or larger than `most` [bytes]."""
    if path.is_dir():
        raise invalid(path, "is a folder; give the files in it, for instance with /*.csv")
    if not path.is_file():
        raise invalid(path, "is not a file" if path.exists() else "there is no such file")
    with reading(path):
        size = path.stat().st_size
    if not 0 < size <= most:
        raise invalid(path, f"is larger than {most // 1_000_000} MB; import it in parts" if size else "is empty")


def content_of(path: Path, most: int | None = None) -> bytes:
    """The first `most` bytes of a file (None: all); raises InvalidFile where it is missing, empty or too large."""
    _check_size(path, MAX_WHOLE if most is None else MAX_BYTES)
    with reading(path), path.open("rb") as file:
        content = file.read(MAX_WHOLE if most is None else most)
    if not content.strip():
        raise invalid(path, "is empty")
    return content
