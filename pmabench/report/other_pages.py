"""Pages for what is no report: a comparison, with both sides over pressure, and the life of a specimen over its cycles.

Their rows of text are printed on a terminal, too, and so is what a recalibration changed. No estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.verdict import comparison
from pmabench.analysis.verdict.comparison import Change, Difference, Side, percent
from pmabench.analysis.verdict.life import Past, References, Series, chosen
from pmabench.base.quantities import in_words
from pmabench.plotting.chart import BLUE, FAINT, FAULT, PAGE, Chart, Level
from pmabench.plotting.chart import Series as Drawn
from pmabench.plotting.pictures import LARGEST, Picture, drawable, of_charts
from pmabench.plotting.svg import capital
from pmabench.plotting.wording import Frame, clean, point_text, rounded, shown, symbol_text
from pmabench.report.document.special_tables import change_rows
from pmabench.report.figures import over_pressure
from pmabench.report.overlays import Comparison, comparison_table
from pmabench.report.terminal import print_grid
from pmabench.report.words import declared, kind_title
from pmabench.report.writing import Page, TextTable, write_page
from pmabench.store.analyses.results import PUBLISHED, Analysis, Finding

if TYPE_CHECKING:
    from rich.console import Console


def write_comparison(
    a: Side,
    b: Side,
    found: comparison.Comparison,
    curves: Sequence[Comparison],
    failed: Sequence[str],
    path: Path,
) -> Path:
    """Write the page; raises RecordError where it cannot be."""
    sides = [_drawn(side, found.differences, which) for which, side in (("a", a), ("b", b))]
    drawn = over_pressure(sides, declared([*a.analyses, *b.analyses]), [_named(side) for side in (a, b)])
    facts = [(clean(side.name, 60), clean(side.about, 600)) for side in (a, b)]
    differences = TextTable("Coefficient by coefficient", *rows_of(a, b, found.differences), 3)
    tables = [differences, TextTable("Curves compared with published points", *curve_rows(curves), 3)]
    title, simulated = f"{clean(a.name, 60)} against {clean(b.name, 60)}", a.simulated or b.simulated
    return write_page(Page("Comparison", title, simulated, facts, failed, found.findings, drawn, tables), path)


def _named(side: Side) -> str:
    """The side in a legend, where a letter alone would be taken for a symbol."""
    return side.name if len(side.name) > 1 else f"side {side.name}"


def _drawn(side: Side, differences: Sequence[Difference], which: str) -> Analysis:
    """The compared values of a side as an analysis, whose method is the name of the side."""
    estimates = [replace(getattr(d, which), method=_named(side), coordinate=d.a.coordinate) for d in differences]
    kind = PUBLISHED if side.published else "comparison"
    return drawable(Analysis(kind, (), simulated=side.simulated, estimates=tuple(estimates)))


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
                marks[0] + unit.rounded(d.a.value, d.a.parts.combined),
                marks[1] + unit.rounded(d.b.value, d.b.parts.combined),
                unit.rounded(d.value, d.half, 3),
                "" if d.relative is None else percent(d.relative).replace("-", "−"),
                "" if d.score is None else f"{d.score:+.2f}".replace("-", "−"),
                {True: "", False: "differs, or its scale" if d.lacks else "differs", None: "no interval"}[d.agrees],
            ]
        )
    return heads, rows


def curve_rows(curves: Sequence[Comparison]) -> Rows:
    """A row for each curve compared with published points."""
    frame = comparison_table(curves)
    return frame.columns, frame.cells()


HEADS = ("coefficient", "at", "unit", "as recorded", "as reduced here", "difference", "%")


def print_changes(changes: Sequence[Change], console: Console) -> None:
    """A table for each kind and method; the half width of the difference is that of the calibrations."""
    from rich.text import Text

    rows = []
    for change in changes:
        sides = (("as recorded", change.before), ("as reduced here", change.after))
        known = [(head, e, shown(e.quantity, e.unit)) for head, e in sides if e is not None and e.value is not None]
        values = {head: unit.rounded(e.value, e.parts.combined) for head, e, unit in known}
        rows += [{"kind": change.kind, **row, **values} for row in change_rows([change.to_dict()])]
    for kind, method in dict.fromkeys((row["kind"], row["method"]) for row in rows):
        console.print(Text(f"{kind}, {method}", style="italic"))
        mine = [row for row in rows if (row["kind"], row["method"]) == (kind, method)]
        print_grid(console, HEADS, Frame(mine, HEADS).cells(), ("coefficient", "at", "unit"), keys=2)


FEWEST = 2
"""Values that a figure over the life needs."""


def write_history(
    title: str,
    life: Sequence[Past],
    series: Sequence[Series],
    references: Sequence[References],
    remarks: Sequence[Finding],
    path: Path,
) -> Path:
    """Write the page; raises RecordError where it cannot be."""
    simulated = any(past.simulated for past in life)
    drawn = [_over_cycles(one, simulated=simulated) for one in chosen(series) if len(one.moments) >= FEWEST]
    drawn += [_control(one, simulated=simulated) for one in references if len(one.moments) >= FEWEST]
    facts = [
        ("Specimen", clean(title, 200)),
        ("Benches", ", ".join(dict.fromkeys(clean(past.bench, 80) for past in life))),
        ("Runs", f"{len(life)}, {life[0].date[:10]} to {life[-1].date[:10]}"),
    ]
    tables = [TextTable("Coefficients over its life", *value_rows(life, series)), TextTable("Runs", *run_rows(life), 3)]
    return write_page(
        Page("History of a specimen", clean(title, 200), simulated, facts, (), remarks, drawn, tables), path
    )


def _over_cycles(one: Series, *, simulated: bool) -> Picture:
    """A coefficient over cycles with 95 % bars; in order of time where no cycle is known."""
    e = one.first
    unit = shown(e.quantity, e.unit)
    moments = [m for m in one.moments if abs(m.estimate.value or 0.0) < LARGEST]
    x = np.array([m.cycles for m in moments], dtype=np.float64)
    over, axis = "over pressure cycles", "pressure cycles"
    if not np.ptp(x):
        x, over, axis = np.arange(1.0, len(x) + 1), "in order of time", "value, in order of time"
    y = np.array([m.estimate.value or 0.0 for m in moments]) / unit.scale
    bars = np.array([m.estimate.parts.combined or 0.0 for m in moments]) / unit.scale
    series = (Drawn("", x, y, BLUE, "o", bars),)
    x_ticks = () if axis == "pressure cycles" else _whole(len(x))
    chart = Chart(axis, unit.label(clean(e.symbol, 20)), series, x_ticks=x_ticks)
    at = point_text({name: value for name, value in e.at.items() if name != "mass"})
    name = clean(one.name, 200)
    interval_text = "95 % intervals" if bars.any() else "values without intervals"
    caption = f"{kind_title(one.kind)}{f', {at}' if at else ''}; {interval_text}."
    values = zip(moments, y.tolist(), bars.tolist(), strict=True)
    rows = [_row(m.date, m.cycles) | {chart.y_label: rounded(v, half or None)} for m, v, half in values]
    title = f"{capital(name)} {over}"
    return of_charts([[chart]], title, caption, Frame(rows), simulated=simulated)


def _minute(date: str) -> str:
    return clean(date, 40)[:16].replace("T", " ")


def _row(date: str, cycles: int) -> dict[str, str]:
    return {"date": _minute(date), "cycles": f"{cycles:,}"}


def _control(one: References, *, simulated: bool) -> Picture:
    """Strokes of a reference trial by days in order of time, and their means with control limits."""
    strokes = np.array([stroke for _, _, stroke, _ in one.moments]) * 1e3
    limits, days = one.chart, one.days
    means, place = np.array([stroke for _, _, stroke, _ in days]) * 1e3, np.arange(1.0, len(days) + 1)
    dates = [date[:10] for date, *_ in days]
    single = np.array([dates.index(date[:10]) + 1.0 for date, *_ in one.moments])
    alarms = set() if limits is None else {*limits.beyond, *([limits.shifted] if limits.shifted is not None else [])}
    marks = [
        Drawn("", single, strokes, FAINT, "."),
        Drawn("", place, means, FAINT, width=0.8),
        *(
            Drawn("", place[mine], means[mine], FAULT if alarm else BLUE, "s" if alarm else "o")
            for alarm in (False, True)
            if (mine := [i for i in range(len(days)) if (i in alarms) == alarm])
        ),
    ]
    levels: tuple[Level, ...] = ()
    if limits is not None:
        levels = (Level(1e3 * limits.low, to=1e3 * limits.high), Level(1e3 * limits.centre, dashed=False))
    x_label, whole = "day, in order of time", _whole(len(days))
    chart = Chart(x_label, "stroke [mm]", tuple(marks), PAGE, levels=levels, x_ticks=whole)
    caption = "Means of days; too few for control limits."
    if limits is not None:
        caption = (
            f"Means of days. Shaded: control limits from the first {limits.base}; red squares: beyond them, or the end "
            "of a long row on one side. Of charts of an unchanged muscle about 1 in 20 has one."
        )
    rows = [
        {"trial": clean(trial, 120)} | _row(date, cycles) | {"stroke [mm]": f"{1e3 * stroke:.6g}"}
        for date, cycles, stroke, trial in one.moments
    ]
    title = f"Control chart: {clean(one.title, 120)}"
    return of_charts([[chart]], title, caption, Frame(rows), simulated=simulated)


def _whole(most: int) -> tuple[float, ...]:
    """About ten ticks at whole numbers from 1 on."""
    return tuple(map(float, range(1, most + 1, -(-most // 10))))


MOST_COLUMNS = 8
"""Coefficients that are shown side by side."""


def run_rows(life: Sequence[Past]) -> Rows:
    """A row for each run: when, what, cycles before it and in it, time at pressure; strokes where a drive made any."""
    driven = any(past.use.strokes for past in life)
    heads = ["date", "kind", "status", "cycles before", "cycles", "at pressure", "highest [kPa]"]
    return heads + ["driven strokes"] * driven, [
        [
            _minute(past.date),
            kind_title(past.kind),
            clean(past.status, 40),
            f"{past.before:,}",
            f"{past.use.cycles:,}",
            in_words(past.use.at_pressure),
            f"{past.use.highest / 1e3:.4g}",
            *[f"{past.use.strokes:,.6g}"] * driven,
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
            rows.append([_minute(past.date), f"{past.before:,}", *cells])
    return heads, rows


def _cell(one: Series, past: Past) -> str:
    e = next((moment.estimate for moment in one.moments if moment.run == past.run), None)
    return "" if e is None or e.value is None else shown(e.quantity, e.unit).rounded(e.value, e.parts.combined)
