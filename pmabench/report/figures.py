"""Which figures an analysis has, with captions in plain words and alternative texts.

A trace of an unknown kind becomes a generic line plot, so a new reduction needs no entry here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.base.kind import load
from pmabench.kinds import registry
from pmabench.plotting.chart import PAGE, Chart, Series, small_multiples
from pmabench.plotting.looks import PALETTE
from pmabench.plotting.pictures import Picture, column, curve, drawable, has, label, numbers, of_charts, spread
from pmabench.plotting.wording import COLUMNS, clean, shown
from pmabench.report import coefficient_figures
from pmabench.report.certificate.force_chart import FIGURE
from pmabench.store.analyses.results import Analysis, Trace

GENERIC, FEW = 6, 30
"""Most figures of traces that no kind of test draws, and points up to which they may be marks."""


def front_pictures(
    analyses: Sequence[Analysis], most: int, without: Sequence[str] = ()
) -> tuple[list[Picture], list[str]]:
    """At most so many plots for the first pages, by what the kinds declare, and the names of the traces in them.

    `without` names traces that are shown already.
    """
    analyses = [drawable(analysis) for analysis in analyses]
    found: list[Picture] = []
    used: list[str] = []
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
    return found + _generic([t for t in traces if t.figure in left], analysis.simulated)


def _drawn_by(kind: str) -> dict[str, set[str]]:
    """Drawing function -> kinds of traces that it draws: those of the kind of test first, then those of others."""
    own = registry.find(kind)
    found: dict[str, set[str]] = {}
    known: set[str] = set()
    for figures in [own.figures if own else {}, *(other.figures for other in registry.all_kinds().values())]:
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
        rows = small_multiples([_lines(trace, x, rest)], 1, width=PAGE)
        title = clean(trace.title, 120) or clean(trace.name, 80)
        ends = column(trace, x)[np.isfinite(column(trace, x))]
        over = f"over {label(trace, x)}, from {ends.min():.4g} to {ends.max():.4g}"
        alt = f"{', '.join(map(_word, rest))} {over}."
        found.append(of_charts(rows, title, "", alt, numbers([("", trace)]), simulated=simulated))
    return found


def _lines(trace: Trace, x: str, names: Sequence[str]) -> list[Chart]:
    """Columns over another one, a chart for each axis label; few points as marks."""
    at, axes = column(trace, x), [_axis(trace, name, names) for name in names]
    mark = "o" if len(at) <= FEW and not np.all(np.diff(at) > 0) else ""
    series: dict[str, list[Series]] = {}
    for n, (name, axis) in enumerate(zip(names, axes, strict=True)):
        said, color = _word(name) if axes.count(axis) > 1 else "", PALETTE[n % len(PALETTE)]
        series.setdefault(axis, []).append(curve(trace, x, name, said, color, mark, dashed=n % 2 > 0 and bool(said)))
    return [Chart(label(trace, x), axis, tuple(mine), height=128.0, legend=True) for axis, mine in series.items()]


def _word(name: str) -> str:
    return COLUMNS.get(name) or clean(name, 40)


def _axis(trace: Trace, name: str, names: Sequence[str]) -> str:
    """Columns of one quantity share an axis, which has the name of the first."""
    quantity = trace.quantities.get(name, "")
    first = next(other for other in names if trace.quantities.get(other, "") == quantity)
    return shown(quantity).label(_word(first) if quantity else _word(name))
