"""Reduction of free contraction: length over pressure, the sigmoid a to e through it, paper 2's formula beside it.

Knows the samples at rest of each trial; words and figure are in `view`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.analysis.fitting.model_fit import ModelFit, fit_model
from pmabench.analysis.results import Analysis, Dropped, Estimate, Finding, Parts
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.samples import NotUsable, noise_of
from pmabench.base.quantities import show
from pmabench.kinds.free_contraction import RESULTS, view
from pmabench.model.library import MODELS
from pmabench.store.records import Array, RunData, TrialData

KIND = "free-contraction"
FREE, SIGMOID = "free-length", "sigmoid"
FORM, PAPER = "sigmoid-length-coefficients", "sigmoid-length"
"""Models of the library: with coefficients of its own, and as paper 2 has it for a length."""
UNKNOWN = ("a", "b", "c", "d", "e")
UNITS = {"length": "m", "pressure": "Pa", "count": "1"}
RESIDUALS = (
    "repeats part: residuals of the fit; no calibration part, no method part: those of L are not carried into the "
    "coefficients"
)
LAST = 0.2
"""Share of each rest at its end whose mean counts."""
FEWEST = 5
"""Samples that it needs."""
CHANNELS = ("displacement", "pressure")
UNUSABLE_SHARE = 0.5


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
    drift: float
    """What x still changes by over the last fifth of the hold [m]."""
    noise: float
    """Of the displacement [m]."""

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
    estimates = _lengths(points, length, scales)
    fit, why = _fit(points, length)
    estimates += [_half(points, scales)] if len(points) > 2 else []
    estimates += _largest(points, length, scales)
    estimates += _coefficients(fit, why)
    curve = view.curves(points, fit, length, compare=compare) if points else None
    findings = [
        *view.of_points(points),
        *(view.of_fit(fit, why) if points else []),
        *(view.of_paper(curve, length) if curve is not None and compare else []),
    ]
    if estimates and (untold := scales.lack(CHANNELS)):
        findings.append(Finding("note", untold))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=findings,
        traces=[] if curve is None else [view.trace(curve, length)],
        facts={
            "options": dict(options or {}),
            "nominal_length": length,
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
    there = max(
        (c.t + abs(c.value - c.before) / c.data["rate"] for c in moved if c.data.get("rate", 0.0) > 0), default=t[0]
    )
    first = good & (t >= begin - LAST * (begin - t[0])) & (t < begin - 1e-9)
    last = good & (t >= end - LAST * (end - there)) & (t <= end)
    if min(first.sum(), last.sum()) < FEWEST or end <= there:
        raise NotUsable(f"fewer than {FEWEST} samples at the end of a rest")
    held = np.flatnonzero(last)
    middle = len(held) // 2
    return Rest(
        run=run,
        trial=trial,
        pressure=float(P[last].mean()),
        x=float(x[last].mean()),
        start=float(x[first].mean()),
        drift=2 * float(x[held[middle:]].mean() - x[held[:middle]].mean()),
        noise=noise_of(x[last]) / np.sqrt(max(1, middle)),
    )


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
        by: dict[object, dict[float, list[float]]] = {}
        for rest in rests:
            by.setdefault((rest.run.id, rest.trial.repeat), {}).setdefault(rest.side, []).append(rest.x)
        sides = {rest.side for rest in rests}
        means = [{side: float(np.mean(values)) for side, values in repeat.items()} for repeat in by.values()]
        whole = [one for one in means if set(one) == sides]
        for key, one in zip(by, means, strict=True):
            if set(one) != sides:
                lost = [rest for rest in rests if (rest.run.id, rest.trial.repeat) == key]
                dropped += [Dropped(r.trial.name, r.trial.point, "the other side of its repeat is lost") for r in lost]
        rests = [r for r in rests if set(by[(r.run.id, r.trial.repeat)]) == sides]
        if whole:
            gaps = [one[1.0] - one[-1.0] for one in whole if {1.0, -1.0} <= set(one)]
            repeats = np.array([np.mean(list(one.values())) for one in whole])
            measured = float(np.mean([rest.pressure for rest in rests]))
            points.append(Point(float(pressure), tuple(rests), measured, repeats, np.array(gaps)))
    return points, dropped


def _lengths(points: Sequence[Point], length: float, scales: Scales) -> list[Estimate]:
    """L, and the difference of both sides, at each pressure."""
    P, x = np.array([p.pressure for p in points]), np.array([p.x for p in points])
    over = np.gradient(x, P) if len(points) > 1 and bool((np.diff(P) > 0).all()) else np.zeros(len(points))
    found, gaps = [], []
    for point, slope in zip(points, over, strict=True):
        at, names = {"pressure": point.set}, tuple(rest.trial.name for rest in point.rests)
        rises = {"displacement": point.x, "pressure": float(slope) * point.pressure}
        scale = scales.part(rises, {"displacement": 1.0, "pressure": float(slope)})
        drift = max(abs(rest.drift) for rest in point.rests)
        half, n = spread(point.repeats), len(point.repeats)
        note = "" if half is not None else "no repeats part: one repeat only"
        parts = Parts(repeats=half, method=drift, calibration=scale)
        found.append(Estimate("L", length - point.x, "m", "length", FREE, at, parts, n, note=note, trials=names))
        if len(point.gaps):
            value, half = float(point.gaps.mean()), spread(point.gaps)
            note = "" if half is not None else "no repeats part: one repeat only"
            parts = Parts(repeats=half, method=2 * drift, calibration=scales.part({"displacement": value}))
            n = len(point.gaps)
            gaps.append(Estimate("x_H", value, "m", "length", FREE, at, parts, n, note=note, trials=names))
    return found + gaps


def _half(points: Sequence[Point], scales: Scales) -> Estimate:
    """The pressure at which half of the contraction at the highest pressure is reached."""
    P = np.array([point.pressure for point in points])
    names = tuple(rest.trial.name for point in points for rest in point.rests)
    value = view.half_pressure(P, np.array([point.x for point in points]))
    n = min(len(point.repeats) for point in points)
    if value is None:
        note = "the contraction does not rise through half of its largest value once"
        return Estimate("P_half", None, "Pa", "pressure", FREE, n=n, note=note, trials=names)
    each = [view.half_pressure(P, np.array([point.repeats[i] for point in points])) for i in range(n)]
    half = spread([one for one in each if one is not None])
    coarse = float(np.diff(P).max()) / 2
    note = sentences("" if half is not None else "no repeats part: one repeat only", "")
    parts = Parts(half, method=0.1 * coarse, calibration=scales.part({"pressure": value}, {"pressure": 1.0}))
    return Estimate("P_half", value, "Pa", "pressure", FREE, {}, parts, n, note=note, trials=names)


def _largest(points: Sequence[Point], length: float, scales: Scales) -> list[Estimate]:
    """The largest contraction of all pressures, as a share of the nominal length, which is taken as exact."""
    top = max(points, key=lambda point: point.x, default=None)
    if top is None or not length > 0 or not np.isfinite(length):
        return []
    half, names = spread(top.repeats), tuple(rest.trial.name for rest in top.rests)
    drift = max(abs(rest.drift) for rest in top.rests) / length
    scale = scales.part({"displacement": top.x / length}, {"displacement": 1 / length})
    parts = Parts(None if half is None else half / length, method=drift, calibration=scale)
    note = "" if half is not None else "no repeats part: one repeat only"
    at = {"pressure": top.set}
    n = len(top.repeats)
    return [Estimate("eps_max", top.x / length, "1", "ratio", FREE, at, parts, n, note=note, trials=names)]


def _fit(points: Sequence[Point], length: float) -> tuple[ModelFit | None, str]:
    """The sigmoid with a to e of its own through the means, or why there is none."""
    model = MODELS[FORM]
    P, L = np.array([max(point.pressure, 0.0) for point in points]), length - np.array([p.x for p in points])
    if len(points) <= len(UNKNOWN):
        return None, f"no fit: {len(points)} pressures for {len(UNKNOWN)} coefficients"
    if not np.isfinite(L).all() or not 0 < length <= 2:
        return None, "no fit: the plan tells no nominal length"
    most = next(p.high for p in model.parameters if p.name == "pressure")
    if P.max() > view.BARELY * most:
        return None, f"no fit: the sigmoid holds up to {show(most, 'pressure')}"
    fixed = {p.name: p.value for p in model.parameters if p.name not in ("pressure", *UNKNOWN)}
    fixed["nominal_length"] = length
    start = {"a": 0.7 * length, "b": 0.3 * length}
    try:
        return fit_model(model, "length", {"pressure": np.minimum(P, most)}, fixed, L, UNKNOWN, start=start), ""
    except ValueError:
        return None, "no fit: no sigmoid comes near these lengths"


def _coefficients(fit: ModelFit | None, why: str) -> list[Estimate]:
    """The coefficients a to e, those without an interval as not identifiable."""
    quantities = {p.name: p.quantity for p in MODELS[FORM].parameters}
    found = []
    for name in UNKNOWN:
        quantity = quantities[name]
        value, half, note = (None, None, why) if fit is None else fit.told(name, UNITS[quantity])
        parts = Parts(repeats=half)
        n = 0 if fit is None else len(fit.measured)
        note = sentences(note, RESIDUALS if half is not None else "")
        found.append(Estimate("L", value, UNITS[quantity], quantity, SIGMOID, {}, parts, n, note=note, coordinate=name))
    return found
