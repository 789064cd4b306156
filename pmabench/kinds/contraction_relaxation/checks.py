"""Checks of the pooled fit apart from its residual: loads left out, friction, simulation of whole trials.

NRMSE = ||x - x_model|| / ||x - mean x|| over the samples of a trial; 100 (1 - NRMSE) is the fit in % of system
identification. For one phase: rms error divided by the standard deviation of the whole trial, since a phase that hardly
moves has almost none. For several trials, the squares of all are summed.

Each check is a least squares on the segments of the fit; no trial is read again. Also findings, facts and overlays of
the fit. Works from the pooled fit; gives no estimate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from math import inf, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import simulated
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.trials import grouped, thinned
from pmabench.analysis.verdict.checks import Check
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.intervals import NORMAL, Pooled
from pmabench.kinds.contraction_relaxation.pooled import (
    SYMBOLS,
    inverse_of,
    least_squares,
    levers,
    place,
    rms_of,
    spread,
    without_each,
)
from pmabench.kinds.contraction_relaxation.segments import (
    ASSUMED_MASS,
    Campaign,
    Gate,
    Segments,
    strokes,
)
from pmabench.kinds.contraction_relaxation.values import WIDE
from pmabench.store.analyses.results import Estimate, Finding, Trace
from pmabench.store.records import Array, TrialData

BLIND = 0.15
"""Share of the largest contraction that a free run may move through at pressures where a coefficient is unknown."""
PACE = 0.008
"""Time step of a free run [s], as a whole number of samples."""
AIM = 0.1
"""NRMSE from which on the fitted model is a doubt: good models reach a fit of 90 %."""
PHASES = ("contraction", "relaxation")


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Simulation of one trial with the fitted muscle; arrays of shape (n,), a row every `PACE`."""

    number: int
    """Number of the trial in the campaign."""
    t: Array
    P: Array
    x: Array
    model: Array
    """Contraction of the fitted muscle [m]; nan from where the motion needs an unknown coefficient."""
    ok: NDArray[np.bool_]
    """Samples that count: measured and simulated."""
    way: NDArray[np.intp]
    """1 after a rise of the commanded pressure, -1 after a fall, 0 before any."""

    @property
    def whole(self) -> bool:
        """Whether the simulation covers the whole trial."""
        return bool(np.isfinite(self.model).all())

    @cached_property
    def squares(self) -> dict[str, tuple[float, float]]:
        """Sums of (x - model)^2 and (x - mean x)^2 [m2], of the trial and of each of `PHASES`, the latter sum by its
        share of rows.
        """
        parts = {"": self.ok, PHASES[0]: self.ok & (self.way > 0), PHASES[1]: self.ok & (self.way < 0)}
        variance = float(np.var(self.x[self.ok])) if self.ok.any() else 0.0
        return {
            name: (float(np.sum((self.x[rows] - self.model[rows]) ** 2)), variance * int(rows.sum()))
            for name, rows in parts.items()
        }


def free_runs(campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate]) -> list[FreeRun]:
    """Free run of every trial of the fit, from rest, sorted by pressure, load and number.

    Trials at pressures where a coefficient other than B_r is not identifiable are left out; the others run as long as
    the coefficients that the motion needs are known. A bent force-contraction curve is simulated with its bend.
    """
    unknown = {e.at["pressure"] for e in estimates if e.value is None and e.symbol in ("F_ce", "K", "B_c")}
    used = [i for i in np.unique(pooled.segments.trial).tolist() if campaign.trials[i].point["pressure"] not in unknown]
    ordered = sorted(used, key=lambda i: (campaign.trials[i].point["pressure"], campaign.samples[i].load, i))
    if not ordered:
        return []
    whole = [(campaign.samples[i], slice(0, len(campaign.samples[i].t))) for i in ordered]
    work = simulated.stretches(whole, 1 / campaign.rate, 1)
    every = max(1, round(PACE * campaign.rate))
    P = _thinned(work.P, every)
    more = pooled.diagnosis.more if pooled.diagnosis.bent else None
    run = simulated.run(pooled.fit, P, every * work.dt, work.load, work.mass, work.x, 1, more)
    found, known = [], _identified(pooled)
    for column, i in enumerate(ordered):
        t, x, ok = (getattr(campaign.samples[i], name)[::every] for name in ("t", "x", "ok"))
        mine = P[: len(t), column]
        model = np.where(t >= _known_until(t, mine, x, ok, known), nan, run.x[: len(t), column])
        ok = ok & (mine >= pooled.fit.knots[0]) & np.isfinite(model)
        found.append(FreeRun(i, t, mine, x, model, ok, _way(campaign.trials[i])[::every]))
    return found


def rms(runs: Sequence[FreeRun]) -> float | None:
    """Root mean square error over all samples that count [m]."""
    count = sum(int(run.ok.sum()) for run in runs)
    return sqrt(sum(run.squares[""][0] for run in runs) / count) if count else None


def nrmse(runs: Sequence[FreeRun], phase: str = "") -> float | None:
    """NRMSE of several trials together, in one of `PHASES` or in all; None where nothing moves."""
    error, size = (sum(run.squares[phase][side] for run in runs) for side in (0, 1))
    return sqrt(error / size) if size > 0 else None


def check(campaign: Campaign, runs: Sequence[FreeRun]) -> Check | None:
    """NRMSE over all trials, by direction, of reference trials, and at the worst operating point; None without runs."""
    value, error = nrmse(runs), rms(runs)
    if value is None or error is None:
        return None
    kinds = [f"{phase} {_percent(one)}" for phase in PHASES if (one := nrmse(runs, phase)) is not None]
    reference = nrmse([run for run in runs if campaign.trials[run.number].reference])
    if reference is not None:
        kinds.append(f"reference trials {_percent(reference)}")
    rows = [row for row in table(campaign, runs) if row["nrmse"] is not None]
    worst = max(rows, key=lambda row: row["nrmse"])
    cut = sum(not run.whole for run in runs)
    text = (
        f"free run of the fitted muscle with the measured pressure over {len(runs)} trials: NRMSE "
        f"{_percent(value)} (fit {100 * (1 - value):.4g} %), {show(error, 'length', 2)} rms; {', '.join(kinds)}; worst "
        f"{_percent(worst['nrmse'])} at {show(worst['pressure'], 'pressure', 4)}, {show(worst['load'], 'force', 4)}"
    )
    if cut:
        text += f"; {cut} of them end where a coefficient is not known"
    if value > AIM:
        text += ": the fitted muscle does not follow its own trials"
    return Check("free_run", value, "ratio", "doubt" if value > AIM else "note", text)


def table(campaign: Campaign, runs: Sequence[FreeRun]) -> list[dict[str, Any]]:
    """Rows: pressure [Pa], load [N], trials, NRMSE as a whole and by phase, rms [m]; one for each operating point."""
    cells = grouped(runs, lambda run: int(campaign.cells[run.number]))
    return [
        {
            "pressure": campaign.trials[members[0].number].point["pressure"],
            "load": campaign.samples[members[0].number].load,
            "trials": len(members),
            "nrmse": nrmse(members),
            **{phase: nrmse(members, phase) for phase in PHASES},
            "rms": rms(members),
        }
        for members in cells.values()
    ]


def _percent(value: float) -> str:
    return f"{100 * value:.2g} %" if value < 0.995 else f"{100 * value:.0f} %"


def _way(trial: TrialData) -> NDArray[np.intp]:
    """1, -1 or 0 for each sample, by the preceding command."""
    way = np.zeros(len(trial.t), dtype=np.intp)
    values = [c.value for c in trial.commands if c.output == "pressure" and c.t >= trial.t[0] - 1e-9]
    for rows, before, value in zip(strokes(trial), [0.0, *values], values, strict=False):
        way[rows] = np.sign(value - before)
    return way


def _known_until(t: Array, P: Array, x: Array, ok: NDArray[np.bool_], known: tuple[Array, Array]) -> float:
    """Start time [s] of the motion that goes `BLIND` too far where it needs an unknown coefficient; `known` is the
    result of `_identified`.
    """
    grid, identified = known
    low, high = grid[0], grid[-1]
    cell = np.clip(((P - low) / (high - low) * (len(grid) - 1)).round().astype(np.intp), 0, len(grid) - 1)
    F_ce, K, B_c, B_r = identified[:, cell] & (P >= low)
    way = np.diff(x, append=x[-1:])
    blind = ok & (x > Gate.lift) & ~(F_ce & K & np.where(way > 0, B_c, B_r))
    travelled = np.cumsum(np.where(blind, np.abs(way), 0.0))
    lost = np.flatnonzero(travelled > BLIND * float(np.max(x[ok], initial=0.0)))
    if not len(lost):
        return inf
    seeing = np.flatnonzero(~blind[: lost[0]])
    return float(t[seeing[-1] + 1 if len(seeing) else 0])


def _identified(pooled: Pooled) -> tuple[Array, Array]:
    """Pressures [Pa] from the first to the last knot, shape (n,), and whether each coefficient is known there by its
    remaining scatter, shape (4, n) in the order of `SYMBOLS`.
    """
    solved = pooled.fit
    P = np.linspace(solved.knots[0], solved.knots[-1], 256)
    hats = spread(place(P[:, None], solved.knots), np.ones((len(P), 1)), len(solved.knots))
    found = []
    for symbol in SYMBOLS:
        mine = solved.columns(symbol)
        half = NORMAL * np.sqrt(np.maximum(0.0, np.sum(hats @ pooled.trust.covariance[mine, mine] * hats, axis=1)))
        size = float(np.median(np.abs(solved.theta[mine])))
        found.append(half <= WIDE * np.maximum(np.abs(hats @ solved.theta[mine]), size))
    return P, np.array(found)


def _thinned(P: Array, every: int) -> Array:
    """One of `every` rows, as the mean of the rows around it."""
    rows = np.arange(0, len(P), every)
    first, last = np.maximum(0, rows - every // 2), np.minimum(len(P), rows + every // 2 + 1)
    found = np.empty((len(rows), P.shape[1]))
    for begin in range(0, P.shape[1], simulated.TOGETHER):
        some = slice(begin, begin + simulated.TOGETHER)
        sums = np.cumsum(np.vstack((np.zeros_like(P[:1, some]), P[:, some])), axis=0)
        found[:, some] = (sums[last] - sums[first]) / (last - first)[:, None]
    return found


FEWEST = 3
"""Fewest loads for one to be left out: two others separate F_ce from K."""
ENOUGH = 20
"""Fewest segments of a load or a direction."""
WORSE = 2.0
"""A prediction counts as bad where its residual is this many times that of the fit ..."""
NOTABLE = 0.01
"""... and more than this share of the largest load."""


def checks(campaign: Campaign, pooled: Pooled) -> list[dict[str, Any]]:
    """Checks for `Analysis.facts`: held-out loads, the other direction, friction by sign of the velocity."""
    segments = pooled.segments
    size = float(np.max(np.abs(segments.force)))
    found = [_held_out(campaign, pooled, size), _other_direction(pooled, size), _friction(pooled, size)]
    return [asdict(check) for check in found if check is not None]


def _judged(name: str, error: float, residual: float, size: float, text: str, means: str) -> Check:
    """The check of a prediction error [N] against the fit's `residual` [N]; `means` is the explanation of a doubt."""
    doubt = error > WORSE * residual and error > NOTABLE * size
    return Check(name, error / size, "ratio", "doubt" if doubt else "note", f"{text}: {means}" if doubt else text)


def _held_out(campaign: Campaign, pooled: Pooled, size: float) -> Check | None:
    """Each load predicted by a fit to all others, where these determine it; the worst load counts.

    The error is the rms residual of the segments whose prediction is at least as certain as one segment.
    """
    segments, fit = pooled.segments, pooled.fit
    loads = np.array([round(samples.load, 2) for samples in campaign.samples])[segments.trial]
    each = np.unique(loads)
    if len(each) < FEWEST:
        return None
    without = without_each(fit.design, segments.force, fit.prior(segments, pooled.expected), [loads == n for n in each])
    errors: dict[float, float] = {}
    for load, (inverse, theta) in zip(each, without, strict=True):
        design, force = fit.design[loads == load], segments.force[loads == load]
        sure = levers(design, inverse) <= 1.0
        if sure.sum() >= ENOUGH:
            errors[float(load)] = rms_of(force[sure] - design[sure] @ theta)
    if not errors:
        return None
    worst = max(errors, key=lambda load: errors[load])
    text = (
        f"loads predicted by a fit to all others, {len(errors)} of {len(each)}: within "
        f"{show(errors[worst], 'force', 2)} rms, worst at {show(worst, 'force', 4)}, "
        f"{100 * errors[worst] / size:.2g} % of the largest; "
        f"the residual of the fit to all is {show(fit.rms, 'force', 2)}"
    )
    return _judged("held_out", errors[worst], fit.rms, size, text, "the fit does not carry over to other loads")


def _other_direction(pooled: Pooled, size: float) -> Check | None:
    """Relaxation predicted with K and F_ce of a fit to contraction alone; only B_r and friction are fitted to it.

    One direction alone does not separate F_c from F_ce: they differ by 2 F_c between directions, so one constant is
    used for both.
    """
    segments, fit = pooled.segments, pooled.fit
    k = len(fit.knots)
    both, theirs, own = slice(0, 2 * k), slice(0, 3 * k), np.r_[3 * k : 4 * k, 4 * k]
    up, down = segments.way > 0, segments.way < 0
    if min(up.sum(), down.sum()) < ENOUGH:
        return None
    prior = fit.prior(segments, pooled.expected)
    design = fit.design[up, theirs]
    inverse = inverse_of(design.T @ design + prior[:, theirs].T @ prior[:, theirs])
    alone = inverse @ (design.T @ segments.force[up])
    rows = np.flatnonzero(down)
    rows = rows[levers(fit.design[rows, both], inverse[both, both]) <= 1.0]
    if len(rows) < ENOUGH:
        return None
    target = segments.force[rows] - fit.design[rows, both] @ alone[both]
    design = fit.design[np.ix_(rows, own)]
    free = least_squares(design, target, prior[:, own])
    error = rms_of(target - design @ free)
    text = (
        f"relaxation with K and F_ce of contraction alone: missed by {show(error, 'force', 2)} rms, "
        f"{100 * error / size:.2g} % of the largest load; "
        f"the residual of the fit to both is {show(fit.rms, 'force', 2)}"
    )
    means = "the two directions do not have one K and F_ce, as with hysteresis they have not"
    return _judged("other_direction", error, fit.rms, size, text, means)


def _friction(pooled: Pooled, size: float) -> Check | None:
    """Residual by the sign of the velocity, without and with the Coulomb term."""
    segments, fit = pooled.segments, pooled.fit
    if not fit.friction:
        return None
    design = fit.design[:, :-1]
    prior = fit.prior(segments, pooled.expected)[:, :-1]
    theta = least_squares(design, segments.force, prior)
    without = rms_of(segments.force - design @ theta)
    left = max(abs(float(fit.residual[rows].mean())) for rows in _groups(segments))
    needed = without > WORSE * fit.rms
    doubt = left > max(WORSE * fit.rms, NOTABLE * size)
    seen = "is seen in the data" if needed else "is hardly seen in the data"
    text = (
        f"friction {seen}: without F_c the residual is {show(without, 'force', 2)} rms instead of "
        f"{show(fit.rms, 'force', 2)}; with it, the mean residual by direction and speed is at most "
        f"{show(left, 'force', 2)}"
    )
    if doubt:
        text += ": it depends on speed in a way that the model does not have"
    return Check("friction", left / size, "ratio", "doubt" if doubt else "note", text)


def _groups(segments: Segments) -> list[NDArray[np.bool_]]:
    """Segments by direction, slower and faster half of each."""
    speed = np.abs(segments.v.mean(axis=1))
    found = []
    for way in (-1.0, 1.0):
        mine = segments.way == way
        middle = float(np.median(speed[mine])) if mine.any() else 0.0
        found += [mine & (speed <= middle), mine & (speed > middle)]
    return [rows for rows in found if rows.sum() >= ENOUGH] or [np.ones(len(segments), dtype=bool)]


UNEVEN = 2.0
"""Ratio of the variance between trials to that of noise from which on the difference is reported."""
SHOWN = 6


def facts(campaign: Campaign, pooled: Pooled, runs: Sequence[FreeRun]) -> dict[str, Any]:
    """Numbers about the fit and its free runs [SI], for `Analysis.facts`."""
    used = np.unique(pooled.segments.trial)
    free = check(campaign, runs)
    return {
        "trials_used": len(used),
        "cells": len(np.unique(campaign.cells)),
        "cells_used": len(np.unique(campaign.cells[used])),
        "segments": len(pooled.segments),
        "residual_rms": pooled.fit.rms,
        "expected_rms": pooled.expected,
        "knots": [float(P) for P in pooled.fit.knots],
        "noise": asdict(campaign.noise),
        "scatter_between_trials": {symbol: float(value) for symbol, value in pooled.trust.excess.items()},
        "load_cell": campaign.cell,
        "form": pooled.diagnosis.facts,
        "free_run_rms": rms(runs),
        "free_run": table(campaign, runs),
        "checks": [*([asdict(free)] if free else ()), *checks(campaign, pooled)],
    }


def findings(campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate]) -> Iterator[Finding]:
    """Adequacy of the model, coefficients that could not be identified, and scatter between trials."""
    trust = pooled.trust
    size = f"residual {show(pooled.fit.rms, 'force', 2)} rms over {len(pooled.segments)} segments"
    yield Finding("note", f"{size}; noise of the channels explains {show(pooled.expected, 'force', 2)}")
    yield from pooled.diagnosis.findings(trust)
    if not campaign.cell:
        text = "no load cell: F_L is the weight, and M x'' of the moving mass; both are taken as exact, M is not fitted"
        if any("mass" not in trial.point for trial in campaign.trials):
            text += f"; where a trial names no moving mass, {show(ASSUMED_MASS, 'mass')} is taken"
        yield Finding("note", text)
    if lack := Scales.of(campaign.runs).lack(campaign.channels):
        yield Finding("note", lack)
    yield from (Finding("doubt", cause.note) for cause in trust.causes if cause.seen and cause.note)
    if step := campaign.pressure_step:
        text = f"the pressure is read in steps of {show(step, 'pressure', 3)}, which its noise does not fill"
        yield Finding("note", f"{text}: the intervals hold that; finer steps would tell B and F_ce better")
    yield from _polled(campaign, "doubt" if pooled.diagnosis.reason else "note")
    if not pooled.fit.friction:
        yield Finding("doubt", "all samples move one way: F_ce carries the friction")
    for symbol in SYMBOLS:
        none = [show(e.at["pressure"], "pressure", 4) for e in estimates if e.symbol == symbol and e.value is None]
        if none:
            yield Finding("note", f"{symbol} is not identifiable at {', '.join(none)}")
    uneven = [symbol for symbol, value in trust.excess.items() if value > UNEVEN]
    if uneven:
        between = "repeats of a cell scatter" if trust.within else "trials scatter about the fit"
        yield Finding("note", f"{between} more than the noise explains ({', '.join(uneven)}); intervals follow")
    if not trust.within:
        yield Finding("note", "hardly a cell is repeated: the repeats part rests on noise and on the fit's residual")


def _polled(campaign: Campaign, level: str) -> Iterator[Finding]:
    """One finding for each channel that is updated less often than it is recorded."""
    for name in campaign.channels:
        if every := campaign.between[name]:
            yield Finding(
                level,
                f"the {name} is new every {1e3 * every:.3g} ms only, while the run records every"
                f" {1e3 / campaign.rate:.3g} ms, and is taken on straight lines in between: what happens within"
                " that time is lost; read it as often as the others",
            )


def overlays(campaign: Campaign, runs: Sequence[FreeRun]) -> tuple[Trace, ...]:
    """Measured and modelled contraction of some of the free runs."""
    picks = dict.fromkeys(round(i) for i in np.linspace(0, len(runs) - 1, SHOWN)) if runs else ()
    traces = []
    for run in (runs[i] for i in picks):
        load, P = campaign.samples[run.number].load, campaign.trials[run.number].point["pressure"]
        name = f"overlay-{P / 1e3:.0f}kPa-{load:.0f}N-{run.number}"
        title = f"{show(P, 'pressure', 4)}, {show(load, 'force', 4)}: measured and fitted muscle"
        traces.append(overlay(name, "overlay", title, (run.t, run.P, run.x, run.model), P, load))
    return tuple(traces)


def overlay(
    name: str, figure: str, title: str, columns: tuple[Array, Array, Array, Array], P: float, load: float
) -> Trace:
    """Measured and modelled contraction of a trial at P [Pa] with a load [N].

    `columns` are time [s], pressure [Pa], measured and modelled contraction [m], all samples.
    """
    t, *others = columns
    quantities = {"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"}
    shown = thinned(dict(zip(quantities, (t - t[0], *others), strict=True)))
    return Trace(name, figure, title, shown, quantities, {"pressure": P, "load": load})
