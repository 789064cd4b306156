"""Effects of departures from the model on the values of an arm: motion at the end of a hold, a cable that slips, a zero
error in the recorded channels, coarse steps of the angle, a curve that is not of the form.

The form is paper 2's, alpha = a + b / (1 + (p / c)^d), with a, b, c and d polynomials in the load: `terms`, shape (4,
powers), holds a0, a1 ... in its first row, b0, b1 ... in the second, and so on. At one load there is one power.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.shared import student
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.samples import Left
from pmabench.base.quantities import show
from pmabench.kinds.arm_angle.stairs import Loaded, flat_from
from pmabench.store.analyses.results import Estimate, withhold
from pmabench.store.records import Array

LATE = 0.25
"""Share of the gap between both branches; a significant effect above it withholds the gap, a smaller one only widens
the interval.
"""
OFF = 3.0
"""Largest rms misfit of the form, in standard errors of a mean angle."""
POWERS = 5
"""Powers of the load, from 0 on: the form goes through this many loads exactly; only more loads can test it."""
LEAST = 0.003
"""Misfit, as a share of the largest angle, that is too small to count against the form."""


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


def zero_off(one: Loaded) -> str:
    """Message that the vented gauge does not read 0. A reading above 0 may also be air left in the muscle."""
    text = f"with {one.mass:g} kg the pressure reads {show(one.zero, 'pressure', 2)} when it is vented, more than its"
    other = "" if one.zero < 0 else ", or let out what the valve leaves in the muscle"
    return f"{text} calibration allows: zero the gauge{other}"


def _zero(one: Loaded, slope: float) -> Doubt:
    """Effect of the gauge's zero error on a value that changes by `slope` per pascal of reading."""
    return Doubt("zero of the pressure", "calibration", abs(slope * one.zero), one.zero < 0, zero_off(one))


def _apart(one: Loaded, share: float = 1.0) -> Doubt:
    """Effect of the angle's zero error on a value that changes by `share` per radian of reading."""
    return Doubt("zero of the angle against the displacement", "calibration", abs(share * one.apart), seen=False)


def _steps(half: float) -> Doubt:
    return Doubt("steps of the angle", "method", half, seen=False)


def at_rest(one: Loaded, place: int, slope: float) -> list[Doubt]:
    """Effects on an angle of the way up; `slope` is d(angle)/d(pressure) there [rad/Pa]."""
    further, reason = _moving(one, place, -1)
    moving = Doubt("motion after the hold", "method", further.most, further.seen, reason)
    return [moving, _slips(one), _zero(one, slope), _apart(one), _steps(one.coarse)]


def of_gap(one: Loaded, place: int, value: float) -> list[Doubt]:
    """Effects on the gap between both branches, which unfinished motion would close."""
    found = [_moving(one, place, side) for side in (-1, 1)]
    half, seen = sum(further.most for further, _ in found), any(further.seen for further, _ in found)
    reason = next((text for further, text in found if further.seen), "")
    slip = _slips(one, 1 / len(one.stairs))
    doubts = [Doubt("motion after the hold", "method", half, seen, reason), slip, _steps(2**0.5 * one.coarse)]
    doubts.append(Doubt("hysteresis of the angle", "method", one.hysteresis, seen=False))
    return [one if one.half > LATE * abs(value) else replace(one, reason="") for one in doubts]


def of_flat(one: Loaded, top: int, value: float) -> list[Doubt]:
    """Effects on the pressure where the angle becomes flat, which shifts with the largest angle."""
    further, reason = _moving(one, top, -1)
    P, angles = one.pressure[: top + 1], one.up.mean(axis=0)[: top + 1]

    def by(more: float) -> float:
        moved = [flat_from(P, np.append(angles[:-1], angles[-1] + way * more)) for way in (-1, 1)]
        return max((abs(other - value) for other in moved if other is not None), default=0.0)

    moving = Doubt("motion after the hold", "method", by(further.most), further.seen, reason)
    return [moving, _zero(one, 1.0), _steps(by(2**0.5 * one.coarse))]


def of_fit(estimates: Sequence[Estimate], one: Loaded, start: Sequence[float]) -> list[Estimate]:
    """The coefficients of the form at one load, widened by the scatter of the trials, or withheld where the misfit is
    too large.

    `start` are the coefficients fitted to the mean of the trials.
    """
    rows = one.up
    P, mean = one.pressure, rows.mean(axis=0)
    fitted = _fit(P, mean, start)
    text = "the angles lie {} (rms) off this form, {:.0f} of their errors: it is another curve. Take the angles at rest"
    miss = float(np.sqrt(np.sum((_curve(P, fitted) - mean) ** 2) / max(1, len(mean) - len(fitted))))
    if why := _misses(miss, _error(one, rows), float(np.abs(mean).max()), text):
        return [e if e.value is None else withhold(e, why) for e in estimates]
    each = np.array([_fit(P, row, fitted) for row in rows])
    further, seen = _motions(one)
    level, tilted = np.ones(len(mean)), np.linspace(-1.0, 1.0, len(mean))
    moved = np.hypot(*(_fit(P, mean + tilt * further, fitted) - fitted for tilt in (level, tilted)))
    slip, (solve, shifts) = _slips(one), linearized([one], fitted[:, None])
    slipped = np.abs(_fit(P, mean + slip.half * 0.5 * (level + tilted), fitted) - fitted)
    slipped[0] += slip.half  # a shifts by the whole slip, too
    steps = one.coarse * np.linalg.norm(solve, axis=1)
    repeats = np.array([spread(column) or 0.0 for column in each.T])
    return _wider(estimates, [one], repeats, moved, seen, slipped, shifts, steps, slip.reason)


def of_loads(estimates: Sequence[Estimate], loads: Sequence[Loaded]) -> list[Estimate]:
    """The coefficients of the powers of the load, fitted to the ways up of all `loads` and widened by the scatter of
    the trials, unfinished motion and slips; withheld where the misfit is too large.

    `estimates` are named by coordinate (`a_0` and so on). First order: changes of the angles are passed through the
    linearized least squares.
    """
    known = {e.coordinate: e.value for e in estimates}
    terms = np.array([[known[f"{name}_{n}"] for n in range(POWERS)] for name in "abcd"], dtype=np.float64)
    if np.isnan(terms).any():
        return list(estimates)
    solve, shifts = linearized(loads, terms)
    parts = np.split(solve, np.cumsum([len(one.sets) for one in loads])[:-1], axis=1)
    pairs = list(zip(parts, loads, strict=True))
    off = np.concatenate([one.up.mean(axis=0) - _curve(one.pressure, _at(one, terms)) for one in loads])
    miss = float(np.sqrt(off @ off / max(1, len(off) - len(solve))))
    error = float(np.sqrt(np.mean([_error(one, one.up) ** 2 for one in loads])))
    largest = max(float(np.abs(one.mean).max()) for one in loads)
    text = "the angles of all loads lie {} (rms) off the powers of the load, {:.0f} of their errors: take the "
    if len(loads) > POWERS and (why := _misses(miss, error, largest, f"{text}coefficients of each load")):
        return [withhold(e, why) for e in estimates]
    scatter = [np.var(part @ one.up.T, axis=1, ddof=1) / len(one.up) for part, one in pairs if len(one.up) > 1]
    few = sum(len(one.up) - 1 for one in loads)
    repeats = student.ppf(0.975, few) * np.sqrt(np.sum(scatter, axis=0)) if scatter else np.zeros(len(solve))
    motions = [_motions(one) for one in loads]
    moved = np.hypot.reduce([part @ further for part, (further, _) in zip(parts, motions, strict=True)])
    slipped = np.hypot.reduce([_slips(one).half * part.sum(axis=1) for part, one in pairs])
    steps = np.hypot.reduce([one.coarse * np.linalg.norm(part, axis=1) for part, one in pairs])
    seen = any(seen for _, seen in motions)
    return _wider(estimates, loads, repeats, moved, seen, slipped, shifts, steps)


def _motions(one: Loaded) -> tuple[Array, bool]:
    """Motion still to come in each angle of the way up [rad], shape (pressures,), and whether any is significant."""
    motions = [one.motion(place, -1) for place in range(len(one.sets))]
    return np.array([motion.most for motion in motions]), any(motion.seen for motion in motions)


def _misses(miss: float, error: float, largest: float, text: str) -> str:
    """Reason for withholding the coefficients if the rms misfit `miss` [rad] is too large; else empty.

    `error` is the standard error of a mean angle, `largest` the largest angle [rad].
    """
    if miss <= max(OFF * error, LEAST * largest):
        return ""
    return text.format(show(miss, "angle", 2), miss / max(error, 1e-12))


def _wider(
    estimates: Sequence[Estimate], loads: Sequence[Loaded], repeats: Array, moved: Array, seen: bool, slipped: Array,
    shifts: Array, steps: Array, slips: str = "",
) -> list[Estimate]:  # fmt: skip
    """The coefficients, widened by the scatter of the trials, unfinished motion, slips, zero errors and steps of the
    angle.

    Arrays have shape (coefficients,); `shifts` is per pascal. `seen`: the motion is significant; `slips`: reason for
    withholding because of a slip.
    """
    zero, apart = max(loads, key=lambda one: abs(one.zero)), max(loads, key=lambda one: abs(one.apart))
    found = []
    for n, e in enumerate(estimates):
        if e.value is None:
            found.append(e)
            continue
        doubts = [
            Doubt("motion after the hold", "method", float(moved[n]), seen),
            Doubt("slip", "drift", float(slipped[n]), True, slips),
            _zero(zero, float(shifts[n])),
            _apart(apart, 1.0 if e.coordinate in ("a", "a_0") else 0.0),
            _steps(float(steps[n])),
        ]
        wider = replace(e.parts, repeats=max(e.parts.repeats or 0.0, float(repeats[n])))
        found.append(weighed(replace(e, parts=wider), doubts))
    return found


def linearized(loads: Sequence[Loaded], terms: Array) -> tuple[Array, Array]:
    """Sensitivity of all coefficients by linearized least squares: to each angle, shape (4 powers, angles), and to 1 Pa
    more in every pressure reading, shape (4 powers,).
    """
    rows, bends = [], []
    for one in loads:
        _, b, c, d = _at(one, terms)
        P = np.maximum(one.pressure, 1.0)
        with np.errstate(over="ignore", invalid="ignore"):  # a form far from these angles may have infinite powers
            share = (P / abs(c)) ** d
            bent = np.nan_to_num(b * share / (1 + share) ** 2)
        each = np.column_stack([np.ones(len(P)), 1 / (1 + share), bent * d / c, -bent * np.log(P / abs(c))])
        rows.append((each[:, :, None] * one.mass ** np.arange(terms.shape[1])).reshape(len(P), -1))
        bends.append(bent * d / P)
    slopes = np.vstack(rows)
    size = np.sqrt(np.sum(slopes**2, axis=0))
    scale = np.where(size > 0, size, 1.0)
    solve = np.linalg.pinv(slopes / scale, rcond=1e-12) / scale[:, None]
    return np.asarray(solve), np.asarray(solve @ np.concatenate(bends))


def _at(one: Loaded, terms: Array) -> Array:
    """a, b, c, d at the load of `one`, from `terms`, shape (4, powers)."""
    return np.asarray(terms @ one.mass ** np.arange(terms.shape[1]))


def _error(one: Loaded, rows: Array) -> float:
    """Standard error of a mean angle at rest [rad] from `rows` (trials, n), without the common shift of each trial."""
    within = np.sqrt(np.mean(np.var(rows - rows.mean(axis=1, keepdims=True), axis=0, ddof=min(1, len(rows) - 1))))
    return max(float(within), one.noise) / float(np.sqrt(len(rows)))


def _curve(P: Array, terms: Array) -> Array:
    """Angle [rad] of the form of paper 2."""
    a, b, c, d = terms
    with np.errstate(over="ignore"):  # far from the solution a power may be infinite, and its term is then 0
        return np.asarray(a + b / (1 + (np.maximum(P, 0.0) / abs(c)) ** d))


def _fit(P: Array, angles: Array, start: Sequence[float] | Array) -> Array:
    """Coefficients a, b, c, d by least squares, starting from `start`."""
    begin = np.array(start, dtype=np.float64)

    def miss(share: Array) -> Array:
        return np.asarray(_curve(P, share * begin) - angles)

    solved = least_squares(miss, np.ones(len(begin)), method="lm")
    return np.asarray(solved.x * begin)
