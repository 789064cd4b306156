"""Uncertainty budgets as text: which sources make an interval, in shares of its variance; computes no estimate."""

from __future__ import annotations

import pandas as pd

from pmabench.analysis.results import Analysis, Estimate
from pmabench.plotting.wording import clean, half_width, point_text, shown, symbol_text
from pmabench.report.document.tables import Table, least
from pmabench.report.words.names import kind_title

NAMED_ALONE = 0.01
"""Sources with a smaller share of the variance are given as one sum."""


def budget_table(analysis: Analysis) -> Table | None:
    """One row for each estimate that has a budget; the caption names what was not assessed. None without any."""
    members = [e for e in analysis.estimates if e.budget and e.value is not None and e.parts.combined is not None]
    if not members:
        return None
    rows = []
    for e in members:
        unit = shown(e.quantity, e.unit)
        rows.append(
            {
                "method": clean(e.method),
                "symbol": symbol_text(e.symbol, e.coordinate),
                "at": point_text(e.at),
                "± 95 %": half_width((e.parts.combined or 0.0) / unit.scale, least(e)),
                "unit": unit.unit,
                "sources, shares of the variance": _shares(e),
            }
        )
    open_sources = dict.fromkeys(
        f"{clean(s.name, 80)}" + (f" ({clean(s.note, 120)})" if s.note else "")
        for e in members
        for s in e.budget
        if s.half is None
    )
    caption = f"{kind_title(analysis.kind)}: uncertainty budgets"
    if open_sources:
        caption += f"; not assessed: {'; '.join(open_sources)}"
    return Table(caption, pd.DataFrame(rows, dtype=object))


def _shares(e: Estimate) -> str:
    shares = [
        (share, clean(s.name, 80)) for s, share in zip(e.budget, e.shares, strict=True) if share is not None and s.half
    ]
    large = sorted((entry for entry in shares if entry[0] >= NAMED_ALONE), reverse=True)
    words = [f"{name} {100 * share:.0f} %" for share, name in large]
    rest = sum(share for share, _ in shares) - sum(share for share, _ in large)
    others = len(shares) - len(large)
    if others:
        words.append(f"{others} other{'s' if others > 1 else ''} {f'{100 * rest:.1f}' if rest >= 5e-4 else '< 0.1'} %")
    return ", ".join(words)
