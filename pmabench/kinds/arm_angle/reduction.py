"""Reduction of an arm's bending angle: both branches over pressure at each load, and paper 2's formula fitted to them.

Works on the rests of each staircase of pressure (`stairs`); sentences and figure are in `figures`. Angles at rest are
widened for motion at the end of a hold, a cable that slips, zero errors and coarse steps of the angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmabench.analysis.model_fit import ModelFit, fit_model
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import Left, settings_of
from pmabench.analysis.shared.trials import mean_of_trials
from pmabench.base.quantities import show
from pmabench.kinds.arm_angle import RESULTS, figures
from pmabench.kinds.arm_angle.stairs import Loaded, channel_of, flat_from, loads_of
from pmabench.model.library import MODELS
from pmabench.store.analyses.results import Analysis, Estimate, Parts, withhold
from pmabench.store.records import Array, RunData

KIND = "arm-angle"
REST, UP, MATRIX = "angle-at-rest", "logistic-up", "logistic-loads"
"""Methods: the rests alone; paper 2's form fitted to the way up, or over all loads."""
FORM, FORM_LOADS = "arm-angle-at-load", "arm-angle-coefficients"
"""Models of the library."""
UNKNOWN = ("a", "b", "c", "d")
UNITS = {"angle": "rad", "pressure": "Pa", "count": "1"}
ONCE = "no repeats part: one repeat only"
TOGETHER = "no repeats part, no method part, no calibration part: of the form, the angles at rest have the intervals"
LATE = 0.25
"""Share of the gap between both branches; a significant effect above it withholds the gap, a smaller one only widens
the interval.
"""
OFF = 3.0
"""Largest rms misfit of the form, in standard errors of a mean angle."""
POWERS = 5
"""Powers of the load, from 0 on: the form goes through this many loads exactly; only more loads can test it."""
LEAST = 0.003
"""Misfit, or motion after a hold, as a share of the largest angle, that is too small to count against the form."""
ANOTHER = "the angles lie {} (rms) off this form, {:.0f} of their errors: it is another curve. Take the angles at rest"
NO_POWERS = (
    "the angles of all loads lie {} (rms) off the powers of the load, {:.0f} of their errors: take the coefficients of "
    "each load"
)


@dataclass(frozen=True, eq=False)
class Fitted:
    """One load: its rests and the fit of paper 2's form, or the reason why there is none."""

    of: Loaded
    up: ModelFit | None
    why: str = ""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Bending angle [rad] at the preload and at most, its hysteresis, and a, b [rad], c [Pa], d [1] at each load [kg].

    As in the paper: alpha = a + b / (1 + (p / c)^d) fitted to the way up, its coefficients as powers of the load. Also
    both branches separately and their difference. `options`: `angle`, `radius` [m] and `compare`, in place of the
    plan's settings.
    """
    settings = settings_of(runs[0], options) if runs else dict(options or {})
    compare = settings.get("compare") == "paper-2"
    loads, dropped = loads_of(runs, settings)
    fits = [_fitted(one) for one in loads]
    matrix, why = _matrix(fits)
    estimates = [estimate for one in fits for estimate in _of_load(one)]
    used = [one.of for one in fits if one.up is not None]
    other = next((e.note for e in estimates if e.withheld and e.method == UP), "")
    other = other or (_misses(matrix, used, NO_POWERS) if len(used) > POWERS else "")
    estimates += _without(_coefficients(matrix, why, MATRIX, {}, used), other)
    findings = [
        *figures.of_rests(loads, settings),
        *figures.of_fits(fits),
        *figures.of_matrix(matrix, why, fits),
        *(figures.of_paper(fits) if compare else []),
    ]
    findings += Scales.of(runs).findings(estimates, (channel_of(settings), "pressure"))
    traces = [figures.trace(one, compare=compare) for one in fits]
    trials, rms = sum(len(one.stairs) for one in loads), None if matrix is None else matrix.residual_rms
    facts = {"options": dict(options or {}), "trials": trials, "loads": len(loads), "residual_rms": rms}
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates, dropped=dropped, findings=findings, traces=traces, facts=facts
    )


def _of_load(fitted: Fitted) -> list[Estimate]:
    """The values of one load."""
    one = fitted.of
    at, names, channel = {"tip_mass": one.mass}, tuple(stair.trial.name for stair in one.stairs), one.channel
    slope, largest = _slopes(one.pressure, one.mean), float(np.abs(one.mean).max())
    exact = "the radius is taken as exact" if channel == "displacement" else ""

    def made(
        symbol: str, values: Array, method: float, gains: Mapping[str, float],
        offsets: Mapping[str, float] | None = None, note: str = "", kind: tuple[str, str] = ("rad", "angle"),
    ) -> Estimate:  # fmt: skip
        """Mean of the trials' `values`; `method` is the half width of its method part; gains, offsets: see
        `Scales.part`.
        """
        part = one.scales.part(gains, offsets)
        return mean_of_trials(symbol, kind, REST, at, names, values, method, part, ONCE, note)

    def angle(symbol: str, place: int, method: float) -> Estimate:
        values, by_pressure = one.up[:, place], float(slope[place])
        gains = {channel: float(values.mean()), "pressure": by_pressure * float(one.pressure[place])}
        e = made(symbol, values, method, gains, {channel: one.per_offset, "pressure": by_pressure}, exact)
        return weighed(e, _at_rest(one, place, by_pressure), largest)

    top, widest = int(np.argmax(one.up.mean(axis=0))), one.widest
    side = 0.0 if widest is None else 0.5 * float(np.abs(one.gaps[:, widest].mean()))
    found = [angle("alpha_0", 0, 0.0), angle("alpha_max", top, side)]
    P, flat = one.pressure[: top + 1], ("Pa", "pressure")
    each = [from_ for row in one.up if (from_ := flat_from(P, row[: top + 1])) is not None]
    if len(each) < len(one.up):
        note = "the angle at the preload is within 1 deg of the largest"
        found.append(Estimate("P_flat", None, *flat, REST, at, n=len(one.up), note=note, trials=names))
    else:
        value, coarse = float(np.mean(each)), 0.1 * float(np.diff(P).max()) / 2
        e = made("P_flat", np.array(each), coarse, {"pressure": value}, {"pressure": 1.0}, kind=flat)
        found.append(weighed(e, _of_flat(one, top, value)))
    if widest is not None:
        gap = float(one.gaps[:, widest].mean())
        e = made("alpha_H", one.gaps[:, widest], 0.0, {channel: gap})
        found.append(weighed(e, _of_gap(one, widest, max(LATE * abs(gap), LEAST * largest))))
    late = (_moving(one, place, -1) for place in range(len(one.sets)))
    contradicted = next((e.note for e in found if e.withheld and e.symbol != "alpha_H"), "")
    contradicted = contradicted or next((why for left, why in late if left.seen and left.most > LEAST * largest), "")
    contradicted = contradicted or (one.zero_off if one.zero < 0 else "")
    contradicted = contradicted or _misses(fitted.up, [one], ANOTHER)
    return [*found, *_without(_coefficients(fitted.up, fitted.why, UP, at, [one]), contradicted)]


def _slopes(P: Array, angle: Array) -> Array:
    """d(angle)/d(pressure) at each pressure [rad/Pa]; the mean slope where two rests have the same pressure."""
    if len(P) > 1 and (np.diff(P) > 0).all():
        return np.asarray(np.gradient(angle, P))
    return np.full(len(P), np.ptp(angle) / np.ptp(P) if len(P) > 1 else 0.0)


# -- paper 2's form ------------------------------------------------------------------------------------------------


def _fitted(one: Loaded) -> Fitted:
    """Paper 2's form at one load, with coefficients fitted to it."""
    if len(one.pressure) <= len(UNKNOWN):
        return Fitted(one, None, f"no fit: {len(one.pressure)} pressures for {len(UNKNOWN)} coefficients")
    if one.pressure[-1] > figures.BARELY * figures.HIGHEST:
        return Fitted(one, None, f"no fit: the form holds up to {show(figures.HIGHEST, 'pressure')}")
    try:
        return Fitted(one, _fit(one.pressure, one.up.mean(axis=0)))
    except ValueError:
        return Fitted(one, None, "no fit: no curve of this form comes near these angles")


def _fit(P: Array, angle: Array) -> ModelFit:
    start = {
        "a": float(angle[-1]),
        "b": float(angle[0] - angle[-1]),
        "c": float(np.interp(0.5 * (angle[0] + angle[-1]), np.maximum.accumulate(angle), P)),
    }
    columns = {"pressure": np.clip(P, 0.0, figures.HIGHEST)}
    return fit_model(MODELS[FORM], "angle", columns, {}, angle, UNKNOWN, start=start)


def _matrix(fits: Sequence[Fitted]) -> tuple[ModelFit | None, str]:
    """Paper 2's 20 numbers: the coefficients as powers of the load, fitted to the ways up of all loads at once."""
    used = [(one.of, one.up) for one in fits if one.up is not None]
    if len(used) < POWERS:
        return None, f"no powers of the load: {len(used)} loads with a fit, {POWERS} are needed"
    model = MODELS[FORM_LOADS]
    w = np.array([one.mass for one, _ in used])
    most = next(p.high for p in model.parameters if p.name == "load")
    if w.max() > most * (1 + 1e-9):
        return None, f"no powers of the load: they hold up to {most:g} kg"
    start: dict[str, float] = {}
    for i, row in enumerate(UNKNOWN):
        powers = np.polynomial.polynomial.polyfit(w, [up.unknowns[i].value for _, up in used], POWERS - 1)
        start |= {f"{row}_{n}": float(power) for n, power in enumerate(powers)}
    columns = {
        "pressure": np.concatenate([np.clip(one.pressure, 0.0, figures.HIGHEST) for one, _ in used]),
        "load": np.concatenate([np.full(len(one.pressure), min(one.mass, most)) for one, _ in used]),
    }
    measured = np.concatenate([one.up.mean(axis=0) for one, _ in used])
    try:
        return fit_model(model, "angle", columns, {}, measured, list(start), start=start), ""
    except ValueError:
        return None, "no powers of the load: the fit finds no start at which the form holds"


def _coefficients(
    fit: ModelFit | None, why: str, method: str, at: Mapping[str, float], loads: Sequence[Loaded]
) -> list[Estimate]:
    """The coefficients of a fit, without intervals: they mean something together only."""
    model = MODELS[FORM_LOADS if method == MATRIX else FORM]
    quantities = {p.name: p.quantity for p in model.parameters}
    names = tuple(stair.trial.name for one in loads for stair in one.stairs)
    found = []
    for name in model.fitted:
        unit = UNITS[quantities[name]]
        power = name.partition("_")[2]
        per = f"per kg{power if power != '1' else ''}" if power not in {"", "0"} else ""
        value, _, note = (None, None, why) if fit is None else fit.identified(name, unit)
        note = note if value is None else sentences(per, TOGETHER)
        found.append(
            Estimate("alpha_b", value, unit, quantities[name], method, at, Parts(), len(names), note=note,
                     trials=names, coordinate=name)
        )  # fmt: skip
    return found


def _without(estimates: Sequence[Estimate], why: str) -> list[Estimate]:
    """The coefficients, withheld if there is a reason."""
    return [withhold(e, why) if why and e.value is not None else e for e in estimates]


def _misses(fit: ModelFit | None, loads: Sequence[Loaded], text: str) -> str:
    """Reason to withhold the coefficients of a fit whose rms misfit [rad] is too large; else empty."""
    if fit is None:
        return ""
    off = fit.computed - fit.measured
    miss = float(np.sqrt(off @ off / max(1, len(off) - len(fit.unknowns))))
    error = float(np.sqrt(np.mean([_error(one) ** 2 for one in loads])))
    if miss <= max(OFF * error, LEAST * max(float(np.abs(one.mean).max()) for one in loads)):
        return ""
    return text.format(show(miss, "angle", 2), miss / max(error, 1e-12))


def _error(one: Loaded) -> float:
    """Standard error of a mean angle at rest on the way up [rad], without the common shift of each trial."""
    rows = one.up
    within = np.sqrt(np.mean(np.var(rows - rows.mean(axis=1, keepdims=True), axis=0, ddof=min(1, len(rows) - 1))))
    return max(float(within), one.noise) / float(np.sqrt(len(rows)))


# -- what the rests leave open -------------------------------------------------------------------------------------


def _moving(one: Loaded, place: int, side: int) -> tuple[Left, str]:
    found = one.motion(place, side)
    where = f"{show(one.sets[place], 'pressure')}, {one.mass:g} kg"
    text = f"the angle is not at rest: after the hold it may still change by {show(found.most, 'angle', 2)} ({where})"
    return found, f"{text}. Hold longer"


def _slips(one: Loaded, share: float = 1.0) -> Doubt:
    size, seen = one.slip
    text = f"with {one.mass:g} kg one trial comes back to the preload {show(size, 'angle', 2)} off the others"
    reason = f"{text}: a cable or a mount slips. Fasten it, and do the load again"
    return Doubt("slip", "drift", share * size if seen else 0.0, seen, reason)


def _zero(one: Loaded, slope: float) -> Doubt:
    """Effect of the gauge's zero error on a value that changes by `slope` per pascal of reading."""
    return Doubt("zero of the pressure", "calibration", abs(slope * one.zero), one.zero < 0, one.zero_off)


def _apart(one: Loaded) -> Doubt:
    """Effect of the angle's zero error on an angle."""
    return Doubt("zero of the angle against the displacement", "calibration", abs(one.apart), seen=False)


def _steps(half: float) -> Doubt:
    return Doubt("steps of the angle", "method", half, seen=False)


def _at_rest(one: Loaded, place: int, slope: float) -> list[Doubt]:
    """Effects on an angle of the way up; `slope` is d(angle)/d(pressure) there [rad/Pa]."""
    further, reason = _moving(one, place, -1)
    moving = Doubt("motion after the hold", "method", further.most, further.seen, reason)
    drift = Doubt("drift of the angle's zero", "drift", abs(one.drift), seen=True)
    return [moving, _slips(one), _zero(one, slope), _apart(one), _steps(one.coarse), drift]


def _of_gap(one: Loaded, place: int, most: float) -> list[Doubt]:
    """Effects on the gap between both branches, which unfinished motion would close; above `most` it is withheld."""
    found = [_moving(one, place, side) for side in (-1, 1)]
    half, seen = sum(further.most for further, _ in found), any(further.seen for further, _ in found)
    reason = next((text for further, text in found if further.seen), "")
    slip = _slips(one, 1 / len(one.stairs))
    doubts = [Doubt("motion after the hold", "method", half, seen, reason), slip, _steps(2**0.5 * one.coarse)]
    doubts.append(Doubt("hysteresis of the angle", "method", one.hysteresis, seen=False))
    return [one if one.half > most else replace(one, reason="") for one in doubts]


def _of_flat(one: Loaded, top: int, value: float) -> list[Doubt]:
    """Effects on the pressure where the angle becomes flat, which shifts with the largest angle."""
    further, reason = _moving(one, top, -1)
    P, angles = one.pressure[: top + 1], one.up.mean(axis=0)[: top + 1]

    def by(more: float) -> float:
        moved = [flat_from(P, np.append(angles[:-1], angles[-1] + way * more)) for way in (-1, 1)]
        return max((abs(other - value) for other in moved if other is not None), default=0.0)

    moving = Doubt("motion after the hold", "method", by(further.most), further.seen, reason)
    return [moving, _zero(one, 1.0), _steps(by(2**0.5 * one.coarse))]
