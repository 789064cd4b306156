"""Results at a glance: verdict, one table, the findings that matter; fits 25 lines of 80 columns with what follows."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from textwrap import shorten, wrap

from pmabench.base.text import sparkline
from pmabench.plotting.wording import (
    point_head,
    rounded,
    shown,
    symbol_text,
)
from pmabench.report.document.front import Verdict, tiles_of
from pmabench.report.document.tables import matrix_table, pivot_table, two_coordinates
from pmabench.report.foremost import costliest, how_well, richest
from pmabench.report.words import declared, kind_title
from pmabench.store.analyses.results import AGREEMENT, Analysis, Estimate

WIDTH = 80
MOST_LINES = 21
"""The others of 25 say what came to runs since, where everything is, and what to type next."""
MOST_ROWS = 8
MOST_FINDINGS = 3
GAP = "  "


def glance(analyses: Sequence[Analysis], verdict: Verdict, failed: Sequence[str]) -> list[str]:
    """The lines above those that say where everything is and what to type next.

    `failed`: reasons why results are not accepted. The table is that of the test with most values; of the other tests
    the key numbers. Findings are those that cost most: not accepted, withheld, faults, doubts, trials that are missing.
    """
    tests = [a for a in analyses if a.kind != AGREEMENT]
    simulated = "SIMULATED  " if any(a.simulated for a in tests) else ""
    title = kind_title(tests[0].kind) if len(tests) == 1 else f"{len(tests)} tests of one specimen"
    members, over = richest(tests)
    lines = [f"{simulated}{title}", _verdict(verdict, members, over), ""]
    if members:
        lines += _table(members, over, tests)
    known = {symbol_text(e.symbol) for e in members}
    rest = [tile for tile in tiles_of(analyses) if tile.symbol not in known]
    lines += _joined([f"{tile.symbol} {tile.value} {tile.unit}".rstrip() for tile in rest])
    lines += _spark(members, over)
    return [line[:WIDTH] for line in [*lines, "", *_findings(tests, failed, MOST_LINES - len(lines) - 1)]]


def _table(members: Sequence[Estimate], over: str, tests: Sequence[Analysis]) -> list[str]:
    """Columns as far as they fit, rows at most `MOST_ROWS`, else every second."""
    across = two_coordinates(members, over)
    if across:
        heads, body = matrix_table(members, over, across)
        rows, above = [heads, *body], [_head(members[0])]
    else:
        frame = pivot_table(members, declared(tests)).without("method").filled()
        rows, above = [frame.columns, *frame.cells()], []
    while len(rows) - 1 > MOST_ROWS:
        rows = [rows[0], *rows[1::2]]
    widths = [max(len(row[place]) for row in rows) for place in range(len(rows[0]))]
    while sum(widths) + len(GAP) * (len(widths) - 1) > WIDTH:
        widths.pop()
    hidden = rows[0][len(widths) :]
    more = [f"   more with -v, or in the report: {', '.join(hidden)}"] if hidden else []
    lines = [GAP.join(text.rjust(width) for text, width in zip(row, widths, strict=False)) for row in rows]
    return [*above, *lines, *more]


def _head(e: Estimate) -> str:
    return shown(e.quantity, e.unit).label(symbol_text(e.symbol))


def _verdict(verdict: Verdict, members: Sequence[Estimate], over: str) -> str:
    """The word, and for good results how well the values of the table are known."""
    text = verdict.text
    if verdict.level == "good" and members:
        text = how_well(members, over) or text
    word = f"{verdict.word.upper()}  "
    return word + shorten(text, WIDTH - len(word), placeholder=" …")


def _joined(parts: Sequence[str]) -> list[str]:
    """Key numbers, several on a line, at most two lines."""
    lines: list[str] = []
    for part in parts:
        if lines and len(lines[-1]) + 4 + len(part) <= WIDTH:
            lines[-1] += f"    {part}"
        else:
            lines.append(part)
    return lines[:2]


def _spark(members: Sequence[Estimate], over: str) -> list[str]:
    """How K goes over the operating points, else the first coefficient that is known at three of them."""
    courses: dict[str, list[Estimate]] = {}
    if any(len(e.at) > 1 for e in members):
        return []
    for e in sorted((e for e in members if e.value is not None), key=lambda e: e.at[over]):
        courses.setdefault(e.symbol, []).append(e)
    usable = {symbol: course for symbol, course in courses.items() if len({e.at[over] for e in course}) > 2}
    symbol = "K" if "K" in usable else next(iter(usable), "")
    if not symbol:
        return []
    unit = shown(usable[symbol][0].quantity, usable[symbol][0].unit)
    values = [v for e in usable[symbol] if isfinite(v := (e.value or 0.0) / unit.scale)]
    head = f"{symbol_text(symbol)}({symbol_text(point_head(over).partition(' ')[0])})"
    return [f"{head}  {rounded(values[0], None, 3)} {sparkline(values)} {rounded(values[-1], None, 3)} {unit.unit}"]


def _findings(tests: Sequence[Analysis], failed: Sequence[str], room: int) -> list[str]:
    """At most `MOST_FINDINGS`, the costliest first, in full where `room` lines allow it; how many more there are."""
    found = costliest(tests, failed)
    more = len(found[MOST_FINDINGS:]) + sum(f.level == "note" for a in tests for f in a.findings)
    first = found[:MOST_FINDINGS]
    spare = room - len(first) - bool(more)
    lines = []
    for text in first:
        whole = wrap(text, WIDTH - 3, max_lines=1 + max(0, spare), placeholder=" …")
        spare -= len(whole) - 1
        lines += [f"{'   ' if place else '!  '}{part}" for place, part in enumerate(whole)]
    return [*lines, *([f"   {more} more finding{'s'[: more > 1]}: -v, or the report"] if more else [])]
