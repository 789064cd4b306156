"""What one trial says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.validation.reduction import inside_window, unusable
from pmabench.store.records import RunData, TrialData


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
