"""What the searches of static load found: loads, and the pressures at which each lifts and sets down; fits nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.analysis.results import Dropped
from pmabench.store.records import Array, RunData, TrialData

MEAN, LIFT, SET_DOWN = "static-mean", "static-lift", "static-set-down"
PHASES = ("lift", "set-down")


@dataclass(frozen=True, eq=False)
class Points:
    """What was found, one row per trial: load [N] and pressures [Pa]; nan where a search found nothing."""

    names: tuple[str, ...]
    load: Array
    lift: Array
    set_down: Array
    uncertain: float = 0.0
    """What the half width of K makes of a set-down that was carried to x = 0 [Pa], the mean over trials."""
    place: float = 0.0
    """Contraction at which set-down broke away [m], the mean over trials."""

    def side(self, method: str) -> Array:
        """Pressures of a method [Pa]."""
        if method == MEAN:
            return 0.5 * (self.lift + self.set_down)
        return self.lift if method == LIFT else self.set_down


def points_of(runs: Sequence[RunData]) -> tuple[Points, list[Dropped]]:
    """One row per trial that found something, and the trials that did not."""
    rows: list[tuple[str, float, float, float]] = []
    dropped: list[Dropped] = []
    for run in runs:
        for trial in run.trials:
            name = trial.name
            found = {phase: trial.found.get(phase) or {} for phase in PHASES}
            pressures = {phase: pressure_of(result) for phase, result in found.items()}
            if trial.status not in ("finished", "failed"):
                dropped.append(Dropped(name, trial.point, f"the trial is {trial.status}"))
            elif "load" not in trial.point:
                dropped.append(Dropped(name, trial.point, "the trial names no load"))
            elif not np.isfinite(list(pressures.values())).any():
                reasons = [str(result["reason"]) for result in found.values() if result.get("reason")]
                dropped.append(Dropped(name, trial.point, "; ".join(reasons) or "neither lift nor set-down was found"))
            else:
                rows.append((name, trial.point["load"], pressures["lift"], pressures["set-down"]))
    columns = np.array([row[1:] for row in rows], dtype=np.float64).reshape(len(rows), 3)
    return Points(tuple(row[0] for row in rows), columns[:, 0], columns[:, 1], columns[:, 2]), dropped


def pressure_of(result: Mapping[str, Any]) -> float:
    """Pressure of a search's result [Pa]; nan where it found nothing."""
    value = result.get("pressure")
    return float(value) if result.get("found", True) and isinstance(value, int | float) else float("nan")


def mean_pressure(run: RunData, trial: TrialData) -> float | None:
    """Mean of the pressures at which a load lifts and sets down [Pa]; None where one was not found."""
    known = [pressure_of(trial.found.get(phase) or {}) for phase in PHASES]
    return sum(known) / 2 if np.isfinite(known).all() else None
