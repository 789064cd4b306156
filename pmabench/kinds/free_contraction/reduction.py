"""Reduction of free contraction: length over pressure, sigmoid a to e fitted to it, compared with paper 2's formula.

Uses the samples at rest of each trial; sentences and figure are in `figures`. Also the values of one trial, for the
display.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import hypot
from typing import Any

import numpy as np

from pmabench.analysis.model_fit import ModelFit, fit_model
from pmabench.analysis.model_problem import Problem
from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.samples import OF_TWO, STEPS, NotUsable, left
from pmabench.analysis.shared.trials import session_of
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.analysis.verdict.agreement import Offer, Place, between
from pmabench.base.quantities import show
from pmabench.kinds.free_contraction import RESULTS, figures
from pmabench.kinds.free_contraction.points import (
    CHANNELS,
    CLEAR,
    UNEQUAL,
    Level,
    Point,
    Shape,
    curve_of,
    highest,
    measure,
    one_way,
    points_of,
    sigmoid,
    through,
    zero_of,
    zeroed,
)
from pmabench.model.library import MODELS
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, withhold
from pmabench.store.records import Array, RunData, TrialData

KIND = "free-contraction"
FREE, SIGMOID = "free-length", "sigmoid"
FORM = "sigmoid-length-coefficients"
"""Model of the library, with fitted coefficients."""
UNKNOWN = ("a", "b", "c", "d", "e")
UNITS = {"length": "m", "pressure": "Pa", "count": "1", "ratio": "1"}
RESIDUALS = "repeats part: residuals of the fit; no method part: that of L is not carried into the coefficients"
MOTION, ZERO, NOISE = "motion after the hold", "contraction left without pressure", "noise of pressures near 0"
PRESSURE, DAYS = "zero of the pressure", "zeros from session to session"
ONE_WAY = "friction where both sides came from one"
PART = {ZERO: "drift", PRESSURE: "calibration"}
FLOOR = 5e-4
"""Smallest error of a length, as a share of the largest contraction."""
NEAR = 0.5
"""Distance from the knee within which a tested pressure must lie, as a share of the knee's pressure."""
FURTHEST = 3.0
"""Largest distance of a length from the sigmoid, in its errors."""
PRESSED = 1e3
"""Pressure difference for the slope of the sigmoid [Pa]."""
STEEPER = 1.4
"""Factor on the first-order effect of a scale on a to e, since the curve is steep where it starts."""
OPEN = 1.2
"""Factor on the uncertain zero of a pressure."""
OF_NOISE = 3.0
"""Standard deviations of its noise by which the lowest pressure may exceed the declared uncertainty."""
ROUNDS = 4
"""Most fits; each uses the corrections to the pressures of single trials from the one before ..."""
SETTLED = 1e-7
"""... until that changes no length by more than this [m]."""
BENT = 0.5
"""Effect of pressure noise, in standard deviations of a contraction, below which no separate fit is made."""
BETWEEN = 0.25
"""Possible error of a curve through points between two pressures, as a share of their difference."""
MOST_LEFT = 0.5
"""Residual of the sigmoid, as a share of the scatter of the lengths, from which no sigmoid is near them."""
NONE_NEAR = "no fit: no sigmoid comes near these lengths"
FINE = 2001
"""Points of a curve on which a pressure is looked up."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """L [m] at each pressure [Pa], a, b [m], c [Pa], d, e [1] of paper 2's eq. 1, pressure of half the contraction, and
    the largest contraction.

    L = L0 - x: nominal length minus contraction at rest, the mean of both sides from which it was reached; their
    difference is hysteresis. `options`: `nominal_length` [m], `compare` (`paper-2` or `nothing`), in place of the
    plan's.
    """
    settings = {**(runs[0].plan.get("settings") or {} if runs else {}), **(options or {})}
    length, compare = float(settings.get("nominal_length", np.nan)), settings.get("compare") == "paper-2"
    points, dropped = points_of(runs)
    scales = Scales.of(runs)
    points, fit, why, zero, said = _with_zero(points, length, scales)
    zeros = np.empty((0, len(points))) if fit is None else _zeros(points, fit, scales)
    other = "" if fit is None else _other_form(points, fit, zeros) or _unseen(points, fit)
    fits = fit is not None and fit.converged and not other
    shape = through(points, fit if fit is not None and fit.converged else None)
    shifted = {} if fit is None or other else _shifted(points, length, shape, zero)
    levels = [Level.of(point, shape, OPEN * abs(zero), fits=fits) for point in points]
    points = [level.point for level in levels]
    estimates = _weighed(_lengths(levels, length, scales), points, length)
    estimates += _coefficients(fit, why, other, shifted, points, length, scales, zeros)
    findings = [
        *figures.of_points(points),
        *said,
        *(figures.of_fit(fit, why, other) if points else []),
        *(figures.of_paper(points, length) if points and compare else []),
    ]
    findings += scales.findings(estimates, CHANNELS)
    traces = [figures.trace(points, fit, length, compare=compare)] if points else []
    facts = {
        "options": dict(options or {}),
        "nominal_length": length,
        "measured": [point.pressure for point in points],
        "trials": sum(len(point.rests) for point in points),
        "pressures": len(points),
        "residual_rms": None if fit is None else fit.residual_rms,
    }
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates, dropped=dropped, findings=findings, traces=traces, facts=facts
    )


def _lengths(levels: Sequence[Level], length: float, scales: Scales) -> list[Estimate]:
    """L at each pressure, then the difference of both sides, and the largest contraction as a share of the length."""
    lengths, gaps = [], []
    for level in levels:
        point, at, n = level.there, {"pressure": level.point.set}, len(level.there.repeats)
        slope = level.rise(scales.offsets.get("pressure", PRESSED))
        rises = {"displacement": point.x, "pressure": slope * level.point.pressure}
        scale = scales.part(rises, {"displacement": 1.0, "pressure": slope})
        parts = Parts(spread(point.repeats), level.method, scale)
        lengths.append(_free("L", length - point.x, "length", at, parts, n, [point]))
        if len(point.gaps):
            value = float(point.gaps.mean())
            parts = Parts(spread(point.gaps), level.apart, scales.part({"displacement": value}))
            gaps.append(_free("x_H", value, "length", at, parts, len(point.gaps), [point]))
    found = [*lengths, *gaps, *([_half(levels, scales)] if len(levels) > 2 else [])]
    if not levels or not 0 < length < np.inf:
        return found
    # relative to the nominal length, which is taken as exact
    top, e = max(zip(levels, lengths, strict=True), key=lambda one: one[0].there.x)
    largest = replace(e, symbol="eps_max", value=top.there.x / length, unit="1", quantity="ratio")
    return [*found, replace(largest, parts=e.parts.times(1 / length))]


def _free(
    symbol: str, value: float, quantity: str, at: Mapping[str, float], parts: Parts, n: int, points: Sequence[Point]
) -> Estimate:
    """An estimate from the lengths at these points."""
    names = tuple(rest.trial.name for point in points for rest in point.rests)
    note = "" if parts.repeats is not None else "no repeats part: one repeat only"
    return Estimate(symbol, value, UNITS[quantity], quantity, FREE, at, parts, n, note=note, trials=names)


def _half(levels: Sequence[Level], scales: Scales) -> Estimate:
    """The pressure at which half of the contraction at the highest pressure is reached."""
    points = [level.there for level in levels]
    P, x = np.array([point.set for point in points]), np.array([point.x for point in points])
    value, n = figures.half_pressure(P, x), min(len(point.repeats) for point in points)
    if value is None:
        note = "the contraction does not rise through half of its largest value once"
        return replace(_free("P_half", 0.0, "pressure", {}, Parts(), n, points), value=None, note=note)
    each = [figures.half_pressure(P, np.array([point.repeats[i] for point in points])) for i in range(n)]
    half, coarse = spread([one for one in each if one is not None]), float(np.diff(P).max()) / 2
    fine = np.linspace(P[0], P[-1], FINE)
    other = figures.half_pressure(fine, levels[0].shape(fine) - levels[0].shape(np.zeros(1)))
    after = int(np.argmax(x >= 0.5 * x[-1]))
    between = 0.0 if levels[0].fits else BETWEEN * float(P[after] - P[after - 1])
    off = hypot(0.1 * coarse, between, value - (value if other is None else other), levels[0].zero)
    parts = Parts(half, off, scales.part({"pressure": value}, {"pressure": 1.0}))
    return _free("P_half", value, "pressure", {}, parts, n, points)


def _fit(
    points: Sequence[Point], length: float, off: Array | float = 0.0, *, profiles: bool = False
) -> tuple[ModelFit | None, str]:
    """The sigmoid a to e fitted to the mean lengths, with `off` (n,) [m] added to x; or the reason why it cannot be
    fitted.

    Trials are moved to their mean pressure along the sigmoid itself (`Point.at`), and the fit is repeated. With
    `profiles`, intervals are profile intervals.
    """
    model = MODELS[FORM]
    P, x = curve_of(points)
    if len(points) <= len(UNKNOWN):
        return None, f"no fit: {len(points)} pressures for {len(UNKNOWN)} coefficients"
    if not np.isfinite(x).all() or not 0 < length <= 2:
        return None, "no fit: the plan gives no nominal length"
    most = highest(model)
    if P.max() > most:
        return None, f"no fit: the sigmoid holds up to {show(most, 'pressure')}"
    fixed = {p.name: p.value for p in model.parameters if p.name not in ("pressure", *UNKNOWN)}
    fixed["nominal_length"] = length
    start = {"a": 0.7 * length, "b": 0.3 * length}
    through = partial(fit_model, model, "length", {"pressure": np.maximum(P, 0.0)}, fixed, unknown=UNKNOWN)
    for number in range(ROUNDS):
        try:
            fit, fitted = through(length - x - off, start=start, profiles=False, elsewhere=number == 0), x
        except ValueError:
            return None, NONE_NEAR
        if not fit.residual_rms <= MOST_LEFT * np.std(x):
            return None, NONE_NEAR
        start, shape = fit.values, sigmoid(fit)
        x = np.array([point.at(point.pressure, shape).x for point in points])
        if np.abs(x - fitted).max() < SETTLED:
            break
    return through(length - fitted - off, start=start) if profiles else fit, ""


def _weighed(estimates: Sequence[Estimate], points: Sequence[Point], length: float) -> list[Estimate]:
    """The values, widened or withheld for motion after the holds and contraction remaining without pressure."""
    if not points:
        return []
    largest = max(abs(point.x) for point in points)
    moving, leaving = max(abs(point.left.size) for point in points), max(point.off for point in points)
    rests = f"the length is not at rest: it would still change by {show(moving, 'length', 2)} after the hold"
    rests += f" (it contracts by {show(largest, 'length', 3)}). Hold longer"
    zero = (
        f"{show(leaving, 'length', 2)} of contraction are left without pressure, and L counts from the nominal length:"
    )
    zero += " a zero or a mount that moved, or creep. Look for the cause, rest longer, and measure again"
    by_set = {point.set: point for point in points}
    friction = max((float(np.max(np.abs(point.gaps))) for point in points if len(point.gaps)), default=0.0)
    # at 0 kPa friction holds back half the gap, and L counts from the mean of both directions, which is free of it
    steepest, back = max(points, key=lambda point: point.x), one_way(points)
    found = []
    for e in estimates:
        point = by_set.get(e.at.get("pressure", steepest.set), steepest)
        share = {"eps_max": 1 / length, "P_half": 0.5 * _pressure_over_x(points)}.get(e.symbol, 1.0)
        still, off = point.left, max(one.off for one in points) if e.symbol == "P_half" else point.off
        if e.symbol == "x_H":
            still, off = point.apart, float(np.ptp([rest.start for rest in point.rests]))
        noise = max(rest.noise for rest in point.rests)
        coarse = OF_TWO * point.coarse  # contractions, and their zero, are read in the same steps
        doubts = [
            Doubt(STEPS, "method", share * coarse, seen=False),
            Doubt(MOTION, "method", share * still.most, still.seen, rests),
            Doubt(ZERO, "drift", share * off, off > max(CLEAR * noise, friction), zero),
        ]
        short = abs(float(back[points.index(point)])) * (2 if e.symbol == "x_H" else 1)
        doubts.append(Doubt(ONE_WAY, "method", short * share, seen=True))
        found.append(weighed(e, doubts, None if e.symbol == "P_half" else largest * share))
    return found


def _pressure_over_x(points: Sequence[Point]) -> float:
    """dP/dx where half of the largest contraction is reached [Pa/m]."""
    P, x = curve_of(points)
    after = int(np.clip(np.argmax(x >= 0.5 * x[-1]), 1, len(x) - 1))
    return abs(float((P[after] - P[after - 1]) / max(abs(x[after] - x[after - 1]), 1e-9)))


def _zeros(points: Sequence[Point], fit: ModelFit, scales: Scales) -> Array:
    """Change of the lengths by the zero of each channel in one session after the other, at its uncertainty [m], shape
    (m, n); none for one session, whose zeros are in all lengths alike.
    """
    sessions = [[session_of(rest.run) for rest in point.rests] for point in points]
    names = sorted({name for mine in sessions for name in mine})
    share = np.array([[mine.count(name) / len(mine) for mine in sessions] for name in names if len(names) > 1])
    by = _by_offset(fit, _leverage(fit)[1])
    each = [share.reshape(-1, len(points)) * scales.offsets.get(channel, 0.0) * by[channel] for channel in by]
    return np.concatenate(each)


def _by_offset(fit: ModelFit, computed: Shape) -> dict[str, Array]:
    """Derivative of each length by the offset of each channel, shape (n,)."""
    P = fit.columns["pressure"]
    below, above = np.maximum(P - PRESSED, 0.0), np.minimum(P + PRESSED, highest(fit.model))
    return {"pressure": -(computed(above) - computed(below)) / (above - below), "displacement": -np.ones_like(P)}


def _other_form(points: Sequence[Point], fit: ModelFit, zeros: Array) -> str:
    """Reason why the sigmoid is not the form of these lengths, with numbers; empty where it may be.

    A length may be off by three times its error: the pooled scatter of repeats, at least `FLOOR` of the largest
    contraction, and zeros that differ between sessions (`_zeros`).
    """
    freedom = sum(len(point.repeats) - 1 for point in points)
    squares = sum(float(np.sum((point.repeats - point.x) ** 2)) for point in points)
    scatter = np.sqrt(squares / max(1, freedom) / np.array([len(point.repeats) for point in points]))
    error = np.hypot(np.hypot(scatter, FLOOR * max(abs(point.x) for point in points)), [p.coarse for p in points])
    leverage = _leverage(fit)[0]
    apart = zeros - zeros @ (np.linalg.pinv(leverage) @ leverage).T  # what the fit to the moved lengths leaves
    error = np.hypot(error, 0.5 * np.linalg.norm(apart, axis=0))
    off = np.abs(fit.computed - fit.measured)
    if not error.all():
        return ""  # nothing contracted
    worst = int(np.argmax(off / error))
    if off[worst] <= FURTHEST * error[worst]:
        return ""
    where, most = show(points[worst].set, "pressure"), show(float(FURTHEST * error[worst]), "length", 2)
    text = f"the length at {where} is {show(float(off[worst]), 'length', 2)} off the sigmoid"
    return f"{text}, at most {most} is expected: length over pressure has another form here. Use the lengths themselves"


def _unseen(points: Sequence[Point], fit: ModelFit) -> str:
    """Reason why the knee of the sigmoid is not determined, with numbers; empty where a tested pressure is near it."""
    knee = fit.values["c"]
    if any(abs(point.pressure - knee) <= NEAR * knee for point in points):
        return ""
    ends = f"between {show((1 - NEAR) * knee, 'pressure', 2)} and {show((1 + NEAR) * knee, 'pressure', 2)}"
    text = f"no pressure is near the knee of the sigmoid, at about {show(knee, 'pressure', 2)}: what lies between the"
    return f"{text} lengths is not seen. Measure {ends} too"


def _with_zero(
    points: list[Point], length: float, scales: Scales
) -> tuple[list[Point], ModelFit | None, str, float, list[Finding]]:
    """The points with corrected pressure zero, the sigmoid or why there is none, and the remaining uncertainty of the
    zero [Pa].

    The lowest reading at set-point 0 is a zero error of the sensor, or the pressure of a regulator that does not vent.
    Beyond a declared uncertainty it is taken as a pressure; else, if negative, as the zero. Otherwise the fit decides;
    where it cannot, a declared uncertainty covers it, and without one the zero is left uncertain.
    """
    fit, why = _fit(points, length, profiles=True)
    zero, declared = zero_of(points), scales.offsets.get("pressure", 0.0)
    if not zero or 0 < declared < abs(zero) - OF_NOISE * max(rest.pressure_noise for rest in points[0].rests):
        return points, fit, why, 0.0, []
    other = zeroed(points, zero)
    again, why_again = _fit(other, length, profiles=True)
    read = f"at set-point 0 the pressure reads {show(zero, 'pressure', 2)}"
    squares = [np.inf if one is None or not one.converged else one.residual_rms**2 for one in (fit, again)]
    freedom = 0 if again is None else again.freedom
    limit = 1 + float(student.ppf(0.975, freedom)) ** 2 / freedom if freedom > 0 else np.inf
    if zero < 0 or squares[0] > limit * squares[1]:
        text = f"{read}: taken as the zero of its sensor, and off all pressures; the lengths agree with that"
        return other, again, why_again, 2 * points[0].pressure_noise, [Finding("note", text)]
    if declared or squares[1] > limit * squares[0]:
        return points, fit, why, 0.0, []
    text = f"{read}: the zero of its sensor, or a regulator that does not vent. The lengths do not say which, and the"
    text += " intervals hold both. Declare the expanded uncertainty of the pressure, or vent the muscle"
    return points, fit, why, zero, [Finding("doubt", text)]


def _shifted(points: Sequence[Point], length: float, shape: Shape, zero: float) -> dict[str, ModelFit]:
    """The sigmoid fitted to the points with one error source removed, for each one that is significant.

    Contraction remaining without pressure; motion after the hold; noise of the pressure where the curve is bent;
    friction where both sides came from one direction; another zero of the pressure.
    """
    starts = np.array([np.mean([rest.start for rest in point.rests]) for point in points])
    noise = max(rest.noise for point in points for rest in point.rests)
    ways = {ZERO: -starts} if np.abs(starts).max() > CLEAR * noise else {}
    if any(point.left.seen for point in points):
        ways[MOTION] = np.array([point.left.size for point in points])
    bent = np.array([point.bent(shape) for point in points])
    if bent.max() > BENT * noise:
        ways[NOISE] = bent
    if (short := one_way(points)).any():
        ways[ONE_WAY] = short
    fits = {name: _fit(points, length, off)[0] for name, off in ways.items()}
    if zero:
        fits[PRESSURE] = _fit(zeroed(points, zero), length)[0]
    return {name: fit for name, fit in fits.items() if fit is not None and fit.converged}


def _leverage(fit: ModelFit) -> tuple[Array, Shape]:
    """Derivative of a to e by each length, shape (5, n), and the function of the fitted length over pressure."""

    def computed(P: Array) -> Array:
        return np.asarray(fit.model.evaluate({**fit.fixed, "pressure": P, **fit.values})["length"])

    inputs = {**fit.fixed, "pressure": fit.columns["pressure"]}
    problem = Problem(fit.model, "length", tuple(fit.values), inputs, None)
    slopes = problem.slopes(np.array(list(fit.values.values()))).T
    size = np.linalg.norm(slopes, axis=1)
    size = np.where(size > 0, size, 1.0)
    return np.linalg.pinv((slopes / size[:, None]).T) / size[:, None], computed


def _errors(fit: ModelFit, points: Sequence[Point], length: float) -> tuple[dict[str, dict[str, Array]], Array, Array]:
    """Effects on a to e, shape (5,) each: scales of the channels, scatter, and the steps of the displacement.

    Scales: by a relative change (`gain`) or an offset of 1 [SI] of each channel. Scatter: half widths from the repeats
    and the noise of the pressure at each length, which grow with the contraction; a coefficient that depends on few
    lengths does not have the mean error of all residuals. Steps: half widths.
    """
    leverage, computed = _leverage(fit)
    P, x = fit.columns["pressure"], length - fit.measured
    offset = _by_offset(fit, computed)
    moved = {"gain": {"pressure": offset["pressure"] * P, "displacement": -x}, "offset": offset}
    scaled = {kind: {c: STEEPER * leverage @ by for c, by in each.items()} for kind, each in moved.items()}
    stepped = np.linalg.norm(leverage * [point.coarse for point in points], axis=1)
    freedom = sum(len(point.repeats) - 1 for point in points)
    if not freedom:
        return scaled, np.zeros(len(UNKNOWN)), stepped
    noise = np.array([point.pressure_noise for point in points])
    by_noise = computed(P) - computed(np.maximum(P - noise, 0.0))
    errors = [np.std(p.repeats, ddof=1) / np.sqrt(len(p.repeats)) if len(p.repeats) > 1 else 0.0 for p in points]
    scattered = student.ppf(0.975, freedom) * np.sqrt(leverage**2 @ (np.square(errors) + by_noise**2))
    return scaled, scattered, stepped


def _coefficients(
    fit: ModelFit | None, why: str, other: str, shifted: Mapping[str, ModelFit], points: Sequence[Point],
    length: float, scales: Scales, zeros: Array,
) -> list[Estimate]:  # fmt: skip
    """The coefficients a to e; not identifiable ones without an interval; withheld for the reason `other` if given.

    The interval includes the differences to those of `shifted` and the effects of `_errors`.
    """
    quantities = {p.name: p.quantity for p in MODELS[FORM].parameters}
    none = np.zeros(len(UNKNOWN))
    scaled, scattered, stepped = ({}, none, none) if fit is None else _errors(fit, points, length)
    of_days = none if fit is None else STEEPER * np.linalg.norm(_leverage(fit)[0] @ zeros.T, axis=1)
    found = []
    for place, name in enumerate(UNKNOWN):
        quantity = quantities[name]
        value, half, note = (None, None, why) if fit is None else fit.identified(name, UNITS[quantity])
        by = {kind: {c: float(change[place]) for c, change in each.items()} for kind, each in scaled.items()}
        half = None if half is None else max(half, float(scattered[place]))
        parts = Parts(repeats=half, calibration=scales.part(by["gain"], by["offset"]) if by else None)
        n = 0 if fit is None else len(fit.measured)
        note = sentences(note, RESIDUALS if half is not None else "")
        e = Estimate("L", value, UNITS[quantity], quantity, SIGMOID, {}, parts, n, note=note, coordinate=name)
        doubts = [
            Doubt(way, PART.get(way, "method"), abs(one.values[name] - (value or 0.0)), seen=True)
            for way, one in shifted.items()
        ]
        doubts.append(Doubt(STEPS, "method", float(stepped[place]), seen=False))
        doubts.append(Doubt(DAYS, "calibration", float(of_days[place]), seen=False))
        found.append(withhold(e, other) if other and value is not None else weighed(e, doubts))
    return found


def offers(analysis: Analysis) -> Iterator[Offer]:
    """x, the contraction without load, at the measured pressures and between them.

    If it was reached from both sides, friction cancels in their mean once both have moved; a muscle whose contraction
    is below the effect of friction still rests at its start.
    """
    by = {symbol: [e for e in analysis.estimates if (e.symbol, e.method) == (symbol, FREE)] for symbol in ("L", "x_H")}
    length, widths = analysis.facts.get("nominal_length"), [abs(e.value or 0.0) for e in by["x_H"]]
    widest = max(widths, default=0.0)
    known = [
        (
            P,
            replace(
                e,
                symbol="x",
                value=length - e.value,
                parts=replace(e.parts, method=hypot(e.parts.method or 0.0, UNEQUAL * widest / 2)),
            ),
        )
        for e in by["L"]
        for P in [e.at["pressure"]]
        if length and e.value is not None and length - e.value > 1.5 * widest
    ]
    if not (np.diff([P for P, _ in known]) > 0).all():
        return

    def at(place: Place) -> Estimate | None:
        return between(known, place[0], bent=True)

    why = "" if widths else "it was reached from one side only, and friction keeps it short of its rest"
    yield Offer("x", {(P, None): e for P, e in known}, at, side=0 if widths else -1, why=why)


def contraction_of(run: RunData, trial: TrialData) -> float:
    """Contraction of one trial at rest without load [m]; raises `NotUsable`."""
    return measure(run, trial).x


def one_trial(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Contraction at rest, and contraction remaining without pressure before it."""
    try:
        rest = measure(run, trial)
    except NotUsable as reason:
        return [Measured("x", "length", None), Measured("x_0", "length", None)], [str(reason)]
    further = left([rest.hold])
    moves = further.seen and abs(further.size) > max(DRIFT * abs(rest.x - rest.start), 20e-6)
    doubts = [f"the length would still change by {show(further.size, 'length', 2)}"] if moves else []
    noise = max(20e-6, 6 * rest.noise)
    return [
        Measured("x", "length", rest.x, noise=noise),
        Measured("x_0", "length", rest.start, noise=noise),
        Measured("P", "pressure", rest.pressure, trial.point["pressure"] or None, tolerance=2e3, noise=1e3),
    ], doubts
