"""The one table of the certificate: the coefficients of the test with most values, each with its interval.

Its rows come from `foremost.richest`, its cells from `tables.cell`, as on the terminal and in the appendices.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pmabench.plotting.wording import clean, number, point_shown, printed, rounded, shown, symbol_text
from pmabench.report.certificate.force_chart import slopes_of
from pmabench.report.document.tables import cell, matrix_table, two_coordinates
from pmabench.report.foremost import reasons, richest, without_comparison
from pmabench.report.words import declared
from pmabench.store.analyses.results import AGREEMENT, Analysis, Estimate

MOST_ROWS = 11
MOST_LETTERS, WIDE = 62, 55
"""Letters of the coefficients in a row that fit its column of the page, and above which they are smaller."""
MOST_NOTES = 3
FIGURE, POINT, THIN = "\u2007", "\u2008", "\u2009"
"""Spaces as wide as a digit, as a point, and a thin one."""
_VALUE = re.compile(r"(−?[\d.]+)(?: ± ([\d.]+))?")


@dataclass(frozen=True)
class Value:
    """A cell: value and half width padded so that points are below each other; or words in their place."""

    text: str
    half: str = ""
    words: bool = False


@dataclass(frozen=True)
class ResultTable:
    """The table with its heads (symbol, unit) and notes; without rows there is no result."""

    heads: list[tuple[str, str]] = field(default_factory=list)
    rows: list[list[Value]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    symbols: frozenset[str] = frozenset()
    """Whose values it has."""
    tight: bool = False
    """Its letters are smaller."""


def result_table(analyses: Sequence[Analysis]) -> tuple[ResultTable, list[Estimate], str]:
    """The table, the estimates in it, and the coordinate over which they are; without any the key values instead."""
    tests = [a for a in analyses if a.kind != AGREEMENT]
    members, over = richest(tests)
    places = sorted({_place(e, over) for e in members})
    if len(places) < 2:
        return _whole(tests), [], ""
    if across := two_coordinates(members, over):
        return _matrix(members, over, across), members, over
    order = list(declared(tests))
    by = {(_place(e, over), e.symbol): e for e in members}
    stride = -(-len(places) // MOST_ROWS)
    chosen = places[::stride]
    symbols = sorted({s for place, s in by if place in chosen}, key=order.index)
    columns = {s: _aligned([cell(by[p, s]) if (p, s) in by else "not measured" for p in chosen]) for s in symbols}
    named = {s: (symbol_text(s), _unit(members, s)) for s in symbols}
    letters = {s: _letters(columns[s], named[s]) for s in symbols}
    kept = list(symbols)
    while len(kept) > 1 and sum(letters[s] for s in kept) > MOST_LETTERS:
        kept.pop()
    points = [over, *sorted({name for e in members for name in e.at} - {over, "mass"})]
    heads = [*((label, unit.unit) for label, unit in map(point_shown, points)), *(named[s] for s in kept), ("n", "")]
    rows: list[list[Value]] = []
    for n, place in enumerate(chosen):
        mine = [by[place, s] for s in kept if (place, s) in by]
        at = [Value(number(v / point_shown(name)[1].scale)) for name, v in zip(points, place, strict=True)]
        rows.append([*at, *(columns[s][n] for s in kept), Value(str(max(e.n for e in mine)) if mine else "0")])
    notes = [clean(printed(note), 160) for note in reasons([by[p, s] for p in chosen for s in kept if (p, s) in by])]
    if slopes := _slopes(tests, members, [place[0] for place in chosen], over):
        notes.insert(0, slopes)
    if stride > 1:
        notes.append(f"One of {stride} rows; all are in appendix B")
    if hidden := symbols[len(kept) :]:
        notes.append(f"{', '.join(map(symbol_text, hidden))}: in appendix B")
    tight = sum(letters[s] for s in kept) > WIDE
    return ResultTable(heads, rows, notes[:MOST_NOTES], frozenset(symbols), tight), members, over


def _slopes(tests: Sequence[Analysis], members: Sequence[Estimate], chosen: Sequence[float], over: str) -> str:
    """At which contraction K is the slope, for the rows of the table; empty where it is that at any."""
    found = slopes_of(tests, (e.method for e in members if e.symbol == "K")) if over == "pressure" else {}
    at = {round(P, 9): x for P, (x, _) in found.items()}
    places = [rounded(1e3 * at[P], None, 3) if P in at else "–" for P in chosen]
    return f"K: the slope at {', '.join(places)} mm of contraction, row by row" if at else ""


def _matrix(members: Sequence[Estimate], over: str, across: str) -> ResultTable:
    """Values of one symbol by two coordinates; columns as far as they fit."""
    heads, rows = matrix_table(members, over, across)
    columns = [_aligned([row[n] for row in rows]) for n in range(1, len(heads))]
    letters = [_letters(column, (head, "")) for column, head in zip(columns, heads[1:], strict=True)]
    while sum(letters[: len(columns)]) > MOST_LETTERS:
        columns.pop()
    label, down = point_shown(over)
    found = [(label, down.unit), *((head, "") for head in heads[1 : len(columns) + 1])]
    body = [[Value(row[0]), *(column[n] for column in columns)] for n, row in enumerate(rows)]
    symbol = f"{symbol_text(members[0].symbol)} [{_unit(members, members[0].symbol)}]"
    notes = [f"{symbol} at each pressure and contraction; –: not tested, or not known well enough."]
    notes += ["More columns are in appendix B."] if len(found) < len(heads) else []
    return ResultTable(
        found, body[:MOST_ROWS], notes, frozenset({members[0].symbol}), sum(letters[: len(columns)]) > WIDE
    )


def _place(e: Estimate, over: str) -> tuple[float, ...]:
    names = [over, *sorted(set(e.at) - {over, "mass"})]
    return tuple(round(e.at[name], 9) for name in names)


def _unit(members: Sequence[Estimate], symbol: str) -> str:
    first = next(e for e in members if e.symbol == symbol)
    return shown(first.quantity, first.unit).unit


def _letters(column: Sequence[Value], head: tuple[str, str]) -> int:
    """Letters that a column is wide, of its widest cell or of its head, symbol and unit, which is set smaller."""
    cells = max(len(value.text) + (len(value.half) + 3 if value.half else 0) for value in column)
    return max(cells, round(0.9 * len(" ".join(head))))


def _whole(tests: Sequence[Analysis]) -> ResultTable:
    """Where no test has values at several places: its headline values, a row each; a place of all rows is a note."""
    results = declared(tests)
    every = (e for analysis in tests for e in without_comparison(analysis)[0])
    held = [e for e in every if not e.coordinate and e.symbol in results and results[e.symbol].headline][:MOST_ROWS]
    alike = {k: v for k, v in held[0].at.items() if all(e.at.get(k) == v for e in held[1:])} if len(held) > 1 else {}

    def placed(at: Mapping[str, float]) -> str:
        places = [(*point_shown(k), v) for k, v in sorted(at.items()) if k != "mass"]
        return ", ".join(f"{label} {number(v / unit.scale)} {unit.unit}".strip() for label, unit, v in places)

    rows: list[list[Value]] = []
    for e in held:
        named = symbol_text(e.symbol), clean(results[e.symbol].title, 60)
        at = placed({k: v for k, v in e.at.items() if k not in alike})
        texts = shown(e.quantity, e.unit).unit, at, str(e.n)
        rows.append([*map(Value, named), *_aligned([cell(e)]), *map(Value, texts)])
    heads = [("", ""), ("quantity", ""), ("value ± U", ""), ("unit", ""), ("at", ""), ("n", "")]
    notes = [f"All at {where}"] if (where := placed(alike)) else []
    notes += [clean(printed(note), 160) for note in reasons(held)]
    return ResultTable(heads, rows, notes[:MOST_NOTES], frozenset(e.symbol for e in held)) if rows else ResultTable()


def _aligned(cells: Sequence[str]) -> list[Value]:
    """Values and half widths with spaces around them, so that points are below each other; other texts are words."""
    known = [_VALUE.fullmatch(text) for text in cells]
    value, half = (_widths([one[n] or "" for one in known if one]) for n in (1, 2))
    return [
        Value(_padded(one[1], *value), _padded(one[2], *half) if one[2] else "") if one else Value(text, words=True)
        for text, one in zip(cells, known, strict=True)
    ]


def _widths(numbers: Sequence[str]) -> tuple[int, int]:
    """Most digits before and after the point."""
    parts = [number.partition(".") for number in numbers]
    before, after = ([len(part[n]) for part in parts] for n in (0, 2))
    return max(before, default=0), max(after, default=0)


def _padded(text: str, before: int, after: int) -> str:
    whole, _, rest = text.partition(".")
    left = FIGURE * (before - len(whole)) + thousands(whole)
    if not after:
        return left
    return f"{left}.{rest}{FIGURE * (after - len(rest))}" if rest else f"{left}{POINT}{FIGURE * after}"


def thousands(whole: str) -> str:
    """Digits in groups of three with thin spaces, from five digits on."""
    sign, digits = ("−", whole[1:]) if whole.startswith("−") else ("", whole)
    if len(digits) < 5:
        return whole
    head = len(digits) % 3
    groups = [digits[:head]] * bool(head) + [digits[n : n + 3] for n in range(head, len(digits), 3)]
    return sign + THIN.join(groups)
