"""Reduction of an arm's bending angle: both branches over pressure at each load, and paper 2's formula fitted to them.

Works on the rests of each staircase of pressure (`stairs`); sentences and figure are in `figures`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmabench.analysis.model_fit import ModelFit, fit_model
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import weighed
from pmabench.analysis.shared.samples import settings_of
from pmabench.analysis.shared.trials import mean_of_trials
from pmabench.base.quantities import show
from pmabench.kinds.arm_angle import RESULTS, departures, figures
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
RESIDUALS = "repeats part: residuals of the fit, or the scatter of the trials where that is larger"


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
    powers = _coefficients(matrix, why, MATRIX, {}, [one.of for one in fits if one.up is not None])
    other = next((e.note for e in estimates if e.withheld and e.method == UP), "")
    estimates += [withhold(e, other) if other and e.value is not None else e for e in powers]
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
        return weighed(e, departures.at_rest(one, place, by_pressure), largest)

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
        found.append(weighed(e, departures.of_flat(one, top, value)))
    if widest is not None:
        gap = float(one.gaps[:, widest].mean())
        e = made("alpha_H", one.gaps[:, widest], 0.0, {channel: gap})
        found.append(weighed(e, departures.of_gap(one, widest, gap)))
    return [*found, *_coefficients(fitted.up, fitted.why, UP, at, [one])]


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
    if len(used) < departures.POWERS:
        return None, f"no powers of the load: {len(used)} loads with a fit, {departures.POWERS} are needed"
    model = MODELS[FORM_LOADS]
    w = np.array([one.mass for one, _ in used])
    most = next(p.high for p in model.parameters if p.name == "load")
    if w.max() > most * (1 + 1e-9):
        return None, f"no powers of the load: they hold up to {most:g} kg"
    start: dict[str, float] = {}
    for i, row in enumerate(UNKNOWN):
        powers = np.polynomial.polynomial.polyfit(w, [up.unknowns[i].value for _, up in used], departures.POWERS - 1)
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
    """The coefficients of a fit, those without an interval as not identifiable."""
    model = MODELS[FORM_LOADS if method == MATRIX else FORM]
    quantities = {p.name: p.quantity for p in model.parameters}
    names = tuple(stair.trial.name for one in loads for stair in one.stairs)
    by_scales = dict.fromkeys(model.fitted) if fit is None else _by_scales(fit, loads)
    found = []
    for name in model.fitted:
        unit = UNITS[quantities[name]]
        power = name.partition("_")[2]
        per = f"per kg{power if power != '1' else ''}" if power not in {"", "0"} else ""
        value, half, note = (None, None, why) if fit is None else fit.identified(name, unit)
        if half is not None:
            note = sentences(per, note, RESIDUALS, "no method part" if method == MATRIX else "")
        parts = Parts(repeats=half, calibration=None if half is None else by_scales[name])
        found.append(
            Estimate("alpha_b", value, unit, quantities[name], method, at, parts, len(names), note=note,
                     trials=names, coordinate=name)
        )  # fmt: skip
    if fit is None:
        return found
    if method == MATRIX:
        return departures.of_loads(found, loads)
    return departures.of_fit(found, loads[0], [u.value for u in fit.unknowns])


def _by_scales(fit: ModelFit, loads: Sequence[Loaded]) -> dict[str, float | None]:
    """Calibration part of each coefficient.

    The gain of the angle scales a and b, its zero shifts a; the gain of the pressure scales c, its zero changes all.
    """
    values = {u.name: u.value for u in fit.unknowns}
    _, shifts = departures.linearized(loads, np.reshape(list(values.values()), (len(UNKNOWN), -1)))
    found, channel = {}, loads[0].channel
    for (name, value), shift in zip(values.items(), shifts.tolist(), strict=True):
        gains = {channel: value if name[0] in "ab" else 0.0, "pressure": value if name[0] == "c" else 0.0}
        lifted = loads[0].per_offset if name in ("a", "a_0") else 0.0
        found[name] = loads[0].scales.part(gains, {channel: lifted, "pressure": shift})
    return found
