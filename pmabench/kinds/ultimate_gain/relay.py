"""K_u and T_u of relay tests, by set-point, by a fitted loop.

In one trial a loop of dead time, lags and gain is fitted to the harmonics of command, pressure and displacement for
each size of oscillation. If the period, or the gain by the relay's describing function, changes with the size, the loop
is not linear; dry friction in the pressure balance, and a shape that the fitted loop does not have, distinguish
stiction from a curved characteristic. There is no value where friction shows. Uses the trials' samples and the relay's
record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import exp, hypot, isfinite, log, nan, pi, sqrt
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import noise_of
from pmabench.analysis.shared.signals import HARMONICS, SEEN, extremes, mode_amplitudes
from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain import ways
from pmabench.kinds.ultimate_gain.open_loop_fit import balance
from pmabench.kinds.ultimate_gain.relay_gauge import BETTER, gauge_of, positive_sizes
from pmabench.kinds.ultimate_gain.ways import (
    NOTHING,
    SYMBOLS,
    Examined,
    GainCell,
    Pair,
    lags_of,
    oscillating,
)
from pmabench.model.loop import ComplexArray, Loop, ultimate
from pmabench.store.analyses.results import Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

SKIPPED = 3
"""Periods after a change of amplitude that are left out."""
FEWEST_PERIODS = 4
FEWEST_SAMPLES = 4
"""Fewest samples in each period."""
PERIOD_VARIATION = 0.05
ALIKE = 0.01
"""Largest difference between ratios of hysteresis to amplitude that count as equal."""
SPREAD = {"period": {"doubt": 0.008, "fault": 0.02}, "gain": {"doubt": 0.025, "fault": 0.045}}
"""Relative change of period and of K_u (describing function) from the largest oscillation to the smallest.

Without friction or a kink, at most 0.016 and 0.029 in 200 simulated tests (the same as for `FORM`).
"""
RUBS = 0.015
"""Accepted dry friction in the balance, over the smallest amplitude: 0 without friction, up to 0.011 by noise."""
SHAPE = 0.02
"""Difference of the displacement's third harmonic, over the first, to the fitted loop; unequal damping makes up to
0.013.
"""
QUICKER = -0.005
"""Relative change of the period towards the smallest oscillation below which it is not friction, which lengthens it."""


@dataclass(frozen=True, eq=False)
class RelayLevel:
    """One size of oscillation, measured."""

    amplitude: float
    """Amplitude d [Pa]."""
    hysteresis: float
    """Hysteresis h [m]."""
    t0: float
    """Start of the periods that count [s]."""
    t1: float
    period: float
    """[s]."""
    variation: float
    """Standard deviation of single periods over their mean [1]."""
    described: float
    """4 d / (pi sqrt(a^2 - h^2)) with half the swing a [Pa/m]; nan where that is not above the hysteresis."""
    loop: Loop | None = None
    fitted: Pair = NOTHING
    """K_u and T_u of the fitted loop."""
    coulomb: float = nan
    """Dry friction during motion [Pa], from the pressure balance."""
    unlike: float = nan
    """Difference of the lags of both directions over their sum [1]."""
    shape: float = nan
    """Third harmonic of the displacement over the first, its distance from the fitted loop's [1]."""
    left: float = nan
    """Distance of the pressure's harmonics from those of the fitted regulator, relative to the first [1]."""
    gauge: tuple[float, float] = (0.0, 0.0)
    """Filter of the gauge and its delay [s], of which one is not 0, if the displacement moves before the pressure."""
    known: Pair = NOTHING
    """K_u and T_u of the loop that is fitted with these."""


@dataclass(frozen=True, eq=False)
class RelayFound(Examined):
    """Result of one trial; its values are those of the largest oscillation, in which friction matters least."""

    levels: tuple[RelayLevel, ...]

    @property
    def best(self) -> RelayLevel | None:
        """The level with the largest amplitude."""
        return max(self.levels, key=lambda level: level.amplitude) if self.levels else None

    @property
    def pair(self) -> Pair:
        """K_u and T_u of the fitted loop; NaN if refused."""
        return NOTHING if self.best is None or self.refused else self.best.fitted


def search_of(trial: TrialData, way: str) -> Mapping[str, Any] | None:
    """Record of the search by `relay` or by `levels` in this trial; None without one."""
    return next((found for found in trial.found.values() if found.get(way)), None)


def examine(run: RunData, trial: TrialData, search: Mapping[str, Any]) -> RelayFound:
    """K_u and T_u for each amplitude of a trial, or why there are none.

    `search` is the record of the law `relay`.
    """
    lag = {name: info.sensor_lag for name, info in run.channels.items()}
    hold = 0.5 / run.rate if run.rate > 0 else 0.0
    levels = [_measure(trial, level, search, lag, hold) for level in search["relay"]]
    known = tuple(level for level in levels if level is not None)
    if not search.get("found", False):
        return RelayFound(known, refused=(str(search.get("reason") or "the relay test did not end by itself"),))
    if not known or len(known) < len(levels):
        return RelayFound(known, refused=(f"fewer than {FEWEST_PERIODS} whole periods at an amplitude",))
    refused, doubts = _friction(known, 2 * hold)
    best = max(known, key=lambda level: level.amplitude)
    if best.variation > PERIOD_VARIATION:
        refused.append(f"the periods vary by {best.variation:.0%}, at most {PERIOD_VARIATION:.0%} are allowed")
    if not isfinite(best.described):
        refused.append("the swing is not above the hysteresis: the relay did not switch by it")
    if best.loop is None:
        refused.append("no loop of dead time, lags and gain fits")
    noise = noise_of(trial.channels["displacement"][trial.usable])
    if min(level.hysteresis for level in known) < 3 * noise:
        doubts.append("the hysteresis is below three times the noise: noise may have switched the relay")
    return RelayFound(known, refused=tuple(refused), doubts=tuple(doubts), loop=best.loop)


def _friction(levels: tuple[RelayLevel, ...], sample: float) -> tuple[list[str], list[str]]:
    """Reasons to refuse, and doubts, because the oscillation changes with its size, which that of a linear loop does
    not.

    `sample` is the sample period [s].
    """
    ratio = [level.hysteresis / level.amplitude for level in levels]
    if len(levels) < 2 or max(ratio) > (1 + ALIKE) * min(ratio):
        return [], ["one ratio of hysteresis to amplitude at two amplitudes is needed to see friction"]
    small, large = min(levels, key=lambda v: v.amplitude), max(levels, key=lambda v: v.amplitude)
    change = {"period": small.period / large.period - 1, "gain": small.described / large.described - 1}
    reason = (
        f"from {show(large.amplitude, 'pressure')} to {show(small.amplitude, 'pressure')} the period changes by "
        f"{change['period']:+.1%} and the gain by {change['gain']:+.1%}, a linear loop keeps both"
    )
    changed = {how: any(not abs(change[name]) <= SPREAD[name][how] for name in change) for how in ("doubt", "fault")}
    share = small.coulomb / small.amplitude
    rubs = isfinite(share) and share > RUBS and change["period"] > QUICKER
    if isfinite(share):
        reason += f"; dry friction takes {show(max(0.0, small.coulomb), 'pressure', 2)} of the smaller amplitude"
    if isfinite(small.shape):
        reason += f", the third harmonic is {small.shape:.1%} of the first off that of the fitted loop"
    if rubs or not isfinite(share):
        if changed["fault"] or (rubs and small.shape > SHAPE):
            return [f"limit cycle with stiction: {reason}"], []
        return [], [f"as with friction, {reason}"] if rubs or changed["doubt"] else []
    if changed["fault"]:
        if sample > SPREAD["period"]["doubt"] * large.period:
            return [f"{reason}; a relay that switches at samples, every {show(sample, 'time')}, does the same: sample "
                    "quicker, or take smaller amplitudes if the gain bends within the swing"], []  # fmt: skip
        return [f"not one linear loop, its gain bends within the swing: {reason}; take smaller amplitudes"], []
    return [], [f"as where the gain bends within the swing, {reason}"] if changed["doubt"] else []


def _measure(
    trial: TrialData, level: Mapping[str, Any], search: Mapping[str, Any], lag: Mapping[str, float], hold: float
) -> RelayLevel | None:
    """One amplitude from its samples; None with too few whole periods, or too few usable samples in them."""
    switches = np.array([*level["switches"], [level["t1"], search["bias"]]], dtype=float)
    if len(switches) % 2 == 0:
        switches = switches[:-1]
    ups = switches[::2, 0][SKIPPED:]
    if len(ups) < FEWEST_PERIODS + 1:
        return None
    d, h = float(level["amplitude"]), float(level["hysteresis"])
    mask = (trial.t >= ups[0]) & (trial.t < ups[-1]) & trial.usable
    t, x = trial.t[mask], trial.channels["displacement"][mask]
    if len(t) < FEWEST_SAMPLES * len(ups):
        return None
    P = trial.channels["pressure"][mask]
    _, values = extremes(t, x, SEEN * noise_of(x))
    swings = np.abs(np.diff(values)) / 2
    periods = np.diff(ups)
    count = len(periods)
    period = float(periods.mean())
    swing = float(swings.mean()) if len(swings) else 0.0
    K_df = 4 * d / (pi * sqrt(swing**2 - h**2)) if swing > h else nan
    driving = P + lag.get("pressure", 0.0) * np.gradient(P, t)
    up, down = balance(t, x, driving, friction=False).tau
    found = RelayLevel(
        d, h, float(ups[0]), float(ups[-1]), period, float(np.std(periods, ddof=1)) / period, K_df,
        coulomb=balance(t, x, driving, friction=True).coulomb,
        unlike=abs(up - down) / (up + down) if min(up, down) > 0 else 1.0,
    )  # fmt: skip
    whole = _fit(t, x, P, switches, ups, lag, hold)
    if whole is None:
        return found
    loop, left = whole
    single = [_fit(t, x, P, switches, ups[i : i + 3], lag, hold) for i in range(0, count - 1, 2)]
    pair = Pair.of(loop, [ultimate(one[0]) for one in single if one is not None])
    found = replace(found, loop=loop, fitted=pair, shape=_shape_of(t, x, switches, ups, loop), left=left)
    gauge = gauge_of(*_harmonics(t, {"displacement": x, "pressure": P}, ups, lag))
    again = _fit(t, x, P, switches, ups, lag, hold, gauge) if any(gauge) else None
    return found if again is None else replace(found, gauge=gauge, known=Pair.of(again[0], []))


ONE_LAG = 0.003
"""Distance of the pressure from that of one lag, relative to its first harmonic, from which on two lags, real or a
complex pair, may be fitted. Noise makes 0.001.
"""
ROOTS = (0.05, 0.1, 0.2)
"""Start values of the root of b, relative to the period."""


def _shape_of(t: Array, x: Array, switches: Array, ups: Array, loop: Loop) -> float:
    """Distance of the third harmonic of `x` from that of `loop` with the given command, relative to the first."""
    s, X = _harmonics(t, {"displacement": x}, ups, {})
    U = _command_over(switches, ups, s)
    first, third = (complex(U[k]) * complex(loop.response(complex(s[k]))) for k in (0, 2))
    return float(abs(X[2] / X[0] - third / first))


def _command_over(switches: Array, ups: Array, s: ComplexArray) -> ComplexArray:
    """Amplitudes a_k - j b_k of the piecewise constant command at the harmonics `s` [1/s], between `ups`."""
    t0, t1 = float(ups[0]), float(ups[-1])
    found = np.zeros_like(s)
    for (begin, value), (end, _) in pairwise(switches):
        a, b = max(begin, t0) - t0, min(end, t1) - t0
        if b > a:
            found += value * 2 / (t1 - t0) * (np.exp(-s * a) - np.exp(-s * b)) / s
    return found


def _fit(
    t: Array, x: Array, P: Array, switches: Array, ups: Array, lag: Mapping[str, float], hold: float,
    gauge: tuple[float, float] = (0.0, 0.0),
) -> tuple[Loop, float] | None:  # fmt: skip
    """The loop from whole periods between `ups` [s]: command to pressure, and pressure to displacement, separately.

    P = exp(-L s)/(1 + a s + b s^2) U and P = (1 + tau s + beta s^2) X / k_g at the harmonics of the oscillation; sensor
    lags are corrected, and a filter and a delay of the `gauge` [s]. `hold` [s], half a sample period, is added to L for
    a sampled controller. Also the distance of the pressure from the loop, relative to its first harmonic [1]. None
    where no such loop results.
    """
    if np.count_nonzero((t >= ups[0]) & (t < ups[-1])) < 8 * (HARMONICS + 1) * (len(ups) - 1):
        return None
    s, X, Q = _harmonics(t, {"displacement": x, "pressure": P}, ups, lag)
    U = _command_over(switches, ups, s)
    Q = Q * (1 + gauge[0] * s) * np.exp(gauge[1] * s)
    if not (np.all(np.isfinite(X)) and np.all(np.isfinite(Q))) or abs(X[0]) == 0 or abs(Q[0]) == 0:
        return None
    L, regulator_lags, left = _regulator(s, U, Q)
    muscle = _muscle(s, X, Q)
    if muscle is None or L < -hold:
        return None
    gain, muscle_lags = muscle
    sensor = lag.get("displacement", 0.0)
    lags = (*regulator_lags, *muscle_lags, *((sensor,) if sensor > 0 else ()))
    loop = oscillating(gain, float(max(0.0, L) + hold), lags)
    return None if loop is None else (loop, left)


def _harmonics(t: Array, channels: Mapping[str, Array], ups: Array, lag: Mapping[str, float]) -> list[ComplexArray]:
    """The harmonics `s` [1/s] of the oscillation between `ups`, and their amplitudes in each of the channels, whose
    sensors have the `lag` [s].
    """
    t0, t1 = float(ups[0]), float(ups[-1])
    at, omega = (t >= t0) & (t < t1), 2 * pi * (len(ups) - 1) / (t1 - t0)
    s = (1j * omega * np.arange(1, HARMONICS + 1)).astype(np.complex128)
    found = {name: mode_amplitudes(t[at] - t0, y[at], 1j * omega)[1] for name, y in channels.items()}
    return [s, *(size * (1 + lag.get(name, 0.0) * s) for name, size in found.items())]


def _regulator(s: ComplexArray, U: ComplexArray, Q: ComplexArray) -> tuple[float, tuple[complex, ...], float]:
    """Dead time [s] and lags [s] of the pressure Q behind the command U at the harmonics `s` [1/s], and the residual.

    Q = exp(-L s) U / (1 + a s + b s^2) by least squares.
    """
    period = 2 * pi / float(s[0].imag)
    z = s * period

    def misfit(p: Array) -> Array:
        """Residual with L, a and the root of b relative to the period."""
        off = (U * np.exp(-p[1] * z) / (1 + np.exp(p[0]) * z + sum(p[2:] ** 2) * z**2) - Q) / abs(Q[0])
        return np.concatenate([off.real, off.imag])

    L, lags, squares = _simplest(misfit, ONE_LAG**2)
    return L * period, tuple(lag * period for lag in lags), sqrt(squares)


def _simplest(misfit: Callable[[Array], Array], enough: float) -> tuple[float, tuple[complex, ...], float]:
    """Dead time and lags, relative to the period, of the simplest sufficient regulator; and its sum of squares.

    `misfit` takes (ln a, L, root of b), or the first two for b = 0, relative to the period. One lag is used if its sum
    of squares is at most `enough`, or if two lags are not much better.
    """
    found = least_squares(misfit, [log(0.2), 0.02])
    if 2 * found.cost > enough:
        tried = [least_squares(misfit, [log(2 * root), 0.02, root]) for root in ROOTS]
        best = min(tried, key=lambda one: float(one.cost))
        found = best if best.cost < BETTER * found.cost else found
    a, L, *root = (float(value) for value in found.x)
    return L, lags_of(exp(a), sum(one**2 for one in root)), 2 * float(found.cost)


def _muscle(s: ComplexArray, X: ComplexArray, Q: ComplexArray) -> tuple[float, tuple[complex, ...]] | None:
    """Gain k_g [m/Pa] and lags [s] of the displacement X behind the pressure Q at the harmonics `s` [1/s].

    Q = (1 + tau s + beta s^2) X / k_g by least squares; without beta if that is negative.
    """
    for powers in ((0, 1, 2), (0, 1)):
        found, left = positive_sizes([X * s**power for power in powers], Q)
        if isfinite(left):
            tau, beta = float(found[1] / found[0]), float(found[2] / found[0]) if len(found) > 2 else 0.0
            return float(1 / found[0]), lags_of(tau, beta)
    return None


OF_FRICTION, OF_SHAPE, OF_SIZES = 2.0, 0.5, 1.3
"""Errors of K_u and T_u per friction as a share of the amplitude, per distance of the third harmonic, and per change
between the amplitudes: upper bounds found with play, a second lag and a rate limit in known loops.
"""
OF_LEFT = {"K_u": 9.0, "T_u": 1.0}
"""Errors per square of the pressure's residual, found with venting 1.5 to 3 times as slow as filling."""
LEFT, MOST_LEFT = 0.02, 0.1
"""Residual of the pressure's harmonics from which on the regulator has another form (noise makes 0.006); and share of a
value above which its effect withholds it.
"""
FROM_GAUGE, MOST_GAUGE = 1.3, 0.1
"""Factor on the difference that a filter or a delay of the gauge makes, and share of a value above which it withholds
it."""
FORM = {"K_u": 0.012, "T_u": 0.0045}
"""Relative half width for the form of the fitted loop, with equal damping in both directions."""
UNLIKE, BEYOND = {"K_u": 0.08, "T_u": 0.035}, 0.2
"""The same for unequal damping, per difference of the two lags over their sum, and four times as much beyond `BEYOND`:
lags of 1 to 2 give up to 5 % of K_u, of 1 to 3 up to 6 %.

Both are chosen to cover 95 % of 200 simulated tests without friction: two muscles at 12 to 50 mm, masses of 2 to 13 kg,
dead times of 20 to 60 ms, lags of 50 to 250 ms, amplitudes of 10 to 60 kPa. The largest errors are 2.5 % and 1.0 %.
"""


@dataclass(frozen=True)
class RelayCell(GainCell[RelayFound]):
    """All relay trials at one operating point."""

    called = "relay trials"
    method = "relay-fit"
    alone = "one trial: the repeats part is the scatter between its periods"
    note = "the method part is the difference between the amplitudes, and what the loop's form is worth"
    by_command = False

    def _estimate(self, place: int) -> Estimate:
        e = self.estimate(place, Parts(method=_method_part(self, place)))
        return weighed(e, _doubts([one.found for one in self.good], e.symbol, e.value or 0.0))

    def findings(self) -> list[Finding]:
        """Problems of the trials, and the fitted loop."""
        lines, loop = super().findings(), self.loop
        if loop is None:
            return lines
        text = f"at {self.where} the loop fitted to the relay oscillation has {ways.described(loop)}"
        lines.append(Finding("note", f"{text}: {ways.limit_of(loop)}"))
        return lines

    def traces(self) -> list[Trace]:
        """Displacement and command over the last periods of the largest oscillation."""
        trial, best = self.shown.trial, self.shown.found.best
        if best is None:
            return []
        begin = max(best.t0, best.t1 - 4 * best.period)
        mask = (trial.t >= begin) & (trial.t <= best.t1)
        names = [name for name in ("displacement", "pressure", "pressure_command") if name in trial.channels]
        columns = {"t": trial.t[mask] - begin, **{name: trial.channels[name][mask] for name in names}}
        marks = {"centre": float((search_of(trial, "relay") or {}).get("centre", 0.0)), "hysteresis": best.hysteresis}
        return [self.trace("relay", f"Relay oscillation, {show(best.amplitude, 'pressure')}", columns, marks)]


def _doubts(trials: Sequence[RelayFound], symbol: str, value: float) -> list[Doubt]:
    """Effects on a value of friction or play in the pressure balance, and of another form of the loop.

    Friction is the same at all amplitudes; the smallest one counts, since curvature adds to it at the largest only.
    """
    rubs, shape, left = 0.0, 0.0, 0.0
    for trial in trials:
        known = [level for level in trial.levels if isfinite(level.coulomb)]
        least = min((level.coulomb for level in known), default=0.0)
        rubs = max(rubs, least / max((level.amplitude for level in known), default=1.0))
        if trial.best is not None and isfinite(trial.best.shape):
            shape, left = max(shape, trial.best.shape), max(left, trial.best.left)
    reason = (
        f"dry friction or play takes {rubs:.1%} of the relay's amplitude, at most {RUBS:.1%} is accepted: the loop is "
        "not linear. Take a larger amplitude"
    )
    regulator = (
        f"{left:.1%} of the pressure's swing is not what a regulator of two lags makes of the command: it fills "
        "quicker than it vents, or the other way round. Take open-loop steps, or a rising gain"
    )
    return [
        Doubt("form of the regulator", "method", OF_LEFT[symbol] * left**2 * value, left > LEFT, regulator, MOST_LEFT),
        Doubt("friction in the balance", "method", OF_FRICTION * rubs * value, rubs > RUBS, reason),
        Doubt("form of the loop", "method", OF_SHAPE * shape * value, seen=False),
        _of_gauge(trials, symbol),
    ]


def _of_gauge(trials: Sequence[RelayFound], symbol: str) -> Doubt:
    """Effect of a gauge that is behind the displacement."""
    place = [one for one, *_ in SYMBOLS].index(symbol)
    levels = [trial.best for trial in trials if trial.best is not None and any(trial.best.gauge)]
    changes = [abs(one.known.value[place] - one.fitted.value[place]) for one in levels]
    late = max((sum(one.gauge) for one in levels), default=0.0)
    reason = (
        f"the displacement moves before the measured pressure does: the gauge has a filter or a delay of about "
        f"{show(late, 'time', 2)}. Declare its `sensor_lag`, or take a quicker one"
    )
    half = FROM_GAUGE * max((one for one in changes if isfinite(one)), default=0.0)
    return Doubt("filter or delay of the gauge", "method", half, half > 0, reason, MOST_GAUGE)


def _method_part(cell: RelayCell, place: int) -> float | None:
    """Half width by the method: the fits to the other amplitudes, the form of the loop, and clocks."""
    symbol, apart, form = SYMBOLS[place][0], list[float](), 0.0
    for one in cell.good:
        for level in one.found.levels:
            off = abs(level.fitted.value[place] - one.found.pair.value[place])
            apart += [off] if level is not one.found.best and isfinite(off) else []
        best = one.found.best
        unlike = min(1.0, best.unlike) if best is not None and isfinite(best.unlike) else 0.0
        sided = UNLIKE[symbol] * (unlike + 3 * max(0.0, unlike - BEYOND))
        form = max(form, hypot(FORM[symbol], sided) * one.found.pair.value[place])
    return hypot(OF_SIZES * max(apart), cell.by_clocks(place), form) if apart else None
