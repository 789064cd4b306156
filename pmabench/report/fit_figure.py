"""A fitted model as a picture: measured marks, fitted curve with its band, residual below; computes no estimate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.model_fit import ModelFit
from pmabench.model.library import OutsideDomain
from pmabench.plotting.chart import BLUE, FAINT, MARKS, PALETTE, Chart, Level, Series, small_multiples
from pmabench.plotting.drawing import joined
from pmabench.plotting.svg import as_file
from pmabench.plotting.wording import Shown, clean, number, shown
from pmabench.report.writing import write_file

MOST_CURVES = 8
"""Combinations of the other inputs up to which each has a curve; with more, computed is drawn over measured."""
POINTS = 121
MOST_MARKS = 400
"""Marks of a curve that are drawn, evenly chosen."""
WIDTH, UPPER, LOWER = 400.0, 190.0, 80.0


def write_fit(fit: ModelFit, path: Path, name: str, source: str = "") -> None:
    """Draw `fit` to an SVG file; `name` of the data and their `source` are in its description. RecordError."""
    unit = shown(next(o.quantity for o in fit.model.outputs if o.name == fit.output))
    title = f"{fit.model.name} fitted to {clean(name, 60)}"
    alt = (
        f"{title}: {fit.output} of {len(fit.measured)} rows as marks, the fit as lines with its 95 % confidence band; "
        f"below, measured less fitted, rms {fit.residual_rms / unit.scale:.3g} {unit.unit}. {clean(source, 300)}"
    ).strip()
    svg = joined(small_multiples([_charts(fit, title, unit)], 1, width=WIDTH), alt)
    write_file(path, f"{as_file(svg, 'Inter, sans-serif')}\n", "the figure")


def _charts(fit: ModelFit, title: str, unit: Shown) -> list[Chart]:
    over = max(fit.columns, key=lambda name: len(np.unique(fit.columns[name])))
    others = [name for name in fit.columns if name != over]
    rows = np.column_stack([fit.columns[name] for name in others]) if others else np.zeros((len(fit.measured), 0))
    groups, member = np.unique(np.round(rows, 9), axis=0, return_inverse=True)
    if len(groups) > MOST_CURVES:
        return [_measured_over_computed(fit, title, unit)]
    return _curves(fit, title, unit, over, [dict(zip(others, row, strict=True)) for row in groups], member.ravel())


def _curves(
    fit: ModelFit, title: str, unit: Shown, over: str, groups: list[dict[str, Any]], member: NDArray[np.intp]
) -> list[Chart]:
    known = {p.name: p for p in fit.model.parameters}
    x_unit = shown(known[over].quantity)
    x, residual = fit.columns[over], fit.measured - fit.computed
    lines: list[Series] = []
    marks: list[Series] = []
    apart: list[Series] = []
    for i, group in enumerate(groups):
        color, mine = PALETTE[i % len(PALETTE)], member == i
        fine = np.linspace(x[mine].min(), x[mine].max(), POINTS)
        try:
            middle, half = fit.band({**fit.columns, over: fine, **{k: np.full(POINTS, v) for k, v in group.items()}})
        except OutsideDomain:
            order = np.argsort(x[mine])
            fine, middle, half = x[mine][order], fit.computed[mine][order], None
        band = None if half is None else half / unit.scale
        lines.append(Series("", fine / x_unit.scale, middle / unit.scale, color, half=band, width=1.0))
        places = [(known[name].symbol or name, shown(known[name].quantity), value) for name, value in group.items()]
        label = ", ".join(f"{word} = {number(value / of.scale)} {of.unit}".strip() for word, of, value in places)
        drawn = np.flatnonzero(mine)[:: -(-int(mine.sum()) // MOST_MARKS)]
        for into, y in ((marks, fit.measured), (apart, residual)):
            place = x[drawn] / x_unit.scale, y[drawn] / unit.scale
            into.append(Series(label, *place, color, MARKS[i % len(MARKS)], hollow=True))
    x_label, less = x_unit.label(over), f"apart [{unit.unit}]" if unit.unit else "apart"
    zero = (Level(0.0, color=FAINT, dashed=False),)
    return [
        Chart(x_label, unit.label(fit.output), (*lines, *marks), WIDTH, UPPER, legend=True, title=title),
        Chart(x_label, less, tuple(apart), WIDTH, LOWER, legend=True, levels=zero, y_ticks=4),
    ]


def _measured_over_computed(fit: ModelFit, title: str, unit: Shown) -> Chart:
    ends = np.array([min(fit.computed.min(), fit.measured.min()), max(fit.computed.max(), fit.measured.max())])
    series = (
        Series("", ends / unit.scale, ends / unit.scale, FAINT, width=1.0),
        Series("", fit.computed / unit.scale, fit.measured / unit.scale, BLUE, "."),
    )
    labels = unit.label(f"{fit.output}, fitted"), unit.label(f"{fit.output}, measured")
    return Chart(*labels, series, WIDTH, UPPER + LOWER, title=title)
