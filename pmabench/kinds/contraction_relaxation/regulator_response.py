"""The regulator from command to measured pressure: dead time and one lag or two, from the steps of contraction runs.

    (P - P_0) / (P_1 - P_0) = 1 - exp(-s / T),  or  1 - (T_1 exp(-s / T_1) - T_2 exp(-s / T_2)) / (T_1 - T_2)

with s the time since command and dead time. The pressure fit does not need it: it is driven by what was measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import log, sqrt

import numpy as np

from pmabench.analysis.results import Estimate, Finding, Parts
from pmabench.analysis.shared import skew
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array

METHOD = "regulator-response"
BEFORE, AFTER = 0.1, 2.0
"""What of a step is fitted: from so long before the command to so long after it [s]."""
FALL = 6.0
"""A second lag is reported where the corrected Akaike criterion falls by more than this."""
NAMES = ("dead time", "lag", "second lag")
FEWEST = 20
STEPS, NUDGE, GAIN = 100, 1.5e-8, 1e-10
"""A fit takes so many steps at most, with slopes over so small a change, until the sum of squares falls by less."""


@dataclass(frozen=True)
class Response:
    """Dead time and lags [s] of one pressure, their standard errors, and rms [1] of what the fit misses of the step."""

    times: tuple[float, ...]
    errors: tuple[float, ...]
    rms: float


def response(t: Array, y: Array) -> Response | None:
    """Fit to a step y (n,) from 0 to about 1 over the time since the command t (n,) [s]; None where none fits."""
    one = _fitted(t, y, 1)
    if one is None:
        return None
    two = _fitted(t, y, 2)
    if two is None or two[1] > one[1] - FALL or two[0].times[2] < float(np.median(np.diff(t))):
        return one[0]
    return two[0]


def step(since: Array, times: Sequence[float]) -> Array:
    """The response to a step at 0, over the time since it [s], shape (n,); `times` = dead time, one or two lags [s]."""
    s = np.maximum(0.0, since - times[0])
    if len(times) == 2:
        return np.asarray(-np.expm1(-s / times[1]))
    T_1, T_2 = times[1], min(times[2], 0.999 * times[1])
    return np.asarray(1 - (T_1 * np.exp(-s / T_1) - T_2 * np.exp(-s / T_2)) / (T_1 - T_2))


def _fitted(t: Array, y: Array, lags: int) -> tuple[Response, float] | None:
    """Best fit with so many lags and its corrected Akaike criterion; unknowns: end value, dead time, ln lags."""
    risen = np.flatnonzero(y > 0.632)
    if len(t) < FEWEST or not len(risen):
        return None
    first = max(2e-3, float(t[risen[0]]))

    def times(z: Array) -> tuple[float, ...]:
        lag = float(np.exp(z[2]))
        return (float(z[1]), lag) if lags == 1 else (float(z[1]), lag, lag / (1 + float(np.exp(z[3]))))

    start = [1.0, 0.3 * first, log(0.7 * first), *([1.0] * (lags - 1))]

    def missed(z: Array) -> Array:
        return np.asarray(z[0] * step(t, times(z)) - y)

    with np.errstate(all="ignore"):  # far from the values a step may overflow; it is not taken
        found, slope = _least(missed, np.array(start))
    n, p = len(t), lags + 3
    power = max(float(np.sum(missed(found) ** 2)), 1e-18 * n)
    values = times(found)
    if not np.all(np.isfinite(slope)) or values[0] < -BEFORE or values[1] > AFTER:
        return None
    nudges = 1e-5 * np.eye(lags + 2)
    slopes = np.array([np.subtract(times(found + by), times(found - by)) / 2e-5 for by in nudges])
    covariance = np.linalg.pinv(slope.T @ slope) * power / (n - p)
    errors = np.sqrt(np.maximum(0.0, np.diag(slopes.T @ covariance @ slopes)))
    aicc = n * log(power / n) + 2 * p + 2 * p * (p + 1) / (n - p - 1)
    return Response(values, tuple(float(e) for e in errors), sqrt(power / n)), aicc


def _least(missed: Callable[[Array], Array], z: Array) -> tuple[Array, Array]:
    """Unknowns with the least sum of squares of `missed` near z, and its slopes there, by damped Gauss-Newton.

    Of its own, for `scipy.optimize` takes longer to import than all of a reduction.
    """
    left, damping = missed(z), 1e-3
    slope = np.empty((len(left), len(z)))
    for _ in range(STEPS):
        for place in range(len(z)):
            ahead = z.copy()
            ahead[place] += NUDGE * max(1.0, abs(z[place]))
            slope[:, place] = (missed(ahead) - left) / (ahead[place] - z[place])
        normal, pull = slope.T @ slope, slope.T @ left
        moved = False
        while damping < 1e9 and not moved:
            move = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal)), -pull, rcond=None)[0]
            new = missed(z + move)
            moved = bool(new @ new < left @ left)
            damping *= 0.1 if moved else 10.0
        if not moved:
            break
        gain = 1 - (new @ new) / (left @ left)
        z, left = z + move, new
        if gain < GAIN:
            break
    return z, slope


def regulator(campaign: Campaign) -> tuple[list[Estimate], list[Finding]]:
    """Dead time and lags [s] at each tested pressure and over all of them, and how well they describe the steps."""
    found = responses(campaign)
    if not found:
        return [], [Finding("note", "the regulator's dead time and lag are not identifiable: no step of the pressure")]
    estimates = [e for P, (one, trials) in found.items() for e in _at(campaign, P, one, trials)]
    whole = [e for place, name in enumerate(NAMES) for e in _over_all(campaign, place, name, found)]
    worst, (one, _) = max(found.items(), key=lambda item: item[1][0].rms)
    lags = " and ".join(show(lag, "time", 3) for lag in one.times[1:])
    text = (
        f"regulator: dead time and lag describe the steps of the pressure within {100 * one.rms:.2g} % of the step,"
        f" rms, at {show(worst, 'pressure', 4)} ({show(one.times[0], 'time', 3)}, then {lags})"
    )
    return [*estimates, *whole], [Finding("note", text)]


def responses(campaign: Campaign) -> dict[float, tuple[Response, tuple[str, ...]]]:
    """Fit to the mean step at each tested pressure [Pa], with the names of its trials; none where none fits."""
    found: dict[float, tuple[Response, tuple[str, ...]]] = {}
    for P in campaign.tested:
        rises = [rise for number in range(len(campaign.trials)) if (rise := _rise(campaign, number, P)) is not None]
        if rises:
            fitted = response(rises[0][1], np.mean([y for _, _, y in rises], axis=0))
            if fitted is not None:
                found[P] = fitted, tuple(name for name, _, _ in rises)
    return found


def _rise(campaign: Campaign, number: int, P: float) -> tuple[str, Array, Array] | None:
    """Name, time since the command and share of the step, of the first command of a trial at P [Pa]."""
    trial, samples = campaign.trials[number], campaign.samples[number]
    if trial.point["pressure"] != P:
        return None
    steps = sorted((c for c in trial.commands if c.output == "pressure"), key=lambda c: c.t)
    if not steps or steps[0].kind != "set" or steps[0].value <= steps[0].before:
        return None
    end = min(AFTER, (steps[1].t if len(steps) > 1 else float(trial.t[-1])) - steps[0].t)
    grid = np.arange(-BEFORE, end, 1 / campaign.rate)
    ok = samples.ok
    at = steps[0].t + grid
    if ok.sum() < FEWEST or at[0] < trial.t[0] - 1e-9 or at[-1] > trial.t[-1]:
        return None
    P_read = np.interp(at, samples.t[ok], samples.P[ok])
    begin = float(np.mean(P_read[grid < 0]))
    return trial.name, grid, (P_read - begin) / (steps[0].value - begin)


def _at(campaign: Campaign, P: float, one: Response, trials: tuple[str, ...]) -> list[Estimate]:
    """Dead time and lags at one pressure [Pa]; intervals from the residual."""
    return [
        _estimate(campaign, place, {"pressure": P}, value, Parts(1.96 * error, 0.0), trials)
        for place, (value, error) in enumerate(zip(one.times, one.errors, strict=True))
    ]


def _over_all(
    campaign: Campaign, place: int, name: str, found: Mapping[float, tuple[Response, tuple[str, ...]]]
) -> list[Estimate]:
    """Mean of one time over the pressures, which are unlike conditions: the method part reaches to the farthest."""
    mine = [(one.times[place], one.errors[place]) for one, _ in found.values() if len(one.times) > place]
    if len(mine) < 2:
        return []
    values, errors = np.array(mine).T
    mean = float(values.mean())
    half = 1.96 * float(np.sqrt(np.sum(errors**2))) / len(values)
    reach = float(np.max(np.abs(values - mean)))
    trials = tuple(trial for _, names in found.values() for trial in names)
    low, high = (show(float(end), "time", 3) for end in (values.min(), values.max()))
    note = f"{name}: mean over {len(mine)} pressures, from {low} to {high}"
    return [_estimate(campaign, place, {}, mean, Parts(half, reach), trials, note)]


def _estimate(
    campaign: Campaign, place: int, at: Mapping[str, float], value: float, parts: Parts, trials: tuple[str, ...],
    note: str = "",
) -> Estimate:  # fmt: skip
    """One time [s]; the dead time knows the command's clock only so well."""
    late = skew.off(campaign.runs, "pressure") if place == 0 else 0.0
    parts = replace(parts, calibration=0.0, skew=late)
    symbol = "tau_P" if place else "t_d"
    return Estimate(
        symbol, value, "s", "time", METHOD, at, parts, len(trials), note=note, trials=trials, coordinate=NAMES[place]
    )
