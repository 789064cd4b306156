"""Second-order motion under a piecewise constant pressure: its exact response, and its fits.

One fit has a delay behind the measured pressure, and K and B that change along the step: several forms of that change
are fitted, and all that fit about equally well count as possible.

The response to a change is the unit step response of w^2 / (s^2 + 2 D w s + w^2); the response at a time is the sum
over all changes before it. For each pole p the sum is one decaying number, Z(t) = sum of dP_j exp(p (t - t_j)), which
is updated from sample to sample; it is computed for all samples by cumulative sums over stretches that are short enough
for exp(p t).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pmabench.analysis.shared.samples import autocorrelation
from pmabench.store.records import Array

REACH = 200.0
"""exp(REACH) is far below the largest number, and its inverse far above the smallest."""
EQUAL = 1e-6
"""Damping ratios closer to 1 than this are computed as 1 + EQUAL: partial fractions need two different poles."""

FREQUENCY = (3.0, 400.0)
DAMPING = (0.01, 20.0)
"""Bounds of natural frequency [rad/s] and damping ratio [1] of the motion; a fit at a bound is not a result."""
FEWEST = 12
"""Fewest samples of a stretch of free oscillation."""
LAGS = (0.005, 0.01, 0.02, 0.04)
"""Lags [s] between measured and driving pressure that are tried."""
PERIODS = 1.5
"""Length of a stretch of free oscillation, in periods."""
CLEAR = 20.0
"""Standard deviations of noise above which an oscillation is clear."""
REACHED, SETTLED = 0.02, 1.8
"""Free oscillation starts at SETTLED times the time [s after the step] at which the pressure is within REACHED of its
end.
"""
SHOWN = 5.0
"""Standard deviations of noise beyond the end position above which an extreme counts."""


@dataclass(frozen=True)
class Motion:
    """x'' + 2 D w x' + w^2 x = w^2 g P, fitted with one assumed delay of the pressure's stamps."""

    late: float
    """[s]."""
    w: float
    """Natural frequency [rad/s]."""
    D: float
    """Damping ratio [1]."""
    g: float
    """Stroke per pressure [m/Pa]."""
    rms: float
    """[m]."""
    model: Array

    @property
    def decay(self) -> float:
        """Rate at which the slowest part of the motion dies [1/s]."""
        return self.w * (self.D - sqrt(max(0.0, self.D**2 - 1))) if self.D > 1 else self.D * self.w


def fit_motion(t: Array, P: Array, x: Array, late: float) -> Motion:
    """Least squares of the driven motion over natural frequency and damping; gain and offset follow linearly.

    The measured pressure changes half way between two different samples, which causes no delay for channels that change
    at each sample or polled ones, and is shifted `late` [s] earlier. The response is the sum of the exact step
    responses to all changes, without resampling.
    """
    at, jumps = _jumps(t, P, late)

    def answer(p: Array) -> tuple[Array, float]:
        driven = Answer(t, at, float(np.exp(p[0])), float(np.exp(p[1]))).to(jumps)
        off = driven - driven.mean()
        power = float(np.sum(off * off))
        g = float(np.sum(off * x)) / power if power > 0 else 0.0
        return np.asarray(x.mean() + g * off), g

    def misfit(p: Array) -> Array:
        return np.asarray((answer(p)[0] - x) / scale)

    scale = max(float(np.ptp(x)), 1e-9)
    start = np.log([40.0, 0.3])
    bounds = (np.log([FREQUENCY[0], DAMPING[0]]), np.log([FREQUENCY[1], DAMPING[1]]))
    solved = least_squares(misfit, start, bounds=bounds, max_nfev=60)
    model, g = answer(solved.x)
    rms = float(np.sqrt(np.mean((model - x) ** 2)))
    w, D = (float(value) for value in np.exp(solved.x))
    return Motion(late, w, D, g, rms, model)


def _jumps(t: Array, P: Array, late: float) -> tuple[Array, Array]:
    """Times of the changes of a pressure, half way between two samples and `late` [s] earlier, and their sizes [Pa]."""
    steps = np.diff(P)
    changes = np.flatnonzero(steps) + 1
    return 0.5 * (t[changes - 1] + t[changes]) - late, steps[changes - 1]


def from_rest(P: Array, rest: float) -> Array:
    """A pressure [Pa] with the rest value as first sample, whose noise would otherwise act as a step."""
    return np.concatenate([[rest], P[1:]])


def behind(t: Array, y: Array, lag: float) -> Array:
    """Reading of a sensor with a first-order `lag` [s] for input `y` at times `t` [s], shape (n,); at rest before,
    exact for input linear between the samples.
    """
    if lag <= 0:
        return y
    length = np.diff(t) / lag
    keep = np.exp(-length)
    new = 1.0 - (1.0 - keep) / length
    read = np.empty(len(y))
    read[0] = y[0]
    for k, (kept, share) in enumerate(zip(keep, new, strict=True)):
        read[k + 1] = kept * read[k] + (1.0 - kept - share) * y[k] + share * y[k + 1]
    return read


def before_sensor(t: Array, y: Array, lag: float, over: float) -> Array:
    """Input of a sensor with a first-order `lag` [s] that reads `y`, shape (n,), as means over a time `over` [s].

    The input is y + lag y', so its mean is the mean of y plus lag times the change of y over that time.
    """
    until, since = np.minimum(t + over / 2, t[-1]), np.maximum(t - over / 2, t[0])
    area = np.concatenate(([0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))))
    change = lag * (np.interp(until, t, y) - np.interp(since, t, y))
    return np.asarray((np.interp(until, t, area) - np.interp(since, t, area) + change) / (until - since))


def extremes(x: Array, end: float, noise: float) -> int:
    """Number of alternating extremes beyond the `end` [m] after a motion x, shape (n,), first reached it."""
    away = (x - end) * (1.0 if end >= x[0] else -1.0)
    count, side = 0, 1.0
    reached = np.flatnonzero(away >= 0)
    for value in away[reached[0] :] if len(reached) else ():
        if side * value > SHOWN * noise:
            count, side = count + 1, -side
    return count


@dataclass(frozen=True)
class Swing:
    """A stretch of free oscillation about the end: natural frequency, damping ratio, amplitude in its middle [m]."""

    w: float
    D: float
    size: float
    expected: float
    """Amplitude of the driven motion there [m]."""


def free_swings(t: Array, P: Array, x: Array, known: Motion, noise: float) -> list[Swing]:
    """Consecutive stretches after the pressure has reached its end; they do not depend on the pressure's time."""
    off = np.abs(P - np.median(P[t > t[-1] - 1.0])) > REACHED * np.ptp(P)
    begin = max(0.0, SETTLED * float(t[np.flatnonzero(off)[-1]])) if off.any() else 0.0
    length = PERIODS * 2 * np.pi / known.w
    at, jumps = _jumps(t, P, known.late)
    model = known.g * Answer(t, at, known.w, known.D).to(jumps)
    found: list[Swing] = []
    while begin + length < t[-1]:
        rows = (t > begin) & (t <= begin + length)
        if np.count_nonzero(rows) < FEWEST or (found and found[-1].size < CLEAR * noise):
            break
        swing, expected = _free(t[rows], x[rows], known), _free(t[rows], model[rows], known)
        found.append(replace(swing, expected=expected.size))
        begin += length
    return found


def _free(t: Array, x: Array, known: Motion) -> Swing:
    """Fit of one stretch: end + (A cos + B sin) of a decaying oscillation; end, A, B follow by linear least squares."""
    since = t - t[0]

    def shapes(p: Array) -> Array:
        decay, turn = np.exp(-np.exp(p[0]) * since), np.exp(p[1]) * since
        return np.column_stack([np.ones(len(since)), decay * np.cos(turn), decay * np.sin(turn)])

    def misfit(p: Array) -> Array:
        design = shapes(p)
        return np.asarray(design @ np.linalg.lstsq(design, x, rcond=None)[0] - x) / max(float(np.ptp(x)), 1e-9)

    solved = least_squares(misfit, np.log([known.D * known.w, known.w * sqrt(1 - min(known.D, 0.9) ** 2)]), max_nfev=60)
    terms = np.linalg.lstsq(shapes(solved.x), x, rcond=None)[0]
    rate, turn = (float(value) for value in np.exp(solved.x))
    w = float(np.hypot(rate, turn))
    return Swing(w, rate / w, float(np.hypot(*terms[1:]) * np.exp(-rate * since[-1] / 2)), 0.0)


class Answer:
    """Response at times `t` [s] to steps at times `at` [s], both ascending, shapes (n,), (m,); keeps its exponentials.

    `w` is the natural frequency [rad/s], `D` the damping ratio. `to(jumps)` has shape (n,) and the unit of the steps.
    """

    def __init__(self, t: Array, at: Array, w: float, D: float) -> None:
        self._before = np.searchsorted(at, t, side="right")
        if abs(D - 1.0) < EQUAL:
            D = 1.0 + EQUAL
        if D < 1:
            root = sqrt(1 - D * D)
            poles: dict[complex, complex] = {complex(-D * w, w * root): complex(1.0, -D / root)}
        else:
            root = sqrt(D * D - 1)
            slow, fast = w * (D - root), w * (D + root)
            poles = {-slow: fast / (fast - slow), -fast: -slow / (fast - slow)}
        decaying = poles.items() if len(at) else ()
        self._parts = [(weight, _Decaying(t, at, self._before, pole)) for pole, weight in decaying]

    def to(self, jumps: Array) -> Array:
        """The response to steps `jumps`, shape (m,), one at each of the times `at`."""
        answer = np.concatenate(([0.0], np.cumsum(jumps)))[self._before]
        for weight, part in self._parts:
            answer -= (weight * part.to(jumps)).real
        return answer


class _Decaying:
    """Z(t) = sum of jumps exp(pole (t - at)) over the `before` changes before each time; Re pole < 0."""

    def __init__(self, t: Array, at: Array, before: NDArray[np.intp], pole: complex) -> None:
        stretch = REACH / -pole.real
        number = np.floor((at - at[0]) / stretch)
        first = np.flatnonzero(np.diff(number, prepend=-1.0))
        starts, self._ends = at[first], [*first[1:], len(at)]
        self._first = first
        self._since = np.exp(-pole * (at - np.repeat(starts, np.diff(first, append=len(at)))))
        self._faded = np.exp(pole * np.diff(starts, prepend=starts[0]))
        seen = np.flatnonzero(before)
        self._seen, self._index = (slice(seen[0], None) if len(seen) else slice(0, 0)), before[seen] - 1
        group = np.searchsorted(first, self._index, side="right") - 1
        self._then, self._size = np.exp(pole * (t[seen] - starts[group])), len(t)

    def to(self, jumps: Array) -> NDArray[np.float64 | np.complex128]:
        """The sum at all times, shape (n,), of jumps of shape (m,)."""
        grown = jumps * self._since
        sums, carried = np.empty_like(grown), 0j
        for begin, end, faded in zip(self._first, self._ends, self._faded, strict=True):
            np.cumsum(grown[begin:end], out=sums[begin:end])
            if begin:
                sums[begin:end] += carried * faded
            carried = sums[end - 1]
        result = np.zeros(self._size, dtype=grown.dtype)
        result[self._seen] = sums[self._index] * self._then
        return result


FREE = 0.04
"""Bounds of a fitted delay between pressure and motion, either sign [s]."""
BOUND = 0.99
"""A delay beyond this share of `FREE` counts as at its bound."""
HEAVIEST = 200.0
"""Largest damping ratio with a fitted delay: the mass then has no visible effect."""
FASTEST = 8e-3
"""A mass whose pole M/B is faster than this [s] may hide behind a delay."""
WIDE = 3.0
"""Half width of the interval in standard deviations; wider than usual, since noise of the pressure acts on the model
and is partly fitted.
"""
REMAINS = 0.3
"""Share of the change by an additional column that is added to the half widths."""


@dataclass(frozen=True)
class Delayed:
    """A driven motion whose delay behind the measured pressure was fitted with it; half widths of 95 % intervals."""

    tau: float
    """Time constant B/K at the pressure that the step ends at, 2 D/w [s]."""
    half_tau: float
    delay: float
    """Delay of the motion behind the measured pressure [s]; negative where the pressure's stamps are late."""
    half_delay: float
    rms: float
    """Rms residual [m]."""
    place: Array
    """Solution of the fit: delay over `FREE`, logarithms of damping ratio and natural frequency."""
    K: float
    """Stiffness over mass, w^2 [1/s2]."""
    half_K: float
    B: float
    """Damping over mass, 2 D w [1/s]."""
    half_B: float

    @property
    def bounded(self) -> bool:
        """Whether the delay and its interval are inside their bounds."""
        return abs(self.delay) + self.half_delay < BOUND * FREE


def fit_delayed(t: Array, P: Array, x: Array, start: Motion) -> Delayed:
    """Least squares of the driven motion over natural frequency, damping ratio and delay behind the pressure.

    t [s], P [Pa], x [m], shapes (n,). K and B may change with pressure along the step, or dry friction may act, and a
    motion without ringing does not show which. The result is that with a second column, driven by the square of the
    pressure's change; the change by that column widens the interval, which also covers the other forms that fit equally
    well. Intervals include the serial correlation of the residual, and half the sample period, since a sample may show
    any moment since the previous one.
    """
    period = float(np.median(np.diff(t)))
    first = place_of(start)
    one = _delayed(t, P, x, first)
    two = min((_delayed(t, P, x, begin, (SQUARE,)) for begin in (first, one.place)), key=lambda found: found.rms)
    two = replace(
        two,
        half_tau=hypot(two.half_tau, REMAINS * (two.tau - one.tau)),
        half_delay=hypot(two.half_delay, REMAINS * (two.delay - one.delay)),
    )
    others = [(STIFFNESS, DAMPED), (STIFFNESS, FRICTION)]
    forms = alike([two, *(_delayed(t, P, x, two.place, terms) for terms in others)])
    return replace(
        two,
        half_tau=max(abs(form.tau - two.tau) + form.half_tau for form in forms),
        half_delay=max(hypot(abs(form.delay - two.delay) + form.half_delay, 0.5 * period) for form in forms),
    )


def alike(forms: Sequence[Delayed]) -> list[Delayed]:
    """Those that fit about as well as the best one (`ALIKE`)."""
    least = min(one.rms for one in forms)
    return [one for one in forms if one.rms <= ALIKE * least]


def fit_swings(t: Array, P: Array, x: Array, first: Array, worst: float = np.inf) -> list[Delayed]:
    """Ringing driven by a pressure: least squares over natural frequency, damping ratio and delay behind it.

    t [s], P [Pa], x [m], shapes (n,); `first` is a start `place`. Three forms, with the stiffness as a second-order
    polynomial of the pressure along the step: the first with nothing else, the others also with a change of the damping
    or with dry friction, first order, and intervals widened by a share of the change. Motion from before the step is
    included in all. Frequency and damping are those at the pressure at the end of the step. Empty where the first form
    has a residual above `worst` [m].
    """
    plain = _delayed(t, P, x, first, (START, STIFFNESS))
    if plain.rms > worst:
        return []
    more = [_delayed(t, P, x, plain.place, (START, STIFFNESS, one)) for one in (DAMPED, FRICTION)]
    return [plain, *(_wider(one, plain) for one in more)]


def _wider(one: Delayed, plain: Delayed) -> Delayed:
    half_K = hypot(one.half_K, REMAINS * (one.K - plain.K))
    half_B = hypot(one.half_B, REMAINS * (one.B - plain.B))
    return replace(one, half_K=half_K, half_B=half_B)


def place_of(start: Motion) -> Array:
    """Start of a fit: delay over `FREE`, logarithms of damping ratio and natural frequency."""
    return np.array([-start.late / FREE, np.log(start.D), np.log(start.w)])


SQUARE, STIFFNESS, DAMPED, FRICTION, START = "square", "stiffness", "damping", "friction", "start"
"""Additional columns of the driven motion: response to the square of the change of pressure; change if stiffness or
damping depend on pressure, or if friction acts; remaining motion from before.
"""
ALIKE = 1.5
"""Forms with an rms residual within this factor of the smallest count as possible."""
TURNS = 0.02
"""Speed over which the friction changes its sign, as a share of the largest speed."""


def _columns(t: Array, P: Array, w: float, D: float, delay: float, terms: tuple[str, ...]) -> Array:
    """Columns: 1, the motion driven by the change of pressure over its range, and one or two for each of `terms`.

    For w^2 (1 + k p) in place of w^2, with p the pressure above its end, x = x0 + k x1 + k^2 x2, where x1 is the
    response to -p x0 and x2 that to -p x1; likewise for the damping, with the speed over w, and for a constant friction
    against the speed.
    """
    span = max(float(np.ptp(P)), 1e-9)
    change, middle = (P - P[0]) / span, 0.5 * (t[1:] + t[:-1])
    driven = Answer(t, middle + delay, w, D)
    still = Answer(t, middle, w, D) if {STIFFNESS, DAMPED, FRICTION} & {*terms} else driven

    def answer(drive: Array) -> Array:
        return still.to(np.diff(drive))

    motion = driven.to(np.diff(change))
    found = [np.ones(len(t)), motion]
    above, speed = np.interp(t - delay, t, change) - change[-1], np.gradient(motion, t) / w
    for term in terms:
        if term == SQUARE:
            found.append(driven.to(np.diff(change * np.abs(change))))
        elif term == STIFFNESS:
            first = answer(above * (motion - change[-1]))
            found += [first, answer(above * first)]
        elif term == DAMPED:
            found.append(answer(above * speed))
        elif term == FRICTION:
            found.append(answer(np.tanh(speed / (TURNS * float(np.max(np.abs(speed)))))))
        else:
            turn, dies = w * sqrt(max(0.0, 1 - D * D)), np.exp(-D * w * (t - t[0]))
            found += [dies * np.cos(turn * (t - t[0])), dies * np.sin(turn * (t - t[0]))]
    return np.column_stack(found)


def _delayed(
    t: Array, P: Array, x: Array, first: Array, terms: tuple[str, ...] = (), w: float | None = None
) -> Delayed:
    scale = max(float(np.ptp(x)), 1e-9)

    def misfit(p: Array) -> Array:
        frequency, damping = w if w is not None else float(np.exp(p[2])), float(np.exp(p[1]))
        design = _columns(t, P, frequency, damping, FREE * p[0], terms)
        return np.asarray(x - design @ np.linalg.lstsq(design, x, rcond=None)[0]) / scale

    low, high = [-1.0, np.log(DAMPING[0]), np.log(FREQUENCY[0])], [1.0, np.log(HEAVIEST), np.log(FREQUENCY[1])]
    free = 3 if w is None else 2
    begin = np.clip(first[:free], np.array(low[:free]) + 1e-3, np.array(high[:free]) - 1e-3)
    solved = least_squares(misfit, begin, bounds=(low[:free], high[:free]), x_scale=0.1, max_nfev=100)
    frequency = w if w is not None else float(np.exp(solved.x[2]))
    damping = float(np.exp(solved.x[1]))
    fast = 1 / (2 * damping * frequency)
    if w is None and fast < 0.5 * float(np.median(np.diff(t))):
        massless = FREQUENCY[1]
        heavy = solved.x[1] + np.log(massless / frequency)
        found = _delayed(t, P, x, np.array([solved.x[0], heavy, np.log(massless)]), terms, massless)
        halves = (float(np.hypot(half, FASTEST)) for half in (found.half_tau, found.half_delay))
        return replace(found, half_tau=next(halves), half_delay=next(halves))
    rest = solved.fun
    power = float(rest @ rest)
    columns = 2 + len(terms) + (START in terms) + (STIFFNESS in terms)
    variance = power / (len(rest) - free - columns) * _together(rest)
    slopes = np.asarray(solved.jac, dtype=np.float64)
    covariance = np.linalg.pinv(slopes.T @ slopes) * variance

    def half(delay: float, damping: float, frequency: float) -> float:
        along = np.array([delay, damping, frequency][:free])
        return WIDE * sqrt(max(0.0, float(along @ covariance @ along)))

    tau = 2 * damping / frequency
    return Delayed(
        tau, tau * half(0, 1, -1), FREE * float(solved.x[0]), FREE * half(1, 0, 0), sqrt(power / len(rest)) * scale,
        np.array([*solved.x[:2], np.log(frequency)]), frequency**2, 2 * frequency**2 * half(0, 0, 1),
        2 * damping * frequency, 2 * damping * frequency * half(0, 1, 1),
    )  # fmt: skip


def _together(rest: Array) -> float:
    """Variance of means of `rest`, shape (n,), relative to independent samples.

    Noise of the measured pressure acts on the model, so the residual is correlated over times of B/K.
    """
    off = rest - rest.mean()
    correlation = autocorrelation(off, len(off) // 2 - 1)
    correlation = correlation / max(float(correlation[0]), 1e-30)
    below = np.flatnonzero(correlation < 0)
    return max(1.0, float(1 + 2 * correlation[1 : below[0] if len(below) else None].sum()))
