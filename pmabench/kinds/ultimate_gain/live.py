"""What one trial says by itself, for the display."""

from __future__ import annotations

from typing import Any

import numpy as np

from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.ultimate_gain.levels import examine
from pmabench.kinds.ultimate_gain.open_loop import examine as examine_steps
from pmabench.kinds.ultimate_gain.open_loop import steps_of
from pmabench.kinds.ultimate_gain.relay_levels import examine as examine_relay
from pmabench.kinds.ultimate_gain.relay_levels import search_of
from pmabench.model.loop import ultimate
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Ultimate gain and period of one search."""
    relay = search_of(trial)
    if steps_of(trial) and {"pressure", "displacement"} <= set(trial.channels):
        by_steps = examine_steps(run, trial)
        truth = None if by_steps.loop is None else ultimate(by_steps.loop)
        both = (None, None) if truth is None else (truth.gain, truth.period)
        return [Measured("K_u", "gain", both[0]), Measured("T_u", "time", both[1])], [
            *by_steps.refused,
            *by_steps.doubts,
        ]
    if relay is not None and "displacement" in trial.channels:
        by_relay = examine_relay(run, trial, relay)
        best = None if by_relay.refused else by_relay.best
        both = (float("nan"), float("nan")) if best is None else (best.K_u, best.T_u)
        values = [None if np.isnan(value) else float(value) for value in both]
        return [Measured("K_u", "gain", values[0]), Measured("T_u", "time", values[1])], [
            *by_relay.refused,
            *by_relay.doubts,
        ]
    search: Any = next((found for found in trial.found.values() if found.get("levels")), None)
    if search is None or "displacement" not in trial.channels:
        return [Measured("K_u", "gain", None), Measured("T_u", "time", None)], ["no levels of gain are recorded"]
    seen = examine(run, trial, search)
    K_u, T_u = (None if np.isnan(value) else float(value) for value in (seen.K_u, seen.T_u))
    reasons = [*seen.refused, *seen.doubts]
    return [Measured("K_u", "gain", K_u), Measured("T_u", "time", T_u)], reasons
