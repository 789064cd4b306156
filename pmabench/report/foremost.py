"""What comes first, on the terminal and on the certificate: verdict, key numbers, the test with most headline values.

Both take these from here, so that they cannot say different things. On the terminal: results at a glance (verdict,
one table, the findings that matter; 25 lines of 80 columns with what follows), and the coefficients of each test,
primary methods in full, others by name. Computes no estimate.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from textwrap import shorten, wrap
from typing import TYPE_CHECKING

from pmabench.base.kind import Result
from pmabench.base.quantities import show
from pmabench.base.text import sparkline
from pmabench.plotting.wording import (
    POINTS,
    WITHHELD,
    clean,
    in_order,
    number,
    point_head,
    point_shown,
    point_text,
    printed,
    rounded,
    shown,
    spoken,
    symbol_text,
)
from pmabench.report.document.tables import cell, matrix_table, pivot_table, two_coordinates, whole_table
from pmabench.report.terminal import print_grid
from pmabench.report.words import declared, is_headline, kind_title
from pmabench.store.analyses.results import AGREEMENT, Analysis, Dropped, Estimate
from pmabench.store.records import RunData

if TYPE_CHECKING:
    from rich.console import Console


TILES = 8


@dataclass(frozen=True)
class Tile:
    """A key number of the first page."""

    symbol: str
    name: str
    value: str
    unit: str
    where: str


def tiles_of(analyses: Sequence[Analysis]) -> list[Tile]:
    """Key numbers: each headline symbol by the method of its test that comes first, at the middle of what was tested.

    Where that method found none (no limit cycle) there is none: what others give, as a simulation, is no key number.
    What is withheld is there without a value.
    """
    found = []
    analyses = [analysis for analysis in analyses if analysis.kind != AGREEMENT]  # differences, no values
    for symbol, result in declared(analyses).items():
        for analysis in (a for a in analyses if is_headline(a, symbol)):
            values = [e for e in analysis.estimates if e.symbol == symbol and "frequency" not in e.at]
            primary = [e for e in values if e.method == values[0].method]
            known = [e for e in primary if e.value is not None]
            members = [e for e in known if set(e.at) == set(known[0].at)]
            held = sum(e.withheld for e in primary)
            if members:
                found.append(_tile(members, result.title))
                break
            if held:
                method = clean(primary[0].method, 60)
                found.append(Tile(symbol_text(symbol), clean(result.title), WITHHELD, "", method))
                break
    if any(tile.symbol in ("B_c", "B_r") for tile in found):
        found = [tile for tile in found if tile.symbol != "B"]
    return found[:TILES]


def _tile(members: list[Estimate], title: str) -> Tile:
    varying = [name for name in in_order(members[0].at, members[0].at) if len({e.at[name] for e in members}) > 1]
    members = sorted(members, key=lambda e: [e.at[name] for name in varying])
    middle = members[len(members) // 2]
    unit = shown(middle.quantity, middle.unit)
    value = cell(middle)
    shown_at = {name: middle.at[name] for name in (varying or in_order(middle.at, ("pressure", "setpoint"))[:1])}
    where = ", ".join(part for part in (point_text(shown_at), clean(middle.method, 60)) if part)
    return Tile(symbol_text(middle.symbol), clean(title), value, unit.unit, where)


@dataclass(frozen=True)
class Verdict:
    """Whether the results are good, in a word and a sentence; `level` is `good`, `doubt` or `fault`."""

    level: str
    word: str
    text: str


def verdict_of(
    analyses: Sequence[Analysis], runs: Sequence[RunData], failed: Sequence[str], *, accepted: bool
) -> Verdict:
    """The worst that is known: acceptance, faults, runs that did not finish, doubts.

    `failed`: reasons why results are not accepted (limits not kept, withheld values, refusals); `accepted`: limits were
    given.
    """
    faults, doubts = (sum(f.level == level for a in analyses for f in a.findings) for level in ("fault", "doubt"))
    ended = (sum(run.status != "finished" for run in runs), "run did not finish", "runs did not finish")
    counts = ((len(failed), "reason", "reasons"), (faults, "fault", "faults"), ended, (doubts, "doubt", "doubts"))
    reasons = [f"{count} {one if count == 1 else several}" for count, one, several in counts if count]
    if not any(e.value is not None or e.withheld for a in analyses for e in a.estimates):
        return Verdict("fault", "No result", "; ".join(["no coefficient came out", *reasons]) + ".")
    if failed or faults:
        return Verdict("fault", "Not accepted" if failed else "Faults were found", "; ".join(reasons) + ".")
    if reasons:
        return Verdict("doubt", "Usable with care", "; ".join(reasons) + ".")
    limits = "The acceptance limits of the protocol are met" if accepted else "The protocol sets no acceptance limits"
    return Verdict("good", "Accepted" if accepted else "No doubt", f"{limits}; no fault and no doubt was found.")


NEAR_0 = 0.5
"""Half width as a share of its value above which a share says little."""
ALIKE = 80
"""Letters of a reason by which two are the same."""
_SIZE = re.compile(r"(,|=|<|>| of)? ?[-\u2212]?\d[\d.,]*( ?(N|mm|m|kPa|Pa|s|ms|Hz|%)(/\w+)?)?(?=\W|$),?")


def richest(tests: Sequence[Analysis]) -> tuple[list[Estimate], str]:
    """The headline values of one test at its operating points, and the name of what these differ in; the most."""
    best: tuple[list[Estimate], str] = ([], "")
    for analysis in tests:
        kept, _ = without_comparison(analysis)
        for names, (members, _) in for_terminal(kept, declared([analysis])).items():
            over = in_order(members[0].at, POINTS)[:1] if names else []
            if len(over) == 1 and len(members) > len(best[0]):
                best = members, over[0]
    return best


def how_well(members: Sequence[Estimate], over: str) -> str:
    """How well the values are known at most, and where: `F_ce within 1.7 %, K 0.31 % from 150 to 500 kPa`; or empty.

    Of values that come near 0 it is a half width in their unit.
    """
    by_symbol: dict[str, list[Estimate]] = {}
    for e in members:
        if e.value and e.parts.combined is not None:
            by_symbol.setdefault(symbol_text(e.symbol), []).append(e)
    widest = {name: widest_half(same) for name, same in by_symbol.items()}
    if not widest:
        return ""
    unit = point_shown(over)[1]
    places = [e.at[over] / unit.scale for e in members]
    known = ", ".join(f"{name}{'' if n else ' within'} {half}" for n, (name, half) in enumerate(widest.items()))
    return f"{known} from {number(min(places))} to {number(max(places))} {unit.unit}".rstrip()


def widest_half(same: Sequence[Estimate]) -> str:
    """The widest half width of estimates of one symbol: as a share of its value, or where that is near 0 as it is."""
    halves = [(e.parts.combined or 0.0, abs(e.value or 0.0)) for e in same]
    if all(half < NEAR_0 * value for half, value in halves):
        return f"{100 * max(half / value for half, value in halves):.2g} %"
    return show(max(half for half, _ in halves), same[0].quantity, 2)


def left_out(dropped: Sequence[Dropped]) -> str:
    """Why trials were left out, without the numbers of each: `the load is not below F_ce (32), too little motion (2)`.

    At most three reasons, the most frequent first.
    """
    counts = Counter(" ".join(_SIZE.sub("", one.reason.partition(":")[0]).split()) for one in dropped)
    return ", ".join(f"{clean(reason)} ({count})" for reason, count in counts.most_common(3))


def without_run(text: str, tests: Sequence[Analysis]) -> str:
    """The text in typography; the name of the run is left out where there is only one."""
    runs = {run for a in tests for run in a.runs}
    return clean(printed(text.replace(f"{next(iter(runs))}: ", "") if len(runs) == 1 else text))


def costliest(tests: Sequence[Analysis], failed: Sequence[str]) -> tuple[list[str], int]:
    """What costs most first: not accepted (`failed`: why), withheld, faults, doubts, trials that are missing.

    At most `MOST_FINDINGS`, and how many more findings there are. That all is well is not among the first.
    """
    found = [f"not accepted: {text}" for text in failed]
    held = [text for a in tests for text in reasons([e for e in a.estimates if e.withheld])]
    found += [text for text in held if not any(text.partition("withheld: ")[2][:ALIKE] in one for one in failed)]
    for level in ("fault", "doubt"):
        texts = (f.text for a in tests for f in a.findings if f.level == level)
        found += [t for t in texts if not any(t.removeprefix("form: ")[:ALIKE] in one for one in failed)]
    lost = [a.dropped for a in tests if a.dropped]
    found += [f"{len(one)} trial{'s'[: len(one) > 1]} not used: {left_out(one)}" for one in lost]
    found = list(dict.fromkeys(without_run(text, tests) for text in found))
    notes = sum(f.level == "note" for a in tests for f in a.findings)
    return found[:MOST_FINDINGS], len(found[MOST_FINDINGS:]) + notes


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
    return [line[:WIDTH] for line in [*lines, "", *_findings(analyses, failed, MOST_LINES - len(lines) - 1)]]


def _table(members: Sequence[Estimate], over: str, tests: Sequence[Analysis]) -> list[str]:
    """Columns as far as they fit, rows at most `MOST_ROWS`, else every second."""
    across = two_coordinates(members, over)
    if across:
        heads, body = matrix_table(members, over, across)
        e, rows = members[0], [heads, *body]
        above = [shown(e.quantity, e.unit).label(symbol_text(e.symbol))]
    else:
        if len({(e.symbol, e.method) for e in members}) == len({e.symbol for e in members}):
            members = [replace(e, method="") for e in members]  # one row for what several methods say of one point
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


def _verdict(verdict: Verdict, members: Sequence[Estimate], over: str) -> str:
    """The word, and for good results how well the values of the table are known."""
    text = (how_well(members, over) if verdict.level == "good" and members else "") or verdict.text
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
    if any(len(e.at) > 1 for e in members):
        return []
    courses: dict[str, list[Estimate]] = {}
    for e in sorted((e for e in members if e.value is not None), key=lambda e: e.at[over]):
        courses.setdefault(e.symbol, []).append(e)
    usable = {symbol: course for symbol, course in courses.items() if len({e.at[over] for e in course}) > 2}
    if not usable:
        return []
    symbol = "K" if "K" in usable else next(iter(usable))
    unit = shown(usable[symbol][0].quantity, usable[symbol][0].unit)
    values = [v for e in usable[symbol] if isfinite(v := (e.value or 0.0) / unit.scale)]
    head = f"{symbol_text(symbol)}({symbol_text(point_head(over).partition(' ')[0])})"
    return [f"{head}  {rounded(values[0], None, 3)} {sparkline(values)} {rounded(values[-1], None, 3)} {unit.unit}"]


def _findings(analyses: Sequence[Analysis], failed: Sequence[str], room: int) -> list[str]:
    """The costliest of the tests, in full where `room` lines allow it; how many more findings there are in all."""
    first, more = costliest([a for a in analyses if a.kind != AGREEMENT], failed)
    more += sum(len(a.findings) for a in analyses if a.kind == AGREEMENT)
    spare = room - len(first) - bool(more)
    lines = []
    for text in first:
        whole = wrap(text, WIDTH - 3, max_lines=1 + max(0, spare), placeholder=" …")
        spare -= len(whole) - 1
        lines += [f"{'   ' if place else '!  '}{part}" for place, part in enumerate(whole)]
    return [*lines, *([f"   {more} more finding{'s'[: more > 1]}: -v, or the report"] if more else [])]


def print_coefficients(analyses: Sequence[Analysis], console: Console) -> None:
    """The main coefficients of each test as tables that fit 80 columns; of methods for comparison the names only."""
    from rich.text import Text

    for analysis in (a for a in analyses if a.estimates or a.kind != AGREEMENT):
        mark = "SIMULATED  " if analysis.simulated else ""
        console.print(Text(f"{mark}{kind_title(analysis.kind)}", style="bold"))
        shown_estimates, compared = without_comparison(analysis)
        results = declared([analysis])
        groups = for_terminal(shown_estimates, results)
        for names, (members, constant) in groups.items():
            frame = pivot_table(members, results) if names else whole_table(members, results).without("quantity")
            over = in_order(members[0].at, POINTS)
            by = f"by {' and '.join(spoken(name) for name in over)}" if over else "for the whole campaign"
            at = f", at {point_text(constant)}" if constant else ""
            for method in dict.fromkeys(frame["method"]):
                console.print(Text(f"  {method}, {by}{at}", style="italic"))
                mine = [e for e in members if clean(e.method) == method]
                body = frame.where(name == method for name in frame["method"]).without("method").filled()
                print_grid(console, body.columns, body.cells(), ("symbol", "unit"), len(names) or 1)
                for reason in reasons(mine):
                    console.print(Text(f"  {reason}"))
        shown_symbols = {e.symbol for members, _ in groups.values() for e in members}
        known = {e.symbol for e in shown_estimates} - shown_symbols
        if more := [name for name in results if name in known]:
            others = ", ".join(f"{symbol_text(symbol)} ({clean(results[symbol].title)})" for symbol in more)
            console.print(Text(f"  more in the tables of the analysis folder: {others}"))
        if compared:
            console.print(Text(f"  for comparison, in the tables of the analysis folder: {', '.join(compared)}"))
        console.print()


def without_comparison(analysis: Analysis) -> tuple[list[Estimate], list[str]]:
    """Estimates without those whose symbol an earlier method gives at the same kind of point; names of such methods."""
    first: dict[tuple[str, str, tuple[str, ...]], str] = {}
    kept, compared = [], []
    for e in analysis.estimates:
        if first.setdefault((e.symbol, e.coordinate, tuple(sorted(e.at))), e.method) == e.method:
            kept.append(e)
        else:
            compared.append(clean(e.method))
    return kept, list(dict.fromkeys(compared))


def reasons(estimates: Sequence[Estimate]) -> list[str]:
    """Why values or intervals are missing, the symbols with one reason together."""
    found: dict[str, list[str]] = {}
    for e in estimates:
        if e.note and (e.value is None or e.parts.combined is None):
            lack = "withheld: " if e.withheld else "" if e.value is None else "no interval: "
            found.setdefault(f"{lack}{clean(e.note)}", []).append(symbol_text(e.symbol, e.coordinate))
    return [f"{', '.join(dict.fromkeys(symbols))}: {reason}" for reason, symbols in found.items()]


def for_terminal(
    estimates: Sequence[Estimate], results: Mapping[str, Result]
) -> dict[tuple[str, ...], tuple[list[Estimate], dict[str, float]]]:
    """The estimates for the terminal by kind of operating point: headlines and what is withheld; what is constant."""
    groups: dict[tuple[str, ...], list[Estimate]] = {}
    for e in estimates:
        if e.withheld or results[e.symbol].headline:
            groups.setdefault(tuple(sorted(e.at)), []).append(e)
    shown_groups = {}
    for names, members in groups.items():
        moving = [name for name in names if len({e.at[name] for e in members}) > 1 and name != "mass"]
        kept = moving or in_order(names, POINTS)[:1]
        constant = {name: members[0].at[name] for name in names if name not in kept and name != "mass"}
        shown_groups[names] = ([replace(e, at={name: e.at[name] for name in kept}) for e in members], constant)
    return shown_groups
