"""Fit of a driven motion with its delay behind the measured pressure, where K and B change along the step.

Several forms of that change are fitted; all that fit about equally well count as possible. Uses times, pressures and
contractions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.shared.samples import autocorrelation
from pmabench.kinds.recorded_step.motion import DAMPING, FREQUENCY, Answer, Motion
from pmabench.store.records import Array

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
