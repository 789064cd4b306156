"""Paper 1's reduction of single steps: S and D over pressure, in both conventions of F_ce, each as a separate method.

S = (F_ce - L) / x_max, D = tau S (paper 1 section 3); K is the paper's S, B_c and B_r its D. F_ce comes from the braid
(eqs. 5-10), at x = 0 or at x_max: the plan names the one that comes first. For comparison `measured-pressure`, which
does not assume a pressure step. D of relaxation is given at the pressure *before* the release; reduction only.

Also stroke and time constant of one step, and paper 1's closed form compared with the tests it was fitted to: accuracy
at rest, residual over time, overlays, figure.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, hypot, sqrt
from typing import Any

import numpy as np
from scipy.optimize import brentq

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, calibrated, sentences
from pmabench.analysis.shared.samples import LEAST, Samples, onset
from pmabench.analysis.shared.student import mean_over, mean_with_half
from pmabench.analysis.shared.trials import grouped
from pmabench.base.errors import invalid
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation import PAPER_1_RESULTS
from pmabench.kinds.contraction_relaxation.checks import overlay
from pmabench.kinds.contraction_relaxation.segments import Campaign, gather, moved
from pmabench.kinds.contraction_relaxation.values import (
    QUANTITY,
    best_orders,
    biases,
    curve,
    fit_known_force,
    least,
    with_bias,
)
from pmabench.model.library.braid import braid_force
from pmabench.plotting.motion import overlays
from pmabench.plotting.pictures import Picture
from pmabench.store.analyses.results import Analysis, Curve, Dropped, Estimate, Finding, Parts, Trace, without_value
from pmabench.store.records import Array, RunData, TrialData

KIND = "contraction-relaxation-paper-1"
METHODS = {"x0": "paper-1-x0", "xmax": "paper-1-xmax"}
DRIVEN = "measured-pressure-x0"
LOWEST = 100e3
"""Paper 1's S and D are declared invalid below this pressure [Pa]."""
SYMBOLS = ("K", "B_c", "B_r")
GIVEN = "F_ce from the braid's geometry, whose error is in no part"
START = "by the pressure before the release: a reduction only, no coefficient at that pressure"
OTHER = "F_ce at x_max: not to be mixed with values at x = 0"
ONCE = "no repeats part: each step was made once"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m], B_c, B_r [N.s/m] at every pressure by two conventions of F_ce, polynomials, model compared with tests.

    Geometry, convention and orders are in the plan's `reduction`; runs whose plan has other ones are dropped.
    """
    settings = dict(_plan_of(runs[0]) or {}) | dict(options or {})
    braid, chosen, orders = _asked(runs[0], settings)
    alike = [run for run in runs if _plan_of(run) == _plan_of(runs[0])]
    dropped = [
        Dropped(trial.name, trial.point, "another geometry, convention or order than in the first run: reduce it apart")
        for run in runs
        if run not in alike
        for trial in run.trials
    ]
    campaign, unusable = gather(alike)
    dropped += unusable
    steps = _steps_of(campaign, dropped) if campaign else []
    if campaign is None or not any(step.way > 0 for step in steps):
        fault = Finding("fault", "no contraction can be read: there is no S, and no D without it")
        facts = {"options": settings, "trials_used": 0}
        return Analysis.of(KIND, runs, results=PAPER_1_RESULTS, dropped=dropped, findings=[fault], facts=facts)
    both = sorted(grouped(steps, lambda step: (step.way, step.pressure)).items())
    up, down = ([group for (way, _), group in both if way == each] for each in (1, -1))
    driven = _driven(campaign, up, braid)
    estimates: list[Estimate] = []
    for at in sorted(METHODS, key=lambda name: name != chosen):
        estimates += _by_paper(campaign, up, down, braid, at, driven if at == "x0" else ())
    curves, findings = _curves([*estimates, *driven], orders)
    stiff = [e for e in estimates if (e.symbol, e.method) == ("K", METHODS[chosen]) and e.value is not None]
    of_model, said, traces = compare(campaign, steps, curves, stiff, braid, chosen)
    return Analysis.of(
        KIND,
        runs,
        results=PAPER_1_RESULTS,
        estimates=(*estimates, *driven, *of_model),
        curves=curves,
        dropped=dropped,
        findings=(
            *_said(campaign, steps, estimates),
            *findings,
            *said,
            *skew.findings(alike, campaign.channels, campaign.skew, driven),
        ),
        traces=traces,
        facts={
            "options": settings,
            "trials": sum(len(run.trials) for run in runs),
            "trials_used": len(steps),
            "steps": [_as_fact(campaign, step) for step in steps],
        },
    )


def _steps_of(campaign: Campaign, dropped: list[Dropped]) -> list[Step]:
    """The steps that can be read; other trials are added to `dropped`."""
    steps: list[Step] = []
    for samples, trial in zip(campaign.samples, campaign.trials, strict=True):
        step = read(samples, trial)
        if isinstance(step, Step) and step.pressure < LOWEST * (1 - 1e-9):
            step = f"below {show(LOWEST, 'pressure')}, where paper 1's S and D do not hold"
        if isinstance(step, Step):
            steps.append(step)
        else:
            dropped.append(Dropped(trial.name, trial.point, step))
    return steps


def _as_fact(campaign: Campaign, step: Step) -> dict[str, Any]:
    before, after = (0.0, step.pressure) if step.way > 0 else (step.pressure, 0.0)
    found = {"load": step.load, "x_max": step.stroke, "t_d": step.t_d, "tau": step.tau}
    return {"trial": campaign.name(step.trial), "from": before, "to": after, **found}


def _plan_of(run: RunData) -> Any:
    return (run.plan.get("settings") or {}).get("reduction")


def _asked(run: RunData, settings: Mapping[str, Any]) -> tuple[Braid, str, dict[str, int]]:
    """Geometry, convention and orders; InvalidFile where the plan lacks them or has them in another form."""
    try:
        braid, chosen = Braid.of(settings), str(settings.get("F_ce_at", "x0"))
        orders = {str(symbol): int(order) for symbol, order in dict(settings.get("orders") or {}).items()}
        if chosen not in METHODS or not all(x > 0 for x in vars(braid).values()) or any(n < 1 for n in orders.values()):
            raise ValueError
    except (KeyError, TypeError, ValueError) as error:
        text = (
            'the plan\'s "reduction" tells no radius, nominal_length, braid_angle above 0, F_ce_at x0 or xmax, '
            "and orders from 1 on; was it made by hand? Make the run's plan with `pmabench check`"
        )
        raise invalid(run.path, text) from error
    return braid, chosen, orders


def _by_paper(
    campaign: Campaign, up: Sequence[Sequence[Step]], down: Sequence[Sequence[Step]], braid: Braid, at: str,
    driven: Sequence[Estimate],
) -> list[Estimate]:  # fmt: skip
    """K, B_c, B_r at every pressure in one convention; with `driven` the distance to it as bias and method part."""
    scales = Scales.of(campaign.runs)
    estimates: list[Estimate] = []
    stiff: dict[float, Estimate] = {}
    for group in up:
        values = [braid.stiffness(s.held, s.stroke, s.load, at) for s in group]
        K = _estimate(campaign, "K", group, values, at)
        B = _estimate(campaign, "B_c", group, [s.tau * S for s, S in zip(group, values, strict=True)], at)
        if min(values) <= 0:
            note = "not identifiable: by its geometry the muscle has no pull above the load left at x_max"
            K, B = (without_value(e, note) for e in (K, B))
        else:
            tau = float(np.mean([s.tau for s in group]))
            K, B = _calibrated(K, group, braid, at, scales, 1.0), _calibrated(B, group, braid, at, scales, tau)
            B = _sampled(campaign, B, tau)
            stiff[group[0].pressure] = K
        estimates += [_against(K, driven), _against(B, driven)]
    for group in down:
        S = stiff.get(group[0].pressure)
        if S is None or S.value is None:
            blank = _estimate(campaign, "B_r", group, [0.0] * len(group), at)
            note = "not identifiable: there is no S of a contraction to this pressure"
            estimates.append(without_value(blank, note))
            continue
        taus = [s.tau for s in group]
        mean = float(np.mean(taus))
        B = _estimate(campaign, "B_r", group, [tau * S.value for tau in taus], at, START)
        halves = (B.parts.repeats, S.parts.repeats)
        repeats = None if None in halves else hypot(halves[0] or 0.0, mean * (halves[1] or 0.0))
        calibration = None if S.parts.calibration is None else mean * S.parts.calibration
        B = replace(B, parts=replace(B.parts, repeats=repeats, calibration=calibration))
        estimates.append(_sampled(campaign, B, mean))
    return sorted(estimates, key=lambda e: SYMBOLS.index(e.symbol))


def _estimate(
    campaign: Campaign, symbol: str, group: Sequence[Step], values: Sequence[float], at: str, note: str = ""
) -> Estimate:
    """Mean over the repeats and loads of a group, with their scatter as repeats part."""
    mean, half, _ = mean_over(values, [s.load for s in group])
    note = sentences(note, GIVEN, OTHER if at == "xmax" else "", ONCE if half is None else "")
    where, names = {"pressure": group[0].pressure}, tuple(campaign.name(s.trial) for s in group)
    return Estimate(
        symbol, mean, *QUANTITY[symbol], METHODS[at], where, Parts(half), len(values), note=note, trials=names
    )


def _calibrated(e: Estimate, group: Sequence[Step], braid: Braid, at: str, scales: Scales, factor: float) -> Estimate:
    """The estimate with a calibration part, from dS/dP and dS/dx times `factor`."""
    P, x, load = (float(np.mean([getattr(s, name) for s in group])) for name in ("held", "stroke", "load"))
    by_P = factor * (braid.stiffness(P * 1.001, x, load, at) - braid.stiffness(P * 0.999, x, load, at)) / (0.002 * P)
    by_x = factor * (braid.stiffness(P, x * 1.001, load, at) - braid.stiffness(P, x * 0.999, load, at)) / 0.002
    gains, offsets = {"displacement": by_x, "pressure": by_P * P}, {"pressure": by_P}
    return calibrated(e, scales, gains, offsets)


def _sampled(campaign: Campaign, e: Estimate, tau: float) -> Estimate:
    """The estimate with a method part for the sampling: half a period at either end of tau."""
    part = abs(e.value or 0.0) * hypot(0.5, 0.5) / campaign.rate / tau
    return replace(e, parts=replace(e.parts, method=part))


def _against(e: Estimate, driven: Sequence[Estimate]) -> Estimate:
    """The estimate with its difference to the fit with measured pressure as bias, not subtracted, and in the method
    part.
    """
    other = next((d for d in driven if d.symbol == e.symbol and d.at == e.at and d.value is not None), None)
    return e if other is None or e.value is None else with_bias(e, other)


def _driven(campaign: Campaign, up: Sequence[Sequence[Step]], braid: Braid) -> list[Estimate]:
    """K and B_c by the measured pressure, F_ce at x = 0; repeats are fitted separately, their scatter gives the
    interval.
    """
    tested = np.array([group[0].pressure for group in up])
    members = sorted({s.trial for group in up for s in group})
    samples = {n: campaign.samples[n] for n in members}
    found = _fitted(campaign, samples, tested, braid)
    late = dict.fromkeys(found, 0.0)
    for names, bound in skew.causes(campaign.runs, campaign.channels).items():
        ways = [
            _fitted(campaign, {n: moved(one, names, way * bound) for n, one in samples.items()}, tested, braid)
            for way in (1.0, -1.0)
        ]
        for key, values in found.items():
            changes = [abs(float(np.mean(again[key]) - np.mean(values))) for again in ways if key in again]
            late[key] += max(changes, default=0.0)
    estimates = []
    for (symbol, P), fitted in sorted(found.items(), key=lambda item: (SYMBOLS.index(item[0][0]), item[0][1])):
        mean, half = mean_with_half(fitted)
        names = tuple(campaign.name(s.trial) for group in up if group[0].pressure == P for s in group)
        parts, note = Parts(half, skew=late[symbol, P]), sentences(GIVEN, ONCE if half is None else "")
        at = {"pressure": P}
        e = Estimate(symbol, mean, *QUANTITY[symbol], DRIVEN, at, parts, len(names), note=note, trials=names)
        estimates.append(skew.settled(e, "pressure and displacement", campaign.skew))
    return estimates


def _fitted(
    campaign: Campaign, samples: Mapping[int, Samples], tested: Array, braid: Braid
) -> dict[tuple[str, float], list[float]]:
    """Symbol and pressure [Pa] -> the values of all rounds of repeats."""
    found: dict[tuple[str, float], list[float]] = {}
    for repeat in sorted({campaign.trials[n].repeat for n in samples}):
        chosen = [one for n, one in samples.items() if campaign.trials[n].repeat == repeat]
        for P, values in fit_known_force(chosen, campaign.rate, tested, lambda P: braid.force(P, 0.0)).items():
            for symbol, value in zip(("K", "B_c"), values, strict=True):
                found.setdefault((symbol, P), []).append(value)
    return found


def _curves(estimates: Sequence[Estimate], orders: Mapping[str, int]) -> tuple[list[Curve], list[Finding]]:
    """A line and a polynomial in z through each coefficient of each method, only those that are positive on their
    domain.
    """
    curves: list[Curve] = []
    findings: list[Finding] = []
    for method, symbol in dict.fromkeys((e.method, e.symbol) for e in estimates):
        known = [e for e in estimates if (e.method, e.symbol) == (method, symbol) and e.value is not None]
        if len(known) < 2:
            continue
        what = f"{symbol} by {method}"
        P, y = np.array([e.at["pressure"] for e in known]), np.array([e.value for e in known], dtype=np.float64)
        given = orders.get(symbol)
        ranked = [given] if given else best_orders(P, y)
        if given and len(P) < given + 2:
            text = f"a polynomial of order {given} through {what} needs {given + 2} pressures, there are {len(P)}"
            findings.append(Finding("doubt", text))
            ranked = []
        fitted = [c for order in ranked if (c := _sound(known, order, True)) is not None]
        if ranked and not fitted:
            text = f"no polynomial through {what}: it would fall below 0 between the tested pressures"
            findings.append(Finding("doubt", text))
        line = _sound(known, 1, False)
        curves += [c for c in (line, *fitted[:1]) if c is not None]
    return curves, findings


def _sound(known: Sequence[Estimate], order: int, normalised: bool) -> Curve | None:
    """The curve, if it is above 0 on its whole domain: no damping is negative."""
    found = curve(known, order, normalised=normalised)
    if found is None:
        return None
    terms = np.array([term.value for term in found.terms], dtype=np.float64)
    low, high = ((end - found.centre) / found.scale for end in found.domain)
    return found if least(terms, (low, high)) > 0 else None


def _said(campaign: Campaign, steps: Sequence[Step], estimates: Sequence[Estimate]) -> Iterator[Finding]:
    """The difference between paper 1's method and the fit with measured pressure in the convention that both have, and
    steps that had not come to rest.
    """
    if parts := biases(estimates, ("K", "B_c")):
        text = f"{METHODS['x0']} against {DRIVEN}: {', '.join(parts)}; it takes the pressure for a step"
        yield Finding("note", text + ", as it must for B_r, which no second method can tell here")
    if moving := [s for s in steps if abs(s.creeps) > STILL]:
        worst = max(moving, key=lambda s: abs(s.creeps))
        text = (
            f"{len(moving)} of {len(steps)} steps still moved at their end, {campaign.name(worst.trial)} by "
            f"{100 * abs(worst.creeps):.2g} % of its stroke: x_max and tau come out short; hold longer"
        )
        yield Finding("doubt", text)


SHARE = 1 - exp(-1)
"""Share of the stroke that is reached after one time constant, 0.63212."""
SETTLED = 0.2
"""The end of a stroke is the mean over this last share of the hold."""
STILL = 2e-3
"""Share of the stroke that may still be moved within the last part of the hold."""
LEAST_STROKE = 0.2e-3
"""Smaller steps are not evaluated [m]."""


@dataclass(frozen=True)
class Braid:
    """Geometry for F_ce [m, rad]: F = pi r0^2 P (a (1 - x / L0)^2 - b) (paper 1 eqs. 5-10)."""

    radius: float
    nominal_length: float
    braid_angle: float

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Braid:
        """From the settings of a plan."""
        return cls(*(float(settings[name]) for name in ("radius", "nominal_length", "braid_angle")))

    def force(self, P: Array | float, x: Array | float) -> Array:
        """F_ce [N] at pressures P [Pa gauge] and contractions x [m], not below 0; broadcast."""
        P, x = np.broadcast_arrays(np.asarray(P, dtype=np.float64), np.asarray(x, dtype=np.float64))
        one = np.ones(P.shape)
        return braid_force(P, x / self.nominal_length, self.radius * one, self.braid_angle * one, one)[0]

    def stiffness(self, P: float, x_max: float, load: float, at: str) -> float:
        """S = (F_ce - L) / x_max [N/m], F_ce at x = 0 (`x0`) or at x_max (`xmax`); 0 or less where no force is left."""
        return (float(self.force(P, x_max if at == "xmax" else 0.0)) - load) / x_max


@dataclass(frozen=True)
class Step:
    """One evaluated trial. `way` is +1 from 0 to `pressure`, -1 from there to 0 [Pa, commanded]."""

    trial: int
    way: int
    pressure: float
    held: float
    """Pressure measured at the end of the contraction, or before the release [Pa]."""
    load: float
    stroke: float
    """x_max of a contraction, or the distance moved back in a relaxation [m]."""
    t_d: float
    """From the command to the first motion [s]."""
    tau: float
    """From the first motion to 63.2 % of the stroke [s]."""
    creeps: float
    """Motion in the last part of the hold, as a share of the stroke."""


def read(samples: Samples, trial: TrialData) -> Step | str:
    """The trial's step, or the reason why there is none."""
    high, start = trial.point.get("pressure", 0.0), trial.point.get("from", 0.0)
    way = 1 if high > start else -1
    phase = "contract" if way > 0 else "relax"
    command = next((c for c in trial.commands if c.output == "pressure" and c.phase == phase), None)
    if command is None:
        return f"no pressure is commanded in the phase {phase}"
    before = samples.ok & (samples.t < command.t - 1e-9)
    after = samples.ok & (samples.t >= command.t - 1e-9)
    last = after & (samples.t > samples.t[-1] - SETTLED * (samples.t[-1] - command.t))
    if before.sum() < 8 or last.sum() < 8:
        return "too few usable samples before the step or at its end"
    origin, end = float(np.mean(samples.x[before])), float(np.mean(samples.x[last]))
    stroke = way * (end - origin)
    if stroke < LEAST_STROKE:
        return f"too little motion: {1e3 * stroke:.3g} mm"
    gone = way * (samples.x - origin)
    begun = onset(samples.t[samples.ok], gone[samples.ok], command.t, LEAST["displacement"])
    rows = np.flatnonzero(after)
    beyond = np.flatnonzero(gone[rows] >= SHARE * stroke)
    if begun is None or not len(beyond) or beyond[0] == 0:
        return "the first motion, or 63.2 % of the stroke, is not seen"
    left, right = rows[beyond[0] - 1], rows[beyond[0]]
    reached = float(np.interp(SHARE * stroke, gone[[left, right]], samples.t[[left, right]]))
    half = np.flatnonzero(last)
    middle = len(half) // 2
    creep = 2 * way * float(np.mean(samples.x[half[middle:]]) - np.mean(samples.x[half[:middle]]))
    held = float(np.mean(samples.P[last if way > 0 else before]))
    t_d, tau = begun - command.t, reached - begun
    return Step(samples.trial, way, max(high, start), held, samples.load, stroke, t_d, tau, creep / stroke)


MODEL = "closed form of paper 1"
METRIC = "100 (1 - |x_s - x_e| / x_e)"
WORDS = {1: "contracting", -1: "relaxing"}


def at_rest(braid: Braid, P: float, S: float, load: float, at: str) -> float:
    """x_max [m] where F_ce = L + S x: F_ce at x = 0 (`x0`) or at that x (`xmax`), not below 0."""
    if float(braid.force(P, 0.0)) <= load:
        return 0.0
    if at == "x0":
        return (float(braid.force(P, 0.0)) - load) / S
    return float(brentq(lambda x: float(braid.force(P, x)) - load - S * x, 0.0, braid.nominal_length, xtol=1e-12))


def compare(
    campaign: Campaign, steps: Sequence[Step], curves: Sequence[Curve], stiff: Sequence[Estimate], braid: Braid, at: str
) -> tuple[list[Estimate], list[Finding], list[Trace]]:
    """Model x_max (1 - e^(-t/tau)) and x_max e^(-t/tau_r) with the polynomials of one method, compared with each step.

    `stiff` are that method's K; accuracies are of contractions alone, since a relaxation ends at 0.
    """
    found, traces = list[Estimate](), list[Trace]()
    method = stiff[0].method if stiff else ""
    of = {c.symbol: c for c in curves if c.method == method}  # the last of each symbol is its polynomial
    if "K" not in of:
        return [], [], []
    rms: dict[int, list[float]] = {1: [], -1: []}
    for way, symbol in ((1, "B_c"), (-1, "B_r")):
        members = [step for step in steps if step.way == way]
        if symbol not in of or not members:
            continue
        dead = float(np.mean([step.t_d for step in members]))
        low, high = (pick(of["K"].domain[i], of[symbol].domain[i]) for i, pick in enumerate((max, min)))
        for P in sorted({step.pressure for step in members if low <= step.pressure <= high}):
            group = [step for step in members if step.pressure == P]
            S, D = (float(of[name].values(np.array(P))) for name in ("K", symbol))
            misfits = []
            for step in group:
                model = _closed_form(campaign, step, at_rest(braid, P, S, step.load, at), D / S, dead)
                samples, direction = campaign.samples[step.trial], "to" if way > 0 else "from"
                misfits.append(sqrt(float(np.mean((model - samples.x)[samples.ok] ** 2))))
                name = f"step-{direction}-{P / 1e3:.0f}kPa-{step.trial}"
                title = f"{direction} {show(P, 'pressure', 4)}: measured and closed form"
                columns = (samples.t, samples.P, samples.x, model)
                traces.append(overlay(name, "step-overlay", title, columns, P, step.load))
            rms[way] += misfits
            measure, mean = "rms over the whole trial, rest before the step included", float(np.mean(misfits))
            found.append(_of_model(campaign, "misfit", group, mean, measure, ("m", "length"), WORDS[way]))
    ups = [step for step in steps if step.way > 0]
    fitted, left_out = _accuracies(campaign, ups, of["K"], stiff, braid, at)
    return [*found, *fitted, *left_out], _findings(rms, fitted, left_out, method), traces


def _accuracies(
    campaign: Campaign, steps: Sequence[Step], K: Curve, stiff: Sequence[Estimate], braid: Braid, at: str
) -> tuple[list[Estimate], list[Estimate]]:
    """Accuracy at rest as in paper 1, 1 - |x_s - x_e| / x_e: of the fit, and at each inner pressure by a fit without
    it.
    """
    fitted: list[Estimate] = []
    left_out: list[Estimate] = []
    for e in stiff:
        P = e.at["pressure"]
        group = [step for step in steps if step.pressure == P]
        rest = [other for other in stiff if other.at["pressure"] != P]
        without = curve(rest, len(K.terms) - 1, normalised=K.normalised)
        for through, found, coordinate, note in (
            (K, fitted, "", f"{METRIC}; the model was fitted to these trials"),
            (without, left_out, "left out", f"{METRIC}; the model was fitted without this pressure"),
        ):
            if through is None or not through.domain[0] <= P <= through.domain[1]:
                continue
            S = float(through.values(np.array(P)))
            if S > 0:
                shares = [1 - abs(at_rest(braid, P, S, s.load, at) - s.stroke) / s.stroke for s in group]
                value = float(np.mean(shares))
                found.append(_of_model(campaign, "accuracy", group, value, note, ("1", "ratio"), coordinate))
    return fitted, left_out


def _of_model(
    campaign: Campaign, symbol: str, group: Sequence[Step], value: float, note: str, unit: tuple[str, str], way: str
) -> Estimate:
    names, at = tuple(campaign.name(step.trial) for step in group), {"pressure": group[0].pressure}
    return Estimate(symbol, value, *unit, MODEL, at, n=len(group), note=note, trials=names, coordinate=way)


def _closed_form(campaign: Campaign, step: Step, x_s: float, tau: float, dead: float) -> Array:
    """Modelled contraction of a trial [m] at all its samples."""
    t, trial = campaign.samples[step.trial].t, campaign.trials[step.trial]
    command = next(c.t for c in trial.commands if c.output == "pressure" and c.t >= t[0] - 1e-9)
    fade = np.exp(-np.maximum(t - command - dead, 0.0) / tau)
    return np.asarray(x_s * (1 - fade) if step.way > 0 else x_s * fade)


def _findings(
    rms: dict[int, list[float]], fitted: Sequence[Estimate], left_out: Sequence[Estimate], method: str
) -> list[Finding]:
    lines = []
    if fitted:
        text = f"closed form with the polynomials by {method} against the test at rest: accuracy {_ends(fitted)}"
        if left_out:
            text += f"; with each inner pressure left out of the fit {_ends(left_out)}"
        lines.append(Finding("note", text))
    for way, values in rms.items():
        if values:
            low, high = (show(end, "length", 3) for end in (min(values), max(values)))
            lines.append(Finding("note", f"residual of the closed form over time, {WORDS[way]}: {low} to {high} rms"))
    return lines


def _ends(accuracies: Sequence[Estimate]) -> str:
    worst = min(accuracies, key=lambda e: e.value or 0.0)
    best = max(e.value or 0.0 for e in accuracies)
    return f"{100 * (worst.value or 0.0):.2f} ({show(worst.at['pressure'], 'pressure', 4)}) to {100 * best:.2f} %"


CLOSED_FORM = "closed form of single steps with the polynomials of the first method, from the mean dead time on"


def step_overlays(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """Overlays of steps up and steps down in separate figures, since their damping differs."""
    ways = [[t for t in traces if t.name.startswith(f"step-{way}-")] for way in ("to", "from")]
    titles = ("Contraction, measured and closed form", "Relaxation, measured and closed form")
    return [p for mine, title in zip(ways, titles, strict=True) for p in overlays(mine, analysis, CLOSED_FORM, title)]
