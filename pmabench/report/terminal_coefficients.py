"""The coefficients of each test on a terminal: primary methods in full, others by name; computes no estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from pmabench.base.kind import Result
from pmabench.plotting.wording import POINTS, clean, in_order, point_text, spoken, symbol_text
from pmabench.report.document.tables import pivot_table, whole_table
from pmabench.report.terminal import print_grid
from pmabench.report.words import declared, kind_title
from pmabench.store.analyses.results import AGREEMENT, Analysis, Estimate

if TYPE_CHECKING:
    from rich.console import Console


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
                body = frame.where(cell == method for cell in frame["method"]).without("method").filled()
                print_grid(console, body.columns, body.cells(), ("symbol", "unit"), len(names) or 1)
                for reason in reasons(mine):
                    console.print(Text(f"  {reason}"))
        shown_symbols = {e.symbol for members, _ in groups.values() for e in members}
        more = [
            name for name in results if name not in shown_symbols and any(e.symbol == name for e in shown_estimates)
        ]
        if more:
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
    shown_groups: dict[tuple[str, ...], tuple[list[Estimate], dict[str, float]]] = {}
    for names, members in groups.items():
        moving = [name for name in names if len({e.at[name] for e in members}) > 1 and name != "mass"]
        kept = moving or in_order(names, POINTS)[:1]
        constant = {name: members[0].at[name] for name in names if name not in kept and name != "mass"}
        shown_groups[names] = ([replace(e, at={name: e.at[name] for name in kept}) for e in members], constant)
    return shown_groups
