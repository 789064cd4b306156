"""The loop from a relay oscillation: dead time, lags and gain by the harmonics of command, pressure and displacement.

Uses samples and the switching times of the command; knows no trial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from math import exp, log, pi, sqrt

import numpy as np
from scipy.optimize import least_squares

from pmabench.analysis.shared.signals import HARMONICS, mode_amplitudes
from pmabench.kinds.ultimate_gain.ways import lags_of, oscillating
from pmabench.model.loop import ComplexArray, Loop
from pmabench.store.records import Array

ONE_LAG = 0.003
"""Distance of the pressure from that of one lag, relative to its first harmonic, from which on two lags, real or a
complex pair, may be fitted. Noise makes 0.001.
"""
BETTER = 0.5
"""Two lags are used if their residual (squared) is below this share of that of one lag; lags that differ between
filling and venting do not reduce it that much.
"""
ROOTS = (0.05, 0.1, 0.2)
"""Start values of the root of b, relative to the period."""


def shape_of(t: Array, x: Array, switches: Array, ups: Array, loop: Loop) -> float:
    """Distance of the third harmonic of `x` from that of `loop` with the given command, relative to the first."""
    t0, t1, periods = float(ups[0]), float(ups[-1]), len(ups) - 1
    omega = 2 * pi * periods / (t1 - t0)
    X = mode_amplitudes(t - t0, x, 1j * omega)[1]
    U = command_over(switches, t0, t1, periods, HARMONICS)
    first, third = (complex(U[k]) * complex(loop.response(1j * omega * k)) for k in (1, 3))
    return float(abs(X[2] / X[0] - third / first))


def command_over(switches: Array, t0: float, t1: float, periods: int, harmonics: int) -> ComplexArray:
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


def fit(
    t: Array, x: Array, P: Array, switches: Array, ups: Array, lag: Mapping[str, float], hold: float
) -> tuple[Loop, float] | None:
    """The loop from whole periods between `ups` [s]: command to pressure, and pressure to displacement, separately.

    P = exp(-L s)/(1 + a s + b s^2) U and P = (1 + tau s + beta s^2) X / k_g at the harmonics of the oscillation; sensor
    lags are corrected. `hold` [s], half a sample period, is added to L for a sampled controller. Also the distance of
    the pressure from the loop, relative to its first harmonic [1]. None where no such loop results.
    """
    t0, t1, periods = float(ups[0]), float(ups[-1]), len(ups) - 1
    at = (t >= t0) & (t < t1)
    if at.sum() < 8 * (HARMONICS + 1) * periods:
        return None
    omega = 2 * pi * periods / (t1 - t0)
    s = (1j * omega * np.arange(1, HARMONICS + 1)).astype(np.complex128)
    U = command_over(switches, t0, t1, periods, HARMONICS)[1:]
    X, Q = (
        mode_amplitudes(t[at] - t0, y[at], 1j * omega)[1] * (1 + lag.get(name, 0.0) * s)
        for name, y in (("displacement", x), ("pressure", P))
    )
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

    L, lags, squares = simplest(misfit, ONE_LAG**2)
    return L * period, tuple(lag * period for lag in lags), sqrt(squares)


def simplest(misfit: Callable[[Array], Array], enough: float) -> tuple[float, tuple[complex, ...], float]:
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
        columns = np.column_stack([X * s**power for power in powers])
        size = np.linalg.norm(columns, axis=0)
        design = np.concatenate([columns.real, columns.imag]) / size
        found = np.linalg.lstsq(design, np.concatenate([Q.real, Q.imag]), rcond=None)[0] / size
        if np.all(found > 0):
            tau, beta = float(found[1] / found[0]), float(found[2] / found[0]) if len(found) > 2 else 0.0
            return float(1 / found[0]), lags_of(tau, beta)
    return None
