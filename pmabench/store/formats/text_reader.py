"""Reads columns of numbers from text with a given layout, piece by piece, without guessing.

Arrow converts simple pieces. A piece that it refuses, or in which it finds numbers that are not finite, is read again
line by line, to accept what the map allows and to report faults with their lines.
"""

from __future__ import annotations

import codecs
import csv
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import IncrementalNewlineDecoder
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import InvalidFile, Problem, did_you_mean, invalid
from pmabench.store.formats.record import Format
from pmabench.store.formats.text import MARKS, MINUS, Fields, TextLayout, seconds_of
from pmabench.store.records import Array

PIECE = 4_000_000
"""Size of the pieces in which a file is read [bytes]."""
LONGEST_LINE = 8_000_000
SHOWN = 10
"""Largest number of faulty rows that are reported for one file."""
MOST_HEAD = 60
"""Largest number of header lines passed on to the caller, and of lines below the last row that are left out."""


@dataclass(frozen=True)
class Rows:
    """Consecutive rows of a file."""

    columns: dict[str, Array]
    """Name -> numbers, shape (n,); NaN for "no value"; seconds for times."""
    lines: NDArray[np.int64]
    """Line number in the file of each row, from 1; shape (n,)."""
    starts: tuple[int, ...] = ()
    """Rows, from 0, at which another test begins, after a repeated header."""


@dataclass
class TextReader:
    """Reads one file: `feed` takes its bytes in pieces of any size, `end` returns the last rows."""

    path: str
    layout: TextLayout
    wanted: Sequence[str]
    optional: Sequence[str] = ()
    ignored: Sequence[str] = ()
    texts: Mapping[str, str] = field(default_factory=dict)
    order: str = "year first"
    """Order of day and month in dates."""
    taken: list[str] = field(default_factory=list)
    """Names of the columns that are read, once the first row is known."""
    head: list[str] = field(default_factory=list)
    cut_end: bool = False
    cut_row: str = ""

    def __post_init__(self) -> None:
        encoding = self.layout.encoding
        decoder = codecs.getincrementaldecoder("utf-8-sig" if encoding == "utf-8" else encoding)()
        self._decoder = IncrementalNewlineDecoder(decoder, translate=True)
        self._plain = encoding not in ("utf-16", "utf-16-le", "utf-16-be")
        self._begun = False
        """Whether anything but blanks was read."""
        self._rest = ""
        """Decoded text that was not processed yet: the last complete line and an incomplete one."""
        self._zeros = 0
        """Number of zero bytes at the end, as left by an interrupted write."""
        self._line = 0
        """Number of processed lines."""
        self._names: list[str] = []
        self._header = ""
        self._below = 0
        """Number of lines below the header that are still to be skipped."""
        self._rows = 0
        self._seen = False
        """Whether any line was kept."""
        self._titles: list[tuple[int, str]] = []
        """Lines (number, text) that are not rows; allowed only above a repeated header or below the last row."""
        self._fields_of = Fields(self.layout, self.order)

    # -- pieces ------------------------------------------------------------------------------------------------

    def answer(self, piece: bytes, *, last: bool) -> tuple[dict[str, Any], list[Any]]:
        """The answer for a piece (see `apart`): head and arrays of the rows that it completes; all rows with `last`."""
        rows = self.feed(piece)
        if last:
            rows = self.joined([rows, self.end()])
        head = {"columns": list(rows.columns), "rows": len(rows.lines), "starts": rows.starts, "head": self.head}
        if last:
            head |= {"cut_end": self.cut_end, "cut_row": self.cut_row, "above": self._above()}
        return head, [*rows.columns.values(), rows.lines]

    def _above(self) -> list[list[str]]:
        """Texts in the wanted columns of each line that is as wide as a row but none, such as a line of units."""
        plain = (line.lstrip().removeprefix(self.layout.comment or "").lstrip() for line in self.head)
        rows = ([text.strip().strip('"').strip() for text in self._cells(line)] for line in plain)
        at = [self._names.index(name) for name in self.taken]
        return [[row[k] for k in at] for row in rows if len(row) == len(self._names) and row != self._names]

    def feed(self, piece: bytes) -> Rows:
        """The rows completed by this piece, except the last line, which may turn out to be cut off."""
        self._rest += self._decoded(piece, last=False)
        if not self._begun:
            return self._none()
        end = self._rest.rfind("\n")
        end = self._rest.rfind("\n", 0, max(end, 0))
        if end < 0:
            if len(self._rest) > LONGEST_LINE:
                raise invalid(self.path, f"has a line longer than {LONGEST_LINE // 1_000_000} MB", self._line + 1, 1)
            return self._none()
        block, self._rest = self._rest[: end + 1], self._rest[end + 1 :]
        return self._block(block)

    def end(self) -> Rows:
        """The last rows; raises InvalidFile where the file has no rows."""
        self._rest += self._decoded(b"", last=True)
        block, self._rest = self._rest, ""
        if not self._begun and not block.strip():
            raise invalid(self.path, "is empty")
        self.cut_end = bool(block) and not block.endswith("\n")
        body = block.rstrip()
        before, last = body[: body.rfind("\n") + 1], block[body.rfind("\n") + 1 :]
        parts = [self._block(before)] if before else []
        if last:
            parts.append(self._last(last))
        words = [title for title in self._titles if not self._blank(title[1])]
        if words and len(self._titles) <= MOST_HEAD:
            at, first = words[0]
            text = f'{len(words)} lines below the last row, from line {at} ("{first.strip()[:40]}") on'
            self.cut_row = f"{text}, are no rows: they were left out"
        elif self._titles:
            self._no_rows()
        if self._zeros:
            text = f"the file ends with {self._zeros} bytes of zero, as after an interrupted write: rows may be missing"
            self.cut_row = f"{self.cut_row}; {text}".removeprefix("; ")
        if not self._seen:
            raise invalid(self.path, "holds no data: all lines are blank, skipped or comments")
        if not self._rows:
            raise invalid(self.path, self.cut_row or "holds a header and no data", max(self._line, 1), 1)
        return self.joined(parts)

    def joined(self, parts: Sequence[Rows]) -> Rows:
        """Rows of several pieces, joined in order."""
        ends = np.cumsum([0, *(len(part.lines) for part in parts)])
        return Rows(
            {n: np.concatenate([p.columns[n] for p in parts if p.columns] or [np.empty(0)]) for n in self.taken},
            np.concatenate([np.empty(0, np.int64), *(part.lines for part in parts)]),
            tuple(int(end) + start for end, part in zip(ends, parts, strict=False) for start in part.starts),
        )

    def _last(self, last: str) -> Rows:
        """The last line, with blank ones after it; if it is cut off it is left out, and `cut_row` states this."""
        number = self._line + 1
        begun = bool(self._names)
        try:
            return self._block(last if last.endswith("\n") else last + "\n")
        except InvalidFile:
            fields = self._split(last.split("\n", 1)[0])
            count, expected = len(fields), len(self._names)
            if not begun or self._rows < 2 or not (count < expected or (self.cut_end and self._ends_badly(fields))):
                raise
            what = f"{count} of {expected} columns" if count < expected else "its last number is incomplete"
            self.cut_row = f"the last row is cut off, in line {number}: {what}; it was left out"
            self._line, self.cut_end = number, False
            return self._none()

    def _ends_badly(self, fields: Sequence[str]) -> bool:
        """Whether only the last field of a row is incomplete."""
        with suppress(ValueError):
            for name in self.taken:
                if name != self._names[-1]:
                    self._fields_of.value(fields[self._names.index(name)], self.texts.get(name, ""))
            return len(fields) == len(self._names)
        return False

    def _decoded(self, piece: bytes, *, last: bool) -> str:
        if self._plain and (self._zeros or b"\0" in piece):
            text = piece.rstrip(b"\0")
            if b"\0" in text or (self._zeros and text):
                raise invalid(self.path, f"is binary, not text (a zero at byte {piece.index(0)})")
            self._zeros, piece = self._zeros + len(piece) - len(text), text
        self._begun = self._begun or bool(piece.strip())
        try:
            return self._decoder.decode(piece, last).replace(MINUS, "-")
        except UnicodeError as error:
            where = f" (byte {error.start})" if isinstance(error, UnicodeDecodeError) else ""
            sentence = f"is not text in {self.layout.encoding}{where}; say the right encoding, or it is binary"
            raise invalid(self.path, sentence) from error

    def _none(self) -> Rows:
        return Rows({name: np.empty(0) for name in self.taken}, np.empty(0, np.int64))

    # -- blocks of whole lines ---------------------------------------------------------------------------------

    def _block(self, block: str) -> Rows:
        """The rows in a block of complete lines."""
        if not self._names or self._below:
            block = self._past_header(block)
            if not block:
                return self._none()
        layout = self.layout
        if layout.delimiter != "blank" and not layout.quoted and not (layout.comment and layout.comment in block):
            count = block.count("\n")
            found = self._by_arrow(block, count, MARKS[layout.delimiter])
            if found is not None and not self._titles and not np.isnan(next(iter(found.values()), np.empty(0))).any():
                lines = np.arange(self._line + 1, self._line + 1 + count)
                self._line, self._rows = self._line + count, self._rows + count
                return Rows(found, lines)
        return self._by_lines(block)

    def _past_header(self, block: str) -> str:
        """Process the lines above the first row; returns the rest of the block."""
        layout = self.layout
        while block:
            line, _, after = block.partition("\n")
            number = self._line + 1
            skipped = number <= layout.skip_lines
            if skipped or not self._counts(line, number):
                self._keep_head(line)
            elif not self._names:
                self._seen = True
                self._name(line, number)
                if layout.header == "none":
                    return block
                self._header, self._below = line.strip(), layout.lines_below_header
                self._keep_head(line)
            elif self._below:
                self._below -= 1
                self._keep_head(line)
            else:
                return block
            self._line, block = number, after
        return ""

    def _keep_head(self, line: str) -> None:
        if len(self.head) < MOST_HEAD:
            self.head.append(line[:400])

    def _counts(self, line: str, number: int) -> bool:
        """Whether a line is neither a comment nor blank; raises InvalidFile for a blank one that is not expected."""
        if self.layout.comment and line.lstrip().startswith(self.layout.comment):
            return False
        if not self._blank(line):
            return True
        if self.layout.blank_lines == "refuse":
            raise invalid(self.path, 'the line is blank; if that is usual say "blank_lines: skip"', number, 1)
        return False

    def _blank(self, line: str) -> bool:
        """Whether a line is empty or has only delimiters, as below a table of a spreadsheet."""
        return not line.strip().strip(MARKS.get(self.layout.delimiter)).strip()

    def _name(self, line: str, number: int) -> None:
        """Take the names of the columns from the header line (or the layout), and choose those to read."""
        fields = self._fields(line, number)
        if self.layout.header == "first line":
            names = [text.strip().strip('"').strip() for text in fields]
            if names and not names[-1] and len(names) > 1:  # each line ends with a delimiter
                names[-1] = "@end"
            if len(set(names)) < len(names):
                raise invalid(self.path, "two columns have the same name", number, 1)
        else:
            names = list(self.layout.names)
            while len(names) > len(fields) and names[-1] in {*self.optional, *self.ignored}:
                names.pop()
        wanted = [*self.wanted, *(name for name in self.optional if name in names)]
        known = {*wanted, *self.ignored, "@end"}
        problems = [
            *(Problem(self.path, number, 1, f'has no column "{n}"{did_you_mean(n, names)}')
              for n in wanted if n not in names),
            *[Problem(self.path, number, 1, f'the map does not say what column "{n}" is')
              for n in names if n not in known][:SHOWN],
        ]  # fmt: skip
        if problems:
            raise InvalidFile(problems)
        self._names, self.taken = names, wanted

    def _by_arrow(self, block: str, count: int, delimiter: str) -> dict[str, Array] | None:
        """The columns of a block of plain rows; None where Arrow cannot convert them all."""
        from pmabench.store.livestream import arrow_csv, numbers, pa  # not with the list of formats: it takes long

        layout, texts = self.layout, self.texts
        if layout.thousands is not None:
            return None
        try:
            table = arrow_csv.read_csv(
                pa.BufferReader(block.encode()),
                read_options=arrow_csv.ReadOptions(
                    use_threads=False, column_names=self._names, block_size=max(1 << 16, 2 * PIECE)
                ),
                parse_options=arrow_csv.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=False),
                convert_options=arrow_csv.ConvertOptions(
                    include_columns=self.taken,
                    column_types={name: pa.string() if name in texts else pa.float64() for name in self._names},
                    null_values=layout.missing,
                    strings_can_be_null=False,
                    decimal_point="," if layout.decimal == "comma" else ".",
                ),
            )
        except pa.ArrowException:
            return None
        if table.num_rows != count:
            return None
        columns: dict[str, Array] = {}
        for name, column in ((name, table.column(name)) for name in self.taken):
            if name in texts:
                with suppress(ValueError):
                    columns[name] = seconds_of(column.to_pylist(), texts[name], self.order)
                    continue
                return None
            values = np.concatenate([numbers(c.fill_null(np.nan) if c.null_count else c) for c in column.chunks])
            # words that Arrow takes for numbers ("nan", "inf") are neither finite nor missing
            if int(np.isfinite(values).sum()) + column.null_count != count:
                return None
            columns[name] = values
        return columns

    # -- line by line ------------------------------------------------------------------------------------------

    def _by_lines(self, block: str) -> Rows:
        """The rows of a block that Arrow alone cannot read; raises InvalidFile with its faults and their lines."""
        kept, numbers, starts = list[str](), list[int](), list[int]()
        for line in block.removesuffix("\n").split("\n"):
            self._line += 1
            begun = bool(self._rows or kept) or self.layout.repeated_header != "refuse"
            blank = begun and self.layout.blank_lines == "refuse" and self._blank(line)
            if not blank and not self._counts(line, self._line):
                continue
            if self._header and line.strip() == self._header:
                self._again(starts, len(kept))
            elif self._below:
                self._below -= 1
            elif blank or (begun and self._is_title(line)):
                self._titles.append((self._line, line))
            else:
                kept.append(line)
                numbers.append(self._line)
                if self._titles:
                    self._no_rows()
        if not kept:
            return Rows(self._none().columns, np.empty(0, np.int64), tuple(starts))
        self._seen = True
        rows: list[list[str]] = []
        if self.layout.delimiter == "blank" or self.layout.quoted:
            rows = [self._fields(line, number) for line, number in zip(kept, numbers, strict=True)]
            found = self._by_arrow("\n".join("\t".join(fields) for fields in rows) + "\n", len(kept), "\t")
        else:
            found = self._by_arrow("\n".join(kept) + "\n", len(kept), MARKS[self.layout.delimiter])
        if found is None:
            rows = rows or [self._split(line) for line in kept]
            self._rectangular(rows, numbers)
            found = self._each(rows, numbers)
        self._rows += len(kept)
        return Rows(found, np.array(numbers, dtype=np.int64), tuple(starts))

    def _is_title(self, line: str) -> bool:
        """Whether a line is not a row: it may belong to the header of another test, or be below all rows.

        After such a line it is enough that the first column has no value, as in a table of means.
        """
        fields = self._cells(line)
        other = len(fields) != len(self._names)
        if other and self.layout.repeated_header != "refuse":
            return True
        reads = (self._reads(name, fields) for name in sorted(self.taken, key=self._names.index))
        return not next(reads) and (other or bool(self._titles) or not any(reads))

    def _reads(self, name: str, fields: Sequence[str]) -> bool:
        """Whether a line has a finite value in a column."""
        with suppress(ValueError, IndexError):
            return isfinite(self._fields_of.value(fields[self._names.index(name)], self.texts.get(name, "")))
        return False

    def _no_rows(self) -> None:
        """Raise InvalidFile for lines that are not rows, because rows follow them or they are too many."""
        for number, line in self._titles:
            self._counts(line, number)
        numbers, rows = [number for number, _ in self._titles], [self._split(line) for _, line in self._titles]
        self._rectangular(rows, numbers)
        self._each(rows, numbers)

    def _again(self, starts: list[int], row: int) -> None:
        """Handle a repeated header line: another test begins, if the map allows that."""
        if self.layout.repeated_header == "refuse":
            text = 'the header is repeated: say "repeated_header: new test" or, where the test goes on below it, "page"'
            raise invalid(self.path, text, self._line, 1)
        if self.layout.repeated_header == "new test":
            starts.append(row)
        self._titles.clear()
        self._below = self.layout.lines_below_header

    def _split(self, line: str) -> list[str]:
        return line.split(MARKS.get(self.layout.delimiter))

    def _cells(self, line: str) -> list[str]:
        """Fields of a line, also where quotation marks are set wrongly."""
        mark = MARKS.get(self.layout.delimiter, ",")
        return next(csv.reader([line], delimiter=mark), []) if self.layout.quoted else self._split(line)

    def _fields(self, line: str, number: int) -> list[str]:
        """Fields of one line, without quotation marks where the map allows them."""
        if not self.layout.quoted:
            return self._split(line)
        try:
            (fields,) = csv.reader([line], delimiter=MARKS[self.layout.delimiter], strict=True)
        except (csv.Error, ValueError) as error:
            sentence = "the line ends within quotation marks, or they are set wrongly"
            raise invalid(self.path, sentence, number, 1) from error
        if any("\t" in text for text in fields):
            raise invalid(self.path, "holds a tab within a field", number, 1)
        return fields

    def _rectangular(self, rows: Sequence[Sequence[str]], numbers: Sequence[int]) -> None:
        """Raise InvalidFile where a row has another number of fields than there are names."""
        expected = len(self._names)
        wrong = [(number, len(row)) for number, row in zip(numbers, rows, strict=True) if len(row) != expected]
        if wrong and len(wrong) == len(rows) and {count for _, count in wrong} == {1} and not self._rows:
            text = f"is not delimited by {self.layout.delimiter}: the whole line is one column, {expected} are expected"
            raise invalid(self.path, text, numbers[0], 1)
        if wrong:
            text = f"has {{}} columns, {expected} are expected"
            raise InvalidFile(Problem(self.path, number, 1, text.format(count)) for number, count in wrong[:SHOWN])

    def _each(self, rows: Sequence[Sequence[str]], numbers: Sequence[int]) -> dict[str, Array]:
        """Convert every wanted field separately; raises InvalidFile with the first faults and their places."""
        problems: list[Problem] = []
        columns: dict[str, Array] = {}
        for name in self.taken:
            index = self._names.index(name)
            values = np.empty(len(rows))
            for at, row in enumerate(rows):
                try:
                    values[at] = self._fields_of.value(row[index], self.texts.get(name, ""))
                except ValueError as error:
                    shown = f'"{row[index].strip()[:40]}" {error}, in column "{name}"'
                    column = 1 + sum(len(text) + 1 for text in row[:index])
                    problems.append(Problem(self.path, numbers[at], column, shown))
                    if len(problems) >= SHOWN:
                        break
            columns[name] = values
        if problems:
            raise InvalidFile(sorted(problems, key=lambda problem: problem.line)[:SHOWN])
        return columns


FORMAT = Format(
    name="text",
    title="text",
    layout=TextLayout,
    recognise=lambda content: False,  # the default where no format recognises a file
    reader=TextReader,
    modules=("pmabench.store.livestream",),
)
