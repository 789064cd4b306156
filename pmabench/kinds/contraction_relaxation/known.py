"""What is known of the coefficients during a contraction test, and what further trials in each cell would add."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from pmabench.analysis.next_trial import FEWEST_FREEDOM, NORMAL, SCATTER, SWEEP, Aim, Goal, scatter_like
from pmabench.analysis.shared.samples import NotUsable
from pmabench.kinds.contraction_relaxation import predicted
from pmabench.kinds.contraction_relaxation.intervals import CORRECTED, Pooled
from pmabench.kinds.contraction_relaxation.pooled import design_of, rms_of
from pmabench.kinds.contraction_relaxation.reduction import estimates_of, pool, withheld
from pmabench.kinds.contraction_relaxation.segments import Gate, cut, gather
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import Array, RunData, TrialData

NOISE = 1e-3
"""Assumed noise of a row before any measurement, as a share of the typical force; trials scatter far more."""

BY_CHANCE = 2.326
"""Standard deviations of a one-sided probability of 1 in 100, from which on a misfit is taken as certain."""
NARROWED = ("that the fit does not exclude", CORRECTED)
"""Ends of names of sources of the method part that further trials narrow."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known after some trials."""

    outlook: predicted.Outlook
    """Expected effect of trials; its wanted values are those with a goal."""
    aim: Aim
    freedom: int
    """Degrees of freedom among repeats."""
    misfit: str
    """Why no goal can be promised, since the data contradict the form of the fit; empty where they do not."""
    pooled: Pooled | None
    """None before there is a fit."""
    reported: Mapping[tuple[str, float], Estimate]
    """Symbol and pressure [Pa] -> the value, as the analysis of these trials reports it."""
    as_reported: bool = True
    """Whether reported values must reach their goals; else the design's prediction counts."""

    def counts(self, trials: Sequence[TrialData]) -> Array:
        """How many of the trials are in each cell of the outlook, shape (cells,)."""
        return self.outlook.counts(trials)

    def parts(self, name: tuple[str, float]) -> Parts:
        """Interval parts of a reported value; empty parts for others."""
        return self.reported[name].parts if name in self.reported else Parts()

    def halves(self, counts: Array) -> Array:
        """Predicted half width [SI] of each wanted value after `counts` (cells,) trials, shape (m,)."""
        return self.aim.halves(self.outlook.design.variances(counts))

    def without(self, numbers: Collection[int]) -> Known:
        """The same without some of the wanted values."""
        rows, aim = [n for n in range(len(self.outlook.names)) if n not in numbers], self.aim
        fewer = Aim(aim.goal[rows], aim.factor[rows], aim.rest[rows])
        return replace(self, outlook=self.outlook.of_values(rows), aim=fewer)

    @property
    def sure(self) -> bool:
        """Whether a misfit is certain despite the few repeats from which scatter is estimated, by the distribution of a
        sample variance (its cube root is nearly normal, Wilson and Hilferty 1931).
        """
        if self.pooled is None or self.freedom < FEWEST_FREEDOM:
            return False
        test, few = self.pooled.diagnosis.rounds.before.test, 2 / (9 * self.freedom)
        least = max(0.0, 1 - few - BY_CHANCE * sqrt(few)) ** 3
        return least * max(test.ratio**2, 1 + test.alike) > 1

    def reached(self, counts: Array) -> bool:
        """Whether every goal is reached by `counts` (cells,) trials and, if `as_reported`, in the reported values."""
        if not self.outlook.names or not (self.halves(counts) <= self.aim.goal).all():
            return False
        if not self.as_reported:
            return self.pooled is not None and not self.misfit
        halves = (self.parts(name).combined for name in self.outlook.names)
        return all(half is not None and half <= goal for half, goal in zip(halves, self.aim.goal, strict=True))


def finished(runs: Sequence[RunData]) -> list[TrialData]:
    """Finished trials of the runs in chronological order, without those that were done again."""
    return [trial for run in runs for trial in run.trials if trial.status == "finished" and not trial.again]


def of_trials(runs: Sequence[RunData], trials: Sequence[TrialData]) -> list[RunData]:
    """The runs with these of their trials alone."""
    wanted = {(trial.run, trial.index) for trial in trials}
    return [replace(run, trials=tuple(t for t in run.trials if t.again or (t.run, t.index) in wanted)) for run in runs]


def known_after(
    cells: Sequence[predicted.Cell], goals: Sequence[Goal], runs: Sequence[RunData], expected: Mapping[str, Any] | None
) -> Known | None:
    """Knowledge of the coefficients with a goal from the runs; from `expected` where nothing can be fitted yet.

    None where neither is possible.
    """
    campaign, _ = gather(runs) if finished(runs) else (None, [])
    pooled = None
    with suppress(NotUsable):
        pooled = pool(campaign, {}) if campaign is not None else None
    if pooled is not None:
        return _measured(cells, goals, pooled)
    if expected is None:
        return None
    fit = predicted.as_expected(expected, cells)
    noise = NOISE * rms_of(predicted.simulated_trials(fit, cells).force)
    return _with_goals(predicted.outlook(fit, cells, noise), goals, {}, None)


def _measured(cells: Sequence[predicted.Cell], goals: Sequence[Goal], pooled: Pooled) -> Known:
    """The same from a fit."""
    campaign = pooled.campaign
    estimates, _ = estimates_of(campaign, pooled)
    names = [(e.symbol, e.at.get("pressure", 0.0)) for e in estimates]
    reported = dict(zip(names, withheld(estimates, pooled.diagnosis), strict=True))
    used = np.unique(pooled.segments.trial)
    trials = [campaign.trials[number] for number in used]
    freedom = len(used) - len(np.unique(campaign.cells[used]))
    seen = predicted.outlook(pooled.fit, cells, pooled.expected)
    moved = {predicted.cell_key(trial.point) for trial in trials}
    seen = seen.without({predicted.cell_key(trial.point) for trial in campaign.trials} - moved)
    repeats = {name: e.parts.repeats or 0.0 for name, e in reported.items()}
    halves = np.array([repeats.get(name, 0.0) for name in seen.names])
    whole = predicted.scattered(pooled.fit, 1.0)
    alike = replace(seen.design, wanted=seen.design.wanted[halves > 0], between=whole)
    share = scatter_like(alike, seen.counts(trials), halves[halves > 0], SCATTER)
    design = replace(seen.design, between=share**2 * whole)
    found = _with_goals(replace(seen, design=design), goals, reported, pooled)
    gone = [e for e in reported.values() if e.withheld and (e.symbol, e.at.get("pressure", 0.0)) in found.outlook.names]
    misfit = pooled.diagnosis.refusal or (gone[0].note if gone else "")
    return replace(found, freedom=freedom, misfit=misfit)


def _with_goals(
    seen: predicted.Outlook, goals: Sequence[Goal], reported: Mapping[tuple[str, float], Estimate],
    pooled: Pooled | None,
) -> Known:  # fmt: skip
    """The outlook on the values that have a goal, and how their intervals follow from the design."""
    wanted: dict[int, float] = {}
    whole_sweep = np.array([len(cell.trials) for cell in seen.cells], float)
    spread = np.sqrt(seen.design.variances(whole_sweep)) if seen.cells else np.empty(0)
    for number, (name, value) in enumerate(zip(seen.names, seen.values, strict=True)):
        whole = NORMAL * float(spread[number])
        halves = [half for goal in goals if (half := goal.of(name, float(value), whole)) is not None]
        if halves:
            wanted[number] = min(halves)
    aim = Aim(np.array(list(wanted.values())), np.full(len(wanted), NORMAL), np.zeros(len(wanted)))
    as_reported = not any(goal.symbol == SWEEP for goal in goals)
    found = Known(seen.of_values(list(wanted)), aim, 0, "", pooled, reported, as_reported)
    if pooled is None or not wanted or not as_reported:
        return found
    seen, factor, rest = found.outlook, found.aim.factor, found.aim.rest
    trials = [pooled.campaign.trials[number] for number in np.unique(pooled.segments.trial)]
    spread = np.sqrt(seen.design.variances(found.counts(trials)))
    for number, name in enumerate(seen.names):
        if half := found.parts(name).combined:
            rest[number] = sqrt(min(fixed(found.reported[name]), half**2))
            factor[number] = sqrt(half**2 - rest[number] ** 2) / spread[number]
    return found


def fixed(e: Estimate) -> float:
    """Square of the half width [SI] by what no further trial narrows: what is declared of sensors and clocks, and lines
    between pressures. Scatter and departures that few trials do not exclude become smaller.
    """
    lasting = (s for s in e.budget if s.kind == "B" and s.part != "repeats" and not s.name.endswith(NARROWED))
    return sum((source.half or 0.0) ** 2 for source in lasting)


def missed_by(before: Known, fitted: Sequence[TrialData], runs: Sequence[RunData]) -> float:
    """Mean square prediction error of a fit for the trials of `runs`, relative to noise and scatter.

    `before` comes from the trials `fitted`, which are not in `runs`. 1.0 where samples were corrected for the fit:
    recorded samples would not agree with it, and only the fit to all of them is a test.
    """
    campaign, _ = gather(runs)
    if campaign is None or before.pooled is None or before.pooled.diagnosis.state != "sound":
        return 1.0
    segments = cut(campaign.samples, campaign.rate, Gate()).within(before.pooled.fit.knots)
    if not len(segments):
        return 1.0
    fit, design = before.pooled.fit, before.outlook.design
    rows = design_of(segments, fit.knots)
    spread = design.covariance(before.counts(fitted)) + design.between
    residual = segments.force - rows @ fit.theta
    return float(residual @ residual / (len(segments) * design.noise**2 + np.sum((rows @ spread) * rows)))
