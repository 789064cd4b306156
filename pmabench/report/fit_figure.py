"""A fitted model as a picture: measured marks, fitted curve with its band, residual below; computes no estimate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.model_fit import ModelFit
from pmabench.model.library import OutsideDomain
from pmabench.plotting import plots
from pmabench.plotting.plots import FAINT, FULL, MARKERS, PALETTE, blank, few_ticks, grid
from pmabench.plotting.svg import drawing, to_svg
from pmabench.plotting.wording import clean, number, shown
from pmabench.report.writing import write_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CURVES = 8
"""Combinations of the other inputs up to which each has a curve; with more, computed is drawn over measured."""
POINTS = 121
MARK: dict[str, Any] = {"markerfacecolor": "white", "markersize": 3.6, "markeredgewidth": 0.9}
MOST_MARKS = 400
"""Marks of a curve that are drawn, evenly chosen."""
ALONE = 'xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" style="background: #fff"'
"""What an SVG element needs to be a file."""


def write_fit(fit: ModelFit, path: Path, name: str, source: str = "") -> None:
    """Draw `fit` to an SVG file; `name` of the data and their `source` are in its description. RecordError."""
    outputs = {o.name: o for o in fit.model.outputs}
    unit = shown(outputs[fit.output].quantity)
    title = f"{fit.model.name} fitted to {clean(name, 60)}"
    alt = (
        f"{title}: {fit.output} of {len(fit.measured)} rows as marks, the fit as lines with its 95 % confidence band; "
        f"below, measured less fitted, rms {fit.residual_rms / unit.scale:.3g} {unit.unit}. {clean(source, 300)}"
    ).strip()
    with drawing():
        svg = to_svg(_draw(fit, title), alt)
    text = svg.replace("<svg ", f"<svg {ALONE} ", 1)
    write_file(path, f"{text}\n", "the figure")


def _draw(fit: ModelFit, title: str) -> Figure:
    over = max(fit.columns, key=lambda name: len(np.unique(fit.columns[name])))
    others = [name for name in fit.columns if name != over]
    rows = np.column_stack([fit.columns[name] for name in others]) if others else np.zeros((len(fit.measured), 0))
    groups, member = np.unique(np.round(rows, 9), axis=0, return_inverse=True)
    figure = blank(FULL * 0.7, 3.6)
    if len(groups) > MOST_CURVES:
        _measured_over_computed(figure, fit, title)
    else:
        _curves(figure, fit, title, over, [dict(zip(others, row, strict=True)) for row in groups], member.ravel())
    return figure


def _curves(
    figure: Figure, fit: ModelFit, title: str, over: str, groups: list[dict[str, Any]], member: NDArray[np.intp]
) -> None:
    known = {p.name: p for p in fit.model.parameters}
    quantity = next(o.quantity for o in fit.model.outputs if o.name == fit.output)
    unit, x_unit = shown(quantity), shown(known[over].quantity)
    cells = grid(figure, 1, 1, left=0.6, top=0.32, right=1.35 if len(groups) > 1 else 0.12)[0]
    upper, lower = plots.above_each_other(figure, cells, (3, 1), 0.12)
    x, residual = fit.columns[over], fit.measured - fit.computed
    for i, group in enumerate(groups):
        color, mine = PALETTE[i % len(PALETTE)], member == i
        fine = np.linspace(x[mine].min(), x[mine].max(), POINTS)
        try:
            middle, half = fit.band({**fit.columns, over: fine, **{k: np.full(POINTS, v) for k, v in group.items()}})
        except OutsideDomain:
            order = np.argsort(x[mine])
            fine, middle, half = x[mine][order], fit.computed[mine][order], None
        if half is not None:
            ends = (middle - half) / unit.scale, (middle + half) / unit.scale
            upper.fill_between(fine / x_unit.scale, *ends, color=color, alpha=0.2, linewidth=0)
        upper.plot(fine / x_unit.scale, middle / unit.scale, color=color, linewidth=1.0)
        places = [(known[name].symbol or name, shown(known[name].quantity), value) for name, value in group.items()]
        label = ", ".join(f"{word} = {number(value / of.scale)} {of.unit}".strip() for word, of, value in places)
        drawn = np.flatnonzero(mine)[:: -(-int(mine.sum()) // MOST_MARKS)]
        for axes, y in ((upper, fit.measured), (lower, residual)):
            place, look = (x[drawn] / x_unit.scale, y[drawn] / unit.scale), MARKERS[i % len(MARKERS)]
            axes.plot(*place, look, color=color, label=label, **MARK)
    lower.axhline(0, color=FAINT, linewidth=0.6, zorder=0)
    upper.set(title=title, ylabel=unit.label(fit.output))
    lower.set(ylabel=f"apart [{unit.unit}]" if unit.unit else "apart", xlabel=x_unit.label(over), xlim=upper.get_xlim())
    few_ticks(upper)
    few_ticks(lower, y=3)
    figure.align_ylabels([upper, lower])
    if len(groups) > 1:
        upper.legend(loc="upper left", bbox_to_anchor=(1.02, 1))


def _measured_over_computed(figure: Figure, fit: ModelFit, title: str) -> None:
    quantity = next(o.quantity for o in fit.model.outputs if o.name == fit.output)
    unit = shown(quantity)
    axes = figure.add_subplot(plots.grid(figure, 1, 1, left=0.6, top=0.32)[0])
    ends = np.array([min(fit.computed.min(), fit.measured.min()), max(fit.computed.max(), fit.measured.max())])
    axes.plot(ends / unit.scale, ends / unit.scale, color=FAINT, linewidth=1.0)
    axes.plot(fit.computed / unit.scale, fit.measured / unit.scale, ".", color=PALETTE[0], markersize=2.5)
    axes.set(title=title, xlabel=unit.label(f"{fit.output}, fitted"), ylabel=unit.label(f"{fit.output}, measured"))
    few_ticks(axes)
