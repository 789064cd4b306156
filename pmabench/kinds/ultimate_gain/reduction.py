"""Reduction of ultimate-gain runs: K_u and T_u of each set-point, refused where the loop does not oscillate as a sine.

Open-loop steps are reduced in `open_loop`, relay trials in `relay`; here are those with a rising gain, and the results
of all methods together.

For each level of gain the mean ln of the ratio of successive swings; K_u is the zero of a line through the last levels.
Uses the samples and the record of the search; knows nothing of the bench.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis import tuning
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain import RESULTS
from pmabench.kinds.ultimate_gain import ways as gain_ways
from pmabench.kinds.ultimate_gain.levels import TrialFound, examine
from pmabench.kinds.ultimate_gain.open_loop import METHOD as OPEN_LOOP
from pmabench.kinds.ultimate_gain.open_loop import StepsCell, steps_of
from pmabench.kinds.ultimate_gain.open_loop import examine as examine_steps
from pmabench.kinds.ultimate_gain.relay import RelayCell, search_of
from pmabench.kinds.ultimate_gain.relay import examine as examine_relay
from pmabench.kinds.ultimate_gain.ways import Examined, GainCell
from pmabench.model.loop import Loop
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

KIND = "ultimate-gain"
NO_LEVELS = "no levels of gain are recorded"
METHOD = "gain-steps"
USED = ("finished", "failed")
"""Statuses of trials that are evaluated; a search that found nothing is a failed trial, and its reason is reported."""
ALONE = "one trial: the repeats part is the scatter about its own line, and repeated tests may scatter more"
CURVED = (0.008, 0.0015)
"""Relative error of K_u and of T_u because growth and period over the gain are no lines: up to 0.7 and 0.1 % in 45
loops.
"""


@dataclass(frozen=True)
class _Cell(GainCell[TrialFound]):
    """All trials with a rising gain at one operating point."""

    methods = (METHOD,)

    def _estimate(self, place: int, method: str) -> Estimate:
        good = [one.found for one in self.good]
        if not good:
            return self.empty(place, method)
        pairs = [found.pair for found in good]
        mean = float(np.mean([pair.value[place] for pair in pairs]))
        friction = 0.0 if place else max(found.friction for found in good)
        parts = Parts(method=hypot(CURVED[place], friction) * mean)
        return self.estimate(place, method, self.good, pairs, parts, (), alone=ALONE)

    def findings(self) -> list[Finding]:
        """Problems of the trials, and K_u and T_u."""
        lines = self.said()
        K_u, T_u = (estimate.value for estimate in self.estimates)
        if K_u is None or T_u is None:
            return lines
        text = f"at {self.where} the loop oscillates at K_u = {show(K_u, 'gain', 4)}, T_u = {T_u:.4g} s"
        return [*lines, Finding("note", text)]

    def traces(self) -> list[Trace]:
        """The oscillation nearest to K_u, and the growth plot."""
        trial, found, K_u = self.shown.trial, self.shown.found, self.estimates[0].value
        if not found.levels:
            return []
        at = next((i for i, level in enumerate(found.levels) if level is found.nearest), len(found.levels) - 1)
        near = found.levels[max(0, at - 1) : at + 2]
        mask = (trial.t >= near[0].t0) & (trial.t <= near[-1].t1)
        if not mask.any():
            return []
        columns: dict[str, Array] = {
            "t": trial.t[mask] - trial.t[mask][0],
            "displacement": trial.channels["displacement"][mask],
            "pressure_command": _command(trial, found, mask),
        }
        marks = {} if K_u is None else {"K_u": K_u}
        setpoint = {"setpoint": self.at.get("setpoint", 0.0)}
        traces = [self.trace("oscillation", "Oscillation nearest to the ultimate gain", columns, setpoint | marks)]
        measured = [level for level in found.levels if level.swinging is not None]
        if measured:
            gains = np.array([level.gain for level in measured])
            slope, start = found.zero.line
            columns = {
                "gain": gains,
                "log_ratio": np.array([level.log_ratio for level in measured]),
                "fit": start + slope * gains,
                "period": np.array([level.period for level in measured]),
                "used": np.array([float(level in found.used) for level in measured]),
            }
            traces.append(self.trace("growth", "Growth per half period", columns, marks))
        return traces


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Ultimate gain K_u [Pa/m] and period T_u [s] of every set-point, and controller settings by the tuning rules.

    ln(ratio) of successive swings is fitted against K_p by a line over the last levels; K_u is its zero, T_u the period
    by a line at the same gain (Ziegler and Nichols 1942).
    """
    cells, dropped = _cells(runs)
    estimates: list[Estimate] = []
    findings: list[Finding] = []
    traces: list[Trace] = []
    loops: list[dict[str, Any]] = []
    settings: list[dict[str, Any]] = []

    def settle(K_u: Estimate, T_u: Estimate, loop: Loop | None, apart: float) -> None:
        """Settings and loop of one operating point; the first method with a result there is used."""
        if K_u.value is None or T_u.value is None or any(entry["at"] == dict(K_u.at) for entry in settings):
            return
        if loop is not None:
            fact = {"gain": loop.gain, "dead_time": loop.dead_time, "lags": gain_ways.plain_lags(loop), "skew": apart}
            loops.append({"at": dict(K_u.at), **fact})
        settings.extend(tuning.facts(tuning.tune(K_u, T_u, loop=loop), K_u.at))

    every = [cell for mine in cells.values() for cell in mine]
    for cell in every:
        estimates += cell.estimates
        findings += cell.findings()
        traces += cell.traces()
        dropped += cell.dropped
        settle(cell.estimates[0], cell.estimates[1], cell.loop, cell.apart)
    findings += gain_ways.findings(estimates)
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=findings,
        traces=traces,
        facts={
            "trials": sum(len(cell.good) for cell in every),
            "cells": len(every),
            "loops": loops,
            "tuning": settings,
            "levels": [level for cell in cells["levels"] for level in cell.facts(lambda found: found.levels)],
            "relay": [level for cell in cells["relay"] for level in cell.facts(lambda found: found.levels)],
            "open_loop": [trial for cell in cells["open_loop"] for trial in cell.facts(lambda found: [found])],
        },
    )


WAYS: Mapping[str, tuple[type[GainCell[Any]], Callable[[RunData, TrialData], Examined]]] = {
    "open_loop": (StepsCell, examine_steps),
    "levels": (_Cell, lambda _, trial: examine(trial, _search(trial) or {})),
    "relay": (RelayCell, lambda run, trial: examine_relay(run, trial, search_of(trial) or {})),
}
"""Methods in order of preference -> their cells, and the function that evaluates a trial."""


def _way_of(trial: TrialData) -> tuple[str, str]:
    """The method of a trial, and what it lacks for that; the latter is empty if nothing."""
    way = "open_loop" if steps_of(trial) else "levels" if search_of(trial) is None else "relay"
    if way == "levels" and _search(trial) is None:
        return way, NO_LEVELS
    needed = ("displacement", "pressure") if way == "open_loop" else ("displacement",)
    return way, next((f"the {name} is not recorded" for name in needed if name not in trial.channels), "")


def _cells(runs: Sequence[RunData]) -> tuple[dict[str, list[GainCell[Any]]], list[Dropped]]:
    """The cells of each method, and the trials that are not evaluated."""
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
    return {way: cell.all_of(ways[way], look) for way, (cell, look) in WAYS.items()}, dropped


def _search(trial: TrialData) -> Mapping[str, Any] | None:
    """The record of the search; None without one."""
    return next((found for found in trial.found.values() if found.get("levels")), None)


def _command(trial: TrialData, found: TrialFound, mask: NDArray[np.bool_]) -> Array:
    """The command [Pa], as recorded, else worked out from the law u = bias + K_p (aim - x) of each level."""
    if "pressure_command" in trial.channels:
        return np.asarray(trial.channels["pressure_command"][mask])
    t, x = trial.t[mask], trial.channels["displacement"][mask]
    command = np.full(len(t), np.nan)
    for level in found.levels:
        at = (t >= level.t0) & (t <= level.t1)
        command[at] = found.bias + level.gain * (level.aim - x[at])
    return command


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
