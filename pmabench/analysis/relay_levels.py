"""One relay trial: each size of oscillation measured, the loop fitted to it, and what speaks against it.

Two ways stand side by side: the describing function of the relay, and a loop of dead time, lags and gain fitted to the
harmonics of command, pressure and displacement. Friction shows where period and gain change with the size.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, log, pi, sqrt
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis import student
from pmabench.analysis.oscillation import SEEN, extremes, noise_of
from pmabench.base.quantities import show
from pmabench.model.loop import ComplexArray, Loop, ultimate
from pmabench.store.records import Array, RunData, TrialData

SKIPPED = 3
"""Periods after a change of amplitude that do not count."""
FEWEST_PERIODS = 4
HARMONICS = 3
PERIOD_VARIATION = 0.05
LOPSIDED = 0.05
"""Mean command off the bias, over the amplitude, from which on the mean displacement tells a static gain."""
ALIKE = 0.01
"""Ratios of hysteresis to amplitude that differ by less count as one."""
SPREAD = {"period": {"doubt": 0.008, "fault": 0.02}, "gain": {"doubt": 0.025, "fault": 0.045}}
"""Relative change of period and of K_u (describing function) from the largest oscillation to the smallest.

Without friction at most 0.016 and 0.021 were seen in 60 simulated tests (those of `relay_gain.FORM`)."""


@dataclass(frozen=True, eq=False)
class RelayLevel:
    """One size of oscillation, measured."""

    amplitude: float
    """d [Pa]."""
    hysteresis: float
    """h [m]."""
    t0: float
    """From here the periods count [s]."""
    t1: float
    period: float
    """[s]."""
    variation: float
    """Standard deviation of single periods over their mean [1]."""
    swing: float
    """Half of the peak-to-peak displacement, a [m]."""
    K_df: float
    """4 d / (pi sqrt(a^2 - h^2)) [Pa/m]; nan where the swing is not above the hysteresis."""
    static: float
    """Mean displacement from the centre over mean command from the bias [m/Pa]; nan with a symmetric command."""
    loop: Loop | None = None
    K_u: float = float("nan")
    T_u: float = float("nan")
    half_K_u: float = float("nan")
    """Half width of the 95 % interval from the scatter between periods."""
    half_T_u: float = float("nan")
    half_K_df: float = float("nan")
    half_period: float = float("nan")

    def to_dict(self) -> dict[str, Any]:
        """Plain data; what is not known as None."""
        names = ("amplitude", "hysteresis", "t0", "t1", "period", "variation", "swing", "K_df", "static", "K_u", "T_u")
        values = {name: float(getattr(self, name)) for name in names}
        return {name: value if isfinite(value) else None for name, value in values.items()}


@dataclass(frozen=True, eq=False)
class RelayFound:
    """What one trial says; its numbers are those of the largest oscillation, in which friction weighs least."""

    levels: tuple[RelayLevel, ...]
    refused: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def best(self) -> RelayLevel | None:
        """The level with the largest amplitude."""
        return max(self.levels, key=lambda level: level.amplitude) if self.levels else None


def search_of(trial: TrialData) -> Mapping[str, Any] | None:
    """What the law `relay` wrote down in this trial."""
    return next((found for found in trial.found.values() if found.get("relay")), None)


def examine(run: RunData, trial: TrialData, search: Mapping[str, Any]) -> RelayFound:
    """Both ways to K_u and T_u for each amplitude of a trial, or why there are none.

    `search` is what the law `relay` wrote down.
    """
    lag = {name: info.sensor_lag for name, info in run.channels.items()}
    hold = 0.5 / run.rate if run.rate > 0 else 0.0
    levels = [_measure(trial, level, search, lag, hold) for level in search["relay"]]
    known = tuple(level for level in levels if level is not None)
    if not search.get("found", False):
        return RelayFound(known, (str(search.get("reason") or "the relay test did not end by itself"),))
    if not known or len(known) < len(levels):
        return RelayFound(known, (f"fewer than {FEWEST_PERIODS} whole periods at an amplitude",))
    refused, doubts = _friction(known)
    found = RelayFound(known, tuple(refused), tuple(doubts))
    best = found.best
    if best is None:
        return found
    if best.variation > PERIOD_VARIATION:
        refused.append(f"the periods vary by {best.variation:.0%}, at most {PERIOD_VARIATION:.0%} are allowed")
    if not isfinite(best.K_df):
        refused.append("the swing is not above the hysteresis: the relay did not switch by it")
    if best.loop is None:
        doubts.append("no loop of dead time, lags and gain fits: the describing function stands alone")
    noise = noise_of(trial.channels["displacement"][trial.usable])
    if min(level.hysteresis for level in known) < 3 * noise:
        doubts.append("the hysteresis is below three times the noise: noise may have switched the relay")
    return RelayFound(known, tuple(refused), tuple(doubts))


def _friction(levels: tuple[RelayLevel, ...]) -> tuple[list[str], list[str]]:
    """What a change of the oscillation with its size says: a linear loop has one period and one gain at all sizes."""
    ratio = [level.hysteresis / level.amplitude for level in levels]
    if len(levels) < 2 or max(ratio) > (1 + ALIKE) * min(ratio):
        return [], ["one ratio of hysteresis to amplitude at two amplitudes is needed to see friction"]
    small, large = min(levels, key=lambda v: v.amplitude), max(levels, key=lambda v: v.amplitude)
    change = {"period": small.period / large.period - 1, "gain": small.K_df / large.K_df - 1}
    told = (
        f"from {show(large.amplitude, 'pressure')} to {show(small.amplitude, 'pressure')} the period changes by "
        f"{change['period']:+.1%} and the gain by {change['gain']:+.1%}, a linear loop keeps both"
    )
    if any(not abs(change[name]) <= SPREAD[name]["fault"] for name in change):
        return [f"limit cycle with stiction: {told}"], []
    if any(abs(change[name]) > SPREAD[name]["doubt"] for name in change):
        return [], [f"as with friction, {told}"]
    return [], []


def _measure(
    trial: TrialData, level: Mapping[str, Any], search: Mapping[str, Any], lag: Mapping[str, float], hold: float
) -> RelayLevel | None:
    """One amplitude from its samples; None with too few whole periods."""
    switches = np.array([*level["switches"], [level["t1"], search["bias"]]], dtype=float)
    if len(switches) % 2 == 0:
        switches = switches[:-1]
    ups = switches[::2, 0][SKIPPED:]
    if len(ups) < FEWEST_PERIODS + 1:
        return None
    d, h = float(level["amplitude"]), float(level["hysteresis"])
    mask = (trial.t >= ups[0]) & (trial.t < ups[-1]) & trial.usable
    t, x = trial.t[mask], trial.channels["displacement"][mask]
    P = trial.channels["pressure"][mask] if "pressure" in trial.channels else None
    _, values = extremes(t, x, SEEN * noise_of(x))
    swings = np.abs(np.diff(values)) / 2
    periods = np.diff(ups)
    count = len(periods)
    period = float(periods.mean())
    swing = float(swings.mean()) if len(swings) else 0.0
    quantile = float(student.ppf(0.975, count - 1)) / sqrt(count)
    K_df = half_df = float("nan")
    if swing > h:
        K_df = 4 * d / (pi * sqrt(swing**2 - h**2))
        half_df = K_df * quantile * float(np.std(swings, ddof=1)) * swing / (swing**2 - h**2) if len(swings) > 1 else 0
    off = float(_command(switches, float(ups[0]), float(ups[-1]), 1, 0)[0].real) - float(search["bias"])
    static = (float(x.mean()) - float(search["centre"])) / off if abs(off) > LOPSIDED * d else float("nan")
    found = RelayLevel(
        d, h, float(ups[0]), float(ups[-1]), period, float(np.std(periods, ddof=1)) / period, swing, K_df, static,
        half_K_df=half_df, half_period=quantile * float(np.std(periods, ddof=1)),
    )  # fmt: skip
    loop = None if P is None else _fit(t, x, P, switches, ups, lag, hold)
    if loop is None or P is None:
        return found
    truth = ultimate(loop)
    single = [_fit(t, x, P, switches, ups[i : i + 3], lag, hold) for i in range(0, count - 1, 2)]
    each = [ultimate(one) for one in single if one is not None]
    halves = [float("nan"), float("nan")]
    if len(each) > 1:
        wide = float(student.ppf(0.975, len(each) - 1)) / sqrt(len(each))
        halves = [wide * float(np.std([getattr(one, name) for one in each], ddof=1)) for name in ("gain", "period")]
    return RelayLevel(
        d, h, found.t0, found.t1, period, found.variation, swing, K_df, static, loop, truth.gain, truth.period,
        halves[0], halves[1], half_df, found.half_period,
    )  # fmt: skip


def _command(switches: Array, t0: float, t1: float, periods: int, harmonics: int) -> ComplexArray:
    """Mean and amplitudes a_k - j b_k of the piecewise constant command over the `periods` periods of [t0, t1]."""
    omega = 2 * pi * periods / (t1 - t0)
    found = np.zeros(harmonics + 1, dtype=np.complex128)
    for (begin, value), (end, _) in pairwise(switches):
        a, b = max(begin, t0) - t0, min(end, t1) - t0
        if b <= a:
            continue
        found[0] += value * (b - a) / (t1 - t0)
        for k in range(1, harmonics + 1):
            s = -1j * k * omega
            found[k] += value * 2 / (t1 - t0) * (np.exp(s * b) - np.exp(s * a)) / s
    return found


def _harmonics(t: Array, y: Array, omega: float) -> ComplexArray:
    """Amplitudes a_k - j b_k of the harmonics of `y`, by least squares beside a mean and a drift."""
    columns = [np.ones_like(t), t - t.mean()]
    for k in range(1, HARMONICS + 1):
        columns += [np.cos(k * omega * t), np.sin(k * omega * t)]
    fitted, *_ = np.linalg.lstsq(np.column_stack(columns), y, rcond=None)
    return np.asarray(fitted[2::2] - 1j * fitted[3::2])


def _fit(
    t: Array, x: Array, P: Array, switches: Array, ups: Array, lag: Mapping[str, float], hold: float
) -> Loop | None:
    """The loop behind whole periods between `ups` [s]: command to pressure, and pressure to displacement, apart.

    P = exp(-L s)/(1 + T_r s) U and P = (1 + tau s) X / k_g at the harmonics of the oscillation; sensor lags are taken
    off. `hold` [s], half a sample period, is added to L for the hold of a sampled controller. None where no such loop
    comes out.
    """
    t0, t1, periods = float(ups[0]), float(ups[-1]), len(ups) - 1
    at = (t >= t0) & (t < t1)
    if at.sum() < 8 * (HARMONICS + 1) * periods:
        return None
    omega = 2 * pi * periods / (t1 - t0)
    s = 1j * omega * np.arange(1, HARMONICS + 1)
    U = _command(switches, t0, t1, periods, HARMONICS)[1:]
    X = _harmonics(t[at] - t0, x[at], omega) * (1 + lag.get("displacement", 0.0) * s)
    Q = _harmonics(t[at] - t0, P[at], omega) * (1 + lag.get("pressure", 0.0) * s)
    if not (np.all(np.isfinite(X)) and np.all(np.isfinite(Q))) or abs(X[0]) == 0 or abs(Q[0]) == 0:
        return None

    def misfit(p: Array) -> Array:
        off = (U * np.exp(-p[1] * s) / (1 + np.exp(p[0]) * s) - Q) / abs(Q[0])
        return np.concatenate([off.real, off.imag])

    T_r, L = least_squares(misfit, [log(0.2 * 2 * pi / omega), 0.02 * 2 * pi / omega]).x
    columns = np.column_stack([X, X * s])
    design = np.concatenate([columns.real, columns.imag])
    one, slope = np.linalg.lstsq(design, np.concatenate([Q.real, Q.imag]), rcond=None)[0]
    if one <= 0 or slope <= 0 or L < -hold:
        return None
    sensor = lag.get("displacement", 0.0)
    lags = (float(np.exp(T_r)), float(slope / one), *((sensor,) if sensor > 0 else ()))
    try:
        loop = Loop(float(1 / one), float(max(0.0, L) + hold), lags)
        ultimate(loop)
    except ValueError:
        return None
    return loop
