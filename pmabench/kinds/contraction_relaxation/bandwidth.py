"""Response of the regulator from command to pressure, fitted to its steps, and small-signal bandwidth (-3 dB) of
contraction.

    (P - P_0) / (P_1 - P_0) = 1 - exp(-s / T),  or  1 - (T_1 exp(-s / T_1) - T_2 exp(-s / T_2)) / (T_1 - T_2)

with s the time since command and dead time. The pooled fit does not need it: its input is the measured pressure.

From the coefficients, at a pressure and with the mass of a load, the command goes through the regulator's lags and the
muscle (dead time changes only the phase):

    |G|^2 = 1 / prod(1 + (omega T_i)^2)  K^2 / ((K - M omega^2)^2 + (B omega)^2),  B = (B_c + B_r)/2

The bandwidth is where |G| first falls to 1/sqrt(2). It does not include friction, which blocks small motions.

Times since a command come from the samples as gathered, whatever the diagnosis corrects for the fit: it brings all
channels behind one filter, or moves those that are in time to one that is late, which is right for a fit of forces.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import hypot, log, pi, sqrt

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.samples import LAG_KNOWN, UNDECLARED, lag_of
from pmabench.analysis.verdict.agreement import weighted
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.diagnosis.corrections import in_samples
from pmabench.kinds.contraction_relaxation.diagnosis.verdict import Diagnosis
from pmabench.kinds.contraction_relaxation.intervals import NORMAL
from pmabench.kinds.contraction_relaxation.segments import Campaign
from pmabench.kinds.contraction_relaxation.values import aicc
from pmabench.store.analyses.results import Estimate, Finding, Parts
from pmabench.store.records import Array


@dataclass(frozen=True)
class Late:
    """How much later than what it measures a sensor reads."""

    declared: float = 0.0
    """Taken off the samples as a delay [s]."""
    found: float = 0.0
    """More than that, by the diagnosis [s]."""
    unsure: float = 0.0
    """Half width of their sum [s]."""
    half_sample: float = 0.0
    """A digital filter is earlier than one of first order by that [s]."""

    @property
    def lag(self) -> float:
        """In all [s]."""
        return self.declared + self.found

    def filter_in(self, lags: Sequence[float], errors: Sequence[float]) -> int | None:
        """Which of several lags of a step is that of a filter of the sensor; None for none."""
        off = [abs(T - self.lag) - NORMAL * error for T, error in zip(lags, errors, strict=True)]
        nearest = min(range(len(off)), key=off.__getitem__)
        reach = LAG_KNOWN * self.lag + self.unsure + self.half_sample
        return nearest if self.lag and len(lags) > 1 and off[nearest] <= reach else None


def in_order(recorded: Campaign, diagnosis: Diagnosis) -> dict[str, Late]:
    """How late pressure and displacement are.

    The diagnosis sees the time between the two: nothing reads ahead, so one that seems to has the other late.
    """
    declared = {channel: [lag_of(run, channel) for run in recorded.runs] for channel in ("pressure", "displacement")}
    mine = [one for one in diagnosis.reported.explanations if one.kind in ("late", "lag") and one.which in declared]
    sizes = {
        name: max(lags) + sum(one.sizes[0] for one in mine if one.which == name) for name, lags in declared.items()
    }
    ahead = {name: max(0.0, -size) for name, size in sizes.items()}
    errors = [NORMAL * one.error for one in diagnosis.of_fit if one.explanation in mine]
    found = {}
    for name, other in zip(declared, reversed(declared), strict=True):
        lag, most = max(0.0, sizes[name]) + ahead[other], max(declared[name])
        known = LAG_KNOWN * most if diagnosis.reason else min(LAG_KNOWN * most, diagnosis.hidden.late(name))
        unsure = hypot(known, most - min(declared[name]), *errors) if lag else 0.0
        found[name] = Late(most, lag - most, unsure, 0.5 / recorded.rate)
    return found


METHOD = "regulator-response"
BEFORE, AFTER = 0.1, 2.0
"""Fitted part of a step: from BEFORE the command to AFTER it [s]."""
FALL = 6.0
"""A second lag is reported where the corrected Akaike criterion falls by more than this."""
NAMES, SENSOR = ("dead time", "lag", "second lag"), "displacement sensor or tube"
BLURRED = 0.75
"""A second lag up to this share of a sample period is what sampling makes of steps, at any times between samples."""
FEWEST = 20
STEPS, NUDGE, GAIN = 100, 1.5e-8, 1e-10
"""Gauss-Newton: most steps, relative difference for derivatives, relative fall of the sum of squares that ends it."""
ROUGH = 1e-5
"""That fall where it is asked only whether there is a second lag."""


@dataclass(frozen=True)
class Response:
    """Dead time and lags [s] at one pressure, their standard errors, and rms of the residual as a share of the step."""

    times: tuple[float, ...]
    errors: tuple[float, ...]
    rms: float
    aicc: float
    """Corrected Akaike criterion."""
    single: Response | None = None
    """Of two lags, the best fit with one."""
    unsure: tuple[float, ...] = ()
    """Half widths of what else is open of the times [s]."""
    filtered: bool = False
    """Whether a filter of the gauge was seen, which is none of the lags."""

    def of_regulator(self, late: Late, period: float) -> Response:
        """The same without what the gauge makes of it, sampled every `period` [s].

        A lag as long as that of the gauge is its filter; without one it has a delay; with another second lag it may
        have either. A short second lag of a gauge of which nothing is known may be that of its filter.
        """
        dead, *lags = self.times
        which = late.filter_in(lags, self.errors[1:])
        if which is not None:
            kept = [1 + i for i in range(len(lags)) if i != which]
            times, errors = ([each[i] for i in kept] for each in (self.times, self.errors))
            unsure = (late.half_sample, *(0.0 for _ in kept))
            return replace(
                self, times=(dead + late.declared, *times), errors=(self.errors[0], *errors), unsure=unsure,
                filtered=True,
            )  # fmt: skip
        one = self.single
        if one is not None and lags[1] < period:
            moved = abs(one.times[0] - dead) if lags[1] > BLURRED * period else 0.0
            return replace(
                one, times=(one.times[0] - late.found, *one.times[1:]), unsure=(hypot(moved, late.unsure), 0.0)
            )
        short = [T if i and T < UNDECLARED and not late.lag else 0.0 for i, T in enumerate(lags)]
        return replace(
            self, times=(dead - late.found, *lags), unsure=(late.lag if len(lags) > 1 else late.unsure, *short)
        )


def response(t: Array, y: Array) -> Response | None:
    """Fit to a step y (n,) from 0 to about 1 over time t (n,) since the command [s]; None where no fit succeeds."""
    one = _fitted(t, y, 1)
    if one is None:
        return None
    two = _fitted(t, y, 2, ROUGH)
    if two is None or two.aicc > one.aicc - FALL:
        return one
    two = _fitted(t, y, 2)
    return one if two is None else replace(two, single=one)


def step(since: Array, times: Sequence[float]) -> Array:
    """Step response over the time since the step [s], shape (n,); `times` = dead time, then one or two lags [s]."""
    s = np.maximum(0.0, since - times[0])
    if len(times) == 2:
        return np.asarray(-np.expm1(-s / times[1]))
    T_1, T_2 = times[1], min(times[2], 0.999 * times[1])
    return np.asarray(1 - (T_1 * np.exp(-s / T_1) - T_2 * np.exp(-s / T_2)) / (T_1 - T_2))


def _fitted(t: Array, y: Array, lags: int, gain: float = GAIN) -> Response | None:
    """Best fit with `lags` lags, until it gains less than `gain`; unknowns: end value, dead time, ln of each lag."""
    risen = np.flatnonzero(y > 0.632)
    if len(t) < FEWEST or not len(risen):
        return None
    first = max(2e-3, float(t[risen[0]]))

    def times(z: Array) -> tuple[float, ...]:
        lag = float(np.exp(z[2]))
        return (float(z[1]), lag) if lags == 1 else (float(z[1]), lag, lag / (1 + float(np.exp(z[3]))))

    start = [1.0, 0.3 * first, log(0.7 * first), *([1.0] * (lags - 1))]
    stepped = lru_cache(maxsize=1)(lambda at: step(t, at))  # the first slope needs the step that was just computed

    def missed(z: Array) -> Array:
        return np.asarray(z[0] * stepped(times(z)) - y)

    with np.errstate(all="ignore"):  # a trial step far from the solution may overflow; it is rejected
        found, slope = _least(missed, np.array(start), gain)
    n, p = len(t), lags + 3
    power = max(float(np.sum(missed(found) ** 2)), 1e-18 * n)
    values = times(found)
    if not np.all(np.isfinite(slope)) or values[0] < -BEFORE or values[1] > AFTER:
        return None
    nudges = 1e-5 * np.eye(lags + 2)
    slopes = np.array([np.subtract(times(found + by), times(found - by)) / 2e-5 for by in nudges])
    covariance = np.linalg.pinv(slope.T @ slope) * power / (n - p)
    errors = np.sqrt(np.maximum(0.0, np.diag(slopes.T @ covariance @ slopes)))
    return Response(values, tuple(errors.tolist()), sqrt(power / n), aicc(power / n, n, p))


def _least(missed: Callable[[Array], Array], z: Array, least: float) -> tuple[Array, Array]:
    """Unknowns with the least sum of squares of `missed` near z, and the Jacobian there, by damped Gauss-Newton,
    until a step lessens it by a smaller share than `least`.

    Written here because importing `scipy.optimize` takes longer than a whole reduction.
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
        if gain < least:
            break
    return z, slope


ONSET = 0.2
"""Share of the time constant of a filter by which it delays an onset that is read off the samples."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A campaign as it was recorded, with what it shows of the regulator."""

    campaign: Campaign
    """With a clock of the pressure corrected."""
    late: Mapping[str, Late]
    """How late pressure and displacement are."""
    responses: Mapping[float, tuple[Response, tuple[str, ...]]]
    """Tested pressure [Pa] -> fit to its mean step, and the names of the trials; none where none fits."""

    @classmethod
    def of(cls, campaign: Campaign, diagnosis: Diagnosis) -> Recorded:
        """From the campaign as gathered, and the diagnosis of its fit."""
        clocks = [one for one in diagnosis.reported.explanations if one.kind == "clock" and one.which == "pressure"]
        late, recorded = in_order(campaign, diagnosis), in_samples(campaign, clocks)
        return cls(recorded, late, _responses(recorded, late["pressure"]))

    @property
    def behind(self) -> dict[str, tuple[float, float]]:
        """How late the onsets of pressure and motion are in the samples, and the half width of that [s]; a filter
        hardly delays an onset.
        """
        gauge, sensor = self.late["pressure"], self.late["displacement"]
        steps = [one for one, _ in self.responses.values()]
        by_gauge = gauge.found, max((one.unsure[0] for one in steps), default=gauge.lag)
        if any(one.filtered for one in steps):
            by_gauge = ONSET * gauge.lag - gauge.declared, ONSET * gauge.lag
        return {"pressure": by_gauge, "motion": (sensor.found, sensor.lag)}


def regulator(recorded: Recorded) -> tuple[list[Estimate], list[Finding]]:
    """Dead time and lags [s] at each tested pressure and over all of them, and how well they describe the steps.

    What comes after the gauge and is not of the muscle, a displacement sensor that is late, or a tube, is reported
    separately: a control loop contains it, too.
    """
    campaign, found, sensor = recorded.campaign, recorded.responses, recorded.late["displacement"]
    if not found:
        return [], [Finding("note", "the regulator's dead time and lag are not identifiable: no step of the pressure")]
    estimates = [  # intervals at one pressure from the residual
        _estimate(campaign, place, {"pressure": P}, value, Parts(NORMAL * error, unsure), trials)
        for P, (one, trials) in found.items()
        for place, (value, error, unsure) in enumerate(zip(one.times, one.errors, one.unsure, strict=True))
    ]
    whole = [e for place, name in enumerate(NAMES) for e in _over_all(campaign, place, name, found)]
    if sensor.lag:
        parts, n = Parts(0.0, sensor.unsure), len(campaign.trials)
        whole.append(Estimate("t_d", sensor.lag, "s", "time", METHOD, {}, parts, n, coordinate=SENSOR))
    worst, (one, _) = max(found.items(), key=lambda item: item[1][0].rms)
    lags = " and ".join(show(lag, "time", 3) for lag in one.times[1:])
    text = (
        f"regulator: dead time and lag describe the steps of the pressure within {100 * one.rms:.2g} % of the step,"
        f" rms, at {show(worst, 'pressure', 4)} ({show(one.times[0], 'time', 3)}, then {lags})"
    )
    return [*estimates, *whole], [Finding("note", text)]


def _responses(campaign: Campaign, late: Late) -> dict[float, tuple[Response, tuple[str, ...]]]:
    """As `Recorded.responses`, for a pressure that is `late`."""
    found: dict[float, tuple[Response, tuple[str, ...]]] = {}
    for P in campaign.tested:
        rises = [rise for number in range(len(campaign.trials)) if (rise := _rise(campaign, number, P)) is not None]
        if rises:
            fitted = response(rises[0][1], np.mean([y for _, _, y in rises], axis=0))
            if fitted is not None:
                found[P] = fitted.of_regulator(late, 1 / campaign.rate), tuple(name for name, _, _ in rises)
    return found


def _rise(campaign: Campaign, number: int, P: float) -> tuple[str, Array, Array] | None:
    """Name, time since the command and share of the step, for the first command of a trial at P [Pa]; None if none."""
    trial, samples = campaign.trials[number], campaign.samples[number]
    if trial.point["pressure"] != P:
        return None
    steps = sorted((c for c in trial.commands if c.output == "pressure"), key=lambda c: c.t)
    if not steps or steps[0].kind != "set" or steps[0].value <= steps[0].before or not steps[0].recorded:
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


def _over_all(
    campaign: Campaign, place: int, name: str, found: Mapping[float, tuple[Response, tuple[str, ...]]]
) -> list[Estimate]:
    """Mean of one time over the pressures, which are unlike conditions: the method part reaches to the farthest."""
    mine = [one for one, _ in found.values() if len(one.times) > place]
    if len(mine) < 2:
        return []
    values, errors, unsure = np.array([(one.times[place], one.errors[place], one.unsure[place]) for one in mine]).T
    mean = float(values.mean())
    half = NORMAL * float(np.sqrt(np.sum(errors**2))) / len(values)
    reach = float(np.max(np.abs(values - mean)))
    trials = tuple(trial for _, names in found.values() for trial in names)
    low, high = (show(float(end), "time", 3) for end in (values.min(), values.max()))
    note = f"{name}: mean over {len(mine)} pressures, from {low} to {high}"
    return [_estimate(campaign, place, {}, mean, Parts(half, hypot(reach, unsure.max())), trials, note)]


def _estimate(
    campaign: Campaign, place: int, at: Mapping[str, float], value: float, parts: Parts, trials: tuple[str, ...],
    note: str = "",
) -> Estimate:  # fmt: skip
    """One time [s]; the uncertainty of the command's clock is added to the dead time."""
    late = skew.off(campaign.runs, "pressure") if place == 0 else 0.0
    parts = replace(parts, calibration=0.0, skew=late)
    symbol = "tau_P" if place else "t_d"
    return Estimate(
        symbol, value, "s", "time", METHOD, at, parts, len(trials), note=note, trials=trials, coordinate=NAMES[place]
    )


MODEL = "bandwidth, by coefficients"
LOWEST, HIGHEST = 0.01, 200.0
"""Range in which a bandwidth is searched [Hz]."""
EXACT = 1e-9
"""Largest imaginary part of a root that counts as real, relative to its size."""
SHIFT = 1e-3


def of_model(K: float, B: float, M: float, lags: Sequence[float]) -> float | None:
    """Bandwidth [Hz] with K [N/m], B [N.s/m], M [kg] and the regulator's lags [s]; None outside the range.

    With w = omega^2, |G|^2 = 1/2 where prod(1 + T_i^2 w) ((K - M w)^2 + B^2 w) = 2 K^2: the lowest root above 0.
    """
    if K <= 0 or B < 0:
        return None
    left = np.array([(M / K) ** 2, (B / K) ** 2 - 2 * M / K, 1.0])
    for T in lags:
        left = np.convolve(left, [T * T, 1.0])
    left[-1] -= 2.0
    w = np.roots(left)
    f = np.sqrt(w.real[(np.abs(w.imag) < EXACT * np.abs(w)) & (w.real > 0)]) / (2 * pi)
    return float(f.min()) if len(f) and LOWEST < f.min() < HIGHEST else None


def estimates(campaign: Campaign, found: Sequence[Estimate], recorded: Recorded) -> list[Estimate]:
    """f_b [Hz] at each tested pressure with the least and the largest load.

    `found` are the primary method's estimates. Method part: half the difference between the bandwidths with B_c and
    with B_r, and the method parts of K and B.
    """
    loads = sorted({sample.load for sample in campaign.samples})
    chosen = list(dict.fromkeys((loads[0], loads[-1])))
    by = {(e.symbol, e.at["pressure"]): e for e in found if set(e.at) == {"pressure"} and e.value is not None}
    known = {P: one for P, (one, _) in recorded.responses.items()}
    made = (_by_coefficients(campaign, P, load, by, known.get(P)) for P in campaign.tested for load in chosen)
    return [e for e in made if e is not None]


def _by_coefficients(
    campaign: Campaign, P: float, load: float, by: dict[tuple[str, float], Estimate], response: Response | None
) -> Estimate | None:
    """At one pressure [Pa] and load [N]; None where a coefficient or the regulator's response is unknown."""
    known = [by[symbol, P] for symbol in ("K", "B_c", "B_r") if (symbol, P) in by]
    if response is None or len(known) < 3:
        return None
    K, B_c, B_r = (float(e.value or 0.0) for e in known)
    trial, sample = next((t, s) for t, s in zip(campaign.trials, campaign.samples, strict=True) if s.load == load)
    M, B, lags = float(trial.point.get("mass", sample.mass)), 0.5 * (B_c + B_r), response.times[1:]
    value = of_model(K, B, M, lags)
    if value is None:
        return None

    def change(K: float, B: float, lags: Sequence[float]) -> float:
        return (of_model(K, B, M, lags) or value) - value

    by_K = change(K * (1 + SHIFT), B, lags) / (SHIFT * K)
    by_B = 0.5 * change(K, B * (1 + SHIFT), lags) / (SHIFT * B)
    by_lag = [
        change(K, B, [T * (1 + SHIFT * (i == j)) for j, T in enumerate(lags)]) / (SHIFT * lag)
        for i, lag in enumerate(lags)
    ]
    parts = weighted(list(zip(known, (by_K, by_B, by_B), strict=True)), "f_b").parts
    times = hypot(*(slope * NORMAL * error for slope, error in zip(by_lag, response.errors[1:], strict=True)))
    apart = 0.5 * abs(change(K, B_c, lags) - change(K, B_r, lags))
    repeats = None if parts.repeats is None else hypot(parts.repeats, times)
    parts = replace(parts, repeats=repeats, method=hypot(parts.method or 0.0, apart))
    note = f"K, (B_c + B_r)/2, M {M:.3g} kg, regulator {' and '.join(show(T, 'time', 3) for T in lags)}"
    names = tuple(dict.fromkeys(name for e in known for name in e.trials))
    at = {"pressure": P, "load": load}
    return Estimate("f_b", value, "Hz", "frequency", MODEL, at, parts, len(names), note=note, trials=names)
