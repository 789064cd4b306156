"""How the time of a file that was never seen is written: by its texts, by the size of its numbers, by its header."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.store.formats.shared.times import seconds_of
from pmabench.store.records import Array

ENOUGH = 0.99
"""Share of the texts of a column that must be times."""
_SLASHED = re.compile(r"\s*(\d{1,2})[-/.](\d{1,2})[-/.](?:\d{4}|\d{2})\b")
_LOOKS = re.compile(
    r"\d{1,3}:\d{2}|\d{4}[-/.]\d{1,2}[-/.]\d|\d{1,2}[-/. ](?:\d{1,2}|[A-Za-z]{3,9})[-/. ]\d{2,4}|\d{8}[T_ ]\d{4}"
)
COUNTS = (
    ("serial days", "d", 36_526.0, 54_789.0),
    ("matlab days", "d", 730_486.0, 748_749.0),
    ("epoch", "s", 0.94e9, 2.53e9),
    ("labview", "s", 3.03e9, 4.61e9),
    ("epoch", "ms", 0.94e12, 2.53e12),
    ("epoch", "us", 0.94e15, 2.53e15),
    ("epoch", "ns", 0.94e18, 2.53e18),
)
"""How written, unit, and the numbers of the years 2000 to 2050."""
LONGEST_STEP = {"d": 5e-5, "s": 10.0, "ms": 1e4, "us": 1e7, "ns": 1e10}
"""Median step of a recording that counts so, in that unit; days in longer steps may be seconds."""
_NUMBER = r"[:=,;\s\[(]*([0-9]+(?:[.,][0-9]+)?(?:[eE][+-]?[0-9]+)?)"
_RATE = re.compile(
    r"(?:sampl\w*|scan|acquisition|logging|abtast\w*)[ _]?(?:rate|frequency|freq|ing)?\b[^0-9\n]{0,24}?" + _NUMBER
    + r"\s*(k?)(?:hz|s/s|sps|/s|samples?/s)", re.IGNORECASE)  # fmt: skip
_INTERVAL = re.compile(
    r"(?:(?:sampl\w*|scan|time)[ _]?(?:interval|period|step|time)|delta[ _]?t|\bdt)\b[^0-9\n]{0,24}?" + _NUMBER
    + r"\s*(ms|us|µs|s)\b", re.IGNORECASE)  # fmt: skip


@dataclass(frozen=True)
class Written:
    """How one column of texts writes its time."""

    kind: str
    """`clock`, `date` or `date and time`."""
    order: str
    """Order of a date whose year comes last; empty where the file leaves it open."""


def looks_like_time(text: str) -> bool:
    """Whether a text may be a date or a clock."""
    return _LOOKS.search(text) is not None


def written(texts: Sequence[str]) -> Written | None:
    """How a column of texts writes its time; None where its texts are no times."""
    some = [text.strip() for text in texts if text.strip()]
    if not some or sum(map(looks_like_time, some)) < ENOUGH * len(some):
        return None
    order = _order(some)
    for kind in ("clock", "date", "date and time"):
        try:
            seconds_of(some, kind, order or "day first")
        except ValueError:
            continue
        return Written(kind, order)
    return None


def _order(texts: Sequence[str]) -> str:
    """The order of day and month, where a number above 12 or a point shows it; empty where it is open."""
    pairs = [(int(m[1]), int(m[2])) for text in texts if (m := _SLASHED.match(text))]
    if not pairs:
        return "year first"
    if any("." in text.split()[0] for text in texts[:1]) or any(one > 12 for one, _ in pairs):
        return "day first"
    return "month first" if any(other > 12 for _, other in pairs) else ""


def counted(values: Array) -> tuple[str, str] | None:
    """How a column of numbers counts from a day, and in which unit; None where it is a plain number.

    An empty first text: it may be days or a plain number.
    """
    if len(values) < 2 or not np.isfinite(values).all():
        return None
    steps = np.diff(values)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    for kind, unit, low, high in COUNTS:
        if low <= float(values.min()) and float(values.max()) <= high and 0 < step:
            if step <= LONGEST_STEP[unit]:
                return kind, unit
            if unit == "d" and step <= 1e-2:
                return "", unit
    return None


def interval_in(lines: Sequence[str]) -> float:
    """Distance of the samples [s] that a header gives as a rate or an interval; 0 where it gives none, or several."""
    found: set[float] = set()
    for line in lines:
        if match := _RATE.search(line):
            rate = float(match[1].replace(",", ".")) * (1e3 if match[2] else 1.0)
            found |= {1.0 / rate} if rate > 0 else set()
        elif match := _INTERVAL.search(line):
            found.add(float(match[1].replace(",", ".")) * {"s": 1.0, "ms": 1e-3}.get(match[2].lower(), 1e-6))
    return found.pop() if len(found) == 1 else 0.0


def clock_and_date(kinds: Mapping[str, Written]) -> tuple[str, str]:
    """Of the columns of times by name the one that holds the time, and the one with its date; empty where none."""
    whole = next((name for name, each in kinds.items() if each.kind == "date and time"), "")
    if whole:
        return whole, ""
    clock = next((name for name, each in kinds.items() if each.kind == "clock"), "")
    date = next((name for name, each in kinds.items() if each.kind == "date"), "")
    return clock, date if clock else ""
