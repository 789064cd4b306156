"""Which figures an analysis has, with captions in plain words and alternative texts; draws through `plots`.

A trace of an unknown kind becomes a generic line plot, so a new reduction needs no entry here. The figure of work per
loop is here because every kind of test may have one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pmabench.base.kind import load
from pmabench.kinds import registry
from pmabench.plotting import loops as loop_figures
from pmabench.plotting import time_plots
from pmabench.plotting.pictures import (
    Picture,
    bound,
    column,
    drawable,
    has,
    label,
    numbers,
    panel,
    picture,
    spread,
)
from pmabench.plotting.plots import FULL, MARKERS, PALETTE, Array, blank, few_ticks, grid, legend_above
from pmabench.plotting.wording import COLUMNS, Frame, clean, in_order, point_shown, point_text, shown
from pmabench.report.certificate.force_chart import FIGURE
from pmabench.report.document.tables import cell
from pmabench.report.figures import coefficient_figures
from pmabench.store.analyses.results import Analysis, Estimate, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPEATS = {"repeats": "pmabench.report.figures.coefficient_figures:repeats"}
"""Traces that every kind of test may have."""
GENERIC = 6
"""Most figures of traces that no kind of test draws."""


def front_pictures(
    analyses: Sequence[Analysis], most: int, without: Sequence[str] = ()
) -> tuple[list[Picture], list[str]]:
    """At most so many plots for the first pages, by what the kinds declare, and the names of the traces in them.

    `without` names traces that are shown already.
    """
    analyses = [drawable(analysis) for analysis in analyses]
    found: list[Picture] = []
    used: list[str] = []
    for analysis in analyses if most else ():
        loops = [t for t in analysis.traces if t.figure in loop_figures.TOGETHER]
        if any("frequency" in t.marks or "model" not in t.columns for t in loops):
            found += loop_figures.together(analysis.traces, analysis.simulated)
            break
    for analysis in analyses:
        kind = registry.find(analysis.kind)
        for wanted, target in kind.front.items() if kind else ():
            traces = [t for t in analysis.traces if t.figure == wanted and t.name not in without]
            if not traces or len(found) >= most or (without and wanted == "overlay"):
                continue
            hero = max(traces, key=_stroke)
            pictures = load(target)(traces if len(traces) == 2 and wanted != "overlay" else [hero], analysis)
            found += pictures[:1]
            used += [hero.name] if pictures and wanted == "overlay" and len(traces) > 2 else []
    titles = {picture.title for picture in found}
    for analysis in analyses if len(found) < most else ():
        more = kind_pictures(analysis, [*without, *used])
        # a picture of all contractions would repeat that of one: `Force over pressure, x = 0 mm`
        found += [one for one in more if not any(title.startswith(one.title) for title in titles)]
    return found[:most], used


def _stroke(trace: Trace) -> float:
    """The largest displacement of a trace, to choose one for the first page."""
    values = np.abs(column(trace, "displacement")) if "displacement" in trace.columns else np.zeros(1)
    return float(np.max(values, where=np.isfinite(values), initial=0.0))


def kind_pictures(analysis: Analysis, without: Sequence[str] = ()) -> list[Picture]:
    """All further figures of an analysis; `without` names traces that are shown elsewhere."""
    analysis = drawable(analysis)
    found = coefficient_figures.others(analysis)
    traces = [t for t in analysis.traces if t.name not in without]
    left = {t.figure for t in traces} - {FIGURE}  # in the second figure of the certificate
    for target, kinds in _drawn_by(analysis.kind).items():
        mine = [t for t in traces if t.figure in kinds]
        left -= kinds
        if mine:
            found += load(target)(mine, analysis) or _generic(mine, analysis.simulated)
    return found + energy(analysis) + _generic([t for t in traces if t.figure in left], analysis.simulated)


def _drawn_by(kind: str) -> dict[str, set[str]]:
    """Drawing function -> kinds of traces that it draws: those of the kind of test first, then those of others."""
    own = registry.find(kind)
    found: dict[str, set[str]] = {}
    known: set[str] = set()
    for figures in [own.figures if own else {}, *(other.figures for other in registry.all_kinds().values()), REPEATS]:
        for figure, target in figures.items():
            if figure not in known:
                found.setdefault(target, set()).add(figure)
        known |= set(figures)
    return found


def _generic(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    found = []
    for trace in spread(traces, GENERIC):
        names = [name for name in trace.columns if has(trace, name)]
        if len(names) < 2:
            continue
        x, rest = names[0], names[1:9]
        data = panel(trace, {name: name for name in names}, clean(trace.title, 90)).columns
        columns = [(_word(name), _axis(trace, name, rest), data[name]) for name in rest]
        draw = bound(time_plots.lines, "", data[x], label(trace, x), columns)
        title = clean(trace.title, 120) or clean(trace.name, 80)
        ends = column(trace, x)[np.isfinite(column(trace, x))]
        over = f"over {label(trace, x)}, from {ends.min():.4g} to {ends.max():.4g}"
        alt = f"{', '.join(map(_word, rest))} {over}."
        found.append(picture(draw, title, "", alt, numbers([("", trace)]), wide=True, simulated=simulated))
    return found


def _word(name: str) -> str:
    return COLUMNS.get(name) or clean(name, 40)


def _axis(trace: Trace, name: str, names: Sequence[str]) -> str:
    """Columns of one quantity share an axis, which has the name of the first."""
    quantity = trace.quantities.get(name, "")
    first = next(other for other in names if trace.quantities.get(other, "") == quantity)
    return shown(quantity).label(_word(first) if quantity else _word(name))


SYMBOLS = ("W_c", "W", "eta")
HEADS = {"W_c": "given W_c", "W": "loss W", "eta": "recovered eta"}
MOST = 6
"""Most operating points of the figure."""
Series = tuple[str, str, Array, Array, Array]
"""Operating point, symbol, rate, value and half width in display units."""


def energy(analysis: Analysis) -> list[Picture]:
    """One figure over speed or frequency, a series for each other operating point; none without W_c and W."""
    found = []
    for rate in ("speed", "frequency"):
        mine = [e for e in analysis.estimates if e.symbol in SYMBOLS and rate in e.at and e.value is not None]
        if {"W_c", "W"} <= {e.symbol for e in mine}:
            found.append(_energy(mine, rate, analysis.simulated))
    return found


def _where(e: Estimate, rate: str, alike: Sequence[str]) -> str:
    return point_text({name: at for name, at in e.at.items() if name != rate and name not in alike})


def _energy(mine: Sequence[Estimate], rate: str, simulated: bool) -> Picture:
    alike = [name for name in mine[0].at if name != "pressure" and len({e.at.get(name) for e in mine}) == 1]
    places = list(dict.fromkeys(_where(e, rate, alike) for e in mine))
    kept = spread(places, MOST)
    series: list[Series] = []
    for place in kept:
        for symbol in SYMBOLS:
            there = [e for e in mine if e.symbol == symbol and _where(e, rate, alike) == place]
            members = sorted(there, key=lambda e: e.at[rate])
            scales = np.array([shown(e.quantity, e.unit).scale for e in members])
            values = np.array([e.value or 0.0 for e in members]) / scales
            halves = np.array([e.parts.combined or 0.0 for e in members]) / scales
            at = np.array([e.at[rate] / point_shown(rate)[1].scale for e in members])
            series.append((place, symbol, at, values, halves))
    label, unit = point_shown(rate)
    x_label = unit.label(label)
    here = point_text({name: mine[0].at[name] for name in alike if name in mine[0].at})
    per = "a cycle of the sine" if rate == "frequency" else "a cycle of the ramps"
    some = "" if len(kept) == len(places) else f" {len(kept)} of {len(places)} are shown."
    caption = (
        f"For {per}{f', at {here}' if here else ''}: work given while contracting, the loop's area (work lost), and "
        "what comes back of the work taken up while expanding, eta = W_c/(W_c + W), with 95 % intervals. What the air "
        f"carries in and out is not measured.{some}"
    )
    ends = {s: [float(v) for _, symbol, _, values, _ in series if symbol == s for v in values] for s in SYMBOLS}
    words = {"W_c": ("work given", "J"), "W": ("work lost", "J"), "eta": ("share recovered", "%")}
    spans = [(*words[s], min(v), max(v)) for s, v in ends.items() if v]
    reaches = ", ".join(f"{word} {low:.3g} to {high:.3g} {unit}" for word, unit, low, high in spans)
    alt = f"Work per loop over {label} at {'; '.join(kept)}: {reaches}."
    draw = bound(drawing_of, series, x_label)
    return picture(draw, "Work per loop", caption, alt, _table(mine, rate), wide=True, simulated=simulated)


def _table(mine: Sequence[Estimate], rate: str) -> Frame:
    """One row per operating point."""
    rows: dict[tuple[tuple[str, float], ...], dict[str, str]] = {}
    names = in_order((name for e in mine for name in e.at), ("pressure",))
    for e in mine:
        row = rows.setdefault(tuple((n, e.at[n]) for n in names if n in e.at), {"at": point_text(e.at)})
        row[shown(e.quantity, e.unit).label(e.symbol)] = cell(e)
    return Frame([rows[key] for key in sorted(rows)])


def drawing_of(series: Sequence[Series], x_label: str) -> Figure:
    """A panel for each symbol."""
    figure = blank(FULL, 2.75)
    cells = grid(figure, 1, len(SYMBOLS), top=0.55, left=0.5, across=0.6)
    places = list(dict.fromkeys(place for place, *_ in series))
    for i, symbol in enumerate(SYMBOLS):
        axes = figure.add_subplot(cells[i])
        for place, name, x, y, half in series:
            if name == symbol and len(x):
                n = places.index(place)
                color = PALETTE[n % len(PALETTE)]
                axes.errorbar(x, y, yerr=half, fmt=MARKERS[n % len(MARKERS)], color=color, markersize=3.6,
                              elinewidth=0.9, linewidth=0.7, linestyle="-", label=place)  # fmt: skip
        axes.set(xlabel=x_label, ylabel=f"{HEADS[symbol]} [{'%' if symbol == 'eta' else 'J'}]")
        axes.set_ylim(bottom=0.0, top=None if symbol != "eta" else 100.0)
        few_ticks(axes, x=5)
    legend_above(figure, 3, at=(0.4, 0.06))
    return figure
