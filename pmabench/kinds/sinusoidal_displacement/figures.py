"""Figure of driven sines and the pressure that they make."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.results import Analysis, Trace
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
)
from pmabench.plotting.wording import shown

SINES = 4
"""Most panels."""


def sine_pressure(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Force along sines, measured and modelled with set and measured pressure, above the error of the pressure."""
    able = [t for t in traces if has(t, "displacement", "force", "set", "measured", "error")]
    able = [t for t in able if "frequency" in t.marks]
    chosen = spread(sorted(able, key=lambda t: (t.marks.get("pressure", 0.0), t.marks["frequency"])), SINES)
    if not chosen:
        return []
    names = {"x": "displacement", "y": "force", "set": "set", "model": "measured", "error": "error"}
    panels = [panel(t, names, head(t)) for t in chosen]
    error = shown("pressure").label("P − set P")
    labels = {"x": label(chosen[0], "displacement"), "y": label(chosen[0], "force"), "error": error}
    worst = [float(np.nanmax(np.abs(p.columns["error"]))) for p in panels]
    caption = (
        "Above: the last cycle, and the static model of the slowest sines with the set pressure as input and with the "
        "measured one, damping and friction of the harmonics added. Below: error of the pressure, at most "
        f"{reach(worst)} {shown('pressure').unit}.{how_many(chosen, able)}"
    )
    alt = f"Force and pressure error over contraction along sines at {'; '.join(p.title for p in panels)}."
    draw = bound(time_plots.sine_pressure, panels, labels)
    table = numbers([(p.title, t) for p, t in zip(panels, chosen, strict=True)])
    title = "Force with set and with measured pressure"
    return [picture(draw, title, caption, alt, table, wide=len(chosen) > 1, simulated=analysis.simulated)]
