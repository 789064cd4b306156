"""Paper 1's closed form against the test it was fitted to: accuracy at rest, residual over time, overlays, figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt

import numpy as np
from scipy.optimize import brentq

from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.curves import curve
from pmabench.kinds.contraction_relaxation.paper1_steps import Braid, Step
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.plotting.motion import overlays
from pmabench.plotting.pictures import Picture
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Trace
from pmabench.store.records import Array

MODEL = "closed form of paper 1"
METRIC = "100 (1 - |x_s - x_e| / x_e)"
LONGEST_TRACE = 1500
WORDS = {1: "contracting", -1: "relaxing"}


@dataclass
class Compared:
    """What the model says of each step."""

    estimates: list[Estimate] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    traces: list[Trace] = field(default_factory=list)


def at_rest(braid: Braid, P: float, S: float, load: float, at: str) -> float:
    """x_max [m] where F_ce = L + S x: F_ce at x = 0 (`x0`) or at that x (`xmax`), not below 0."""
    if float(braid.force(P, 0.0)) <= load:
        return 0.0
    if at == "x0":
        return (float(braid.force(P, 0.0)) - load) / S
    return float(brentq(lambda x: float(braid.force(P, x)) - load - S * x, 0.0, braid.nominal_length, xtol=1e-12))


def compare(
    campaign: Campaign, steps: Sequence[Step], curves: Sequence[Curve], stiff: Sequence[Estimate], braid: Braid, at: str
) -> Compared:
    """Model x_max (1 - e^(-t/tau)) and x_max e^(-t/tau_r) with the polynomials of one method, compared with each step.

    `stiff` are that method's K; accuracies are of contractions alone, since a relaxation ends at 0.
    """
    found = Compared()
    method = stiff[0].method if stiff else ""
    of = {c.symbol: c for c in curves if c.method == method}  # the last of each symbol is its polynomial
    if "K" not in of:
        return found
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
                trace = _overlay(campaign, step, at_rest(braid, P, S, step.load, at), D / S, dead)
                found.traces.append(_thinned(trace))
                ok = campaign.samples[step.trial].ok
                gap = (trace.columns["model"] - trace.columns["displacement"])[ok]
                misfits.append(sqrt(float(np.mean(gap**2))))
            rms[way] += misfits
            measure = "rms over the whole trial, rest before the step included"
            found.estimates.append(
                _estimate(campaign, "misfit", group, float(np.mean(misfits)), measure, ("m", "length"), WORDS[way])
            )
    ups = [step for step in steps if step.way > 0]
    fitted, left_out = _accuracies(campaign, ups, of["K"], stiff, braid, at)
    found.estimates += [*fitted, *left_out]
    found.findings += _findings(rms, fitted, left_out, method)
    return found


def _accuracies(
    campaign: Campaign, steps: Sequence[Step], K: Curve, stiff: Sequence[Estimate], braid: Braid, at: str
) -> tuple[list[Estimate], list[Estimate]]:
    """Accuracy at rest as paper 1, 1 - |x_s - x_e| / x_e: of the fit, and with each inner pressure left out of it."""
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
                found.append(_estimate(campaign, "accuracy", group, value, note, ("1", "ratio"), coordinate))
    return fitted, left_out


def _estimate(
    campaign: Campaign,
    symbol: str,
    group: Sequence[Step],
    value: float,
    note: str,
    unit: tuple[str, str],
    coordinate: str,
) -> Estimate:
    return Estimate(
        symbol,
        value,
        *unit,
        MODEL,
        {"pressure": group[0].pressure},
        n=len(group),
        note=note,
        trials=tuple(campaign.name(step.trial) for step in group),
        coordinate=coordinate,
    )


def _overlay(campaign: Campaign, step: Step, x_s: float, tau: float, dead: float) -> Trace:
    """Measured and modelled contraction of a trial, all samples."""
    samples, trial = campaign.samples[step.trial], campaign.trials[step.trial]
    command = next(c.t for c in trial.commands if c.output == "pressure" and c.t >= samples.t[0] - 1e-9)
    fade = np.exp(-np.maximum(samples.t - command - dead, 0.0) / tau)
    model = x_s * (1 - fade) if step.way > 0 else x_s * fade
    change = (
        f"to {show(step.pressure, 'pressure', 4)}" if step.way > 0 else f"from {show(step.pressure, 'pressure', 4)}"
    )
    return Trace(
        name=f"step-{'to' if step.way > 0 else 'from'}-{step.pressure / 1e3:.0f}kPa-{step.trial}",
        figure="step-overlay",
        title=f"{change}: measured and closed form",
        columns={"t": samples.t - samples.t[0], "pressure": samples.P, "displacement": samples.x, "model": model},
        quantities={"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"},
        marks={"pressure": step.pressure, "load": step.load},
    )


def _thinned(trace: Trace) -> Trace:
    stride = -(-len(trace.columns["t"]) // LONGEST_TRACE)
    columns: dict[str, Array] = {name: values[::stride] for name, values in trace.columns.items()}
    return Trace(trace.name, trace.figure, trace.title, columns, trace.quantities, trace.marks)


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
    """Steps up and steps down apart: each has its own damping."""
    ways = [[t for t in traces if t.name.startswith(f"step-{way}-")] for way in ("to", "from")]
    titles = ("Contraction, measured and closed form", "Relaxation, measured and closed form")
    return [p for mine, title in zip(ways, titles, strict=True) for p in overlays(mine, analysis, CLOSED_FORM, title)]
