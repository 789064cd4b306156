"""Text in rows and columns, such as CSV: how a map describes it, and conversion of its fields to numbers and times.

Dates and clocks are matched by the pattern of their kind; counts of seconds or days start at the origin of their kind.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from pmabench.store.formats.record import Layout
from pmabench.store.records import Array

Name = Annotated[str, Field(min_length=1, max_length=120)]
Encoding = Literal[
    "utf-8", "latin-1", "cp1252", "utf-16", "utf-16-le", "utf-16-be", "shift_jis", "euc_jp", "gb18030", "big5", "euc_kr"
]
MARKS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|"}
"""Delimiters of one character."""


class TextLayout(Layout):
    """Layout of a text file; nothing is guessed while the file is read."""

    holds_texts: ClassVar[bool] = True
    format: Literal["text"] = "text"
    delimiter: Literal["comma", "semicolon", "tab", "blank", "bar"]
    """`blank`: any run of blanks and tabs."""
    quoted: bool = False
    """Fields may be in quotation marks; a delimiter between them does not separate."""
    header: Literal["first line", "none"]
    names: Annotated[list[Name], Field(max_length=200)] = []
    """Names of the columns in order, for a file without them."""
    decimal: Literal["point", "comma"] = "point"
    thousands: Literal["comma", "point", "blank", "apostrophe"] | None = None
    """Thousands separator, as in 1,234.5."""
    encoding: Encoding = "utf-8"
    blank_lines: Literal["refuse", "skip"] = "refuse"
    comment: Annotated[str, Field(min_length=1, max_length=8)] | None = None
    """Lines that begin with this are left out."""
    skip_lines: Annotated[int, Field(ge=0, le=10_000)] = 0
    """Number of lines to skip before the header, or before the data."""
    lines_below_header: Annotated[int, Field(ge=0, le=20)] = 0
    """Number of lines between the line of names and the first row, for instance with units."""
    repeated_header: Literal["refuse", "new test", "page"] = "refuse"
    """Meaning of a repeated line of names: another test begins, which becomes a separate run, or the same test
    continues, as on the next page of a print-out.
    """
    missing: Annotated[list[Annotated[str, Field(max_length=20)]], Field(max_length=20)] = []
    """Texts that mean "no value"; any other text in place of a number is an error."""

    @property
    def given(self) -> Sequence[str]:
        """`names`."""
        return self.names

    @property
    def repeats(self) -> bool:
        """Whether a repeated line of names begins another test."""
        return self.repeated_header == "new test"

    @model_validator(mode="after")
    def _names(self) -> TextLayout:
        if (self.header == "none") != bool(self.names):
            raise ValueError('"header: none" needs "names", and "header: first line" has them already')
        if len(set(self.names)) != len(self.names):
            raise ValueError("two columns have the same name")
        if self.delimiter == "comma" and self.decimal == "comma" and not self.quoted:
            text = "comma cannot be delimiter and decimal sign at once, but in quotation marks"
            raise ValueError(f'{text}: "quoted: true"')
        used = (self.decimal, *([] if self.quoted else [self.delimiter]))
        if self.thousands in used:
            raise ValueError(f"{self.thousands} cannot be the sign of thousands and of something else at once")
        if self.header == "none" and (self.lines_below_header or self.repeated_header != "refuse"):
            raise ValueError('"lines_below_header" and "repeated_header" need "header: first line"')
        if self.delimiter == "blank" and self.quoted:
            raise ValueError('"quoted: true" needs a delimiter that is no run of blanks')
        return self


DAY = 86_400.0
EPOCH = datetime(1970, 1, 1)
ORIGINS = {"epoch": 0.0, "serial days": -25_569 * DAY, "matlab days": -719_529 * DAY, "labview": -24_107 * DAY}
"""Zero of each kind of count [s since 1970]: Unix; spreadsheets (from March 1900 on); MATLAB datenum; LabVIEW, 1904."""
IN_DAYS = ("serial days", "matlab days")
TEXTS = ("clock", "date and time")
"""Forms of time that are texts, not numbers."""
_CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2})(?:[.,:](\d{1,9}))?\s*(?:([AaPp])\.?[Mm]\.?)?")
_COMPACT = re.compile(r"(\d{2})(\d{2})(\d{2})(?:[.,](\d{1,9}))?")
_ZONE = re.compile(r"(Z|[+-]\d{2}:?\d{2})$")
_YEAR_FIRST = re.compile(r"(\d{4})([-/.]?)(\d{1,2})\2(\d{1,2})")
_YEAR_LAST = re.compile(r"(\d{1,2})([-/.])(\d{1,2})\2(\d{4}|\d{2})")
_NAMED = re.compile(r"(\d{1,2})[- .]*([A-Za-z]{3})[a-z]*[- .,]*(\d{4})")
_MONTHS = {name: k for k, name in enumerate("jan feb mar apr may jun jul aug sep oct nov dec".split(), 1)}  # noqa: SIM905


@dataclass(frozen=True)
class Stamps:
    """How a file writes its time, from the map."""

    column: str
    written: str = "number"
    """`number`, `index`, `header step`, a key of `ORIGINS`, or one of `TEXTS`."""
    unit: float = 1.0
    """Unit of the number [s], for `epoch` and `labview`."""
    date: str = ""
    """Column of the date, where the date is in a separate column."""
    order: str = "year first"
    """Order of a date whose year comes last: `day first` or `month first`."""
    period: float = 0.0
    """Sampling period for `index` [s]."""

    @property
    def texts(self) -> dict[str, str]:
        """Kind of each column that holds text, by name."""
        data = {self.column: self.written} if self.written in TEXTS else {}
        return {**data, self.date: "date"} if self.date else data


def seconds_of(texts: Sequence[str], kind: str, order: str) -> Array:
    """Seconds, shape (n,): of `clock` since midnight, of `date` and `date and time` since 1970, local time of the file.

    Raises ValueError with the reason for the first invalid text.
    """
    days: dict[str, float] = {}
    return np.array([_seconds(text.strip().strip('"'), kind, order, days) for text in texts], dtype=np.float64)


def _seconds(text: str, kind: str, order: str, days: dict[str, float]) -> float:
    if kind == "clock":
        return clock_seconds(text)
    date, clock = (text, "") if kind == "date" else _parted(text)
    if date not in days:
        days[date] = date_seconds(date, order)
    if kind == "date":
        return days[date]
    clock, zone, _ = _ZONE.split(clock, 1) if _ZONE.search(clock) else (clock, "Z", "")
    late = 0.0 if zone == "Z" else float(f"{zone[0]}1") * (3600 * int(zone[1:3]) + 60 * int(zone[-2:]))
    return days[date] + clock_seconds(clock) - late


def _parted(text: str) -> tuple[str, str]:
    """Date and clock of `2024-03-01T10:00:00`, `1 Mar 2024 10:00:00`, `20240301_100000`."""
    colon = text.find(":")
    until = len(text) if colon < 0 else colon
    at = max(text.rfind(mark, 0, until) for mark in "T _,")
    if at < 1:
        raise ValueError("holds no date and clock with a blank or T between them")
    return text[:at].rstrip(" ,"), text[at + 1 :].strip()


def clock_seconds(text: str) -> float:
    """Seconds since midnight of `HH:MM:SS`, with a fraction behind point, comma or colon, AM or PM; `MM:SS.f` too."""
    match = _CLOCK.fullmatch(text) or _COMPACT.fullmatch(text)
    if match is None:
        raise ValueError("is no clock of the form HH:MM:SS")
    half = match[5] if match.re is _CLOCK else None
    if match[1] is None and match[4] is None:
        raise ValueError("may be hours and minutes or minutes and seconds")
    hours, minutes, seconds = int(match[1] or 0), int(match[2]), int(match[3])
    if minutes > 59 or seconds > 60 or (half is not None and not 1 <= hours <= 12):
        raise ValueError("is no time of the day")
    if half is not None:
        hours = hours % 12 + (12 if half in "Pp" else 0)
    return 3600 * hours + 60 * minutes + seconds + float(f"0.{match[4] or 0}")


def date_seconds(text: str, order: str) -> float:
    """Seconds since 1970 at the beginning of a day; the month by name, or in the given `order`."""
    if (match := _YEAR_FIRST.fullmatch(text)) is not None:
        year, month, day = int(match[1]), int(match[3]), int(match[4])
    elif (match := _NAMED.fullmatch(text)) is not None and match[2].lower() in _MONTHS:
        year, month, day = int(match[3]), _MONTHS[match[2].lower()], int(match[1])
    elif (match := _YEAR_LAST.fullmatch(text)) is not None:
        if order == "year first":
            raise ValueError('its year comes last: say "order: day first" or "order: month first"')
        year = int(match[4]) + (2000 if len(match[4]) == 2 else 0)
        one, other = int(match[1]), int(match[3])
        day, month = (one, other) if order == "day first" else (other, one)
    else:
        raise ValueError("is no date")
    try:
        return (datetime(year, month, day) - EPOCH).total_seconds()
    except ValueError as error:
        raise ValueError(f"is no day with {order}") from error


class Clock:
    """Converts the columns of time into seconds, piece by piece in the order of the file."""

    def __init__(self, stamps: Stamps, step: tuple[float, float] | None = None) -> None:
        """`step`: start and increment [s] from the header of the file."""
        self.stamps, self.step = stamps, step
        self.started: datetime | None = None
        """Time of the first row in local time of the file; None where the file gives no date."""
        self._first = np.nan
        self._last = np.nan
        self._ahead = 0.0

    def seconds(self, values: Array, date: Array | None = None) -> Array:
        """Seconds since the first row, shape (n,); plain numbers are returned unchanged."""
        written = self.stamps.written
        if written == "number" or not len(values):
            return values
        if written == "index":
            return values * self.stamps.period
        if written == "header step" and self.step is not None:
            return self.step[0] + values * self.step[1]
        if written == "clock" and date is None:
            values = self._past_midnight(values)
        elif date is not None:
            values = values + date
        if np.isnan(self._first):
            self._first = float(values[0])
            self.started = self._begin()
        return (values - self._first) * self._scale()

    def _scale(self) -> float:
        return DAY if self.stamps.written in IN_DAYS else self.stamps.unit

    def _begin(self) -> datetime | None:
        """The first row as a date."""
        written = self.stamps.written
        if written == "clock" and not self.stamps.date:
            return None
        with suppress(OverflowError, ValueError):
            return EPOCH + timedelta(seconds=ORIGINS.get(written, 0.0) + self._first * self._scale())
        return None

    def _past_midnight(self, values: Array) -> Array:
        """Add a day whenever the clock falls by more than half a day, which means midnight."""
        before = np.concatenate([[values[0] if np.isnan(self._last) else self._last], values[:-1]])
        days = self._ahead + DAY * np.cumsum(values - before < -DAY / 2)
        self._last, self._ahead = float(values[-1]), float(days[-1])
        return np.asarray(values + days)


_START, _INCREMENT = re.compile(r"start", re.IGNORECASE), re.compile(r"incr(?:ement)?|delta ?t", re.IGNORECASE)


def step_in(lines: Sequence[str]) -> tuple[float, float] | None:
    """Start and increment [s] from an oscilloscope's header (`X,CH1,Start,Increment` above numbers), or None."""
    cells = [[cell.strip().strip('"') for cell in re.split(r"[,;\t]", line)] for line in lines]
    for names, numbers in pairwise(cells):
        start = next((k for k, name in enumerate(names) if _START.fullmatch(name)), None)
        increment = next((k for k, name in enumerate(names) if _INCREMENT.fullmatch(name)), None)
        if start is None or increment is None or max(start, increment) >= len(numbers):
            continue
        with suppress(ValueError):
            found = float(numbers[start]), float(numbers[increment])
            if np.isfinite(found).all() and found[1] > 0:
                return found
    return None


THOUSANDS = {"comma": ",", "point": ".", "blank": " \u00a0\u2009\u202f", "apostrophe": "'\u2019"}
"""Name of a thousands separator -> its characters."""
NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,3})?\s*")
MINUS = "\u2212"
"""The typographic minus sign, which some programs write."""


class Fields:
    """Converts fields according to a layout; `order` is that of day and month in dates."""

    def __init__(self, layout: TextLayout, order: str) -> None:
        """Compile the pattern of grouped numbers."""
        self._layout, self._order = layout, order
        self._signs = "" if layout.thousands is None else THOUSANDS[layout.thousands]
        point = "," if layout.decimal == "comma" else "."
        self._grouped = re.compile(rf"\s*[+-]?\d{{1,3}}(?:[{self._signs or '_'}]\d{{3}})+(?:[{point}]\d*)?\s*")

    def value(self, text: str, kind: str) -> float:
        """A field as a number, or in seconds if it is a time of a `kind`; NaN for "no value". Raises ValueError."""
        if text.strip() in self._layout.missing:
            return np.nan
        if kind:
            return float(seconds_of([text], kind, self._order)[0])
        plain = text
        if self._signs and self._grouped.fullmatch(plain):
            plain = re.sub(f"[{self._signs}]", "", plain.strip())
        if self._layout.decimal == "comma":
            plain = "?" if "." in plain else plain.replace(",", ".")
        if NUMBER.fullmatch(plain) is None:
            raise ValueError("is no number")
        value = float(plain.replace("d", "e").replace("D", "e"))
        if not np.isfinite(value):
            raise ValueError("is no finite number")
        return value
