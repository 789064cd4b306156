"""Pressure steps fitted in two parts: command to pressure, and pressure to displacement; friction; and departures of
the samples from these parts: a valve that limits the flow, channels read in steps.

Uses samples and steps; knows no controller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import exp, hypot, log, sqrt

import numpy as np
from scipy.linalg.lapack import dtbtrs
from scipy.optimize import least_squares

from pmabench.analysis.shared.samples import FINE, noise_of
from pmabench.analysis.shared.signals import SEEN
from pmabench.kinds.ultimate_gain.ways import lags_of
from pmabench.store.records import Array

FEWEST = 100
"""Samples below which nothing is fitted."""
SEGMENT = 0.02
"""Length of the stretches over which the balance of forces is averaged [s]."""
SMOOTHED = 0.05
"""Smoothing time of the difference of measured and fitted pressure [s], whose noise would look like inertia."""
MOVING = 0.1
"""Share of the largest speed above which the sign of Coulomb friction is certain."""
BETTER = 10.0
"""Reduction of the sum of squares, in units of the variance, from which on a second lag is used."""
BOTH = 0.02
"""Relative reduction of the sum of squares from which on inertia and delay are both used: noise in the fitted pressure
makes 0.003.
"""
FURTHER = ("second", "swing")
"""Optional parameters of a regulator, besides dead time and lags."""
DELAYED, HEAVY = (0, 1, 2), (0, 1, 3)
"""Free parameters out of tau in both directions, delay, inertia: with delay only, or inertia only."""
MOST_LATE = 0.2
"""Largest delay or lead of a displacement relative to its pressure [s]."""
OVER = 30.0
"""Lags after which a step response has ended."""
SLIGHT = 1e-7
"""Inertia over stiffness used for zero inertia [s^2]."""


@dataclass(frozen=True)
class Step:
    """One step of the command: time [s], value [Pa], height [Pa]."""

    t: float
    value: float
    height: float


@dataclass(frozen=True)
class Regulator:
    """Command to pressure: gain [1], dead time [s], lags while filling and venting [s], rms residual [Pa].

    `second` is a lag of both directions [s]; `swing` is sqrt(b) [s] of 1 + a s + b s^2 for an oscillating pressure,
    with `fill` and `vent` as a. Each is 0 if not significant.
    """

    gain: float
    dead_time: float
    fill: float
    vent: float
    residual: float
    second: float = 0.0
    swing: float = 0.0

    @property
    def mean(self) -> Regulator:
        """The same with the mean lag in both directions."""
        return replace(self, fill=(self.fill + self.vent) / 2, vent=(self.fill + self.vent) / 2)

    def lags(self, height: float) -> tuple[complex, ...]:
        """Lags [s] of a step of that `height`."""
        lag = self.fill if height > 0 else self.vent
        return (*lags_of(lag, self.swing**2), self.second)


@dataclass(frozen=True)
class Moved:
    """Pressure to displacement near the operating point.

    beta x'' + tau x' + x = x0 + k_g p + curvature p^2 at a time `late` before, p = P - bias, tau by direction.
    """

    x0: float
    """[m]."""
    gain: float
    """k_g [m/Pa]."""
    curvature: float
    """[m/Pa^2]."""
    tau: tuple[float, float]
    """Contracting, relaxing [s]."""
    beta: float
    """[s^2]."""
    residual: float
    """Standard deviation [m]."""
    late: float = 0.0
    """Delay [s], also in place of an inertia hidden by noise; negative if the motion is earlier than the lags say."""

    @property
    def form(self) -> tuple[int, ...]:
        """Its free parameters, see `DELAYED` and `HEAVY`."""
        return HEAVY if not self.late else (*DELAYED, 3) if self.beta else DELAYED

    def fitted(self, t: Array, P: Array, steps: Sequence[Step]) -> Array:
        """Displacement [m] at even times `t` [s], driven by the pressure `P` over the bias [Pa]; same shape."""
        drive, parts = _driven(t, P, steps)
        made = _simulated(drive, parts, self.tau, max(self.beta, SLIGHT), float(t[1] - t[0]))
        return np.interp(t - self.late, t, self.x0 + made @ [self.gain, self.curvature])


@dataclass(frozen=True)
class Balance:
    """Coefficients of p = p0 + x/k_g + bend x^2 + (tau v + beta a)/k_g + c sign(v), tau by direction; SI."""

    gain: float
    """k_g [m/Pa]."""
    tau: tuple[float, float]
    """Contracting, relaxing [s]."""
    beta: float
    """[s^2]."""
    coulomb: float
    """c [Pa]: dry friction during motion; nan where it was not fitted."""


@dataclass(frozen=True)
class Friction:
    """Friction at rest and in motion."""

    gap: float
    """Distance between rests at the bias reached from above and from below, relative to the swing [1]."""
    balance: Balance
    """With the Coulomb term."""


def fit(
    t: Array, x: Array, P: Array, steps: Sequence[Step], lag: float, like: tuple[Regulator, Moved] | None = None
) -> tuple[Regulator, Moved, Friction] | str:
    """Both parts fitted to evenly spaced samples; a message where something did not move. P is relative to the bias.

    `like` are the parts of a longer record, whose form is used.
    """
    if len(t) < FEWEST or np.ptp(P) <= SEEN * noise_of(P) or np.ptp(x) <= SEEN * noise_of(x):
        return "the steps are not to be seen above the noise of pressure or displacement, or not sampled"
    regulator, made = _regulator(t, P, steps, lag, like[0] if like else None)
    quiet = made + beyond_noise(P - made, round(SMOOTHED / (t[1] - t[0])), noise_of(P))
    P, quiet = (y + lag * np.gradient(y, t) for y in (P, quiet))
    moved = _moved(t, x, quiet, steps, balance(t, x, quiet, friction=False), like[1].form if like else None)
    if moved.gain <= 0:
        return "the muscle does not contract as the pressure rises"
    return regulator, moved, _friction(t, x, P, steps)


def response(s: Array, lags: Sequence[complex]) -> Array:
    """Unit step response at times `s` [s] of several lags [s] in series, by partial fractions; two may be a complex
    pair.
    """
    order = sorted((lag for lag in lags if lag != 0), key=abs)
    lags = [lag * (1 + 1e-4 * i) for i, lag in enumerate(order)]  # partial fractions need different lags
    value = np.where(s > 0, 1.0, 0.0)
    for i, lag in enumerate(lags):
        share: complex = 1.0
        for j, other in enumerate(lags):
            share *= 1.0 if i == j else lag / (lag - other)
        value -= np.where(s > 0, (share * np.exp(-np.maximum(s, 0.0) / lag)).real, 0.0)
    return value


def beyond_noise(y: Array, width: int, noise: float) -> Array:
    """Moving means of `y` over `width` samples, times the share of their variance that is not due to white `noise`."""
    half = max(1, width // 2)
    whole, at = np.concatenate([[0.0], np.cumsum(y)]), np.arange(len(y))
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, len(y))
    means = (whole[high] - whole[low]) / (high - low)
    variance = float(np.var(means))
    return np.asarray(means * max(0.0, 1 - noise**2 / (2 * half + 1) / variance if variance else 0.0))


def _regulator(
    t: Array, P: Array, steps: Sequence[Step], sensor: float, like: Regulator | None
) -> tuple[Regulator, Array]:
    """Least squares of the steps through a dead time and a lag for filling and one for venting, and the fitted
    pressure.

    With a second lag, an oscillating pair, or both, where that improves the fit beyond noise (`BETTER`), or where
    `like` has them.
    """
    starts = np.searchsorted(t, [step.t for step in steps])
    shift = float(P[: max(1, starts[0])].mean())
    period = float(np.median(np.diff(t)))

    def made_of(p: Array, more: Sequence[str]) -> Regulator:
        fill, vent, *others = (exp(one) for one in p[1:])
        return Regulator(1.0, float(p[0]), fill, vent, 0.0, **dict(zip(more, others, strict=True)))

    def solved(p: Array, more: Sequence[str]) -> tuple[float, Array]:
        regulator = made_of(p, more)
        made = np.zeros_like(t)
        for step, k in zip(steps, starts.tolist(), strict=True):
            lags = [lag for lag in (*regulator.lags(step.height), sensor) if lag]
            slowest = max(abs(lag) ** 2 / complex(lag).real for lag in lags)
            over = k + int((OVER * slowest + max(p[0], 0.0)) / period) + 1
            made[k:over] += step.height * response(t[k:over] - step.t - p[0], lags)
            made[over:] += step.height
        columns = np.column_stack([np.ones_like(t), made / steps[0].height])
        linear = np.asarray(np.linalg.solve(columns.T @ columns, columns.T @ (P - shift)), dtype=np.float64)
        return float(linear[1]) / steps[0].height, columns @ linear - P + shift

    def fitted(start: Regulator, *more: str) -> tuple[Regulator, Array]:
        """Fit from a start, with `more` parameters free besides the dead time and both lags."""
        lags = [log(getattr(start, name)) for name in ("fill", "vent", *more)]
        bounds = ([-2 * period, *[log(period / 2)] * len(lags)], [5.0, *[log(20.0)] * len(lags)])

        def misfit(p: Array) -> Array:
            return solved(p, more)[1] / steps[0].height

        begin, scale = np.clip([start.dead_time, *lags], *np.array(bounds)), [0.01, *[0.3] * len(lags)]
        found = least_squares(misfit, begin, x_scale=scale, bounds=bounds, xtol=1e-6).x
        gain, residual = solved(found, more)
        return replace(made_of(found, more), gain=gain, residual=float(np.std(residual))), P + residual

    def best(one: tuple[Regulator, Array], other: tuple[Regulator, Array]) -> tuple[Regulator, Array]:
        return other if len(t) * 2 * log(one[0].residual / other[0].residual) > BETTER else one

    if like is not None:
        return fitted(like, *(name for name in FURTHER if getattr(like, name)))
    one = fitted(Regulator(1.0, 0.02, 0.05, 0.05, 0.0))
    lag = one[0].mean.fill
    late, sooner = one[0].dead_time + lag, max(0.0, one[0].dead_time - 0.1 * lag)
    two = fitted(replace(one[0], dead_time=sooner, second=max(0.2 * lag, period)), "second")
    pair = fitted(Regulator(1.0, 0.4 * late, 0.5 * late, 0.5 * late, 0.0, swing=0.4 * late), "swing")
    found = best(best(one, two), pair)
    if found is one:
        return one
    both = (fitted(replace(pair[0], second=share * pair[0].swing), *FURTHER) for share in (0.2, 1.0))
    return best(found, min(both, key=lambda found: found[0].residual))


def balance(t: Array, x: Array, P: Array, *, friction: bool) -> Balance:
    """The force balance averaged over short segments, by least squares; it is linear, and most noise is in P.

    With `friction`, segments slower than a share of the fastest are left out, since there the sign is uncertain and the
    muscle may stick.
    """
    period = float(t[1] - t[0])
    width = max(3, round(SEGMENT / period))
    reach = max(2, width // 2)
    edges = np.arange(reach, len(t) - reach, width)
    around = np.arange(-reach, reach + 1)
    local = np.linalg.pinv(np.vander(around, 3))
    near = x[edges[:, None] + around] @ local.T
    v, a = np.diff(near[:, 2]) / (width * period), np.diff(near[:, 1]) / (width * period**2)

    def mean(y: Array) -> Array:
        whole = np.concatenate([[0.0], np.cumsum((y[1:] + y[:-1]) / 2)])
        return np.asarray(np.diff(whole[edges]) / width)

    away = x - x.mean()
    columns = [np.ones_like(v), mean(away), mean(away**2), np.maximum(v, 0.0), np.minimum(v, 0.0), a]
    rows = np.ones(len(v), dtype=bool)
    if friction:
        columns.append(np.sign(v))
        rows = np.abs(v) > MOVING * float(np.abs(v).max())
    design, y = np.column_stack(columns)[rows], mean(P)[rows]
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = 1.0
    found = np.linalg.lstsq(design / size, y, rcond=None)[0] / size
    slope, up, down, heavy = (float(found[i]) for i in (1, 3, 4, 5))
    slope = slope if slope else float("nan")
    c = float(found[6]) if friction else float("nan")
    return Balance(1 / slope, (up / slope, down / slope), heavy / slope, c)


def _moved(t: Array, x: Array, P: Array, steps: Sequence[Step], start: Balance, form: tuple[int, ...] | None) -> Moved:
    """Least squares of a simulated displacement with the measured pressure as input; `start` gives the start values.

    An inertia cannot be negative, so noise alone would make it too large and the loop too slow. A delay of either sign
    replaces it where that fits better; both are used where that is far better (`BOTH`), or as `form` says.
    """
    period = float(t[1] - t[0])
    swing = float(np.ptp(P))
    drive, parts = _driven(t, P / swing, steps)
    begin = np.array([*np.clip(np.nan_to_num(start.tau), 1e-3, 20.0), 0.0, np.clip(np.nan_to_num(start.beta), 0, 0.01)])

    def whole(p: Array, free: tuple[int, ...]) -> Array:
        """Tau in both directions, delay and inertia, of which some are `free`."""
        values = np.array([0.0, 0.0, 0.0, SLIGHT])
        values[list(free)] = p
        return values

    def solved(p: Array) -> tuple[Array, Array]:
        """Constant, gain and curvature for the `whole` values, and the residual relative to the swing."""
        made = _simulated(drive, parts, (p[0], p[1]), p[3], period)
        late = [np.interp(t - p[2], t, column) if p[2] else column for column in made.T]
        design = np.column_stack([np.ones_like(t), *late])
        linear = np.asarray(np.linalg.solve(design.T @ design, design.T @ x), dtype=np.float64)
        return linear, (design @ linear - x) / float(np.ptp(x))

    def fitted(free: tuple[int, ...]) -> tuple[float, Array]:
        at = list(free)
        low, high = (np.array(limit)[at] for limit in ([1e-4, 1e-4, -MOST_LATE, SLIGHT], [50.0, 50.0, MOST_LATE, 1.0]))

        def misfit(p: Array) -> Array:
            return solved(whole(p, free))[1]

        guess, scale = np.clip(begin[at], low + SLIGHT, high), np.array([0.1, 0.1, 0.01, 1e-3])[at]
        found = least_squares(misfit, guess, x_scale=scale, bounds=(low, high), xtol=1e-5, ftol=1e-7)
        return float(found.cost), whole(found.x, free)

    if form is None:
        cost, p = min(fitted(DELAYED), fitted(HEAVY), key=lambda one: one[0])
        both = fitted((*DELAYED, 3))
        p = both[1] if both[0] < (1 - BOTH) * cost else p
    else:
        p = fitted(form)[1]
    (x0, gain, curvature), residual = solved(p)
    rms = float(np.std(residual)) * float(np.ptp(x))
    up, down, late, beta = p.tolist()
    beta = beta if beta > SLIGHT else 0.0
    return Moved(float(x0), float(gain) / swing, float(curvature) / swing**2, (up, down), beta, rms, late)


def _driven(t: Array, P: Array, steps: Sequence[Step]) -> tuple[Array, list[tuple[int, int, int]]]:
    """Pressure and its square, constant before the first step, and the parts (from, to, index of tau) between steps."""
    limits = [0, *(int(k) for k in np.searchsorted(t, [step.t for step in steps])), len(t)]
    ways = [0, *(0 if step.height > 0 else 1 for step in steps)]
    parts = [(a, b, way) for a, b, way in zip(limits[:-1], limits[1:], ways, strict=True) if b > a]
    even = np.where(np.arange(len(P)) < limits[1], P[: max(1, limits[1])].mean(), P)
    return np.column_stack([even, even * even]), parts


def _simulated(
    drive: Array, parts: Sequence[tuple[int, int, int]], tau: tuple[float, float], beta: float, period: float
) -> Array:
    """Motion x of beta x'' + tau x' + x = `drive`, for each column, from rest; `parts` are (from, to, index of tau).

    The drive between two samples is their mean; the state is continuous between parts.
    """
    u = (drive + np.vstack([drive[:1], drive[:-1]])) / 2
    made = np.empty_like(drive)
    state = np.vstack([drive[0], np.zeros(drive.shape[1])])
    exact = [_transition(T, beta, period) for T in tau]
    for begin, end, way in parts:
        A = exact[way]
        b = np.array([1 - A[0, 0], -A[1, 0]])
        trace, det = float(A[0, 0] + A[1, 1]), float(A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])
        after = np.empty_like(state)
        for row in (0, 1):  # x_k = trace x_(k-1) - det x_(k-2) + contributions of drive and previous state
            w = b[row] * u[begin:end]
            w[1:] += (A[row, 1 - row] * b[1 - row] - A[1 - row, 1 - row] * b[row]) * u[begin : end - 1]
            w[0] += A[row] @ state
            w[1:2] -= det * state[row]
            bands = np.array([[1.0], [-trace], [det]]) * np.ones(len(w))
            value, _ = dtbtrs(bands, w, uplo="L", diag="U")
            after[row] = value[-1]
            if row == 0:
                made[begin:end] = value
        state = after
    return made


def _transition(tau: float, beta: float, period: float) -> Array:
    """exp(A h) of beta x'' + tau x' + x = 0 for (x, x'), from its two poles; shape (2, 2)."""
    root = complex(tau * tau - 4 * beta) ** 0.5
    root = root if abs(root) > 1e-6 * tau else complex(1e-6 * tau)  # partial fractions need different poles
    one, two = (-tau + root) / (2 * beta), (-tau - root) / (2 * beta)
    first, second = np.exp(one * period), np.exp(two * period)
    apart = one - two
    made = np.array([
        [one * second - two * first, first - second],
        [(second - first) / beta, one * first - two * second],
    ]) / apart  # fmt: skip
    return np.asarray(made.real)


def _friction(t: Array, x: Array, P: Array, steps: Sequence[Step]) -> Friction:
    """Difference of the rests at the bias from above and from below, and the Coulomb term of the balance in motion."""
    ends = [step.t for step in steps[1:]] + [steps[-1].t + (steps[-1].t - steps[-2].t)]
    rests = np.array([_rest(t, x, step.t, end) for step, end in zip(steps, ends, strict=True)])
    kinds = np.arange(len(steps)) % 4
    up, above, down, below = (float(rests[kinds == kind].mean()) for kind in range(4))
    swing = up - down
    gap = (above - below) / swing if swing else float("nan")
    return Friction(gap, balance(t, x, P, friction=True))


def _rest(t: Array, x: Array, begin: float, end: float) -> float:
    """End value of the hold from `begin` to `end` [s], by an exponential through its second half."""
    at = (t >= (begin + end) / 2) & (t < end)
    if at.sum() < 9:
        return float("nan")
    thirds = [float(part.mean()) for part in np.array_split(x[at], 3)]
    one, two = thirds[1] - thirds[0], thirds[2] - thirds[1]
    return thirds[2] + two * two / (one - two) if one and 0 < two / one < 0.9 else thirds[2]


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
    """Relative errors of K_u and T_u by quantisation of displacement [m] and pressure [Pa] in steps of `sizes`, where
    noise does not average it out.
    """
    errors = [0.0]
    for y, size, of in zip(readings, sizes, OF_STEPS, strict=True):
        swing = float(np.ptp(y))
        if FINE * swing < size < np.inf and noise_of(y) < DITHERED * size:
            errors.append(of * size / (swing / 2))
    return hypot(*errors), hypot(*errors) / 2
