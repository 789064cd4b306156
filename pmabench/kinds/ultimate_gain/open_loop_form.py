"""Departures of open-loop steps from the fitted loop: a valve that limits the flow, channels read in steps.

Uses samples, steps and the fitted parts; knows no controller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, log, sqrt

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.shared.samples import FINE, noise_of
from pmabench.kinds.ultimate_gain.open_loop_fit import Moved, Regulator, Step, beyond_noise, response
from pmabench.kinds.ultimate_gain.ways import lags_of
from pmabench.store.records import Array

HUM = 0.1
"""Averaging time that removes hum of 50 and of 60 Hz [s]."""
CHANCE = 0.3
"""Ratio of a swing to the noise of such a mean below which it counts as noise."""
SETTLED = 0.75
"""Share of the time between steps after which the pressure has settled."""
DITHERED = 0.6
"""Noise of the readings, as a share of a reading step, above which the steps average out."""
OF_STEPS = (2.0, 0.5)
"""Relative error of K_u per reading step of displacement and of pressure over half the swing; T_u has half of it. In
known loops without noise, with 8 to 14 bits, up to 1.8 and 0.33.
"""
LEAST_LATE = 2e-3
"""Lead of the displacement before the pressure from which on the gauge is late [s]."""
MATCHES = 2.0
"""Largest ratio between that lead and a second lag in the pressure for both to be one filter of the gauge."""


def gauge_filter(regulator: Regulator, moved: Moved) -> float:
    """Time constant of an undeclared filter of the gauge [s]; 0 if the steps show none.

    Nothing moves before its pressure does. If the displacement seems to, and the pressure has a second lag of that
    length, the lag belongs to the gauge and not to the regulator.
    """
    early = -moved.late
    matches = early > LEAST_LATE and early / MATCHES < regulator.second < early * MATCHES
    return early if matches else 0.0


def hunting(P: Array, t: Array, steps: Sequence[Step]) -> float:
    """Rms variation of the pressure at rest beyond its noise, relative to the largest step [1]."""
    noise, width, parts = noise_of(P), round(HUM / (t[1] - t[0])), [np.zeros(1)]
    times = [*(step.t for step in steps), 2 * steps[-1].t - steps[-2].t]
    for begin, end in pairwise(times):
        rest = P[(t >= (begin + end) / 2) & (t < end)]
        place = np.arange(len(rest))
        if len(rest) > 9:
            parts.append(rest - np.polyval(np.polyfit(place, rest, 1), place))
    swing = float(np.std(beyond_noise(np.concatenate(parts), width, noise)))
    return swing / max(abs(step.height) for step in steps) if swing > CHANCE * noise / sqrt(width) else 0.0


def better_by(one: tuple[Regulator, Moved], other: tuple[Regulator, Moved], count: int) -> float:
    """Twice the log likelihood ratio of `one` to `other`, both fitted to `count` samples."""
    pressure = other[0].residual / one[0].residual
    return 2 * count * log(pressure * other[1].residual / one[1].residual)


@dataclass(frozen=True)
class Flow:
    """A valve that limits the flow: far from the command, the pressure changes at a constant rate."""

    dead_time: float
    fill: float
    vent: float
    """Lags for steps too small for the limit [s]."""
    rate: float
    """[Pa/s]."""
    better: float
    """Twice the logarithm of its likelihood over that of a second lag, or of a pair that swings."""
    needed: float
    """The same relative to a single lag."""

    def small(self, like: Regulator) -> Regulator:
        """The regulator `like`, with the values for small steps."""
        return replace(like, dead_time=self.dead_time, fill=self.fill, vent=self.vent, second=0.0, swing=0.0)


def flow_limited(t: Array, P: Array, steps: Sequence[Step], sensor: float) -> Flow | None:
    """Fit of such a valve to the mean rise and the mean fall; None if there is no limit.

    `sensor` is the lag of the gauge [s].
    """
    s, curves = _curves(t, P + sensor * np.gradient(P, t), steps)
    if not len(curves):
        return None
    period = float(s[1] - s[0])

    def fitted(start: Sequence[float], shape: Callable[[Array, Array, int], Array]) -> tuple[Array, float]:
        def misfit(p: Array) -> Array:
            return np.concatenate([shape(s - p[0], np.exp(p[1:]), way) - y for way, y in enumerate(curves)])

        more = len(start) - 1
        bounds = ([-2 * period, *[log(period / 10)] * more], [5.0, *[log(20.0)] * more])
        start = np.clip(start, *(np.array(bound) for bound in bounds)).tolist()
        found = least_squares(misfit, start, x_scale=[0.01, *[0.3] * more], bounds=bounds, xtol=1e-8)
        return found.x, 2 * len(s) * log(max(2 * float(found.cost), 1e-30))

    def lags(at: Array, p: Array, way: int) -> Array:
        return response(at, (float(p[way]), *p[2:].tolist()))

    def pair(at: Array, p: Array, way: int) -> Array:
        return response(at, lags_of(float(p[way]), float(p[2]) ** 2))

    def flow(at: Array, p: Array, way: int) -> Array:
        return _limited(at, float(p[way]), float(p[2 + way]))

    late = max(float(np.mean([np.sum(1 - y) for y in curves])) * period, 10 * period)
    dead, lag = 0.2 * late, log(0.8 * late)
    one, single = fitted([dead, lag, lag], lags)
    double = min(fitted([one[0], *one[1:], start], lags)[1] for start in (log(period), lag - log(5.0)))
    half = log(0.5 * late)
    double = min(double, fitted([0.4 * late, half, half, half], pair)[1])
    found, left = fitted([one[0], one[1] - 0.3, one[2] - 0.3, one[1], one[2]], flow)
    fill, vent, *whole = np.exp(found[1:]).tolist()
    height = abs(steps[0].height)
    rates = [height / way for way, lag in zip(whole, (fill, vent), strict=True) if way > lag]
    return Flow(float(found[0]), fill, vent, max(rates), double - left, single - left) if rates else None


def _limited(s: Array, lag: float, whole: float) -> Array:
    """Unit step response at times `s` [s] of a lag [s] behind a flow at which the step would take `whole` [s]."""
    whole = max(whole, lag)
    late = np.maximum(s - (whole - lag), 0.0)
    return np.where(s < whole - lag, np.maximum(s, 0.0) / whole, 1 - lag / whole * np.exp(-late / lag))


def _curves(t: Array, P: Array, steps: Sequence[Step]) -> tuple[Array, list[Array]]:
    """Times after a step [s], and the mean rise and the mean fall from 0 to 1; empty where one is missing."""
    hold = min(b.t - a.t for a, b in pairwise(steps))
    s = np.arange(0.0, hold, float(t[1] - t[0]))
    rows: dict[bool, list[Array]] = {True: [], False: []}
    for step in steps:
        y = np.interp(step.t + s, t, P)
        rest = (t < step.t) & (t >= step.t - (1 - SETTLED) * hold)
        if rest.any():
            before, after = float(P[rest].mean()), float(y[s > SETTLED * hold].mean())
            rows[step.height > 0].append((y - before) / (after - before))
    return s, [np.mean(rows[way], axis=0) for way in (True, False)] if all(rows.values()) else []


def read_in_steps(readings: Sequence[Array], sizes: Sequence[float]) -> tuple[float, float]:
    """Relative errors of K_u and T_u because displacement [m] and pressure [Pa] are read in steps of `sizes` that noise
    does not average out.
    """
    errors = [0.0]
    for y, size, of in zip(readings, sizes, OF_STEPS, strict=True):
        swing = float(np.ptp(y))
        if FINE * swing < size < np.inf and noise_of(y) < DITHERED * size:
            errors.append(of * size / (swing / 2))
    return hypot(*errors), hypot(*errors) / 2
