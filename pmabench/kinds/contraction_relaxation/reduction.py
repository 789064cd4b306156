"""Reduction of contraction-relaxation runs: K, B_c, B_r, F_ce and F_c over pressure, by two methods.

`measured-pressure` (primary) is the pooled fit of `pooled`, with the measured pressure as input; `step-exponential` is
the papers' method. Uses the samples and the plan's commands; knows nothing of the bench. `measure`: one trial for the
display.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np

from pmabench.analysis.shared import simulated, skew
from pmabench.analysis.shared.samples import NotUsable, Samples
from pmabench.analysis.shared.student import half_width
from pmabench.analysis.shared.trials import reference_findings
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation import RESULTS, bandwidth, checks, exponentials
from pmabench.kinds.contraction_relaxation.bandwidth import Recorded, regulator
from pmabench.kinds.contraction_relaxation.checks import free_runs
from pmabench.kinds.contraction_relaxation.diagnosis.held_out import Test
from pmabench.kinds.contraction_relaxation.diagnosis.hiding import hidden, of_the_sensors
from pmabench.kinds.contraction_relaxation.diagnosis.verdict import Diagnosis, examined
from pmabench.kinds.contraction_relaxation.exponentials import regress, steps_of
from pmabench.kinds.contraction_relaxation.intervals import (
    Cause,
    Pooled,
    Rest,
    assess,
    causes_of,
)
from pmabench.kinds.contraction_relaxation.pooled import (
    FLOOR,
    SYMBOLS,
    Fit,
    expected_noise,
    first_knots,
    fit,
    rms_of,
)
from pmabench.kinds.contraction_relaxation.segments import (
    Campaign,
    Cut,
    Gate,
    Kept,
    Segments,
    cut,
    gather,
    moved,
    samples_of,
    strokes,
)
from pmabench.kinds.contraction_relaxation.values import FEWEST, FORMS, METHOD, best_orders, curve, values
from pmabench.store.analyses.results import Analysis, Curve, Dropped, Estimate, Finding, withhold, without_value
from pmabench.store.records import Array, RunData, TrialData

KIND = "contraction-relaxation"
REPLAYS = 10
"""Replays of the fitted muscle, for the bias of the estimator and its scatter."""
AFTER = 0.15
"""Time that a replay continues after the last segment of a stroke [s]."""
OF_THE_FORM = (*SYMBOLS, "F_c", "f_b")
"""Symbols whose values depend on the form of the model; times are read directly from the samples."""
ORDERS = {"F_ce": (1,), "K": (1, 2), "B_c": (1,), "B_r": (1,)}
"""Orders of curves over pressure that are given where there are pressures enough; in addition that which the Akaike
criterion chooses."""
TWO = "no curve over pressure: a line through two pressures shows nothing of what lies between; add a third pressure"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m], B_c, B_r [N.s/m], F_ce [N] at every pressure, F_c [N], dead times [s], with curves over pressure.

    M x'' + B(P) x' + K(P) x + F_c sign(x') = F_ce(P) - F_L (paper 0), fitted to all trials at once over short moving
    segments with the measured pressure; for comparison K by regression over loads and B = K tau of an exponential.

    `options`: `replays` (number), `regulator`: also dead time and lags of the pressure.
    """
    options = options or {}
    campaign, dropped = gather(runs)
    pooled, reason = None, "no trial moves: there is nothing to fit"
    try:
        pooled = pool(campaign, options) if campaign is not None else None
    except NotUsable as why:
        reason = str(why)
    facts = {"options": dict(options), "trials": sum(len(run.trials) for run in runs)}
    if campaign is None or pooled is None:
        return _without_fit(runs, campaign, dropped, reason, {**facts, "trials_used": 0})
    recorded = Recorded.of(campaign, pooled.diagnosis)
    campaign, diagnosis = pooled.campaign, pooled.diagnosis
    estimates, curves = estimates_of(pooled)
    stepwise = exponentials.compare(pooled, estimates)
    widths = bandwidth.estimates(campaign, estimates, recorded)
    dropped += _unmoved(campaign, pooled)
    response, described = regulator(recorded) if options.get("regulator") else ([], [])
    simulated = free_runs(campaign, pooled, estimates)
    every = (*estimates, *stepwise.estimates, *exponentials.onsets(recorded, pooled), *widths)
    reported = withheld(every, diagnosis)
    gone = {e.symbol for e in reported if e.withheld}
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=(*reported, *response),
        curves=[c for c in (*curves, *stepwise.curves) if c.symbol not in gone],
        dropped=dropped,
        findings=(
            *checks.findings(campaign, pooled, estimates),
            *skew.findings(runs, campaign.channels, campaign.skew, every),
            *stepwise.findings,
            *described,
            *([Finding("note", TWO)] if len(campaign.tested) == 2 else []),
            *reference_findings(runs),
        ),
        traces=checks.overlays(campaign, simulated),
        facts={
            **facts,
            **checks.facts(campaign, pooled, simulated),
            "steps": stepwise.steps,
        },
        refusals=[f"{KIND}: {diagnosis.refusal}"] if diagnosis.refusal else [],
    )


def _without_fit(
    runs: Sequence[RunData], campaign: Campaign | None, dropped: list[Dropped], reason: str, facts: dict[str, Any]
) -> Analysis:
    findings = [] if campaign is None and dropped else [Finding("fault", reason)]
    if campaign is not None:
        dropped = [*dropped, *(Dropped(campaign.name(i), t.point, reason) for i, t in enumerate(campaign.trials))]
    return Analysis.of(KIND, runs, results=RESULTS, dropped=dropped, findings=findings, facts=facts)


def withheld(estimates: Sequence[Estimate], diagnosis: Diagnosis) -> list[Estimate]:
    """The estimates without the values whose form the data contradict; other methods follow the first one.

    Where the fit needed a correction for a property of the muscle, methods without that correction give no value.
    """
    reasons: dict[tuple[str, float | None], str] = {}
    hidden = diagnosis.hides(estimates)
    uncorrected = next((one for one in diagnosis.of_fit if one.of_muscle), None)
    result = []
    for place, e in enumerate(estimates):
        key, corrected = (e.symbol, e.at.get("pressure")), e.method == METHOD
        why = diagnosis.reason or reasons.get(key) or hidden.get(place, "")
        if e.symbol in OF_THE_FORM and e.value is not None:
            if why:
                e = withhold(e, why)
                reasons |= {key: why} if corrected else {}
            elif uncorrected is not None and not corrected:
                why = f"not given: {uncorrected.text}, and this method has no correction for it"
                e = without_value(e, why)
        result.append(e)
    return result


def segments_like(campaign: Campaign) -> tuple[Array, Cut]:
    """First knots of the fit [Pa], and the function that cuts samples into segments within their range."""
    commanded = np.unique([c.value for trial in campaign.trials for c in trial.commands if c.output == "pressure"])
    knots = first_knots(np.array(campaign.tested), commanded)
    kept = Kept()
    return knots, lambda samples: cut(samples, campaign.rate, Gate(), kept).within(knots)


def _replays(
    campaign: Campaign, segments_of: Cut, work: simulated.Stretches, fit: Fit, count: int
) -> Iterator[Segments]:
    """Segments of `count` replays of a fitted muscle; NotUsable where it does not move."""
    if not count:
        return
    run = simulated.run(fit, work.P, work.dt, work.load, work.mass, work.x)
    noise = campaign.noise
    if campaign.pressure_step:
        noise = replace(noise, pressure=sqrt(max(0.0, noise.pressure**2 - campaign.steps.pressure**2)))
    for samples in simulated.measured(work, run, noise, campaign.cell, count, campaign.pressure_step):
        seen_again = segments_of(samples)
        if len(seen_again) < 2 * FEWEST:
            raise NotUsable("the fitted muscle does not move under the loads and pressures that moved the real one")
        yield seen_again


def pool(recorded: Campaign, options: Mapping[str, Any]) -> Pooled | None:
    """The pooled fit of the corrected campaign with its uncertainty; None where nothing moves; NotUsable where the
    fitted muscle does not move in the replays.
    """
    knots, segments_of = segments_like(recorded)
    as_recorded = segments_of(recorded.samples)
    if len(as_recorded) < 2 * FEWEST:
        return None
    diagnosis = examined(recorded, knots, segments_of, as_recorded)
    test = diagnosis.reported.test
    campaign, segments, solved = test.campaign, test.segments, test.fit
    noise = np.maximum(FLOOR * rms_of(segments.force), expected_noise(segments, solved, campaign.noise))
    slipped = any(one.kind == "slip" for one in diagnosis.reported.explanations)  # its correction covers that
    rested = ["pressure"] if slipped else ["pressure", "displacement"]
    rests = {channel: Rest.of(campaign, channel) for channel in rested}
    stepless = replace(campaign, samples=_stepless(campaign))
    work = simulated.stretches(_moving(stepless, segments), 1 / campaign.rate, round(0.1 * campaign.rate))

    def again(samples: Sequence[Samples]) -> Array:
        """Theta of a fit to these samples from the first knots on: shifted clocks may need added knots elsewhere."""
        other = diagnosis.corrected(segments_of(samples))
        return fit(other, knots, campaign.noise)[0].at_knots(solved.knots)

    def replays(count: int) -> Iterator[Segments]:
        return _replays(campaign, segments_of, work, solved, count)

    expected = rms_of(noise)
    thetas = [solved.again(one, expected).theta for one in replays(int(options.get("replays", REPLAYS)))]
    skews = _skews(campaign, again, solved)
    causes = list(causes_of(campaign, segments, solved, expected, rests))
    if campaign.pressure_step:
        between = again(stepless.samples) - solved.theta
        causes.append(Cause("where the pressure is between its steps", "method", between[None]))
    trust = assess(campaign, segments, solved, noise, thetas, skews, causes)
    if diagnosis.spread is not None:
        trust = replace(trust, correction=diagnosis.spread.correction())

    def tests_of_noise(count: int) -> list[Test]:
        return [Test.of(campaign, one, solved.again(one, test.expected), test.expected) for one in replays(count)]

    departures = hidden(test, diagnosis.search.followed, diagnosis.weighed, trust, tests_of_noise)
    sensors = of_the_sensors(campaign, diagnosis.weighed, segments, solved)
    trust = replace(trust, causes=(*trust.causes, *departures.lines(solved), *sensors))
    return Pooled(campaign, segments, solved, noise, trust, replace(diagnosis, hidden=departures))


def _stepless(campaign: Campaign) -> tuple[Samples, ...]:
    """The samples with the pressure interpolated between its steps, where noise does not fill these."""
    step = campaign.pressure_step
    found = list(campaign.samples)
    for i, one in enumerate(found if step else ()):
        if one.ok.any():
            P = np.interp(one.t, one.t[one.ok], one.P[one.ok])
            found[i] = replace(one, P=simulated.between_steps(P, step))
    return tuple(found)


def _skews(campaign: Campaign, again: Callable[[Sequence[Samples]], Array], solved: Fit) -> Array:
    """Change of theta by the clock of each stream at its bound, with both signs; shape (clocks, courses, p)."""

    def changed(channels: tuple[str, ...], by: Array) -> Array:
        late = [moved(samples, channels, float(one)) for samples, one in zip(campaign.samples, by, strict=True)]
        return again(late) - solved.theta

    clocks = skew.causes(campaign.runs, campaign.channels)
    courses = [way * course for course in skew.courses(campaign.trials) for way in (1.0, -1.0)]
    shifts = [[changed(names, bound * course) for course in courses] for names, bound in clocks.items()]
    return np.array(shifts).reshape(len(clocks), len(courses), len(solved.theta))


def _moving(campaign: Campaign, segments: Segments) -> list[tuple[Samples, slice]]:
    """The strokes that have segments, each cut `AFTER` its last segment."""
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


def estimates_of(pooled: Pooled) -> tuple[list[Estimate], list[Curve]]:
    """The primary method's coefficients at the tested pressures, and curves through them."""
    estimates = values(pooled)
    curves = []
    for symbol, orders in ORDERS.items():
        known = [e for e in estimates if e.symbol == symbol and e.value is not None]
        places = [pooled.fit.columns(symbol).start + pooled.fit.at(e.at["pressure"]) for e in known]
        best = best_orders(np.array([e.at["pressure"] for e in known]), np.array([e.value for e in known], float))
        for order in sorted({*orders, *best[:1]}):
            curves.append(curve(known, order, pooled.trust, places, normalised=order > max(FORMS)))
    return estimates, [through for through in curves if through is not None]


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
        elif not samples.ok.any():
            reason = "no sample of its strokes is usable"
        else:
            moved = float(np.ptp(samples.x[samples.ok]))
            reason = f"too little motion: {show(moved, 'length', 3)} with F_ce - F_L = {show(pull - load, 'force', 3)}"
        dropped.append(Dropped(campaign.name(number), trial.point, reason))
    return dropped


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """x_inf and tau of the contraction; K and F_ce from the loads done so far at this pressure.

    At the end of a contraction K x_inf = F_ce - F_c - F_L, so the line over loads gives F_ce - F_c; the prediction that
    is compared with it is reduced by F_c, too.
    """
    if "displacement" not in trial.channels or "pressure" not in trial.channels or len(trial.t) < 2:
        return [], ["pressure or displacement is not recorded"]
    if "from" in trial.point:
        return _single_step(run, trial)
    P, load = trial.point.get("pressure", 0.0), trial.point.get("load", 0.0)
    steps = steps_of([(samples_of(run, trial, 0), trial)], Gate.lift)
    step = next((s for s in steps if s.phase == "contract"), None)
    K_e, F_e = (expected.at(name, P) if expected else None for name in ("K", "F_ce"))
    slip = expected.F_c if expected else 0.0
    pull = F_e - slip - load if F_e is not None else None  # F_ce - F_c - F_L, which is K x_inf
    doubts: list[str] = []
    if step is None:
        if pull is None or pull > slip:
            doubts.append("no contraction step: the muscle did not lift the load")
        names = (("x_inf", "length"), ("tau", "time"), ("K", "stiffness"), ("F_ce", "force"))
        return [Measured(name, quantity, None) for name, quantity in names], doubts
    x = step.fit.end
    doubts += _drift(trial, step.fit.start)
    if trial.status == "finished":
        quick.ends.setdefault(round(P), {})[trial.index] = load, x
    ends = np.array(list(quick.ends.get(round(P), {}).values()))
    line = regress(ends[:, 0], ends[:, 1]) if len(ends) else None
    x_e, tolerance = pull / K_e if pull is not None and K_e else None, slip / K_e if K_e else 0.0
    found = [
        Measured("x_inf", "length", x, expected=x_e, tolerance=tolerance, noise=20e-6),
        Measured("tau", "time", step.fit.tau, noise=0.01),
    ]
    rest = F_e - slip if F_e is not None else None
    if line is not None:
        half = half_width(line.se_K, line.n - 2)
        found.append(Measured("K", "stiffness", line.K, K_e, pooled=True, half=half))
        found.append(Measured("F_ce", "force", line.F_ce, rest, tolerance=slip, pooled=True))
    else:
        one_K = pull / x if pull is not None and pull > 0 else None
        one_F = load + K_e * x if K_e is not None else None
        found.append(Measured("K", "stiffness", one_K, K_e, assumed=True, pooled=True))
        found.append(Measured("F_ce", "force", one_F, rest, assumed=True, pooled=True))
    return found, doubts


def _single_step(run: RunData, trial: TrialData) -> Found:
    """x_max and tau of one of paper 1's steps; K of a contraction, with F_ce from the braid."""
    from pmabench.kinds.contraction_relaxation.paper1 import STILL, Braid, read  # 50 MB with all models

    asked = (run.plan.get("settings") or {}).get("reduction") or {}
    step = read(samples_of(run, trial, 0), trial)
    if isinstance(step, str):
        return [Measured("x_max", "length", None), Measured("tau", "time", None)], [step]
    found = [Measured("x_max", "length", step.stroke, noise=20e-6), Measured("tau", "time", step.tau, noise=0.01)]
    if step.way > 0 and asked:
        K = Braid.of(asked).stiffness(step.held, step.stroke, step.load, str(asked.get("F_ce_at", "x0")))
        found.append(Measured("K", "stiffness", K))
    doubts = []
    if abs(step.creeps) > STILL:
        doubts.append(f"still drifting: {100 * abs(step.creeps):.2g} % of its stroke at the end of the hold")
    return found, doubts


def _drift(trial: TrialData, start: float) -> list[str]:
    """Warning if the displacement still moves at the end of the contraction; else empty."""
    commands = [c for c in trial.commands if c.output == "pressure"]
    first = next((i for i, c in enumerate(commands) if c.phase == "contract"), None)
    if first is None:
        return []
    begin, end = commands[first].t, commands[first + 1].t if first + 1 < len(commands) else float(trial.t[-1])
    late = (trial.t > end - (end - begin) / 5) & (trial.t < end) & trial.usable
    t, x = trial.t[late], trial.channels["displacement"][late]
    if len(t) < 20:
        return []
    half = len(t) // 2
    moved = 2 * (float(x[half:].mean()) - float(x[:half].mean()))
    size = abs(float(x.mean()) - start)
    if abs(moved) <= DRIFT * size:
        return []
    return [f"still drifting: {show(moved, 'length', 2)} in the last {t[-1] - t[0]:.1f} s"]
