"""The life of a specimen as rows of text, for terminal and page; computes nothing."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.analysis.verdict.life import Past, Series, chosen
from pmabench.base.quantities import in_words
from pmabench.plotting.wording import clean, point_text, rounded, shown, symbol_text
from pmabench.report.words.names import kind_title

Rows = tuple[list[str], list[list[str]]]
"""Heads, and rows of text under them."""
MOST_COLUMNS = 8
"""Coefficients that are shown side by side."""


def run_rows(life: Sequence[Past]) -> Rows:
    """A row for each run: when, what, cycles before it and in it, time at pressure."""
    heads = ["date", "kind", "status", "cycles before", "cycles", "strokes", "at pressure", "highest [kPa]"]
    return heads, [
        [
            clean(past.date, 40)[:16].replace("T", " "),
            kind_title(past.kind),
            clean(past.status, 40),
            f"{past.before:,}",
            f"{past.use.cycles:,}",
            f"{past.use.strokes:,.6g}",
            in_words(past.use.at_pressure),
            f"{past.use.highest / 1e3:.4g}",
        ]
        for past in life
    ]


def value_rows(life: Sequence[Past], series: Sequence[Series]) -> Rows:
    """A row for each run that has values: the chosen coefficients side by side."""
    columns = [one for one in chosen(series) if one.moments][:MOST_COLUMNS]
    heads = ["date", "cycles"]
    symbols = [one.first.symbol for one in columns]
    for one in columns:
        e = one.first
        unit = shown(e.quantity, e.unit)
        at = point_text({name: value for name, value in e.at.items() if name in ("pressure", "frequency", "speed")})
        head = f"{unit.label(symbol_text(e.symbol))}{f' at {at}' if at else ''}"
        heads.append(f"{head}, {kind_title(one.kind).lower()}" if symbols.count(e.symbol) > 1 else head)
    rows = []
    for past in life:
        cells = [_cell(one, past) for one in columns]
        if any(cells):
            rows.append([clean(past.date, 40)[:16].replace("T", " "), f"{past.before:,}", *cells])
    return heads, rows


def _cell(one: Series, past: Past) -> str:
    moment = next((moment for moment in one.moments if moment.run == past.run), None)
    if moment is None or moment.estimate.value is None:
        return ""
    e = moment.estimate
    scale, half = shown(e.quantity, e.unit).scale, e.parts.combined
    return rounded(moment.estimate.value / scale, None if half is None else half / scale)
