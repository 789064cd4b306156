"""Held-out error and coverage of pmabench next to other fitting programs, on the same samples of the second muscle.

`python -m tests.benchmarks.compare_fits [SEEDS]` from the root of the repository prints the tables of
docs/other-fits.md. It takes some minutes, most of them for MuJoCo, which simulates every trial at every step.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
from scipy.signal import savgol_filter

from pmabench.analysis.surface.fit import Data, Spread, choose
from pmabench.analysis.surface.muscle import SURFACE, columns_of, memory
from pmabench.analysis.surface.trials import Record, rows_of
from pmabench.analysis.surface.trials import Rows as Joined
from pmabench.kinds.contraction_relaxation.pooled import Fit
from pmabench.kinds.contraction_relaxation.reduction import pool
from pmabench.kinds.contraction_relaxation.segments import gather
from pmabench.kinds.reduce import reduce_runs
from tests.analysis.judged import as_run
from tests.benchmarks import peers
from tests.benchmarks.peers import Array, Fitted, Rows, straight
from tests.judge.second import driven
from tests.judge.second.campaign import PLAN, RATE, REAL, TARGETS, Trial, campaign, truth, undisturbed

CAUSES = (("clean", 0.0), ("drift", 10.0), ("bend", 0.1), ("hysteresis", 20.0), ("creep", 0.04), ("real", 1.0))
SIMULATED = ("clean", "real")
"""Campaigns that MuJoCo is tried on, the first of each: it simulates every trial at every step."""
LEFT_OUT = (10.0, 30.0)
"""Weights [kg] that no fit sees: all are judged by the force there."""
KNOTS = np.array([100e3, 200e3, 350e3, 500e3])
FASTER, SMOOTHED, EVERY = 3e-3, 21, 10
"""Least speed [m/s] of rows, and samples of the polynomial of second order that gives it; every tenth is a row."""
SYMBOLS = ("F_ce", "K", "B_c", "B_r")
CURVE_FIT, LMFIT, SYSID, OURS = "scipy curve_fit", "lmfit", "mujoco.sysid", "pmabench"
COLUMNS = ", our columns"
LEAST, MOST, STEP = 150e3, 551e3, 50e3
"""Pressures of the straight form for slow tests [Pa]."""
PLACES = [(P, x) for P in TARGETS for x in (4e-3, 8e-3, 15e-3)]


@dataclass(frozen=True)
class Score:
    """How one program did on one set of samples."""

    name: str
    error: float
    """Rms force on what was left out [N]."""
    inside: int
    """Values whose interval holds the truth."""
    halves: tuple[float, ...]
    """Half widths of the values that have an interval, over the truth."""
    asked: int
    seconds: float


def timed(fit: Callable[[], Fitted]) -> tuple[Fitted, float]:
    """A fit and the processor time that it took [s]; what it prints is dropped."""
    begun = process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        found = fit()
    return found, process_time() - begun


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


# -- contraction and relaxation ------------------------------------------------------------------------------------


def moving(trials: Sequence[Trial]) -> Rows:
    """Rows of a muscle that moves, for fits of the straight form: all channels through the same smoothing."""
    parts = []
    for trial in trials:
        P, x, F = (savgol_filter(getattr(trial, name), SMOOTHED, 2) for name in ("pressure", "displacement", "force"))
        v = savgol_filter(trial.displacement, SMOOTHED, 2, deriv=1, delta=1 / RATE)
        parts.append(_gated(P, x, v, F))
    return Rows(*np.hstack(parts))


def unseen(cause: str, amount: float) -> Rows:
    """The same of the weights that are left out, as they really were: without noise."""
    trials = zip(PLAN, *undisturbed(cause, amount), strict=True)
    parts = [_gated(P, x, np.gradient(x, 1 / RATE), F) for (mass, _), P, x, F in trials if mass in LEFT_OUT]
    return Rows(*np.hstack(parts))


def _gated(P: Array, x: Array, v: Array, F: Array) -> Array:
    still = (np.abs(v) < FASTER) | (P < KNOTS[0]) | (P > KNOTS[-1] + 10e3)
    near = np.convolve(still, np.ones(SMOOTHED), mode="same") > 0
    return np.array([P, x, v, F])[:, ~near][:, ::EVERY]


def contraction(cause: str, amount: float, seed: int) -> list[Score]:
    """All programs on one campaign."""
    trials = campaign(cause, amount, seed)
    seen = [trial for trial in trials if round(trial.mass, 6) not in LEFT_OUT]
    rows, others = moving(seen), unseen(cause, amount)
    right = truth(cause, amount)
    row = peers.straight_row(KNOTS)

    def columns(of: Rows) -> Array:
        return straight(of.P, of.x, of.v, KNOTS)

    fits = {
        CURVE_FIT: lambda: peers.linear(peers.by_curve_fit, columns, rows, row),
        LMFIT: lambda: peers.linear(peers.by_lmfit, columns, rows, row),
        SYSID: lambda: peers.by_sysid_hanging(
            [one.mass for one in seen], [one.pressure[::2] for one in seen], [one.displacement[::2] for one in seen],
            2 / RATE,
        ),
    }  # fmt: skip
    if cause not in SIMULATED or seed:
        del fits[SYSID]
    scores = []
    for name, fit in fits.items():
        found, seconds = timed(fit)
        intervals = [(symbol, P, *found.value(found.row(symbol, P))) for symbol in SYMBOLS for P in TARGETS]
        scores.append(scored(name, rms(found.force(others) - others.F), intervals, right, seconds))
    return [*scores, *reduced(seen, others, right)]


def reduced(seen: Sequence[Trial], others: Rows, right: dict) -> list[Score]:
    """The same trials by pmabench: its fit predicts, and what it reports is judged; and others with its rows."""
    run, begun = as_run(seen), process_time()
    (analysis,) = reduce_runs([run])
    seconds = process_time() - begun
    gathered, _ = gather([run])
    pooled = pool(gathered, {"replays": 0})
    diagnosis, fit = pooled.diagnosis, pooled.diagnosis.rounds.before.test.fit

    def error(of: Fit) -> float:
        F_ce, K, up, down = (of.values(symbol, others.P) for symbol in SYMBOLS)
        damped = np.where(others.v > 0, up, down) * others.v
        return rms(F_ce - K * others.x - damped - of.coulomb * np.sign(others.v) - others.F)

    scores = []
    for name, solve in ((CURVE_FIT, peers.by_curve_fit), (LMFIT, peers.by_lmfit)):
        start = process_time()
        weights, covariance = solve(fit.design, fit.design @ fit.theta + fit.residual)
        took = process_time() - start
        rows = [(symbol, P, fit.row(symbol, P)) for symbol in SYMBOLS for P in TARGETS]
        values = [(symbol, P, row @ weights, peers.half_width(row, covariance)) for symbol, P, row in rows]
        scores.append(scored(name + COLUMNS, error(replace(fit, theta=weights)), values, right, took))
    intervals = [
        (e.symbol, e.at["pressure"], e.value, e.parts.combined)
        for e in analysis.estimates
        if e.method == "measured-pressure" and e.symbol in SYMBOLS and e.value is not None
    ]
    of_muscle = diagnosis.state != "withheld" and any(one.of_muscle for one in diagnosis.of_fit)
    whole = np.nan if of_muscle else error(pooled.fit)  # the straight part alone is not what the muscle does
    return [*scores, scored(OURS, whole, intervals, right, seconds)]


def scored(name: str, error: float, intervals: Iterable[tuple], right: dict, seconds: float) -> Score:
    """Intervals (symbol, pressure, value, half width) against a truth that is a range."""
    inside, halves = 0, []
    for symbol, P, value, half in intervals:
        if half is None or not np.isfinite(half):
            continue
        low, high = (float(end[0]) for end in right[symbol](np.array([P])))
        halves.append(2 * half / (low + high))
        inside += low - half <= value <= high + half
    return Score(name, error, inside, tuple(halves), len(SYMBOLS) * len(TARGETS), seconds)


# -- the surface ---------------------------------------------------------------------------------------------------


def surface(seed: int) -> list[Score]:
    """All programs on the slow tests of the real second muscle, judged by its motions at random."""
    tests, motions = driven.session(REAL, seed)
    known, later = [slow(one) for one in tests], [slow(one) for one in motions]
    begun = process_time()
    choice = choose(Data.of(known))
    spread = Spread.of(choice)
    seconds = process_time() - begun
    rows, others = joined(known), joined(later)
    near = (rows.P > LEAST) & (rows.P < MOST)  # a straight form does best where it is fitted where it is judged
    near_rows = Rows(*(getattr(rows, one)[near] for one in ("P", "x", "v", "F")))
    knots = np.arange(LEAST, MOST, STEP)
    row = peers.straight_row(knots)

    def columns(of: Rows) -> Array:
        return straight(of.P, of.x, of.v, knots)

    def stiffness(found: Fitted) -> list[tuple[float, float]]:
        return [found.value(found.row("K", P)) for P, _ in PLACES]

    scores = []
    for name, fit in {
        CURVE_FIT: lambda: peers.linear(peers.by_curve_fit, columns, near_rows, row),
        LMFIT: lambda: peers.linear(peers.by_lmfit, columns, near_rows, row),
        SYSID: lambda: peers.by_sysid_driven(near_rows),
    }.items():
        found, took = timed(fit)
        scores.append(tangents(name, rms(found.force(others) - others.F), stiffness(found), took))
    scores += with_columns(choice, known, later, rows, others)
    force = np.concatenate([choice.muscle.force([one])[one.used] for one in later])
    each = [spread.of_value(lambda m, P=P, x=x: float(m.stiffness(np.array([P]), np.array([x]))[0])) for P, x in PLACES]
    halves = [(one.value, np.hypot(one.repeats or np.inf, one.method)) for one in each]
    return [*scores, tangents(OURS, rms(force - others.F), halves, seconds)]


def with_columns(choice, known: Sequence[Record], later: Sequence[Record], rows: Rows, others: Rows) -> list[Score]:
    """curve_fit and lmfit with the columns that pmabench chose: no bounds, no smoothing, every row alike."""
    frame, terms = choice.data.frame, [*choice.muscle.weights]

    def columns(records: Sequence[Record]) -> Array:
        together = [(Joined.of_records([one]), memory([one], frame), one.used) for one in records]
        return np.vstack([
            np.hstack([columns_of(term, frame, part, past, choice.muscle.stiffness) for term in terms])[used]
            for part, past, used in together
        ])  # fmt: skip

    A, B = columns(known), columns(later)
    first = sum(np.size(choice.muscle.weights[term]) for term in terms[: terms.index(SURFACE)])
    slope = np.zeros((len(PLACES), A.shape[1]))
    steep = -frame.slope(*np.array(PLACES).T)
    slope[:, first : first + steep.shape[1]] = steep
    scores = []
    for name, solve in ((CURVE_FIT, peers.by_curve_fit), (LMFIT, peers.by_lmfit)):
        begun = process_time()
        weights, covariance = solve(A, rows.F)
        took = process_time() - begun
        values = [(float(row @ weights), peers.half_width(row, covariance)) for row in slope]
        scores.append(tangents(name + COLUMNS, rms(B @ weights - others.F), values, took))
    return scores


def tangents(name: str, error: float, values: Sequence[tuple[float, float]], seconds: float) -> Score:
    """K at `PLACES` against the tangent of the second muscle."""
    right = [float(REAL.tangent(np.array(x), np.array(P))) for P, x in PLACES]
    printed = [(value, half, K) for (value, half), K in zip(values, right, strict=True) if np.isfinite(half)]
    inside = sum(abs(value - K) <= half for value, half, K in printed)
    return Score(name, error, inside, tuple(half / K for _, half, K in printed), len(PLACES), seconds)


def slow(one: driven.Record) -> Record:
    """A test as rows at 25 Hz; what belongs together is left out together."""
    rows = rows_of(one.t, one.pressure, one.displacement, one.force, np.ones(len(one.t), bool))
    place = ", ".join(f"{name} {value:g}" for name, value in one.point.items())
    return Record(f"{one.kind} {place}", f"{one.kind} {place}", *rows, rows[3] > 5.0)


def joined(records: Sequence[Record]) -> Rows:
    """All rows that count."""
    return Rows(*(np.concatenate([getattr(r, name)[r.used] for r in records]) for name in ("P", "x", "v", "F")))


# -- tables --------------------------------------------------------------------------------------------------------


def table(title: str, scores: Sequence[Score]) -> str:
    """One line for each program, over all sets of samples."""
    titles = "held-out error N | intervals that hold the truth | median half width | values printed | time s"
    lines = [f"| {title} | {titles} |",
             "| --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for name in dict.fromkeys(one.name for one in scores):
        mine = [one for one in scores if one.name == name]
        inside, asked = (sum(getattr(one, what) for one in mine) for what in ("inside", "asked"))
        halves = [half for one in mine for half in one.halves]
        wide = float(np.median(halves)) if halves else np.nan
        half = f"{100 * wide:.2g} %" if wide < 10 else "above 1000 %"
        share = f"{100 * inside / len(halves):.0f} % | {half}" if halves else "- | -"
        errors = np.array([one.error for one in mine if np.isfinite(one.error)])
        error = f"{np.sqrt(np.mean(errors**2)):.2f}" if len(errors) else "-"
        seconds = float(np.mean([one.seconds for one in mine]))
        lines.append(f"| {name} | {error} | {share} | {len(halves)} of {asked} | {seconds:.2g} |")
    return "\n".join(lines)


def main(seeds: int = 5) -> None:
    for cause, amount in CAUSES:
        title = f"{cause} {amount:g}" if amount else cause
        print(
            table(title, [one for seed in range(seeds) for one in contraction(cause, amount, seed)]), "\n", flush=True
        )
    print(table("slow tests of `real`", [one for seed in range(seeds) for one in surface(seed)]))


if __name__ == "__main__":
    main(*(int(one) for one in sys.argv[1:]))
