"""A comparison as rows of text, for terminal and page; computes nothing."""

from __future__ import annotations

from collections.abc import Sequence

from pmabench.analysis.results import Estimate
from pmabench.analysis.verdict.comparison import Difference, Side, percent
from pmabench.plotting.wording import clean, point_text, rounded, shown, symbol_text
from pmabench.report.figures.overlays import Comparison, comparison_table

Rows = tuple[list[str], list[list[str]]]
"""Heads, and rows of text under them."""


def rows_of(a: Side, b: Side, differences: Sequence[Difference]) -> Rows:
    """A row for each difference: both values, a - b, in % of b, E_n."""
    one, other = clean(a.name, 30), clean(b.name, 30)
    heads = ["symbol", "at", "unit", one, other, f"{one} − {other}", "[%]", "E_n", ""]
    rows = []
    for d in differences:
        unit = shown(d.a.quantity, d.a.unit)
        marks = ["~" if side in d.between else "" for side in ("a", "b")]
        rows.append(
            [
                symbol_text(d.a.symbol, d.a.coordinate),
                point_text({name: float(f"{value:.6g}") for name, value in d.a.at.items()}),
                unit.unit,
                marks[0] + _value(d.a, unit.scale),
                marks[1] + _value(d.b, unit.scale),
                rounded(d.value / unit.scale, None if d.half is None else d.half / unit.scale, 3),
                "" if d.relative is None else percent(d.relative).replace("-", "−"),
                "" if d.score is None else f"{d.score:+.2f}".replace("-", "−"),
                {True: "", False: "differs", None: "no interval"}[d.agrees],
            ]
        )
    return heads, rows


def _value(e: Estimate, scale: float) -> str:
    half = e.parts.combined
    return rounded(None if e.value is None else e.value / scale, None if half is None else half / scale)


def curve_rows(curves: Sequence[Comparison]) -> Rows:
    """A row for each curve compared with published points."""
    frame = comparison_table(curves)
    return [str(head) for head in frame.columns], [[str(cell) for cell in row] for row in frame.itertuples(index=False)]
