"""How a text file seems to be laid out: encoding, delimiter, decimal sign, header; looks at its first lines."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from pmabench.base.errors import invalid
from pmabench.store.importers.map_file import TextLayout

TABLE = 0.5
"""Least share of the lines below the first row of numbers that are such rows, too."""
LOOKED_AT = 400
"""Lines from the beginning."""
MARKS = {"tab": "\t", "semicolon": ";", "comma": ",", "bar": "|"}
COMMENTS = ("#", "%", "//", ";", "!")
NO_VALUE = {"nan", "na", "n/a", "null", "none", "-", "--", "", "inf", "-inf", "*", "#n/a", "err", "error", "overflow"}
MOST_MISSING = 12
_QUOTED = re.compile(r'"\s*[+-]?[\d.,]+(?:[eE][+-]?\d{1,3})?\s*"')
_POINT = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?\s*")
_COMMA = re.compile(r"\s*[+-]?(?:\d+,?\d*|,\d+)(?:[eE][+-]?\d{1,3})?\s*")


@dataclass
class TextGuess:
    """A layout with the names of its columns, and why."""

    layout: TextLayout
    names: list[str]
    """In order; as the file gives them, or `column 1` and so on."""
    named: bool
    """The file gives the names."""
    texts: list[str]
    """Names of columns that hold words."""
    units: dict[str, str] = field(default_factory=dict)
    """From a line of units below the names."""
    reasons: list[str] = field(default_factory=list)


def guess_layout(path: str, content: bytes) -> TextGuess:
    """The layout that makes most cells of the first lines numbers; raises InvalidFile where none does."""
    text, encoding, why = _decoded(path, content)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[:LOOKED_AT]
    if len(lines) == LOOKED_AT or not text.endswith("\n"):
        lines = lines[: LOOKED_AT - 1]
    quoted = sum(_QUOTED.search(line) is not None for line in lines) > TABLE * sum(map(bool, lines))
    delimiter, decimal, rows = _cells(path, lines, quoted=quoted)
    width = rows[-1][1]
    first = next(number for number, count in rows if count == width)
    comment = _comment(lines, first)
    reasons = [why, _told(delimiter, decimal, width, len(rows))]
    if quoted:
        reasons.append("numbers stand in quotation marks")

    def cut(line: str) -> list[str]:
        return split(line, delimiter, quoted=quoted)

    names, units, skip = _header(lines, first, cut, width, comment, reasons)
    blank = any(not line.strip() for line in lines[:-1])
    if blank:
        reasons.append("blank lines stand in it, and are skipped")
    texts, missing, other = _words(lines[first:], cut, decimal, width)
    if missing:
        reasons.append(f"texts that stand for no value: {', '.join(repr(text) for text in missing)}")
    if other:
        told = ", ".join(str(names[k] if names else k + 1) for k in other)[:200]
        reasons.append(f"columns with the other decimal sign than the others are taken for words: {told}")
    called = names or [f"column {k + 1}" for k in range(width)]
    header_line = bool(names) and not units and skip is not None and not _twice(called)
    called = _apart(called)
    layout = TextLayout.model_validate(
        {
            "delimiter": delimiter,
            "quoted": quoted,
            "decimal": decimal,
            "encoding": encoding,
            "header": "first line" if header_line else "none",
            "names": [] if header_line else called,
            "skip_lines": (skip or 0) if header_line else _before(lines, first, comment),
            "blank_lines": "skip" if blank else "refuse",
            "comment": comment,
            "missing": missing,
        }
    )
    return TextGuess(layout, called, bool(names), [called[k] for k in texts], units, reasons)


def _decoded(path: str, content: bytes) -> tuple[str, str, str]:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            return content[:2_000_000].decode("utf-16", "ignore"), "utf-16", "utf-16, by its first two bytes"
        except UnicodeError as error:
            raise invalid(path, "begins like utf-16 and is not") from error
    if b"\0" in content:
        raise invalid(path, "is binary, and neither LabVIEW (.lvm), TDMS nor MATLAB (.mat): export it as text")
    part = content[:2_000_000]
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return part.decode("latin-1"), "latin-1", "latin-1, for it holds bytes that are not utf-8"
    return part.decode("utf-8-sig", "ignore"), "utf-8", "text in utf-8"


def split(line: str, delimiter: str, *, quoted: bool = False) -> list[str]:
    """Fields of a line as the importer takes them."""
    if quoted:
        with suppress(csv.Error):
            return next(csv.reader([line], delimiter=MARKS[delimiter]), [])
        return []
    return line.split() if delimiter == "blank" else line.split(MARKS[delimiter])


def _cells(path: str, lines: Sequence[str], *, quoted: bool) -> tuple[str, str, list[tuple[int, int]]]:
    """Delimiter, decimal sign, and (line from 0, fields) of all rows of numbers: the pair with most numbers wins."""
    best: tuple[tuple[int, int], str, str, list[tuple[int, int]]] | None = None
    for delimiter in ("tab", "semicolon", "comma", "bar", *(() if quoted else ("blank",))):
        for decimal, number in (("point", _POINT), ("comma", _COMMA)):
            if delimiter == decimal and not quoted:
                continue
            rows: list[tuple[int, int]] = []
            numbers = 0
            for index, line in enumerate(lines):
                fields = split(line, delimiter, quoted=quoted)
                good = sum(number.fullmatch(text) is not None for text in fields)
                if len(fields) > 1 and good >= 2 and 2 * good >= len(fields):
                    rows.append((index, len(fields)))
                    numbers += good
            if not rows:
                continue
            width = Counter(count for _, count in rows).most_common(1)[0][0]
            alike = [row for row in rows if row[1] == width]
            score = (numbers * len(alike) // len(rows), decimal == "point")
            if best is None or score > best[0]:
                best = (score, delimiter, decimal, alike)
    if best is None:
        raise invalid(path, "holds no rows of at least two numbers in its first lines: nothing can be guessed")
    first, count = best[3][0][0], len(best[3])
    below = sum(bool(line.strip()) for line in lines[first:])
    if count < TABLE * below:
        told = f"{count} of {below} lines from line {first + 1} on are rows of {best[3][0][1]} fields with numbers"
        raise invalid(path, f"is no table of numbers ({told}): nothing can be guessed")
    return best[1], best[2], best[3]


def _told(delimiter: str, decimal: str, width: int, rows: int) -> str:
    return f"{width} columns parted by {delimiter}, decimal {decimal}: so {rows} of the first lines are rows of numbers"


def _comment(lines: Sequence[str], first: int) -> str | None:
    for mark in COMMENTS:
        if any(line.lstrip().startswith(mark) for line in lines[:first]):
            return mark
    return None


def _header(
    lines: Sequence[str],
    first: int,
    cut: Callable[[str], list[str]],
    width: int,
    comment: str | None,
    reasons: list[str],
) -> tuple[list[str], dict[str, str], int | None]:
    """Names, units by name from a second line, and lines before the header (None: it is a comment)."""
    from pmabench.store.importers.units import spelled

    above = [(k, lines[k]) for k in range(first) if lines[k].strip()]
    candidates: list[tuple[int, list[str], bool]] = []
    for k, line in above[-3:]:
        commented = comment is not None and line.lstrip().startswith(comment)
        told = line.lstrip()[len(comment or "") :] if commented else line
        fields = [text.strip().strip('"').strip() for text in cut(told)]
        if len(fields) == width and any(re.search(r"[^\W\d_]", text) for text in fields):
            candidates.append((k, fields, commented))
    if not candidates:
        reasons.append("no line of names: the columns are told apart by what they hold")
        return [], {}, None
    k, fields, commented = candidates[-1]
    if len(candidates) > 1 and sum(bool(spelled(text)) for text in fields) * 2 > width:
        names = candidates[-2][1]
        reasons.append(f"names in line {candidates[-2][0] + 1}, their units in line {k + 1}")
        return names, {name: spelled(text) for name, text in zip(names, fields, strict=True)}, None
    if commented:
        reasons.append(f"names in line {k + 1}, which is a comment")
        return fields, {}, None
    reasons.append(f"names in line {k + 1}")
    before = k if comment is None else sum(1 for j in range(k) if not lines[j].lstrip().startswith(comment))
    return fields, {}, (k if before else 0)


def _before(lines: Sequence[str], first: int, comment: str | None) -> int:
    """Lines to skip where the map gives the names: all before the first row, without comments and blank ones."""
    strange = [k for k in range(first) if lines[k].strip() and not (comment and lines[k].lstrip().startswith(comment))]
    return strange[-1] + 1 if strange else 0


def _words(
    lines: Sequence[str], cut: Callable[[str], list[str]], decimal: str, width: int
) -> tuple[list[int], list[str], list[int]]:
    """Columns of words, texts that stand for no value in the others, and which of the words are numbers otherwise."""
    number, otherwise = (_COMMA, _POINT) if decimal == "comma" else (_POINT, _COMMA)
    cells = [row for row in map(cut, lines) if len(row) == width]
    texts: list[int] = []
    missing: set[str] = set()
    other: list[int] = []
    for column in range(width):
        strange = [row[column].strip() for row in cells if number.fullmatch(row[column]) is None]
        if not strange:
            continue
        if len(strange) > len(cells) / 2 or any(text.lower() not in NO_VALUE for text in strange):
            texts.append(column)
            if all(otherwise.fullmatch(text) for text in strange):
                other.append(column)
        else:
            missing |= set(strange)
    return texts, sorted(missing)[:MOST_MISSING], other


def _twice(names: Sequence[str]) -> bool:
    return len(set(names)) < len(names) or any(not name for name in names)


def _apart(names: Sequence[str]) -> list[str]:
    """Names that differ, none of them empty."""
    seen: Counter[str] = Counter()
    told = []
    for k, name in enumerate(names):
        text = name[:100] or f"column {k + 1}"
        seen[text] += 1
        told.append(text if seen[text] == 1 else f"{text} ({seen[text]})")
    return told
