"""The data line of an Alicat controller over its ASCII protocol, by the list of columns that the device sends.

The columns of that list have fixed widths, of its header; `*` marks an entry that is only sometimes in a line::

    A D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________
    A D01 700 Unit ID                    string          1
    A D02 006 Gauge Press                s decimal     7/2 010 02 PSIG
    A D03 038 Gauge Press Setpt          s decimal     7/2 010 02 PSIG
    A D04 702 *Status                    string          3 HLD
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from pmabench_drivers.shared import serial_port as sp

HEAD = re.compile(r"\S D00 (?P<id>ID_+) (?P<name>NAME_+) (?P<type>TYPE_+) (?P<width>WIDTH_*) (?P<notes>NOTES_*)\s*")
ROW = re.compile(r"(?P<unit_id>\S) D(?P<number>\d\d) .*")
NUMBER = re.compile(r"[+-]?\d{1,9}(?:\.\d{1,6})?")
MOST_ROWS = 60
UNIT_ID, ERROR, STATUS = 700, 701, 702
ABSOLUTE_SET_POINT = 34
MEASURED_BY = {38: 6, 39: 7}
"""Statistic of the set-point -> that of the controlled pressure: gauge, and differential to the atmosphere."""


@dataclass(frozen=True)
class Column:
    """One column of every data line."""

    statistic: int
    name: str
    decimal: bool
    width: int
    decimals: int
    unit_code: int
    unit: str


@dataclass(frozen=True)
class Layout:
    """Format of a data line."""

    unit_id: str
    columns: tuple[Column, ...]
    codes: frozenset[str]
    """Status codes that a line may end with."""
    pressure: int
    """Index of the column of the controlled pressure, from 0; `set_point`: that of the set-point."""
    set_point: int

    @property
    def decimals(self) -> int:
        """Decimals of the set-point."""
        return self.columns[self.set_point].decimals

    @property
    def length(self) -> int:
        """Characters of a line without status."""
        return sum(column.width + 1 for column in self.columns)

    def read(self, line: bytes) -> tuple[float, float, frozenset[str]]:
        """Pressure, set-point and status codes; raises `Unreadable`, or `Wrong` for a refusal."""
        if (words := sp.text_of(line).rstrip().split()) in (["?"], [self.unit_id, "?"]):
            raise sp.Wrong("refuses what it was asked (?)")
        count = len(self.columns)
        if len(words) < count or words[0].upper() != self.unit_id or not set(words[count:]) <= self.codes:
            raise sp.Unreadable(f'"{sp.readable(line)}"')
        for column, word in zip(self.columns, words, strict=False):
            if column.decimal and not _fits(column, word):
                raise sp.Unreadable(f'"{sp.readable(line)}"')
        return float(words[self.pressure]), float(words[self.set_point]), frozenset(words[count:])


def read_layout(lines: Sequence[bytes], unit_id: str) -> Layout:
    """Layout from a list of columns; raises `Wrong` if such a device cannot be used."""
    texts = [sp.text_of(line).rstrip() for line in lines]
    head = HEAD.fullmatch(texts[0]) if texts else None
    if head is None:
        first = f'; it begins with "{sp.readable(lines[0])}"' if lines else ""
        raise sp.Wrong(f"its list of columns is not one that is known here (firmware 6v21 or later is needed){first}")
    columns: list[Column] = []
    codes: set[str] = set()
    if len(texts) > MOST_ROWS:
        raise sp.Wrong(f"its list of columns has more than {MOST_ROWS} rows")
    for expected, text in enumerate(texts[1:], 1):
        row = ROW.fullmatch(text)
        if row is None or row["unit_id"].upper() != unit_id or int(row["number"]) != expected:
            raise sp.Wrong(f'its list of columns is not whole: row {expected} reads "{text[:60]}"')
        statistic, name, kind, width = (text[slice(*head.span(key))].strip() for key in ("id", "name", "type", "width"))
        notes = text[head.start("notes") :].split()
        if not statistic.isdecimal():
            raise sp.Wrong(f'its list of columns cannot be read: row {expected} reads "{text[:60]}"')
        if name.startswith("*"):
            codes.update(notes[:1] if int(statistic) in {ERROR, STATUS} else ())
            continue
        columns.append(_column(int(statistic), name, kind, width, notes, text))
    return _chosen(columns, frozenset(codes), unit_id)


def _column(statistic: int, name: str, kind: str, width: str, notes: Sequence[str], text: str) -> Column:
    digits, _, decimals = width.partition("/")
    if not digits.isdecimal() or (decimals and not decimals.isdecimal()):
        raise sp.Wrong(f'its list of columns cannot be read: "{text[:60]}"')
    code = int(notes[0]) if len(notes) >= 2 and notes[0].isdecimal() else -1
    unit = notes[-1] if notes else ""
    return Column(statistic, name, "decimal" in kind, int(digits), int(decimals or 0), code, unit)


def _chosen(columns: Sequence[Column], codes: frozenset[str], unit_id: str) -> Layout:
    """Layout with the columns of set-point and controlled pressure."""
    statistics = [column.statistic for column in columns]
    if not statistics or statistics[0] != UNIT_ID:
        raise sp.Wrong("its data line does not begin with its unit ID")
    if ABSOLUTE_SET_POINT in statistics:
        raise sp.Wrong("controls absolute pressure: set its control variable to gauge pressure")
    for index, statistic in enumerate(statistics):
        if (wanted := MEASURED_BY.get(statistic)) is None:
            continue
        if wanted not in statistics:
            raise sp.Wrong(f'its data line does not contain the pressure of "{columns[index].name}"')
        layout = Layout(unit_id, tuple(columns), codes, statistics.index(wanted), index)
        if not (columns[index].decimal and columns[layout.pressure].decimal):
            raise sp.Wrong("its pressures are no decimal numbers")
        return layout
    raise sp.Wrong("its data line has no set-point of a pressure: is it a pressure controller?")


def _fits(column: Column, word: str) -> bool:
    """Whether a number has exactly the characters and decimals of its column: a lost character is noticed."""
    point = len(word) - word.find(".") - 1 if "." in word else 0
    return NUMBER.fullmatch(word) is not None and len(word) == column.width and point == column.decimals
