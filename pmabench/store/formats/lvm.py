"""LabVIEW measurement files (.lvm), read as text.

The layout is that of National Instruments, "Specification for the LabVIEW Measurement File (.lvm)": a header of keys,
then segments, each with its header, a line of names, and rows.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import islice
from typing import Literal

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, invalid
from pmabench.store.formats.record import TOGETHER, Column, Format, Layout, Recorded, begins, distinct
from pmabench.store.records import Array

MAGIC = (b"LabVIEW Measurement", b"\xef\xbb\xbfLabVIEW Measurement")
END = "***End_of_Header***"
KEYS = {
    *("Channels", "Samples", "Date", "Time", "Notes", "Test_Name", "Test_Numbers", "UUT_Name", "UUT_S/N", "UUT_M/N"),
    *("X_Dimension", "X0", "Delta_X", "Y_Dimension", "Y_Unit_Label", "X_Unit_Label"),
}
"""Keys in the header of a segment."""
SHOWN = 10
MAX_CHANNELS = 500
NO_NUMBER = {"nan": np.nan, "inf": np.inf, "+inf": np.inf, "-inf": -np.inf, "": np.nan}
_EXCHANGED = str.maketrans(",.", ".?")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?")


class LvmLayout(Layout):
    """LabVIEW measurement file: Tab or Comma, decimal point or comma, X_Columns No, One or Multi, several headings."""

    format: Literal["lvm"]


@dataclass
class _Segment:
    """One segment: its header, its names and its rows."""

    keys: dict[str, list[str]]
    names: list[str]
    first: int
    """Line number of its first row."""
    rows: list[tuple[int, list[str]]] = field(default_factory=list)


class _File:
    """The keys of the file's header, and the layout of its rows that follows from them."""

    def __init__(self, path: str, content: bytes) -> None:
        self.path = path
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
        self.ends = text.endswith(("\n", "\r"))
        self.lines = text.replace("\r\n", "\n").removesuffix("\n").split("\n")
        self.separator = self._separator()
        self.keys: dict[str, str] = {}
        self.body = self._header()
        self.x = self.key("X_Columns", {"No", "One", "Multi"}, "One")
        self.step = 2 if self.x == "Multi" else 1
        self.multi = self.key("Multi_Headings", {"Yes", "No"}, "No") == "Yes"
        self.decimal = self.keys.get("Decimal_Separator", "")
        if self.decimal not in {"", ".", ","}:
            raise invalid(path, f'says Decimal_Separator "{self.decimal[:20]}", which is neither point nor comma')

    def _separator(self) -> str:
        for number, line in enumerate(self.lines[:50], 1):
            if line.startswith("Separator"):
                if (line[9:10], line[10:].strip()) in {("\t", "Tab"), (",", "Comma")}:
                    return line[9:10]
                raise invalid(self.path, "says a separator that is neither Tab nor Comma", number, 1)
        raise invalid(self.path, "is no LVM file: its header has no line that begins with Separator", 1, 1)

    def _header(self) -> int:
        for number, line in enumerate(self.lines):
            key, _, value = line.partition(self.separator)
            if key.strip() == END:
                return number + 1
            self.keys.setdefault(key.strip(), value.strip())
        raise invalid(self.path, f"is cut off: its header has no {END}", len(self.lines), 1)

    def key(self, name: str, allowed: set[str], otherwise: str) -> str:
        value = self.keys.get(name, otherwise)
        if value not in allowed:
            raise invalid(self.path, f'says {name} "{value[:20]}", expected {" or ".join(sorted(allowed))}')
        return value

    def width(self, segment: _Segment) -> int:
        """Number of columns of a row."""
        return len(segment.names) * self.step + (self.x != "Multi")


def read_lvm(
    path: str, content: bytes, layout: LvmLayout | None = None, only: Collection[str] | None = None
) -> Recorded:
    """All channels and their X column; raises InvalidFile at file:line.

    The unit of X is s if the file calls it time. Several segments are joined by the clock times in their headers.
    """
    if not content.startswith(MAGIC):
        raise invalid(path, f'is no LVM file: it does not begin with "{MAGIC[0].decode()}"', 1, 1)
    file = _File(path, content)
    segments = _segments(file)
    if not segments or not any(segment.rows for segment in segments):
        raise invalid(path, "holds headers and no data", len(file.lines), 1)
    first = segments[0]
    for segment in segments[1:]:
        if (segment.names, segment.keys.get("Y_Unit_Label")) != (first.names, first.keys.get("Y_Unit_Label")):
            raise invalid(path, "has other channels or units than the segment before; split the file", segment.first, 1)
    recorded = Recorded([], _started(first, file.keys), first.first, not file.ends)
    _drop_cut_row(file, segments[-1], recorded)
    tables = [_numbers(file, segment) for segment in segments]
    recorded.columns.append(_abscissa(file, segments, tables))
    units = first.keys.get("Y_Unit_Label", [])
    units = units if len(units) == len(first.names) else [""] * len(first.names)
    for place, (name, unit) in enumerate(zip(first.names, units, strict=True)):
        values = np.concatenate([table[:, 1 + place * file.step] for table in tables])
        recorded.columns.append(Column(name, values, unit))
    for number, (segment, table) in enumerate(zip(segments, tables, strict=True), 1):
        said = max(map(_whole, segment.keys.get("Samples", [])), default=len(table))
        if file.multi and said != len(table):
            text = f"segment {number} has {len(table)} rows, its header says {said}"
            recorded.doubts.append(f"{text}: rows are missing or were added")
    return recorded


def _drop_cut_row(file: _File, segment: _Segment, recorded: Recorded) -> None:
    """Leave out the last row if the file ends within it, and note a doubt."""
    width = file.width(segment)
    if not file.ends and len(segment.rows) > 1 and len(segment.rows[-1][1]) < width:
        number, fields = segment.rows.pop()
        recorded.cut_end = False
        text = f"the last row is cut off, in line {number}: {len(fields)} of {width} columns; it was left out"
        recorded.doubts.append(text)


def _whole(text: str) -> int:
    return int(text) if text.isdecimal() and len(text) < 12 else -1


def _segments(file: _File) -> list[_Segment]:
    """Split into segments; one begins with any key of its header, in any order."""
    segments: list[_Segment] = []
    keys: dict[str, list[str]] | None = None
    special = names_next = False
    for number, line in enumerate(file.lines[file.body :], file.body + 1):
        fields = line.split(file.separator)
        first = fields[0].strip()
        if special or first == "***Start_Special***":
            special = first != "***End_Special***"
        elif not line.strip():
            continue
        elif keys is None and (first in KEYS or not segments):
            keys = {first: [text.strip() for text in fields[1:] if text.strip()]}
            if not segments and first not in KEYS and _NUMBER.fullmatch(first):
                raise invalid(file.path, "a header with the number of channels is expected before the rows", number, 1)
        elif keys is not None and first == END:
            names_next = True
        elif names_next and keys is not None:
            segments.append(_Segment(keys, _names(file, fields, keys, number), number + 1))
            keys, names_next = None, False
        elif keys is not None:
            keys[first] = [text.strip() for text in fields[1:] if text.strip()]
        else:
            segments[-1].rows.append((number, fields))
    if keys is not None:
        raise invalid(file.path, "is cut off within the header of a segment", len(file.lines), 1)
    return segments


def _names(file: _File, fields: list[str], keys: dict[str, list[str]], line: int) -> list[str]:
    count = _whole(keys["Channels"][0]) if keys.get("Channels") else -1
    if not 1 <= count <= MAX_CHANNELS:
        raise invalid(file.path, f"the number of channels is not 1 to {MAX_CHANNELS}", line, 1)
    names = [text.strip() for text in fields[1 : 1 + count * file.step : file.step]]
    if len(names) < count or fields[0].strip() != "X_Value":
        raise invalid(file.path, f'"X_Value" and the names of {count} channels are expected', line, 1)
    return distinct([name or "channel" for name in names])


def _numbers(file: _File, segment: _Segment) -> Array:
    """Numbers of all rows, shape (rows, columns), without a comment at the end of a row."""
    width = file.width(segment)
    table = np.full((len(segment.rows), width), np.nan)
    comma = file.decimal == ","
    if not file.decimal and file.separator != "," and segment.rows:
        comma = any("," in text for text in segment.rows[0][1][:width])

    def faults() -> Iterator[Problem]:
        for row, (number, fields) in zip(table, segment.rows, strict=True):
            if not width <= len(fields) <= width + 1:
                cut = number == len(file.lines) and len(fields) < width
                text = f"the last row is cut off: {len(fields)} of {width} columns" if cut else ""
                yield Problem(file.path, number, 1, text or f"has {len(fields)} columns, {width} are expected")
                continue
            for place, text in enumerate(map(str.strip, fields[:width])):
                try:
                    row[place] = _number(text, comma)
                except ValueError:
                    yield Problem(file.path, number, 1, f'"{text[:40]}" is no number, in column {place + 1}')

    if problems := list(islice(faults(), SHOWN)):
        raise InvalidFile(problems)
    return table


def _number(text: str, comma: bool) -> float:
    if (known := NO_NUMBER.get(text.lower())) is not None:
        return known
    plain = text.translate(_EXCHANGED) if comma else text
    return float(plain if _NUMBER.fullmatch(plain) else "?")


def _abscissa(file: _File, segments: Sequence[_Segment], tables: Sequence[Array]) -> Column:
    """The column X_Value, from the file or from X0 and Delta_X, shifted by the start time of each segment."""
    times = [_started(segment, file.keys) for segment in segments]
    parts: list[Array] = []
    for segment, table, at in zip(segments, tables, times, strict=True):
        later = (at - times[0]).total_seconds() if at is not None and times[0] is not None else 0.0
        if file.x == "No":
            begin, steps = _floats(file, segment, "X0"), _floats(file, segment, "Delta_X")
            if len(set(steps)) != 1:
                raise invalid(file.path, "its channels have different X (Delta_X differs)", segment.first, 1)
            if not steps[0] > 0:
                raise invalid(file.path, "has no X, and Delta_X is not above 0", segment.first, 1)
            x = (begin[0] if begin else 0.0) + np.arange(len(table)) * steps[0]
        else:
            x, others = table[:, 0], table[:, 2::2]
            same = np.array_equal(others, np.broadcast_to(x[:, None], others.shape), equal_nan=True)
            if file.x == "Multi" and not same:
                raise invalid(file.path, "its channels have different X", segment.first, 1)
        _together(file, segment, float(np.median(np.diff(x))) if len(x) > 1 else 0.0)
        parts.append(np.asarray(x + later, dtype=np.float64))
    unit = segments[0].keys.get("X_Dimension", ["Time"])
    return Column("X_Value", np.concatenate(parts), "s" if unit[:1] == ["Time"] else "")


def _together(file: _File, segment: _Segment, step: float) -> None:
    """Raise InvalidFile where channels start at different times, by Time and X0; `step`: sampling period [s]."""
    starts = dict(enumerate(_floats(file, segment, "X0")))
    clocks = [_started(segment, file.keys, k) for k in range(len(segment.keys.get("Time", [])))]
    for k, at in enumerate(clocks if segment.keys.get("X_Dimension", ["Time"])[:1] == ["Time"] else ()):
        if at is not None and clocks[0] is not None:
            starts[k] = starts.get(k, 0.0) + (at - clocks[0]).total_seconds()
    every = starts.values()
    if (apart := max(every, default=0.0) - min(every, default=0.0)) > TOGETHER * abs(step):
        text = f"its channels begin up to {apart:.3g} s apart (Time, X0): they have no X in common"
        raise invalid(file.path, f"{text}; put them on one clock before you export them", segment.first, 1)


def _floats(file: _File, segment: _Segment, key: str) -> list[float]:
    comma = "," in "".join(segment.keys.get(key, [])) and file.separator != ","
    try:
        values = [_number(text, comma) for text in segment.keys.get(key, [])]
    except ValueError as error:
        raise invalid(file.path, f"its {key} is no number", segment.first, 1) from error
    return values if np.isfinite(values).all() else []


def _started(segment: _Segment, header: dict[str, str], channel: int = 0) -> datetime | None:
    """Start of a channel of a segment, else of the file, without time zone; None if unknown."""
    dates = segment.keys.get("Date") or [header.get("Date", "")]
    times = segment.keys.get("Time") or [header.get("Time", "")]
    date, time = dates[min(channel, len(dates) - 1)], times[min(channel, len(times) - 1)]
    whole, _, part = time.replace(",", ".").partition(".")
    with suppress(ValueError):
        begin = datetime.strptime(f"{date} {whole}", "%Y/%m/%d %H:%M:%S")  # local, zone unknown
        return begin + timedelta(seconds=float(f"0.{part}") if part.isdecimal() else 0.0)
    return None


def _as_one(columns: Mapping[str, Array]) -> dict[str, str]:
    """All columns share one clock: a file has one table, even if channel names contain `/`."""
    return dict.fromkeys(columns, "")


FORMAT = Format("lvm", "LabVIEW measurement", LvmLayout, begins(*MAGIC), read_lvm, together=_as_one)
