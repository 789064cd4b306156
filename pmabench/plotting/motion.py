"""Figures of measured motion compared with the fitted muscle: contraction over pressure, and what residuals look like.

Residuals are described and not tested: at 500 Hz every whiteness test rejects.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from pmabench.plotting.chart import COLUMN, GAP, PAGE, Chart, Series, of_points, with_common_sides
from pmabench.plotting.pictures import (
    Picture,
    has,
    head,
    how_many,
    label,
    numbers,
    of_charts,
    panel,
    reach,
    spread,
    unit_of,
)
from pmabench.plotting.plots import BLUE, BROWN, FAINT, PALETTE, QUIET, Array, Panel
from pmabench.store.analyses.results import Analysis, Trace

TOGETHER = 5
"""Most curves of a figure."""
LAGS = 60
"""Lags of the autocorrelation."""
POINTS = 99
"""Quantiles that are compared with those of a normal distribution."""
NAMES = ("t", "pressure", "displacement", "model")
UPPER, LOWER = 104.0, 66.0
"""Heights of a panel, and of the difference below it [pt]."""
SHORT = 20
"""Letters of titles with which three panels fit side by side, and not two."""
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
    rows = _overlaid(panels, label(chosen[0], "t"), unit, simulated=analysis.simulated)
    return [of_charts(rows, title, caption, alt, table, simulated=analysis.simulated, still=True)]


def _overlaid(panels: Sequence[Panel], t_label: str, unit: str, *, simulated: bool) -> list[list[Chart]]:
    """Measured and model over time with their difference below, in small multiples; columns t, measured, model."""
    columns = 1 if len(panels) == 1 else 3 if max(len(one.title) for one in panels) < SHORT else 2
    width = COLUMN if columns == 1 else (PAGE - GAP * (columns - 1)) / columns
    pairs = []
    for n, one in enumerate(panels, 1):
        t, y, model = (one.columns[name] for name in ("t", "measured", "model"))
        lines = (Series("", t, y, FAINT, width=3.0), Series("", t, model, BROWN))
        apart = (Series("", t, y - model, QUIET, width=0.9),)
        name = "contraction" if columns == 1 else f"{one.title}: x"
        stamp = "SIMULATED" if simulated and n == min(columns, len(panels)) else ""
        upper = Chart(t_label, f"{name} [{unit}]", lines, width, UPPER, "", stamp=stamp, x_named=False)
        pairs.append(
            with_common_sides((upper, Chart(t_label, f"difference [{unit}]", apart, width, LOWER, "", y_ticks=3)))
        )
    rows = [pairs[i : i + columns] for i in range(0, len(pairs), columns)]
    return [[pair[n] for pair in row] for row in rows for n in (0, 1)]


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
    colors = zip(panels, PALETTE, strict=False)
    series = [Series(p.title, p.columns["x"], p.columns["y"], color, width=1.0) for p, color in colors]
    chart = of_points(series, *labels, alt, simulated=simulated)
    title, caption = "Contraction over pressure, both branches", caption + how_many(chosen, able)
    return [of_charts([[chart]], title, caption, alt, table, simulated=simulated, still=True)]


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
    colors = zip(correlations, PALETTE, strict=False)
    left = [Series(name, lags, values, color, width=1.0) for (name, values), color in colors]
    right = [Series("", normal, normal, FAINT, width=1.0), Series("", normal, quantiles, BLUE, width=2.2)]
    charts = [
        of_points(left, "lag [s]", "autocorrelation", "", simulated=False),
        of_points(right, "quantile of a normal distribution", "quantile of residuals", "", simulated=simulated),
    ]
    return [of_charts([charts], "Residuals of the free runs", caption, alt, table, simulated=simulated, still=True)]


def _residual(trace: Trace) -> Array:
    """Measured less modelled contraction where both are known [m]; the mean stays in."""
    values = np.asarray(trace.columns["displacement"], dtype=np.float64) - np.asarray(trace.columns["model"])
    return np.asarray(values[np.isfinite(values)])


def _autocorrelation(values: Array) -> Array:
    """Autocorrelation of values less their mean at lags 0 to `LAGS`, shape (LAGS + 1,); 1 at lag 0."""
    x = values - values.mean()
    power = float(np.dot(x, x))
    return np.array([float(np.dot(x[: len(x) - lag], x[lag:])) / power for lag in range(LAGS + 1)])
