"""The life of a specimen as rows of text and as one HTML file: coefficients over cycles, control charts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pmabench.analysis.verdict.life import Past, References, Series, chosen
from pmabench.base.quantities import in_words
from pmabench.plotting.chart import PAGE, Chart, Level
from pmabench.plotting.chart import Series as Drawn
from pmabench.plotting.looks import BLUE, FAINT, FAULT
from pmabench.plotting.pictures import LARGEST, Picture, of_charts
from pmabench.plotting.wording import Frame, clean, point_text, rounded, shown, symbol_text
from pmabench.report.words import kind_title
from pmabench.report.writing import Page, TextTable, write_page
from pmabench.store.analyses.results import Finding

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
    rows = [
        {
            "date": clean(m.date, 40)[:16].replace("T", " "),
            "cycles": f"{m.cycles:,}",
            unit.label(clean(e.symbol, 20)): rounded(v, half if half else None),
        }
        for m, v, half in zip(moments, y.tolist(), bars.tolist(), strict=True)
    ]
    return of_charts(
        [[chart]],
        f"{name[:1].upper()}{name[1:]} {over}",
        f"{kind_title(one.kind)}{f', {at}' if at else ''}; {interval_text}.",
        f"Plot of {name} {over}, {len(moments)} values. The numbers are in the table below.",
        Frame(rows),
        simulated=simulated,
    )


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
        {"trial": clean(trial, 120), "date": clean(date, 40)[:16].replace("T", " "), "cycles": f"{cycles:,}",
         "stroke [mm]": f"{1e3 * stroke:.6g}"}
        for date, cycles, stroke, trial in one.moments
    ]  # fmt: skip
    return of_charts(
        [[chart]],
        f"Control chart: {clean(one.title, 120)}",
        caption,
        f"Strokes of {len(strokes)} reference trials on {len(days)} days in order of time, from {strokes.min():.4g} to "
        f"{strokes.max():.4g} mm; {len(alarms)} are marked. The numbers are in the table below.",
        Frame(rows),
        simulated=simulated,
    )


def _whole(most: int) -> tuple[float, ...]:
    """About ten ticks at whole numbers from 1 on."""
    return tuple(map(float, range(1, most + 1, -(-most // 10))))


Rows = tuple[list[str], list[list[str]]]
"""Heads, and rows of text under them."""
MOST_COLUMNS = 8
"""Coefficients that are shown side by side."""


def run_rows(life: Sequence[Past]) -> Rows:
    """A row for each run: when, what, cycles before it and in it, time at pressure; strokes where a drive made any."""
    driven = any(past.use.strokes for past in life)
    heads = ["date", "kind", "status", "cycles before", "cycles", "at pressure", "highest [kPa]"]
    return heads + ["driven strokes"] * driven, [
        [
            clean(past.date, 40)[:16].replace("T", " "),
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
            rows.append([clean(past.date, 40)[:16].replace("T", " "), f"{past.before:,}", *cells])
    return heads, rows


def _cell(one: Series, past: Past) -> str:
    e = next((moment.estimate for moment in one.moments if moment.run == past.run), None)
    return "" if e is None or e.value is None else shown(e.quantity, e.unit).rounded(e.value, e.parts.combined)
