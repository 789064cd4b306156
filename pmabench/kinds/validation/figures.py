"""Figure of a validation: contraction after each step of pressure, measured and modelled."""

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
from pmabench.store.analyses.results import Analysis, Trace

MOST = 12
"""Most steps."""


def validations(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Measured and simulated contraction after each step of pressure."""
    able = [t for t in traces if has(t, "t", "displacement", "model")]
    if not able:
        return []
    chosen = spread(able, MOST)
    panels = [panel(t, {"t": "t", "measured": "displacement", "model": "model"}, head(t)) for t in chosen]
    unit = unit_of(chosen[0], "displacement").unit
    labels = {"t": label(chosen[0], "t"), "measured": f"contraction [{unit}]", "residual": f"diff. [{unit}]"}
    misfits = [float(np.sqrt(np.nanmean((p.columns["measured"] - p.columns["model"]) ** 2))) for p in panels]
    caption = (
        "Grey: measured; red: the model that the protocol names, driven by the measured pressure. Below: their "
        f"difference, rms {reach(misfits)} {unit}. It was fitted to nothing in this run.{how_many(chosen, able)}"
    )
    steps = "; ".join(p.title for p in panels)
    alt = f"Contraction over time after steps of pressure, measured and simulated, at {steps}."
    table = numbers([(head(t), t) for t in chosen])
    draw = bound(time_plots.overlay, panels, labels)
    title = "Measured and simulated steps"
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)]
