"""Slow rows of a trial by how its length is set: a kind of test names one of these functions in its record.

Each takes run, trial and rate [Hz], and gives a `Record` or a sentence that says why the trial has no rows.
"""

from __future__ import annotations

import numpy as np

from pmabench.analysis.imported import unusable_because
from pmabench.analysis.shared.samples import on_time
from pmabench.analysis.surface.record import Record, rows_of
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData, TrialData

FEWEST = 25
"""Rows of a trial."""
CONSTANT = 0.03
"""Change, as a share of the value, below which a pressure counts as held."""
HELD = 0.5e-3
"""Change below which a contraction counts as held [m]."""
GRAVITY = 9.80665


def driven(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial whose free end is moved or held by an actuator, with a load cell and a gauge of the length."""
    if lacking := [name for name in ("pressure", "displacement", "force") if name not in trial.channels]:
        return f"{' and '.join(lacking)} was not recorded"
    return _record(run, trial, rate, on_time(run, trial, "displacement"), on_time(run, trial, "force"))


def by_hand(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial at a length that somebody set: the one of its operating point, where no gauge was recorded."""
    if lacking := [name for name in ("pressure", "force") if name not in trial.channels]:
        return f"{' and '.join(lacking)} was not recorded"
    if "displacement" in trial.channels:
        return driven(run, trial, rate)
    if "contraction" not in trial.point:
        return "neither the contraction nor the length that was set is known"
    x = np.full(trial.t.shape, trial.point["contraction"])
    return _record(run, trial, rate, x, on_time(run, trial, "force"), by_hand=True)


def hanging(run: RunData, trial: TrialData, rate: float) -> Record | str:
    """Rows of a trial with a weight on the muscle: the force of the cell, else load and inertia of what hangs there."""
    if "force" in trial.channels:
        return driven(run, trial, rate)
    if lacking := [name for name in ("pressure", "displacement") if name not in trial.channels]:
        return f"{' and '.join(lacking)} was not recorded"
    if "load" not in trial.point:
        return "neither the force nor the load is known"
    load = trial.point["load"]
    found = _record(run, trial, rate, on_time(run, trial, "displacement"), np.full(trial.t.shape, load))
    if isinstance(found, Record):
        found.F[:] += trial.point.get("mass", load / GRAVITY) * np.gradient(found.v, found.t)
    return found


def _record(run: RunData, trial: TrialData, rate: float, x: Array, F: Array, *, by_hand: bool = False) -> Record | str:
    P = on_time(run, trial, "pressure")
    rows = rows_of(trial.t, P, x, F, trial.usable, rate)
    if len(rows[0]) < FEWEST:
        return f"fewer than {FEWEST} rows of {1 / rate:.2g} s can be used (flagged: {unusable_because(trial)})"
    group = trial.name if by_hand else f"{run.kind}, {_held(trial, rows[1], rows[2])}"
    return Record(trial.name, group, *rows, np.ones(len(rows[0]), dtype=bool), by_hand)


def _held(trial: TrialData, P: Array, x: Array) -> str:
    """What stays the same throughout a trial, in words: its load, its pressure or its length; else the trial itself."""
    for name, quantity in (("load", "force"), ("contraction", "length"), ("pressure", "pressure")):
        if name in trial.point:
            return f"{name} {show(trial.point[name], quantity, 3)}"
    if np.ptp(P) <= CONSTANT * abs(float(np.median(P))):
        return f"pressure {show(round(float(np.median(P)), -3), 'pressure', 3)}"
    if np.ptp(x) <= HELD:
        return f"contraction {show(round(float(np.median(x)), 4), 'length', 3)}"
    return trial.name
