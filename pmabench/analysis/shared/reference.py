"""Reference trials held against the first of them: what the specimen drifted meanwhile; fits nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.analysis.results import Finding
from pmabench.base.quantities import show
from pmabench.store.records import RunData, TrialData

DOUBTED = 0.02
"""A stroke that differs by more from that of the first reference trial is doubted [1]."""


@dataclass(frozen=True)
class Compared:
    """One reference trial beside the first at the same point; strokes in m."""

    trial: TrialData
    first: float
    stroke: float

    @property
    def off(self) -> float:
        """Change since the first [1]."""
        return self.stroke / self.first - 1.0


def compared(runs: Sequence[RunData]) -> list[Compared]:
    """Each finished reference trial after the first one of its point and specimen, in order of time.

    Its stroke is the contraction from the rest before the first pressure command to the last fifth of the hold at
    pressure [m].
    """
    first: dict[tuple[object, ...], float] = {}
    found = []
    for run, trial in _references(runs):
        stroke = stroke_of(run, trial)
        if stroke is None:
            continue
        point = tuple(sorted((name, round(value, 3)) for name, value in trial.point.items()))
        key = (str(run.manifest.get("specimen")), point)
        if key in first:
            found.append(Compared(trial, first[key], stroke))
        elif stroke > 0:
            first[key] = stroke
    return found


def findings(runs: Sequence[RunData]) -> list[Finding]:
    """What the reference trials say, a line for each that was done again by a run that went on, and for the rest."""
    again = [one for one in compared(runs) if one.trial.again]
    planned = [one for one in compared(runs) if not one.trial.again]
    lines = [
        _finding(one, f"the reference trial, done again when the run went on ({one.trial.name}),") for one in again
    ]
    if planned:
        widest = max(planned, key=lambda one: abs(one.off))
        what = f"of {len(planned)} further reference trials the one that differs most ({widest.trial.name})"
        lines.append(
            _finding(widest, what if len(planned) > 1 else f"the second reference trial ({widest.trial.name})")
        )
    return lines


def _finding(one: Compared, what: str) -> Finding:
    values = f"came to {show(one.stroke, 'length', 4)} and the first to {show(one.first, 'length', 4)}: {one.off:+.2%}"
    drifts = abs(one.off) > DOUBTED
    return Finding("doubt" if drifts else "note", f"{what} {values}{'; the specimen is not what it was' * drifts}")


def _references(runs: Sequence[RunData]) -> Iterator[tuple[RunData, TrialData]]:
    for run in sorted(runs, key=lambda run: str(run.manifest.get("started_utc", ""))):
        for trial in run.trials:
            if trial.reference and trial.status == "finished" and "displacement" in trial.channels:
                yield run, trial


def stroke_of(run: RunData, trial: TrialData) -> float | None:
    """Contraction at the end of the hold less that at rest [m]; None where either has no usable sample."""
    if "displacement" not in trial.channels:
        return None
    times = sorted(c.t for c in trial.commands if c.output == "pressure" and c.phase != "precondition")
    if len(times) < 2 or not len(trial.t):
        return None
    up, down = times[0], times[1]
    x = trial.channels["displacement"]
    rest = trial.usable & (trial.t < up) & np.isfinite(x)
    held = trial.usable & (trial.t >= down - 0.2 * (down - up)) & (trial.t < down) & np.isfinite(x)
    return float(x[held].mean() - x[rest].mean()) if rest.any() and held.any() else None
