"""Figures of measured motion compared with the fitted muscle: contraction over pressure, and what residuals look like.

Residuals are described and not tested: at 500 Hz every whiteness test rejects.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from pmabench.plotting import plots, time_plots
from pmabench.plotting.pictures import (
    Picture,
    bound,
    has,
    head,
    how_many,
    label,
    numbers,
    panel,
    picture,
    reach,
    spread,
    unit_of,
)
from pmabench.plotting.plots import (
    BLUE,
    FAINT,
    FULL,
    HALF,
    PALETTE,
    QUIET,
    Array,
    Panel,
    blank,
    few_ticks,
    grid,
    legend_above,
)
from pmabench.store.analyses.results import Analysis, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOGETHER = 5
"""Most curves of a figure."""
LAGS = 60
"""Lags of the autocorrelation."""
POINTS = 99
"""Quantiles that are compared with those of a normal distribution."""
NAMES = ("t", "pressure", "displacement", "model")
OVERLAYS = 6
"""Most panels of measured and modelled motion."""
FREE_RUN = "the fitted muscle, run freely with the measured pressure"


def motions(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Free runs of the fitted muscle, their residuals, and the same motion over the pressure."""
    found = overlays(traces, analysis)
    return found + residuals(traces, analysis.simulated) + over_pressure(traces, analysis.simulated)


def overlays(
    traces: Sequence[Trace], analysis: Analysis, model: str = FREE_RUN, title: str = "Measured and modelled motion",
    *, most: int = OVERLAYS, also: str = "", columns: Sequence[str] = NAMES,
) -> list[Picture]:  # fmt: skip
    """Contraction over time, measured and of a `model` in words, and their difference below.

    At `most` so many panels; `also` ends the caption, `columns` are those in the table, all if none are named.
    """
    able = [t for t in traces if has(t, "t", "displacement", "model")]
    if not able:
        return []
    chosen = spread(able, most)
    names = {"t": "t", "measured": "displacement", "model": "model"}
    panels = [panel(t, names, head(t)) for t in chosen]
    unit = unit_of(chosen[0], "displacement").unit
    labels = {"t": label(chosen[0], "t"), "measured": f"contraction [{unit}]", "residual": f"diff. [{unit}]"}
    misfits = [_rms(p.columns["measured"] - p.columns["model"]) for p in panels]
    worst = int(np.argmax(misfits))
    title += f", {panels[0].title}" if len(chosen) == 1 else ""
    caption = f"Grey: measured; brown: {model}. Below: their difference, rms {reach(misfits)} {unit}.{also}"
    caption += how_many(chosen, able)
    if any(not np.isfinite(p.columns["model"]).all() for p in panels):
        caption += " The model ends where the muscle moves at a pressure at which a coefficient is open."
    alt = (
        f"Contraction over time, measured, and {model}, in {len(panels)} panel{'s' if len(panels) > 1 else ''}: "
        f"{'; '.join(p.title for p in panels)}. Root mean square difference {reach(misfits)} {unit}"
        + (f", largest at {panels[worst].title}." if len(panels) > 1 else ".")
    )
    table = numbers([(head(t), t) for t in chosen], columns)
    draw = bound(time_plots.overlay, panels, labels)
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)]


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


def over_pressure(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Contraction over the pressure that was measured, both branches, a curve for each trial."""
    able = [t for t in traces if has(t, "pressure", "displacement")]
    if len(able) < 2:
        return []
    chosen = spread(able, TOGETHER)
    panels = [panel(t, {"x": "pressure", "y": "displacement"}, head(t)) for t in chosen]
    labels = (label(chosen[0], "pressure"), label(chosen[0], "displacement"))
    caption = "Measured, filling and venting; what lies between the branches is lag, damping and friction."
    alt = f"{labels[1]} over {labels[0]} as measured, both branches, for {'; '.join(p.title for p in panels)}."
    table = numbers([(head(t), t) for t in chosen], ("pressure", "displacement"))
    draw = bound(_draw_curves, panels, *labels)
    title = "Contraction over pressure, both branches"
    return [picture(draw, title, caption + how_many(chosen, able), alt, table, wide=False, simulated=simulated)]


def residuals(traces: Sequence[Trace], simulated: bool) -> list[Picture]:
    """Autocorrelation of measured less modelled contraction, and its quantiles against those of a normal one."""
    able = [t for t in traces if has(t, *NAMES)]
    parts = [(t, _residual(t)) for t in able]
    parts = [(t, values) for t, values in parts if len(values) > 2 * LAGS and np.std(values) > 0]
    if not parts:
        return []
    unit = unit_of(parts[0][0], "displacement")
    steps = np.array([float(np.median(np.diff(t.columns["t"]))) for t, _ in parts])
    lags = np.asarray(np.arange(LAGS + 1) * float(np.median(steps)), dtype=np.float64)
    correlations = [(head(t), _autocorrelation(values)) for t, values in parts[:TOGETHER]]
    pooled = np.sort(np.concatenate([values / np.std(values) for _, values in parts]))
    share = np.arange(1, POINTS + 1) / (POINTS + 1)
    normal = np.array([NormalDist().inv_cdf(float(p)) for p in share])
    quantiles = np.quantile(pooled, share)
    rms = float(np.sqrt(np.mean(np.concatenate([values for _, values in parts]) ** 2))) / unit.scale
    caption = (
        f"Measured less modelled contraction of {len(parts)} free runs, {rms:.2g} {unit.unit} rms. Left: "
        "autocorrelation. A free run that comes to rest a little off, as friction lets it, stays off until the next "
        "command, so its errors agree over seconds and say little of the form; that is tested on the segments of the "
        "fit, see `form` among the findings. Right: "
        "quantiles of the residuals, each trial by its own standard deviation, against those of a normal distribution."
    )
    alt = (
        f"Left: autocorrelation of residuals over lags up to {lags[-1]:.3g} s, "
        f"{min(r[-1] for _, r in correlations):.2g} to {max(r[-1] for _, r in correlations):.2g} at the last. Right: "
        f"quantiles of residuals from {quantiles[0]:.2g} to {quantiles[-1]:.2g} standard deviations where a normal "
        f"distribution has {normal[0]:.2g} to {normal[-1]:.2g}."
    )
    columns = {"lag": lags} | {f"r{n}": r for n, (_, r) in enumerate(correlations)}
    table = numbers([("", Trace("", "", "", columns, {"lag": "time"}))])
    for n, (name, _) in enumerate(correlations):
        table = table.renamed(f"r{n}", f"autocorrelation {n + 1}, {name}")
    draw = bound(_draw_residuals, lags, correlations, normal, quantiles)
    return [picture(draw, "Residuals of the free runs", caption, alt, table, wide=True, simulated=simulated)]


def _residual(trace: Trace) -> Array:
    """Measured less modelled contraction where both are known [m]; the mean stays in."""
    values = np.asarray(trace.columns["displacement"], dtype=np.float64) - np.asarray(trace.columns["model"])
    return np.asarray(values[np.isfinite(values)])


def _autocorrelation(values: Array) -> Array:
    """Autocorrelation of values less their mean at lags 0 to `LAGS`, shape (LAGS + 1,); 1 at lag 0."""
    x = values - values.mean()
    power = float(np.dot(x, x))
    return np.array([float(np.dot(x[: len(x) - lag], x[lag:])) / power for lag in range(LAGS + 1)])


def _draw_curves(panels: Sequence[Panel], x_label: str, y_label: str) -> Figure:
    """Columns y over x, a curve for each panel on common axes."""
    figure, axes = plots.one_axes(HALF, 2.7, top=0.2 + 0.16 * ceil(len(panels) / 2), left=0.56)
    for i, one in enumerate(panels):
        axes.plot(one.columns["x"], one.columns["y"], color=PALETTE[i % len(PALETTE)], linewidth=0.9, label=one.title)
    axes.set(xlabel=x_label, ylabel=y_label)
    few_ticks(axes)
    legend_above(figure, 2, at=(0.105, 0.13), handletextpad=0.4)
    return figure


def _draw_residuals(lags: Array, correlations: Sequence[tuple[str, Array]], normal: Array, quantiles: Array) -> Figure:
    """Autocorrelation over lags [s], a line for each trial; quantiles over those of a normal distribution."""
    figure = blank(FULL, 2.7)
    cells = grid(figure, 1, 2, top=0.4, left=0.56, across=0.7)
    left, right = figure.add_subplot(cells[0]), figure.add_subplot(cells[1])
    left.axhline(0, color=QUIET, linewidth=0.8)
    for i, (name, values) in enumerate(correlations):
        left.plot(lags, values, color=PALETTE[i % len(PALETTE)], linewidth=0.9, label=name)
    left.set(xlabel="lag [s]", ylabel="autocorrelation")
    left.set_ylim(min(-0.3, 1.1 * min(float(values.min()) for _, values in correlations)), 1.05)
    few_ticks(left)
    ends = (float(normal[0]), float(normal[-1]))
    right.plot(ends, ends, color=FAINT, linewidth=1.0)
    right.plot(normal, quantiles, ".", color=BLUE, markersize=3)
    right.set(xlabel="quantile of a normal distribution", ylabel="quantile of residuals")
    few_ticks(right)
    figure.legend(*left.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(0.06, 0.985), ncols=3)
    return figure
