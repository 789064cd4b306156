"""What one trial says by itself, for the display."""

from __future__ import annotations

from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.store.records import RunData, TrialData


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Pressures at which the load lifts and sets down, their mean, and half the difference."""
    doubts: list[str] = []
    found: dict[str, float | None] = {}
    for phase in ("lift", "set-down"):
        result = trial.found.get(phase)
        value = result.get("pressure") if result and result.get("found", True) else None
        found[phase] = float(value) if isinstance(value, int | float) else None
        if result is not None and found[phase] is None:
            doubts.append(f"{phase}: {result.get('reason') or 'nothing found'}")
        elif result is None:
            doubts.append(f"{phase} was not looked for")
    lift, down = found["lift"], found["set-down"]
    load = trial.point.get("load")
    predicted = expected.lifts(load) if expected is not None and load is not None else None
    both = lift is not None and down is not None
    middle = 0.5 * (lift + down) if lift is not None and down is not None else None
    half = 0.5 * (lift - down) if lift is not None and down is not None else None
    if both and half is not None and half < 0:
        doubts.append("it sets down at a higher pressure than it lifts")
    return [
        Measured("lift", "pressure", lift, noise=1e3),
        Measured("set-down", "pressure", down, noise=1e3),
        Measured("mean", "pressure", middle, predicted, tolerance=3e3, noise=1e3),
        Measured("half", "pressure", half, noise=2e3),
    ], doubts
