"""Reduction of ultimate-gain runs: K_u and T_u of each set-point, refused where the loop does not oscillate as a sine.

Trials with a rising gain are reduced in `levels`, relay trials in `relay`, open-loop steps in `open_loop`; here are the
results of all methods together. Uses the samples and the record of the search; knows nothing of the bench.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isnan
from typing import Any

from pmabench.analysis import tuning
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.kinds.ultimate_gain import RESULTS
from pmabench.kinds.ultimate_gain import ways as gain_ways
from pmabench.kinds.ultimate_gain.levels import LevelsCell, examine
from pmabench.kinds.ultimate_gain.open_loop import METHOD as OPEN_LOOP
from pmabench.kinds.ultimate_gain.open_loop import StepsCell, steps_of
from pmabench.kinds.ultimate_gain.open_loop import examine as examine_steps
from pmabench.kinds.ultimate_gain.relay import RelayCell, search_of
from pmabench.kinds.ultimate_gain.relay import examine as examine_relay
from pmabench.kinds.ultimate_gain.ways import Examined, GainCell
from pmabench.store.analyses.results import Analysis, Dropped
from pmabench.store.records import RunData, TrialData

KIND = "ultimate-gain"
NO_LEVELS = "no levels of gain are recorded"
USED = ("finished", "failed")
"""Statuses of trials that are evaluated; a search that found nothing is a failed trial, and its reason is reported."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Ultimate gain K_u [Pa/m] and period T_u [s] of every set-point, and controller settings by the tuning rules.

    ln(ratio) of successive swings is fitted against K_p by a line over the last levels; K_u is its zero, T_u the period
    by a line at the same gain (Ziegler and Nichols 1942).
    """
    cells, dropped = _cells(runs)
    estimates = [e for cell in cells for e in cell.estimates]
    loops: list[dict[str, Any]] = []
    settings: list[dict[str, Any]] = []
    for cell in cells:
        (K_u, T_u), loop, at = cell.estimates, cell.loop, dict(cell.at)
        if K_u.value is None or T_u.value is None or any(entry["at"] == at for entry in settings):
            continue  # the first method with a result at an operating point is used
        if loop is not None:
            fact = {"gain": loop.gain, "dead_time": loop.dead_time, "lags": gain_ways.plain_lags(loop)}
            loops.append({"at": at, **fact, "skew": cell.apart})
        settings += tuning.facts(tuning.tune(K_u, T_u, loop=loop), K_u.at)
    trials = sum(len(cell.good) for cell in cells)
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates,
        dropped=[*dropped, *(one for cell in cells for one in cell.dropped)],
        findings=[*(one for cell in cells for one in cell.findings()), *gain_ways.findings(estimates)],
        traces=[one for cell in cells for one in cell.traces()],
        facts={"trials": trials, "cells": len(cells), "loops": loops, "tuning": settings},
    )  # fmt: skip


WAYS: Mapping[str, tuple[type[GainCell[Any]], Callable[[RunData, TrialData], Examined]]] = {
    "open_loop": (StepsCell, examine_steps),
    "levels": (LevelsCell, lambda _, trial: examine(trial, search_of(trial, "levels") or {})),
    "relay": (RelayCell, lambda run, trial: examine_relay(run, trial, search_of(trial, "relay") or {})),
}
"""Methods in order of preference -> their cells, and the function that evaluates a trial."""


def _way_of(trial: TrialData) -> tuple[str, str]:
    """The method that a trial was recorded for, and why it cannot be used for that, or empty."""
    way = "open_loop" if steps_of(trial) else "relay" if search_of(trial, "relay") else "levels"
    if way == "levels" and search_of(trial, "levels") is None:
        return way, NO_LEVELS
    needed = ("displacement",) if way == "levels" else ("displacement", "pressure")
    return way, next((f"the {name} is not recorded" for name in needed if name not in trial.channels), "")


def _cells(runs: Sequence[RunData]) -> tuple[list[GainCell[Any]], list[Dropped]]:
    """The cells of all methods, and the trials that are not evaluated."""
    dropped: list[Dropped] = []
    ways: dict[str, list[tuple[RunData, TrialData]]] = {way: [] for way in WAYS}
    for run, trial in [(one, trial) for one in runs for trial in one.trials]:
        way, why = _way_of(trial)
        if trial.status not in USED:
            why = f"the trial is {trial.status}"
        if why:
            dropped.append(Dropped(trial.name, trial.point, why))
        else:
            ways[way].append((run, trial))
    return [one for way, (cell, look) in WAYS.items() for one in cell.all_of(ways[way], look)], dropped


def of_open_loops(runs: Sequence[RunData]) -> Analysis:
    """The reduction of open-loop steps alone; findings say what other trials of the runs were found."""
    reduced = reduce(runs)
    return replace(reduced, estimates=tuple(e for e in reduced.estimates if e.method == OPEN_LOOP))


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Ultimate gain and period of one search, for the display."""
    way, why = _way_of(trial)
    found = Examined(refused=(why,)) if why else WAYS[way][1](run, trial)
    K_u, T_u = (None if isnan(value) else float(value) for value in found.pair.value)
    return [Measured("K_u", "gain", K_u), Measured("T_u", "time", T_u)], [*found.refused, *found.doubts]
