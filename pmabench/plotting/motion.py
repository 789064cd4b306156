"""Figure of measured motion compared with that of a model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.plotting.chart import COLUMN, GAP, PAGE, Chart, Series, with_common_sides
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
from pmabench.plotting.plots import BROWN, FAINT, QUIET, Array, Panel
from pmabench.store.analyses.results import Analysis, Trace

NAMES = ("t", "pressure", "displacement", "model")
UPPER, LOWER = 104.0, 66.0
"""Heights of a panel, and of the difference below it [pt]."""
SHORT = 20
"""Letters of titles with which three panels fit side by side, and not two."""
OVERLAYS = 6
"""Most panels of measured and modelled motion."""
FREE_RUN = "the fitted muscle, run freely with the measured pressure"


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
