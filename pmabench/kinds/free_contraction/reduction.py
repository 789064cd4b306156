"""Reduction of free contraction: length over pressure, the sigmoid a to e through it, compared with paper 2's formula.

Knows the samples at rest of each trial; words and figure are in `figures`.

What one trial says by itself, for the display.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from pmabench.analysis.model_fit import ModelFit, fit_model
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.samples import Held, Left, NotUsable, left, noise_of
from pmabench.analysis.trial import DRIFT, Expected, Found, Measured, Quick
from pmabench.analysis.verdict.agreement import Offer, Place, between
from pmabench.base.quantities import show
from pmabench.kinds.free_contraction import RESULTS, figures
from pmabench.model.library import MODELS
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, withhold
from pmabench.store.records import Array, RunData, TrialData

KIND = "free-contraction"
FREE, SIGMOID = "free-length", "sigmoid"
FORM, PAPER = "sigmoid-length-coefficients", "sigmoid-length"
"""Models of the library: with fitted coefficients, and with those that paper 2 derives from the length."""
UNKNOWN = ("a", "b", "c", "d", "e")
UNITS = {"length": "m", "pressure": "Pa", "count": "1", "ratio": "1"}
RESIDUALS = "repeats part: residuals of the fit; no method part: that of L is not carried into the coefficients"
LAST = 0.2
"""Share of each rest at its end whose mean counts."""
FEWEST = 5
"""Samples that it needs."""
MOTION, ZERO = "motion after the hold", "contraction left without pressure"
FLOOR = 5e-4
"""Error of a length at the least, as a share of the largest contraction."""
FURTHEST = 3.0
"""Errors by which a length may be off the sigmoid."""
CHANNELS = ("displacement", "pressure")
UNUSABLE_SHARE = 0.5
PRESSED = 1e3
"""Change of pressure by which the slope of the sigmoid is found [Pa]."""
STEEPER = 1.4
"""What a scale does to a to e goes beyond the first order by so much: the curve is steep where it begins."""
CARRIED = 0.35
"""What the way from the measured pressure to the commanded one may be off, as a share: the curve bends between two."""
UNEQUAL = 0.25
"""Share of half the width between both sides by which their mean may be off: friction is not the same both ways."""


@dataclass(frozen=True, eq=False)
class Rest:
    """One trial: what was measured at rest."""

    run: RunData
    trial: TrialData
    pressure: float
    """[Pa]."""
    x: float
    """Contraction [m]."""
    start: float
    """Contraction at rest without pressure, before [m]."""
    hold: Held
    """Contraction along the second half of the hold [m]."""
    noise: float
    """Standard deviation of `start` and x [m]."""

    @property
    def side(self) -> float:
        """-1 reached from below, 1 from above; 0 where the protocol does not tell them apart."""
        return self.trial.point.get("side", 0.0)


@dataclass(frozen=True, eq=False)
class Point:
    """One commanded pressure: all its trials."""

    set: float
    """[Pa]."""
    rests: tuple[Rest, ...]
    pressure: float
    """Measured, the mean [Pa]."""
    repeats: Array
    """Contraction of each repeat, the mean of its sides [m]."""
    gaps: Array
    """Contraction reached from above minus from below, of each repeat that has both [m]."""

    @property
    def x(self) -> float:
        """Mean contraction [m]."""
        return float(self.repeats.mean())

    @cached_property
    def left(self) -> Left:
        """What x would still change by [m]."""
        return left([rest.hold for rest in self.rests])

    @cached_property
    def apart(self) -> Left:
        """What `gaps` would still change by [m]."""
        sides = [left([rest.hold for rest in self.rests if rest.side == side]) for side in (1.0, -1.0)]
        return Left(sides[0].size - sides[1].size, sum(one.most for one in sides), any(one.seen for one in sides))

    @property
    def off(self) -> float:
        """Largest contraction that was left without pressure before a trial [m]."""
        return max(abs(rest.start) for rest in self.rests)

    def reached(self, side: float) -> float:
        """Mean contraction reached from one side [m]; nan where there is none."""
        values = [rest.x for rest in self.rests if rest.side == side]
        return float(np.mean(values)) if values else float("nan")


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """L [m] at each pressure [Pa], a, b [m], c [Pa], d, e [1] of paper 2's eq. 1, pressure of half the contraction,
    and the largest contraction.

    L = L0 - x: the nominal length less the contraction at rest, the mean of both sides from which it was reached; their
    difference is hysteresis. `options`: `nominal_length` [m], `compare` (`paper-2` or `nothing`); else the plan's.
    """
    settings = {**(runs[0].plan.get("settings") or {} if runs else {}), **(options or {})}
    length, compare = float(settings.get("nominal_length", np.nan)), settings.get("compare") == "paper-2"
    points, dropped = _points(runs)
    scales = Scales.of(runs)
    fit, why = _fit(points, length)
    estimates = _lengths(points, length, scales)
    estimates += [_half(points, scales)] if len(points) > 2 else []
    estimates = _weighed([*estimates, *_largest(points, length, scales)], points, length)
    other = "" if fit is None else _other_form(points, fit)
    shifted = {} if fit is None or other else _shifted(points, length)
    estimates += _coefficients(fit, why, other, shifted, {} if fit is None else _scaled(fit, length), scales)
    curve = figures.curves(points, fit, length, compare=compare) if points else None
    findings = [
        *figures.of_points(points),
        *(figures.of_fit(fit, why, other) if points else []),
        *(figures.of_paper(curve, length) if curve is not None and compare else []),
    ]
    if estimates and (missing := scales.lack(CHANNELS)):
        findings.append(Finding("note", missing))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=findings,
        traces=[] if curve is None else [figures.trace(curve, length)],
        facts={
            "options": dict(options or {}),
            "nominal_length": length,
            "measured": [point.pressure for point in points],
            "trials": sum(len(point.rests) for point in points),
            "pressures": len(points),
            "residual_rms": None if fit is None else fit.residual_rms,
        },
    )


def measure(run: RunData, trial: TrialData) -> Rest:
    """One trial at rest; raises `NotUsable`."""
    if trial.status != "finished":
        raise NotUsable(f"the trial is {trial.status}")
    missing = [name for name in CHANNELS if name not in trial.channels]
    if missing:
        raise NotUsable(f"{' and '.join(missing)} not recorded")
    if "pressure" not in trial.point:
        raise NotUsable("its point names no pressure")
    x, P = (trial.channels[name] for name in CHANNELS)
    good = trial.usable & np.isfinite(x) & np.isfinite(P)
    if float(np.mean(~good)) > UNUSABLE_SHARE:
        raise NotUsable(f"{np.mean(~good):.0%} of the samples are flagged or missing")
    ramps = [c for c in trial.commands if c.output == "pressure" and c.kind == "ramp"]
    t = trial.t
    end = min((c.t for c in ramps if c.phase == "vent" and c.t >= t[0]), default=float(t[-1]))
    moved = [c for c in ramps if c.phase != "vent" and t[0] - 1e-9 <= c.t <= end]
    begin = moved[0].t if moved else end
    paced = [c for c in moved if c.data.get("rate", 0.0) > 0]
    there = max((c.t + abs(c.value - c.before) / c.data["rate"] for c in paced), default=t[0])
    first = good & (t >= begin - LAST * (begin - t[0])) & (t < begin - 1e-9)
    last = good & (t >= end - LAST * (end - there)) & (t <= end)
    if min(first.sum(), last.sum()) < FEWEST or end <= there:
        raise NotUsable(f"fewer than {FEWEST} samples at the end of a rest")
    half = good & (t >= 0.5 * (there + end)) & (t <= end)
    noise = noise_of(x[last]) / np.sqrt(min(first.sum(), last.sum()))
    hold = Held.of(t[half], x[half], end - LAST * (end - there))
    return Rest(run, trial, float(P[last].mean()), float(x[last].mean()), float(x[first].mean()), hold, noise)


def _points(runs: Sequence[RunData]) -> tuple[list[Point], list[Dropped]]:
    """The pressures, rising, and the trials that tell nothing."""
    groups: dict[int, list[Rest]] = {}
    dropped = []
    for run in runs:
        for trial in run.trials:
            try:
                rest = measure(run, trial)
            except NotUsable as reason:
                dropped.append(Dropped(trial.name, trial.point, str(reason)))
            else:
                groups.setdefault(round(trial.point["pressure"]), []).append(rest)
    points = []
    for pressure, rests in sorted(groups.items()):
        by: dict[object, dict[float, Rest]] = {}
        order, sides = Counter[object](), {rest.side for rest in rests}
        for rest in rests:  # trials of one file are repeats too, where nothing else tells them apart
            side = rest.run.id, rest.trial.repeat, rest.side
            by.setdefault((rest.run.id, rest.trial.repeat, order[side]), {})[rest.side] = rest
            order[side] += 1
        lost = [rest for repeat in by.values() if set(repeat) != sides for rest in repeat.values()]
        dropped += [Dropped(r.trial.name, r.trial.point, "the other side of its repeat is lost") for r in lost]
        kept = [rest for rest in rests if rest not in lost]
        whole = [{side: r.x for side, r in repeat.items()} for repeat in by.values() if set(repeat) == sides]
        if whole:
            gaps = [one[1.0] - one[-1.0] for one in whole if {1.0, -1.0} <= set(one)]
            repeats = np.array([np.mean(list(one.values())) for one in whole])
            measured = float(np.mean([rest.pressure for rest in kept]))
            points.append(Point(float(pressure), tuple(kept), measured, repeats, np.array(gaps)))
    return points, dropped


def _curve(points: Sequence[Point]) -> tuple[Array, Array]:
    """Measured pressure [Pa] and mean contraction [m] of each point."""
    return np.array([point.pressure for point in points]), np.array([point.x for point in points])


def _rises(points: Sequence[Point]) -> Array:
    """dx/dP at each measured pressure [m/Pa]."""
    P, x = _curve(points)
    return np.gradient(x, P) if len(points) > 1 and bool((np.diff(P) > 0).all()) else np.zeros(len(points))


def _carried(points: Sequence[Point]) -> list[float]:
    """How much further than measured it contracts at each commanded pressure [m]: a regulator rests beside it."""
    P, x = _curve(points)
    wanted = np.array([point.set for point in points])
    further = _rises(points) * (wanted - P)
    if len(points) > 2 and bool((np.diff(P) > 0).all()):
        within = (wanted >= P[0]) & (wanted <= P[-1])
        further = np.where(within, PchipInterpolator(P, x)(np.clip(wanted, P[0], P[-1])) - x, further)
    return [float(one) for one in further]


def _lengths(points: Sequence[Point], length: float, scales: Scales) -> list[Estimate]:
    """L, and the difference of both sides, at each pressure."""
    found, gaps = [], []
    for point, slope, carried in zip(points, _rises(points), _carried(points), strict=True):
        at = {"pressure": point.set}
        rises = {"displacement": point.x, "pressure": float(slope) * point.pressure}
        scale = scales.part(rises, {"displacement": 1.0, "pressure": float(slope)})
        parts = Parts(spread(point.repeats), CARRIED * abs(carried), scale)
        found.append(_free("L", length - point.x - carried, "length", at, parts, len(point.repeats), [point]))
        if len(point.gaps):
            value = float(point.gaps.mean())
            parts = Parts(spread(point.gaps), 0.0, scales.part({"displacement": value}))
            gaps.append(_free("x_H", value, "length", at, parts, len(point.gaps), [point]))
    return found + gaps


def _free(
    symbol: str, value: float, quantity: str, at: Mapping[str, float], parts: Parts, n: int, points: Sequence[Point]
) -> Estimate:
    """A result of the lengths themselves at these points."""
    names = tuple(rest.trial.name for point in points for rest in point.rests)
    note = "" if parts.repeats is not None else "no repeats part: one repeat only"
    return Estimate(symbol, value, UNITS[quantity], quantity, FREE, at, parts, n, note=note, trials=names)


def _half(points: Sequence[Point], scales: Scales) -> Estimate:
    """The pressure at which half of the contraction at the highest pressure is reached."""
    P, x = _curve(points)
    value, n = figures.half_pressure(P, x), min(len(point.repeats) for point in points)
    if value is None:
        note = "the contraction does not rise through half of its largest value once"
        return replace(_free("P_half", 0.0, "pressure", {}, Parts(), n, points), value=None, note=note)
    each = [figures.half_pressure(P, np.array([point.repeats[i] for point in points])) for i in range(n)]
    half, coarse = spread([one for one in each if one is not None]), float(np.diff(P).max()) / 2
    parts = Parts(half, 0.1 * coarse, scales.part({"pressure": value}, {"pressure": 1.0}))
    return _free("P_half", value, "pressure", {}, parts, n, points)


def _largest(points: Sequence[Point], length: float, scales: Scales) -> list[Estimate]:
    """The largest contraction of all pressures, as a share of the nominal length, which is taken as exact."""
    top = max(points, key=lambda point: point.x, default=None)
    if top is None or not length > 0 or not np.isfinite(length):
        return []
    half, place = spread(top.repeats), next(i for i, point in enumerate(points) if point is top)
    carried, rise = _carried(points)[place], float(_rises(points)[place])
    scale = scales.part(
        {"displacement": top.x / length, "pressure": rise * top.pressure / length},
        {"displacement": 1 / length, "pressure": rise / length},
    )
    parts = Parts(None if half is None else half / length, CARRIED * abs(carried) / length, scale)
    n, at = len(top.repeats), {"pressure": top.set}
    return [_free("eps_max", (top.x + carried) / length, "ratio", at, parts, n, [top])]


def _fit(points: Sequence[Point], length: float, off: Array | float = 0.0) -> tuple[ModelFit | None, str]:
    """The sigmoid with fitted a to e through the means, `off` (n,) [m] added to x; or why it cannot be fitted."""
    model = MODELS[FORM]
    P, L = np.array([max(point.pressure, 0.0) for point in points]), length - np.array([p.x for p in points]) - off
    if len(points) <= len(UNKNOWN):
        return None, f"no fit: {len(points)} pressures for {len(UNKNOWN)} coefficients"
    if not np.isfinite(L).all() or not 0 < length <= 2:
        return None, "no fit: the plan tells no nominal length"
    most = next(p.high for p in model.parameters if p.name == "pressure")
    if P.max() > figures.BARELY * most:
        return None, f"no fit: the sigmoid holds up to {show(most, 'pressure')}"
    fixed = {p.name: p.value for p in model.parameters if p.name not in ("pressure", *UNKNOWN)}
    fixed["nominal_length"] = length
    start = {"a": 0.7 * length, "b": 0.3 * length}
    try:
        return fit_model(model, "length", {"pressure": np.minimum(P, most)}, fixed, L, UNKNOWN, start=start), ""
    except ValueError:
        return None, "no fit: no sigmoid comes near these lengths"


def _weighed(estimates: Sequence[Estimate], points: Sequence[Point], length: float) -> list[Estimate]:
    """The values with what motion after the holds, and contraction left without pressure, may do to them."""
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
    # what friction holds back at 0 kPa is half the gap there, and the mean of both directions is free of it
    steepest = max(points, key=lambda point: point.x)
    found = []
    for e in estimates:
        point = by_set.get(e.at.get("pressure", steepest.set), steepest)
        share = {"eps_max": 1 / length, "P_half": 0.5 * _pressure_over_x(points)}.get(e.symbol, 1.0)
        still, off = point.left, max(one.off for one in points) if e.symbol == "P_half" else point.off
        if e.symbol == "x_H":
            still, off = point.apart, float(np.ptp([rest.start for rest in point.rests]))
        noise = max(rest.noise for rest in point.rests)
        doubts = (
            Doubt(MOTION, "method", share * still.most, still.seen, rests),
            Doubt(ZERO, "drift", share * off, off > max(figures.CLEAR * noise, friction), zero),
        )
        found.append(weighed(e, doubts, None if e.symbol == "P_half" else largest * share))
    return found


def _pressure_over_x(points: Sequence[Point]) -> float:
    """Change of pressure over that of contraction where half of the largest contraction is reached [Pa/m]."""
    P, x = _curve(points)
    after = int(np.clip(np.argmax(x >= 0.5 * x[-1]), 1, len(x) - 1))
    return abs(float((P[after] - P[after - 1]) / max(abs(x[after] - x[after - 1]), 1e-9)))


def _other_form(points: Sequence[Point], fit: ModelFit) -> str:
    """Why the sigmoid is not the form of these lengths, with numbers; empty where nothing speaks against it.

    A length may be off by three times its error: what repeats scatter by, pooled, and at least `FLOOR` of the largest
    contraction.
    """
    freedom = sum(len(point.repeats) - 1 for point in points)
    squares = sum(float(np.sum((point.repeats - point.x) ** 2)) for point in points)
    scatter = np.sqrt(squares / max(1, freedom) / np.array([len(point.repeats) for point in points]))
    error = np.hypot(scatter, FLOOR * max(abs(point.x) for point in points))
    off = np.abs(fit.computed - fit.measured)
    if not error.all():
        return ""  # nothing contracted
    worst = int(np.argmax(off / error))
    if off[worst] <= FURTHEST * error[worst]:
        return ""
    where, most = show(points[worst].set, "pressure"), show(float(FURTHEST * error[worst]), "length", 2)
    text = f"the length at {where} is {show(float(off[worst]), 'length', 2)} off the sigmoid"
    return f"{text}, at most {most} is expected: length over pressure has another form here. Use the lengths themselves"


def _shifted(points: Sequence[Point], length: float) -> dict[str, ModelFit]:
    """The sigmoid through the lengths less what is left without pressure, and to which they would come; where seen."""
    starts = np.array([np.mean([rest.start for rest in point.rests]) for point in points])
    noise = max(rest.noise for point in points for rest in point.rests)
    ways = {ZERO: -starts} if np.abs(starts).max() > figures.CLEAR * noise else {}
    if any(point.left.seen for point in points):
        ways[MOTION] = np.array([point.left.size for point in points])
    fits = {name: _fit(points, length, off)[0] for name, off in ways.items()}
    return {name: fit for name, fit in fits.items() if fit is not None and fit.converged}


def _scaled(fit: ModelFit, length: float) -> dict[tuple[str, str], Array]:
    """Change of a to e, shape (5,), by a relative change (`gain`) or an offset of 1 [SI] of each channel."""
    P = fit.columns["pressure"]
    known = {unknown.name: unknown.value for unknown in fit.unknowns}

    def computed(P: Array, **changed: float) -> Array:
        return fit.model.evaluate({**fit.fixed, "pressure": P, **known, **changed})["length"]

    steps = {name: 1e-5 * max(abs(value), 1e-6) for name, value in known.items()}
    slopes = np.array([computed(P, **{n: known[n] + h}) - computed(P, **{n: known[n] - h}) for n, h in steps.items()])
    slopes /= 2 * np.array(list(steps.values()))[:, None]
    most = next(p.high for p in fit.model.parameters if p.name == "pressure")
    below, above = np.maximum(P - PRESSED, 0.0), np.minimum(P + PRESSED, most)
    rises = (computed(above) - computed(below)) / (above - below)
    x = length - fit.measured
    moved = {("pressure", "offset"): -rises, ("pressure", "gain"): -rises * P,
             ("displacement", "offset"): -np.ones_like(x), ("displacement", "gain"): -x}  # fmt: skip
    size = np.linalg.norm(slopes, axis=1)
    size = np.where(size > 0, size, 1.0)
    columns = (slopes / size[:, None]).T
    return {name: STEEPER * np.linalg.lstsq(columns, by, rcond=None)[0] / size for name, by in moved.items()}


def _coefficients(
    fit: ModelFit | None, why: str, other: str, shifted: Mapping[str, ModelFit],
    scaled: Mapping[tuple[str, str], Array], scales: Scales,
) -> list[Estimate]:  # fmt: skip
    """The coefficients a to e, those without an interval as not identifiable, withheld for the reason `other`.

    What they differ by from those of `shifted` is in the interval, and what a scale does to them (`_scaled`).
    """
    quantities = {p.name: p.quantity for p in MODELS[FORM].parameters}
    found = []
    for name in UNKNOWN:
        quantity = quantities[name]
        value, half, note = (None, None, why) if fit is None else fit.identified(name, UNITS[quantity])
        place = UNKNOWN.index(name)
        by = {kind: {c: float(scaled[c, kind][place]) for c in CHANNELS} for kind in ("gain", "offset") if scaled}
        parts = Parts(repeats=half, calibration=scales.part(by["gain"], by["offset"]) if by else None)
        n = 0 if fit is None else len(fit.measured)
        note = sentences(note, RESIDUALS if half is not None else "")
        e = Estimate("L", value, UNITS[quantity], quantity, SIGMOID, {}, parts, n, note=note, coordinate=name)
        others = {way: next(u.value for u in one.unknowns if u.name == name) for way, one in shifted.items()}
        doubts = [
            Doubt(way, "drift" if way == ZERO else "method", abs(other - (value or 0.0)), seen=True)
            for way, other in others.items()
        ]
        found.append(withhold(e, other) if other and value is not None else weighed(e, doubts))
    return found


def offers(analysis: Analysis) -> Iterator[Offer]:
    """x, the contraction without load, at the measured pressures and between them.

    Where it was reached from both sides, friction drops out of their mean once both have moved: a muscle that has
    contracted by no more than the friction is worth still rests where it began.
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
    """Contraction at rest, and what was left without pressure before it."""
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
