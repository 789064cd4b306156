"""Reduction of contraction-relaxation runs: K, B_c, B_r, F_ce and F_c over pressure, by two methods side by side.

`measured-pressure` (primary) is the pooled fit of `pooled`, driven by the pressure that was measured;
`step-exponential` is the papers' way. Knows the samples and the plan's commands; not how the bench is built.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pmabench.analysis import contraction_steps, contraction_view, drift, reference, replay, skew
from pmabench.analysis.calibration import Scales
from pmabench.analysis.campaign import Campaign, gather, strokes
from pmabench.analysis.curves import curve
from pmabench.analysis.intervals import Pooled, assess, replay_fits
from pmabench.analysis.pooled import SYMBOLS, Fit, first_knots, fit, rms_of
from pmabench.analysis.results import Analysis, Curve, Dropped, Estimate, Finding, Parts
from pmabench.analysis.segments import Gate, Samples, Segments, cut, moved
from pmabench.base.quantities import show
from pmabench.store.records import Array, RunData

KIND = "contraction-relaxation"
METHOD = "measured-pressure"
REPLAYS = 10
"""Replays of the fitted muscle, for the bias of the estimator and its scatter."""
OPEN_FORCE = "not identifiable: K is not at this pressure, and F_ce and K x stand for one another"
OPEN_FRICTION = "not identifiable: K is at no pressure"
FEWEST = 3
"""Fewest segments near a pressure for a coefficient there."""
NUMERICS = 2e-4
"""The method part is no smaller than this share of a coefficient: replays are integrated, too."""
AFTER = 0.15
"""Time that a replay goes on after the last segment of a stroke [s]."""
QUANTITY = {"F_ce": ("N", "force"), "K": ("N/m", "stiffness"), "B_c": ("N.s/m", "damping"), "B_r": ("N.s/m", "damping")}
ORDERS = {"F_ce": (1,), "K": (1, 2), "B_c": (1,), "B_r": (1,)}


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m], B_c, B_r [N.s/m], F_ce [N] at every pressure, F_c [N], dead times [s], with curves over pressure.

    M x'' + B(P) x' + K(P) x + F_c sign(x') = F_ce(P) - F_L (paper 0), fitted to all trials at once over short
    moving segments with the measured pressure; K = regression over loads, B = K tau of an exponential beside it.

    `options`: `speed` (gate of the segments [m/s]), `replays` (how many), `static` = {"intercept" [N], "slope"
    [N/Pa]}, F_ce of a static-load study, for the one-parameter regression of K.
    """
    options = options or {}
    campaign, dropped = gather(runs)
    pooled = _pool(campaign, options) if campaign is not None else None
    if campaign is None or pooled is None:
        reason = "no trial moves: there is nothing to fit"
        if campaign is not None:
            dropped += [Dropped(campaign.name(i), trial.point, reason) for i, trial in enumerate(campaign.trials)]
        facts = {"options": dict(options), "trials": sum(len(run.trials) for run in runs), "trials_used": 0}
        return Analysis.of(KIND, runs, dropped=dropped, findings=[Finding("fault", reason)], facts=facts)
    estimates, curves = _estimates(campaign, pooled)
    beside = contraction_steps.compare(campaign, pooled.fit, estimates, options, set(pooled.segments.trial.tolist()))
    dropped += _unmoved(campaign, pooled)
    traces, free_run = contraction_view.overlays(campaign, pooled, estimates)
    return Analysis.of(
        KIND,
        runs,
        estimates=(*estimates, *beside.estimates),
        curves=(*curves, *beside.curves),
        dropped=dropped,
        findings=(
            *contraction_view.findings(campaign, pooled, estimates, free_run),
            *skew.findings(runs, campaign.channels, campaign.skew, (*estimates, *beside.estimates)),
            *beside.findings,
            *reference.findings(runs),
        ),
        traces=traces,
        facts={
            "options": dict(options),
            "trials": sum(len(run.trials) for run in runs),
            **contraction_view.facts(campaign, pooled),
            "free_run_rms": free_run,
            "steps": beside.table,
        },
    )


def _pool(campaign: Campaign, options: Mapping[str, Any]) -> Pooled | None:
    """The pooled fit with its trust; None where nothing moves."""
    gate = Gate(speed=float(options.get("speed", Gate.speed)))
    tested = np.array(campaign.tested)
    commanded = np.unique([c.value for trial in campaign.trials for c in trial.commands if c.output == "pressure"])
    knots = first_knots(tested, commanded)
    low, high = knots[0] - 1e3, knots[-1] + (knots[-1] - knots[-2])

    def segments_of(samples: Sequence[Samples]) -> Segments:
        found = cut(samples, campaign.rate, gate)
        return found.where((found.P.min(axis=1) >= low) & (found.P.max(axis=1) <= high))

    segments = segments_of(campaign.samples)
    if len(segments) < 2 * FEWEST:
        return None
    solved, noise = fit(segments, knots, campaign.noise)
    work = replay.stretches(_moving(campaign, segments), 1 / campaign.rate, round(0.1 * campaign.rate))
    again = replay.run(solved, work.P, work.dt, work.load, work.mass, work.x)

    def replayed(seed: int) -> Segments:
        return segments_of(replay.measured(work, again, campaign.noise, campaign.cell, seed))

    replays = replay_fits(replayed, solved, rms_of(noise), int(options.get("replays", REPLAYS)))
    skews = _skews(campaign, segments_of, knots, solved)
    drifts = drift.causes(campaign.runs, campaign.trials, campaign.channels, segments, solved, rms_of(noise))
    scales = Scales.of(campaign.runs)
    trust = assess(segments, solved, noise, campaign.cells, replays, scales, skews, campaign.steps, drifts)
    return Pooled(segments, solved, noise, trust)


def _skews(
    campaign: Campaign, segments_of: Callable[[Sequence[Samples]], Segments], knots: Array, solved: Fit
) -> Array:
    """Change of theta by the clock of each stream at its bound, both ways; shape (clocks, courses, p).

    Fitted from the first `knots` on: where more are put follows the clocks, too.
    """

    def changed(channels: tuple[str, ...], by: Array) -> Array:
        late = [moved(samples, channels, float(one)) for samples, one in zip(campaign.samples, by, strict=True)]
        again, _ = fit(segments_of(late), knots, campaign.noise)
        values = [again.values(symbol, solved.knots) for symbol in SYMBOLS]
        return np.concatenate((*values, [again.coulomb])) - solved.theta

    clocks = skew.causes(campaign.runs, campaign.channels)
    courses = [way * course for course in skew.courses(campaign.trials) for way in (1.0, -1.0)]
    shifts = [[changed(names, bound * course) for course in courses] for names, bound in clocks.items()]
    return np.array(shifts).reshape(len(clocks), len(courses), len(solved.theta))


def _moving(campaign: Campaign, segments: Segments) -> list[tuple[Samples, slice]]:
    """The strokes that have segments, each up to a moment after its last one."""
    pieces = []
    for number in np.unique(segments.trial):
        samples, trial = campaign.samples[number], campaign.trials[number]
        begins = np.searchsorted(samples.t, segments.t[segments.trial == number])
        for rows in strokes(trial):
            mine = begins[(begins >= rows.start) & (begins < rows.stop)]
            if len(mine):
                stop = int(mine.max()) + segments.v.shape[1] + round(AFTER * campaign.rate)
                pieces.append((samples, slice(rows.start, min(rows.stop, stop))))
    return pieces


def _estimates(campaign: Campaign, pooled: Pooled) -> tuple[list[Estimate], list[Curve]]:
    """The primary method's coefficients at the tested pressures, and curves through them."""
    estimates: list[Estimate] = []
    curves: list[Curve] = []
    stiff = {P: _estimate(campaign, pooled, "K", P) for P in campaign.tested}
    for symbol in SYMBOLS:
        found = [_estimate(campaign, pooled, symbol, P) for P in campaign.tested]
        if symbol == "F_ce":
            found = [_open(e, OPEN_FORCE) if stiff[e.at["pressure"]].value is None else e for e in found]
        estimates += found
        known = [e for e in found if e.value is not None]
        places = [pooled.fit.index(symbol, pooled.fit.at(e.at["pressure"])) for e in known]
        for order in ORDERS[symbol]:
            through = curve(known, order, pooled.trust, places)
            if through is not None:
                curves.append(through)
    friction = _friction(campaign, pooled)
    estimates.append(friction if any(e.value is not None for e in stiff.values()) else _open(friction, OPEN_FRICTION))
    return estimates, curves


def _open(estimate: Estimate, note: str) -> Estimate:
    """The estimate without its value, and why."""
    if estimate.value is None:
        return estimate
    return replace(estimate, value=None, parts=Parts(), bias=None, corrected=False, budget=(), note=note)


def _estimate(campaign: Campaign, pooled: Pooled, symbol: str, P: float) -> Estimate:
    """One coefficient at one pressure [Pa], or why there is none."""
    solved, segments = pooled.fit, pooled.segments
    knot = solved.at(P)
    near = np.abs(segments.pressure - P) <= 0.5 * float(np.min(np.abs(np.delete(solved.knots, knot) - P)))
    if symbol in ("B_c", "B_r"):
        near &= (segments.way > 0) == (symbol == "B_c")
    numbers = np.unique(segments.trial[near])
    unit, quantity = QUANTITY[symbol]
    base: dict[str, Any] = {
        "symbol": symbol,
        "unit": unit,
        "quantity": quantity,
        "method": METHOD,
        "at": {"pressure": P},
        "n": len(numbers),
        "trials": tuple(campaign.name(int(number)) for number in numbers),
    }
    moving = {"B_c": "contracting", "B_r": "relaxing"}.get(symbol, "moving")
    if near.sum() < FEWEST:
        return Estimate(value=None, note=f"not identifiable: no {moving} samples near this pressure", **base)
    combination = np.zeros(len(solved.theta))
    combination[solved.index(symbol, knot)] = 1.0
    value = float(combination @ solved.theta)
    parts, bias, budget = pooled.trust.budget(combination, NUMERICS * abs(value))
    start = solved.index(symbol)
    size = float(np.median(np.abs(solved.theta[start : start + len(solved.knots)])))
    if (parts.repeats or 0.0) > contraction_view.WIDE * max(abs(value), size):
        note = f"not identifiable: the {moving} samples near this pressure leave it open"
        return Estimate(value=None, note=note, **base)
    found = Estimate(value=value - bias, parts=parts, bias=bias, corrected=True, budget=budget, **base)
    return _settled(campaign, found)


def _settled(campaign: Campaign, estimate: Estimate) -> Estimate:
    """The estimate, without a value where the clocks do not allow one."""
    return skew.settled(estimate, "the channels", campaign.skew)


def _friction(campaign: Campaign, pooled: Pooled) -> Estimate:
    """F_c over the whole campaign."""
    numbers = np.unique(pooled.segments.trial)
    base: dict[str, Any] = {
        "symbol": "F_c",
        "unit": "N",
        "quantity": "force",
        "method": METHOD,
        "n": len(numbers),
        "trials": tuple(campaign.name(int(number)) for number in numbers),
    }
    if not pooled.fit.friction:
        note = "not identifiable: the samples move one way only, and F_ce carries the friction"
        return Estimate(value=None, note=note, **base)
    combination = np.zeros(len(pooled.fit.theta))
    combination[-1] = 1.0
    parts, bias, budget = pooled.trust.budget(combination)
    value = pooled.fit.coulomb - bias
    return _settled(campaign, Estimate(value=value, parts=parts, bias=bias, corrected=True, budget=budget, **base))


def _unmoved(campaign: Campaign, pooled: Pooled) -> list[Dropped]:
    """Trials without a segment, and why: the load is more than the muscle lifts, or it moves too little."""
    used = set(pooled.segments.trial.tolist())
    dropped = []
    for number, trial in enumerate(campaign.trials):
        if number in used:
            continue
        samples = campaign.samples[number]
        P, load = trial.point["pressure"], trial.point.get("load", 0.0)
        pull = float(pooled.fit.values("F_ce", np.array([P]))[0])
        if load >= pull:
            reason = f"the load, {show(load, 'force', 4)}, is not below F_ce = {show(pull, 'force', 4)}"
        else:
            moved = float(np.max(samples.x[samples.ok])) - float(np.min(samples.x[samples.ok]))
            reason = f"too little motion: {show(moved, 'length', 3)} with F_ce - F_L = {show(pull - load, 'force', 3)}"
        dropped.append(Dropped(campaign.name(number), trial.point, reason))
    return dropped
