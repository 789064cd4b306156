"""Single steps as in paper 1: stroke, time constant, stiffness from the braid; K and B_c with F_ce known.

With one load F_ce and K x cannot be separated: every solution of F_L = F_ce - K x - B x' can be scaled. So F_ce is
given, and K and B are fitted to all contractions at once as in `pooled`. Uses samples and geometry; no intervals.

Also paper 1's closed form compared with the tests it was fitted to: accuracy at rest, residual over time, overlays,
figure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import exp, sqrt
from typing import Any

import numpy as np
from scipy.optimize import brentq

from pmabench.analysis.shared.samples import LEAST, Samples, onset
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.checks import overlay
from pmabench.kinds.contraction_relaxation.pooled import FLOOR, SYMBOLS, design_of, first_knots, least_squares, prior_of
from pmabench.kinds.contraction_relaxation.segments import Campaign, Gate, cut
from pmabench.kinds.contraction_relaxation.values import FEWEST, curve, near
from pmabench.model.library.braid import braid_force
from pmabench.plotting.motion import overlays
from pmabench.plotting.pictures import Picture
from pmabench.store.analyses.results import Analysis, Curve, Estimate, Finding, Trace
from pmabench.store.records import Array, TrialData


def fit_known_force(
    samples: Sequence[Samples], rate: float, tested: Array, force: Callable[[Array], Array]
) -> dict[float, tuple[float, float]]:
    """K [N/m] and B_c [N.s/m] at those tested pressures [Pa] near which samples move, from contractions alone.

    `force` gives F_ce [N] at pressures [Pa]. Friction, which has one direction here, acts like a smaller F_ce and is
    not separated.
    """
    knots = first_knots(tested, np.empty(0))
    segments = cut(samples, rate, Gate()).within(knots)
    segments = segments.where(segments.way > 0)
    if len(segments) < FEWEST:
        return {}
    design = design_of(segments, knots)
    k = len(knots)
    wanted = slice(SYMBOLS.index("K") * k, (SYMBOLS.index("B_c") + 1) * k)
    known = force(segments.P) @ segments.weights
    noise = FLOOR * float(np.sqrt(np.mean(known**2)))
    prior = prior_of(segments, knots, noise)
    rows = prior[np.any(prior[:, wanted] != 0, axis=1)][:, wanted]
    theta = least_squares(design[:, wanted], segments.force - known, rows)
    found = {}
    for P in tested:
        knot = int(np.argmin(np.abs(knots - P)))
        if near(segments, knots, "K", float(P)).sum() >= FEWEST:
            found[float(P)] = float(theta[knot]), float(theta[k + knot])
    return found


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
            found.append(_estimate(campaign, "misfit", group, mean, measure, ("m", "length"), WORDS[way]))
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
                found.append(_estimate(campaign, "accuracy", group, value, note, ("1", "ratio"), coordinate))
    return fitted, left_out


def _estimate(
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
