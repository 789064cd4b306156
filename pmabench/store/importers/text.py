"""Reads columns of numbers from text with a layout that is given: nothing is guessed; knows no channels.

Rows are checked for their number of fields and characters before pandas turns them into numbers, because it fills
short rows and takes words for numbers without a word.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pmabench.base.errors import InvalidFile, Problem, did_you_mean, invalid
from pmabench.store.importers.map_file import TextLayout
from pmabench.store.records import Array

CHUNK = 100_000
"""Rows that pandas turns into numbers at a time."""
SHOWN = 10
"""Faulty rows that are told of one file."""
_DELIMITER = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|"}
_NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?\s*")
_PLAIN = frozenset("0123456789+-.eE \t")


@dataclass(frozen=True)
class TextTable:
    """Columns of one file."""

    columns: dict[str, Array]
    """Name -> numbers, shape (n,); NaN where the file says that there is none."""
    lines: NDArray[np.int64]
    """Line in the file of each row, from 1."""
    cut_end: bool
    """The last row has no line end: its last number may be cut."""


def parse(
    path: str,
    content: bytes,
    layout: TextLayout,
    wanted: Sequence[str],
    optional: Sequence[str] = (),
    ignored: Sequence[str] = (),
) -> TextTable:
    """The `wanted` columns of a text file as numbers, and those of `optional` that it has; `path` is only told.

    It may hold those of `ignored` too, and no others. Raises InvalidFile, at file:line where there is one, for what is
    empty, binary, cut off, of another layout, lacks a column or holds no number where one should stand.
    """
    if not content.strip():
        raise invalid(path, "is empty")
    text = _decoded(path, content, layout.encoding)
    kept, lines = _kept(path, text, layout)
    if layout.quoted:
        kept = _unquoted(path, kept, lines, layout)
        layout = layout.model_copy(update={"delimiter": "tab"})
    names, first = _names(path, kept, lines, layout, optional)
    wanted = [*wanted, *(name for name in optional if name in names)]
    missing = [name for name in wanted if name not in names]
    known = [*wanted, *ignored]
    strange = [name for name in names if name not in known]
    if missing or strange:
        raise InvalidFile(
            [
                *(Problem(path, lines[0], 1, f'has no column "{n}"{did_you_mean(n, names)}') for n in missing),
                *(Problem(path, lines[0], 1, f'the map does not say what column "{n}" is') for n in strange[:SHOWN]),
            ]
        )
    body, numbers = kept[first:], lines[first:]
    if not body:
        raise invalid(path, "holds a header and no data", lines[0] if lines else 0, 1)
    _rectangular(path, body, numbers, layout, names)
    used = {name: names.index(name) for name in wanted}
    if not _looks_plain(body, layout):
        _only_numbers(path, body, numbers, layout, used)
    try:
        columns = _numbers(path, body, layout, names, wanted)
    except InvalidFile:
        _only_numbers(path, body, numbers, layout, used)
        raise
    return TextTable(
        columns=columns,
        lines=np.array(numbers, dtype=np.int64),
        cut_end=not text.endswith("\n"),
    )


def _decoded(path: str, content: bytes, encoding: str) -> str:
    if encoding != "utf-16" and b"\0" in content:
        raise invalid(path, f"is binary, not text (a zero at byte {content.index(0)})")
    try:
        text = content.decode("utf-8-sig" if encoding == "utf-8" else encoding)
    except UnicodeError as error:
        where = f" (byte {error.start})" if isinstance(error, UnicodeDecodeError) else ""
        raise invalid(path, f"is not text in {encoding}{where}; say the right encoding, or it is binary") from error
    return text.replace("\r\n", "\n")


def _kept(path: str, text: str, layout: TextLayout) -> tuple[list[str], list[int]]:
    """Lines that count and their numbers, without comments, skipped and blank lines."""
    kept: list[str] = []
    lines: list[int] = []
    all_lines = text.removesuffix("\n").split("\n")
    for number, line in enumerate(all_lines, 1):
        if number <= layout.skip_lines or (layout.comment and line.lstrip().startswith(layout.comment)):
            continue
        if not line.strip():
            if layout.blank_lines == "refuse":
                raise invalid(path, 'the line is blank; if that is usual say "blank_lines: skip"', number, 1)
            continue
        kept.append(line)
        lines.append(number)
    if not kept:
        raise invalid(path, "holds no data: all lines are blank, skipped or comments")
    return kept, lines


def _unquoted(path: str, kept: list[str], lines: list[int], layout: TextLayout) -> list[str]:
    """The lines with fields parted by tabs, without the quotation marks around them."""
    told = []
    for line, number in zip(kept, lines, strict=True):
        try:
            (fields,) = csv.reader([line], delimiter=_DELIMITER[layout.delimiter], strict=True)
        except (csv.Error, ValueError) as error:
            raise invalid(path, "the line ends within quotation marks, or they are set wrongly", number, 1) from error
        if any("\t" in field for field in fields) and layout.delimiter != "tab":
            raise invalid(path, "holds a tab within a field", number, 1)
        told.append("\t".join(fields))
    return told


def _split(line: str, layout: TextLayout) -> list[str]:
    return line.split() if layout.delimiter == "blank" else line.split(_DELIMITER[layout.delimiter])


def _names(
    path: str, kept: list[str], lines: list[int], layout: TextLayout, optional: Sequence[str]
) -> tuple[list[str], int]:
    """Names of the columns of this file in order, and the index of the first row."""
    if layout.header == "first line":
        names = [field.strip().strip('"') for field in _split(kept[0], layout)]
        if len(set(names)) < len(names):
            raise invalid(path, "two columns have the same name", lines[0], 1)
        return names, 1
    names, count = list(layout.names), len(_split(kept[0], layout))
    while len(names) > count and names[-1] in optional:
        names.pop()
    return names, 0


def _rectangular(path: str, body: list[str], numbers: list[int], layout: TextLayout, names: list[str]) -> None:
    """Every row has as many fields as there are names."""
    expected = len(names)
    if layout.delimiter == "blank":
        counts = [len(line.split()) for line in body]
    else:
        mark = _DELIMITER[layout.delimiter]
        counts = [line.count(mark) + 1 for line in body]
    wrong = [index for index, count in enumerate(counts) if count != expected]
    if not wrong:
        return
    if wrong == [len(body) - 1]:
        message = f"the last row is cut off: {counts[-1]} of {expected} columns"
        raise invalid(path, message, numbers[-1], 1)
    if len(wrong) == len(body) and set(counts) == {1}:
        message = f"is not delimited by {layout.delimiter}: the whole line is one column, {expected} are expected"
        raise invalid(path, message, numbers[0], 1)
    raise InvalidFile(
        Problem(path, numbers[index], 1, f"has {counts[index]} columns, {expected} are expected")
        for index in wrong[:SHOWN]
    )


def _looks_plain(body: list[str], layout: TextLayout) -> bool:
    """Nothing but characters of numbers stands anywhere; words that pandas takes for numbers cannot hide then."""
    allowed = _PLAIN | {_DELIMITER.get(layout.delimiter, " ")}
    if layout.decimal == "comma":
        allowed = (allowed - {"."}) | {","}
    return not layout.missing and all(allowed.issuperset(line) for line in body)


def _only_numbers(path: str, body: list[str], numbers: list[int], layout: TextLayout, used: dict[str, int]) -> None:
    """Raises where a used field is neither a number nor one of the texts for "no value"."""
    problems: list[Problem] = []
    for line, number in zip(body, numbers, strict=True):
        fields = _split(line, layout)
        for name, index in used.items():
            field = fields[index]
            if field.strip() in layout.missing:
                continue
            text = field
            if layout.decimal == "comma":
                text = "?" if "." in field else field.replace(",", ".")
            if _NUMBER.fullmatch(text) is None:
                column = 1 + sum(len(f) + 1 for f in fields[:index])
                shown = field.strip()[:40]
                problems.append(Problem(path, number, column, f'"{shown}" is no number, in column "{name}"'))
        if len(problems) >= SHOWN:
            break
    if problems:
        raise InvalidFile(problems)


def _numbers(
    path: str, body: list[str], layout: TextLayout, names: list[str], wanted: Sequence[str]
) -> dict[str, Array]:
    """The columns, a chunk of rows at a time."""
    parts: list[pd.DataFrame] = []
    try:
        reader = pd.read_csv(
            io.StringIO("\n".join(body) + "\n"),
            sep=r"\s+" if layout.delimiter == "blank" else _DELIMITER[layout.delimiter],
            header=None,
            names=names,
            index_col=False,
            usecols=list(wanted),
            dtype=np.float64,
            decimal="," if layout.decimal == "comma" else ".",
            quoting=3,
            keep_default_na=False,
            na_values=list(layout.missing),
            engine="c",
            chunksize=CHUNK,
        )
        with reader:
            parts.extend(reader)
    except (ValueError, pd.errors.ParserError) as error:
        raise invalid(path, f"cannot be read as numbers: {' '.join(str(error).split())[:200]}") from error
    table = pd.concat(parts)
    columns = {name: table[name].to_numpy(dtype=np.float64) for name in wanted}
    for name, values in columns.items():
        if len(values) != len(body) or np.isinf(values).any() or (np.isnan(values).any() and not layout.missing):
            raise invalid(path, f'column "{name}" holds what is no finite number')
    return columns
