"""Which figures an analysis has, with captions in plain words and alternative texts; draws through `plots`.

A trace of an unknown kind becomes a generic line plot, so a new reduction needs no entry here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.results import Analysis, Trace
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
from pmabench.plotting.wording import COLUMNS, clean, shown
from pmabench.report.figures import characteristic_figures, coefficient_figures
from pmabench.report.figures.energy_figures import energy

REPEATS = {"repeats": "pmabench.report.figures.repeat_figures:repeats"}
"""Traces that every kind of test may have."""
GENERIC = 6
"""Most figures of traces that no kind of test draws."""
FRONT, FEW = 4, 2
"""Plots of the first page; and those of a report whose tests have none of its kinds."""


def front_pictures(analyses: Sequence[Analysis]) -> tuple[list[Picture], list[str]]:
    """The plots of the first page, and the names of the traces that are in them."""
    analyses = [drawable(analysis) for analysis in analyses]
    found = coefficient_figures.over_pressure(analyses)[: FRONT - 1]
    used: list[str] = []
    for analysis in analyses:
        if len(found) < FRONT and any(t.figure in loop_figures.TOGETHER for t in analysis.traces):
            found += loop_figures.together(analysis.traces, analysis.simulated)
            break
    for analysis in analyses:
        kind = registry.find(analysis.kind)
        for wanted, target in kind.front.items() if kind else ():
            traces = [t for t in analysis.traces if t.figure == wanted]
            if not traces or len(found) >= FRONT:
                continue
            hero = max(traces, key=_stroke)
            pictures = load(target)([hero], analysis)
            found += pictures[:1]
            used += [hero.name] if pictures and wanted == "overlay" and len(traces) > 2 else []
    for analysis in analyses if not found else ():
        found += kind_pictures(analysis)[: FEW - len(found)]
    return found, used


def _stroke(trace: Trace) -> float:
    """The largest displacement of a trace, to choose one for the first page."""
    values = np.abs(column(trace, "displacement")) if "displacement" in trace.columns else np.zeros(1)
    return float(np.max(values, where=np.isfinite(values), initial=0.0))


def kind_pictures(analysis: Analysis, without: Sequence[str] = ()) -> list[Picture]:
    """All further figures of an analysis; `without` names traces that are shown elsewhere."""
    analysis = drawable(analysis)
    found = coefficient_figures.others(analysis)
    traces = [t for t in analysis.traces if t.name not in without]
    left = {t.figure for t in traces} - {characteristic_figures.FIGURE}  # drawn over all tests together
    for target, kinds in _drawn_by(analysis.kind).items():
        mine = [t for t in traces if t.figure in kinds]
        left -= kinds
        if mine:
            pictures = load(target)(mine, analysis)
            found += pictures
            if not pictures:
                found += _generic(mine, analysis.simulated)
    return found + energy(analysis) + _generic([t for t in traces if t.figure in left], analysis.simulated)


def _drawn_by(kind: str) -> dict[str, set[str]]:
    """What draws -> the kinds of traces that it draws: as the kind of test says, then as other kinds do."""
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
    for trace in spread(list(traces), GENERIC):
        names = [name for name in trace.columns if has(trace, name)]
        if len(names) < 2:
            continue
        x, rest = names[0], names[1:9]
        data = panel(trace, {name: name for name in names}, clean(trace.title, 90)).columns
        columns = [(_word(name), _axis(trace, name, rest), data[name]) for name in rest]
        draw = bound(time_plots.lines, "", data[x], label(trace, x), columns)
        title = clean(trace.title, 120) or clean(trace.name, 80)
        ends = column(trace, x)[np.isfinite(column(trace, x))]
        columns_text = ", ".join(_word(name) for name in rest)
        alt = f"{columns_text} over {label(trace, x)}, from {ends.min():.4g} to {ends.max():.4g}."
        found.append(picture(draw, title, "", alt, numbers([("", trace)]), wide=True, simulated=simulated))
    return found


def _word(name: str) -> str:
    return COLUMNS.get(name) or clean(name, 40)


def _axis(trace: Trace, name: str, names: Sequence[str]) -> str:
    """Columns of one quantity share an axis, which has the name of the first."""
    quantity = trace.quantities.get(name, "")
    first = next(other for other in names if trace.quantities.get(other, "") == quantity)
    return shown(quantity).label(_word(first) if quantity else _word(name))
