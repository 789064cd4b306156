"""Figure of measured motion compared with that of a model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.plotting import time_plots
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
from pmabench.plotting.plots import Array
from pmabench.store.analyses.results import Analysis, Trace

NAMES = ("t", "pressure", "displacement", "model")
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
