"""Figure of a validation: contraction after each step of pressure, measured and modelled.

`measure`: what one trial says by itself, for the display.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.validation.reduction import inside_window, unusable
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
from pmabench.store.records import RunData, TrialData

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


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The contraction in the window and the one that the specimen's file expects."""
    reason = unusable(run, trial)
    if reason:
        return [Measured("x", "length", None)], [reason]
    x = float(trial.channels["displacement"][inside_window(run, trial)].mean())
    P, load = trial.point.get("pressure", 0.0), trial.point.get("load", 0.0)
    K_e, F_e = (expected.at(name, P) if expected else None for name in ("K", "F_ce"))
    slip = expected.F_c if expected else 0.0
    predicted = (F_e - slip - load) / K_e if F_e is not None and K_e else None
    return [Measured("x", "length", x, predicted, tolerance=slip / K_e if K_e else 0.0, noise=20e-6)], []
