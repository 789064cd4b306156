"""What is known of the coefficients during a contraction test, and what further trials in each cell would add.

Rows of the fit come from a simulated trial in each cell of a plan; the muscle is that of `expected` in a specimen file,
or a fit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from pmabench.analysis.next_trial import FEWEST_FREEDOM, NORMAL, SCATTER, SWEEP, Aim, Design, Goal, scatter_like
from pmabench.analysis.shared import simulated
from pmabench.analysis.shared.samples import Noise, NotUsable, Samples
from pmabench.kinds.contraction_relaxation.intervals import CORRECTED, Pooled
from pmabench.kinds.contraction_relaxation.pooled import (
    SYMBOLS,
    Fit,
    design_of,
    expected_noise,
    first_knots,
    rms_of,
)
from pmabench.kinds.contraction_relaxation.reduction import estimates_of, pool, withheld
from pmabench.kinds.contraction_relaxation.segments import ASSUMED_MASS, Gate, Segments, cut, gather
from pmabench.kinds.contraction_relaxation.values import FEWEST, WIDE, near
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import Array, RunData, TrialData

RATE = 250.0
"""Samples a second of simulated trials [Hz]; a segment is 40 ms."""
LONGEST_HOLD = 1.2
"""Longest simulated hold after a pressure step, when all motion is over [s]."""
LAG, DEAD_TIME = 0.1, 0.02
"""Time constant and dead time of the simulated regulator [s], typical of proportional valves on small muscles."""
MARGIN = 2.0
"""A load that F_ce exceeds by fewer times the Coulomb friction than this may not be lifted."""


@dataclass(frozen=True)
class Cell:
    """One load and pressure of a plan, with its commands [SI]."""

    load: float
    mass: float
    pressure: float
    steps: tuple[tuple[float, float], ...]
    """Pressures commanded [Pa] and how long each is held [s]."""
    trials: tuple[int, ...]
    """Indices of the plan's trials in this cell."""
    seconds: float
    """Duration of a trial [s]."""

    @property
    def key(self) -> tuple[float, float]:
        """Load [N] and pressure [Pa], rounded, which identify the cell."""
        return cell_key({"load": self.load, "pressure": self.pressure})


def cell_key(point: Mapping[str, float]) -> tuple[float, float]:
    """Load [N] and pressure [Pa] of a trial, rounded."""
    return round(point.get("load", 0.0), 3), round(point["pressure"])


def cells_of(plan: Mapping[str, Any]) -> list[Cell]:
    """The cells of a plan of plain data, in the order of their first trials."""
    done: dict[int, list[Mapping[str, Any]]] = {}
    inside = None
    for step in plan["steps"]:
        if step["step"] == "record":
            inside = step["trial"] if step["on"] else None
        elif inside is not None:
            done.setdefault(inside, []).append(step)
    found: dict[tuple[float, float], Cell] = {}
    for trial in plan["trials"]:
        point, key = trial["point"], cell_key(trial["point"])
        before, held = found.get(key), _held(done.get(trial["index"], ()))
        steps, earlier = (tuple(held[1:]), ()) if before is None else (before.steps, before.trials)
        mass, seconds = point.get("mass", ASSUMED_MASS) or ASSUMED_MASS, sum(seconds for _, seconds in held)
        index = trial["index"]
        found[key] = Cell(point.get("load", 0.0), mass, point["pressure"], steps, (*earlier, index), seconds)
    return list(found.values())


def _held(steps: Sequence[Mapping[str, Any]]) -> list[tuple[float, float]]:
    """Commanded pressures [Pa] and how long each is held [s], starting at 0."""
    held = [(0.0, 0.0)]
    for step in steps:
        if step["step"] == "set" and step["output"] == "pressure":
            held.append((float(step["value"]), 0.0))
        elif step["step"] == "hold":
            held[-1] = held[-1][0], held[-1][1] + float(step["duration"])
    return held


def as_expected(expected: Mapping[str, Any], cells: Sequence[Cell]) -> Fit:
    """A fit with the coefficients that a specimen file expects, as plain data [SI], at the knots of these cells."""
    points = sorted(expected["points"], key=lambda point: float(point["pressure"]))
    at = np.array([point["pressure"] for point in points], float)
    knots = first_knots(np.array([cell.pressure for cell in cells]), np.array([P for c in cells for P, _ in c.steps]))
    values = []
    for symbol in SYMBOLS:
        known = np.array([point[symbol] for point in points], float)
        line = np.interp(knots, at, known)
        if symbol == "F_ce" and len(at) > 1:  # beyond the points straight on, never below 0
            low, high = (known[1] - known[0]) / (at[1] - at[0]), (known[-1] - known[-2]) / (at[-1] - at[-2])
            line = np.where(knots < at[0], known[0] + low * (knots - at[0]), line)
            line = np.maximum(0.0, np.where(knots > at[-1], known[-1] + high * (knots - at[-1]), line))
        values.append(line)
    theta = np.concatenate((*values, [float(expected.get("F_c", 0.0))]))
    none = np.empty((0, len(theta)))
    return Fit(theta, np.eye(len(theta)), none, np.empty(0), True, knots)


def simulated_trials(fit: Fit, cells: Sequence[Cell]) -> Segments:
    """Segments of one trial in each cell, without noise; `trial` is the number of the cell."""
    courses = []
    for cell in cells:
        held = [(0.0, 0.1), *((P, min(seconds, LONGEST_HOLD)) for P, seconds in cell.steps)]
        course, begin = [], 0.0
        for target, seconds in held:
            t = np.arange(1, round(seconds * RATE) + 1) / RATE
            lagged = np.where(t < DEAD_TIME, begin, target + (begin - target) * np.exp(-(t - DEAD_TIME) / LAG))
            course.append(lagged)
            begin = float(lagged[-1]) if len(lagged) else begin
        courses.append(np.concatenate(course))
    P = simulated.as_columns(courses)
    load, mass = np.array([[cell.load, cell.mass] for cell in cells]).T
    moved = simulated.run(fit, P, 1 / RATE, load, mass, np.zeros(len(cells)))
    t, good = np.arange(len(P)) / RATE, np.ones(len(P), bool)
    samples = [
        Samples(n, t, P[:, n], moved.x[:, n], moved.force[:, n], good, cell.load, cell.mass)
        for n, cell in enumerate(cells)
    ]
    return cut(samples, RATE, Gate()).within(fit.knots)


@dataclass(frozen=True, eq=False)
class Outlook:
    """A plan's cells and how well they determine the coefficients."""

    cells: tuple[Cell, ...]
    """The cells of the plan in which the muscle is expected to move."""
    names: tuple[tuple[str, float], ...]
    """Symbol and pressure [Pa] of each value that all trials of the plan together determine."""
    values: Array
    """Expected values [SI], shape (m,)."""
    design: Design
    """Rows of the fit per cell; its wanted combinations are those values."""

    def of_values(self, kept: Sequence[int]) -> Outlook:
        """The outlook for the values with these indices only."""
        rows = list(kept)
        design = replace(self.design, wanted=self.design.wanted[rows])
        return replace(self, names=tuple(self.names[n] for n in rows), values=self.values[rows], design=design)

    def without(self, keys: Set[tuple[float, float]]) -> Outlook:
        """The same without the cells with these keys."""
        kept = [number for number, cell in enumerate(self.cells) if cell.key not in keys]
        design = replace(self.design, cells=self.design.cells[kept])
        return replace(self, cells=tuple(self.cells[n] for n in kept), design=design)

    def counts(self, trials: Sequence[TrialData]) -> Array:
        """Number of trials in each cell, shape (cells,)."""
        done = Counter(cell_key(trial.point) for trial in trials)
        return np.array([done[cell.key] for cell in self.cells], float)


def outlook(fit: Fit, cells: Sequence[Cell], noise: float) -> Outlook:
    """How well trials in `cells` determine F_ce [N], K [N/m], B_c, B_r [N.s/m] at the tested pressures, and F_c [N].

    Parameters
    ----------
    fit
        The muscle, from a fit or `as_expected`.
    noise
        Standard deviation of a row [N].

    Scatter between trials is assumed as `SCATTER`.
    """
    lifts = [
        float(fit.values("F_ce", np.array([cell.pressure]))[0]) - cell.load > MARGIN * fit.coulomb for cell in cells
    ]
    segments = simulated_trials(fit, cells)
    count = np.bincount(segments.trial, minlength=len(cells))
    moves = [number for number in range(len(cells)) if count[number] >= FEWEST and lifts[number]]
    rows = design_of(segments, fit.knots)
    normals = np.array([rows[segments.trial == n].T @ rows[segments.trial == n] for n in moves])
    prior = fit.prior(segments, noise)
    between = scattered(fit, SCATTER)
    tested = sorted({cells[n].pressure for n in moves})
    names = [(symbol, P) for symbol in SYMBOLS for P in tested] + [("F_c", 0.0)]
    wanted = np.array([fit.row(symbol, P) for symbol, P in names])
    normals = normals.reshape(len(moves), len(fit.theta), len(fit.theta))
    whole = Design(prior.T @ prior, normals, noise, between, wanted)
    values = wanted @ fit.theta
    known = np.array(
        [symbol == "F_c" or bool(near(segments, fit.knots, symbol, P).sum() >= FEWEST) for symbol, P in names]
    )
    if moves:
        counts = np.array([len(cells[n].trials) for n in moves], float)
        known = known & (NORMAL * np.sqrt(whole.variances(counts)) <= WIDE * _size(names, values))
    found = Outlook(tuple(cells[n] for n in moves), tuple(names), values, whole)
    return found.of_values(np.flatnonzero(known).tolist() if moves else [])


def scattered(fit: Fit, share: float) -> Array:
    """Covariance of the unknowns from trial to trial, shape (p, p): a constant force, and K, B_c and B_r as a whole,
    each with a standard deviation of `share` of its size.
    """
    directions = np.zeros((len(fit.theta), len(SYMBOLS)))
    for place, symbol in enumerate(SYMBOLS):
        columns = fit.columns(symbol)
        directions[columns, place] = np.median(fit.theta[columns]) if symbol == "F_ce" else fit.theta[columns]
    covariance: Array = share**2 * (directions @ directions.T)
    return covariance


def _size(names: Sequence[tuple[str, float]], values: Array) -> Array:
    """Size of each value, at least the median of its symbol; shape (m,)."""
    symbols = np.array([symbol for symbol, _ in names])
    median = {symbol: float(np.median(np.abs(values[symbols == symbol]))) for symbol in set(symbols.tolist())}
    return np.maximum(np.abs(values), [median[symbol] for symbol in symbols.tolist()])


@dataclass(frozen=True)
class Predicted:
    """A coefficient's expected 95 % interval."""

    symbol: str
    pressure: float
    """[Pa]; 0 for F_c, which has none."""
    value: float
    half: float
    """Half width [SI]."""


def row_noise(fit: Fit, cells: Sequence[Cell], noise: Noise, rate: float) -> float:
    """Standard deviation of a row of the fit [N] from white noise of the channels [SI], sampled at `rate` [Hz]."""
    segments = simulated_trials(fit, cells)
    factor = sqrt(RATE / rate)
    seen = Noise(noise.pressure * factor, noise.displacement * factor, noise.force * factor)
    return max(1e-4 * rms_of(segments.force), rms_of(expected_noise(segments, fit, seen))) if len(segments) else 0.0


def intervals_of_plan(plan: Mapping[str, Any], expected: Mapping[str, Any], noise: Noise) -> list[Predicted]:
    """The 95 % intervals expected from a whole plan for F_ce, K, B_c, B_r over pressure and for F_c.

    By C = N^-1 (sum S_i) N^-1 of `pmabench.analysis.next_trial`, with a scatter between trials of 2 %. Only noise and
    scatter; calibration, drift and departures of the muscle from the form come in addition. Values that the plan does
    not determine (no motion near their pressure) are left out.

    Parameters
    ----------
    plan
        From `Plan.to_dict`, of kind contraction-relaxation.
    expected
        `expected` of the specimen file as plain data: `F_c` [N], `points` with `pressure` [Pa], `F_ce` [N], `K` [N/m],
        `B_c`, `B_r` [N.s/m].
    noise
        White noise of the channels, standard deviation of a sample [Pa, m, N].
    """
    cells = cells_of(plan)
    fit = as_expected(expected, cells)
    seen = outlook(fit, cells, row_noise(fit, cells, noise, float(plan["rate"])))
    if not seen.cells:
        return []
    variances = seen.design.variances(np.array([len(cell.trials) for cell in seen.cells], float))
    return [
        Predicted(symbol, P, float(value), NORMAL * sqrt(variance))
        for (symbol, P), value, variance in zip(seen.names, seen.values, variances, strict=True)
    ]


NOISE = 1e-3
"""Assumed noise of a row before any measurement, as a share of the typical force; trials scatter far more."""

BY_CHANCE = 2.326
"""Standard deviations of a one-sided probability of 1 in 100, from which on a misfit is taken as certain."""
NARROWED = ("that the fit does not exclude", CORRECTED)
"""Ends of names of sources of the method part that further trials narrow."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known after some trials."""

    outlook: Outlook
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
    cells: Sequence[Cell], goals: Sequence[Goal], runs: Sequence[RunData], expected: Mapping[str, Any] | None
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
    fit = as_expected(expected, cells)
    noise = NOISE * rms_of(simulated_trials(fit, cells).force)
    return _with_goals(outlook(fit, cells, noise), goals, {}, None)


def _measured(cells: Sequence[Cell], goals: Sequence[Goal], pooled: Pooled) -> Known:
    """The same from a fit."""
    campaign = pooled.campaign
    estimates, _ = estimates_of(pooled)
    names = [(e.symbol, e.at.get("pressure", 0.0)) for e in estimates]
    reported = dict(zip(names, withheld(estimates, pooled.diagnosis), strict=True))
    used = np.unique(pooled.segments.trial)
    trials = [campaign.trials[number] for number in used]
    freedom = len(used) - len(np.unique(campaign.cells[used]))
    seen = outlook(pooled.fit, cells, pooled.expected)
    moved = {cell_key(trial.point) for trial in trials}
    seen = seen.without({cell_key(trial.point) for trial in campaign.trials} - moved)
    repeats = {name: e.parts.repeats or 0.0 for name, e in reported.items()}
    halves = np.array([repeats.get(name, 0.0) for name in seen.names])
    whole = scattered(pooled.fit, 1.0)
    alike = replace(seen.design, wanted=seen.design.wanted[halves > 0], between=whole)
    share = scatter_like(alike, seen.counts(trials), halves[halves > 0], SCATTER)
    design = replace(seen.design, between=share**2 * whole)
    found = _with_goals(replace(seen, design=design), goals, reported, pooled)
    gone = [e for e in reported.values() if e.withheld and (e.symbol, e.at.get("pressure", 0.0)) in found.outlook.names]
    misfit = pooled.diagnosis.refusal or (gone[0].note if gone else "")
    return replace(found, freedom=freedom, misfit=misfit)


def _with_goals(
    seen: Outlook, goals: Sequence[Goal], reported: Mapping[tuple[str, float], Estimate],
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
