"""The fitted muscle run again: under the measured pressure and load, to see what the estimator makes of it.

Many stretches are integrated side by side. Knows a fit and samples, no trial and no interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pmabench.analysis.shared.samples import Noise, Samples
from pmabench.store.records import Array

SUBSTEPS = 2
"""Integration steps from sample to sample."""
LEAST = 1.0
"""Least stiffness [N/m] and damping [N.s/m] with which a replay goes on where a line falls below."""


class Coefficients(Protocol):
    """A muscle as its coefficients over pressure: a solved fit, or a model from elsewhere."""

    @property
    def coulomb(self) -> float:
        """Coulomb friction [N]."""
        ...

    def values(self, symbol: str, P: Array) -> Array:
        """F_ce [N], K [N/m], B_c or B_r [N.s/m] at pressures P [Pa] of any shape."""
        ...


@dataclass(frozen=True)
class Replayed:
    """What the fitted muscle does: contraction [m] and force at the cell [N], shape (n, m) for m stretches."""

    x: Array
    force: Array


def run(
    fit: Coefficients, P: Array, dt: float, load: Array, mass: Array, x: Array, substeps: int = SUBSTEPS
) -> Replayed:
    """Integrate M x'' = F_ce(P) - K(P) x - B(P) x' - F_c sign(x') - F_L with x >= 0, from rest.

    Per step: exact in the velocity for the damping, trapezoidal in the spring, coefficients at the middle; so no mass
    is too small. A muscle at rest stays until more than F_c is out of balance. The cell reads F_L + M x''.

    Parameters
    ----------
    P
        Pressure [Pa], shape (n, m): sample, stretch. Straight lines between samples.
    dt
        Sampling period [s].
    load, mass, x
        F_L [N], moving mass [kg] and contraction at the start [m] of each stretch, shape (m,).
    """
    F_ce, K, B_c, B_r = _coefficients(fit, P)
    F_c = max(0.0, fit.coulomb)
    h = dt / substeps
    v = np.zeros(P.shape[1])
    all_x, all_v = np.empty(P.shape), np.empty(P.shape)
    middles = [
        [values[:-1] + (part + 0.5) / substeps * np.diff(values, axis=0) for values in (F_ce, K, B_c, B_r)]
        for part in range(substeps)
    ]
    for F, k, B_1, B_2 in middles:
        F -= load
        B_1 += 0.5 * h * k
        B_2 += 0.5 * h * k
    for i in range(len(P)):
        all_x[i], all_v[i] = x, v
        if i + 1 == len(P):
            break
        for F, k, B_1, B_2 in middles:
            drive = F[i] - k[i] * x
            way = np.where(v != 0, np.sign(v), np.sign(drive))
            damping = np.where(way > 0, B_1[i], B_2[i])
            final = (way * drive - F_c) / damping
            rate = damping / mass
            fade = np.expm1(-rate * h)
            speed = way * v
            gone = np.maximum(0.0, final * h - (speed - final) * fade / rate)
            v = way * np.maximum(0.0, speed + (speed - final) * fade)
            x = x + way * gone
            landed = x <= 0
            x, v = np.where(landed, 0.0, x), np.where(landed & (v < 0), 0.0, v)
    force = load + mass * np.gradient(all_v, dt, axis=0)
    return Replayed(all_x, np.where(all_x > 0, force, np.minimum(F_ce, load)))


def _coefficients(fit: Coefficients, P: Array) -> tuple[Array, Array, Array, Array]:
    values = [fit.values(symbol, P) for symbol in ("F_ce", "K", "B_c", "B_r")]
    return values[0], np.maximum(values[1], LEAST), np.maximum(values[2], LEAST), np.maximum(values[3], LEAST)


@dataclass(frozen=True)
class Stretches:
    """Equally long pieces of trials, each from rest, that a replay starts from: columns of `P` (n, m) [Pa]."""

    source: tuple[Samples, ...]
    P: Array
    load: Array
    mass: Array
    x: Array
    dt: float


def stretches(pieces: Sequence[tuple[Samples, slice]], dt: float, rest: int) -> Stretches:
    """Pieces of trials as columns; the shorter ones go on at their last pressure.

    Each begins at rest at the mean contraction of the `rest` samples before it.
    """
    most = max(rows.stop - rows.start for _, rows in pieces)
    P = np.empty((most, len(pieces)))
    source: list[Samples] = []
    start = np.empty(len(pieces))
    for column, (samples, rows) in enumerate(pieces):
        size = rows.stop - rows.start
        P[:size, column] = _whole(samples)[rows]
        P[size:, column] = P[size - 1, column]
        before = slice(max(0, rows.start - rest), rows.start + 1)
        still = samples.x[before][samples.ok[before]]
        start[column] = max(0.0, float(np.mean(still))) if len(still) else 0.0
        t, ok = dt * np.arange(size), samples.ok[rows]
        source.append(replace(samples, t=t, P=P[:size, column], x=samples.x[rows], force=None, ok=ok))
    load = np.array([samples.load for samples, _ in pieces])
    mass = np.array([samples.mass for samples, _ in pieces])
    return Stretches(tuple(source), P, load, mass, start, dt)


def _whole(samples: Samples) -> Array:
    """The pressure with straight lines in place of flagged samples: what drives a replay has no gap."""
    if samples.ok.all() or not samples.ok.any():
        return samples.P
    return np.interp(samples.t, samples.t[samples.ok], samples.P[samples.ok])


def measured(work: Stretches, replayed: Replayed, noise: Noise, cell: bool, seed: int) -> list[Samples]:
    """The replay as sensors with `noise` would show it; the same `seed` gives the same samples."""
    generator = np.random.default_rng(seed)
    result = []
    for column, samples in enumerate(work.source):
        size = len(samples.t)
        shake = generator.standard_normal((3, size))
        result.append(
            replace(
                samples,
                P=samples.P + noise.pressure * shake[0],
                x=replayed.x[:size, column] + noise.displacement * shake[1],
                force=replayed.force[:size, column] + noise.force * shake[2] if cell else None,
            )
        )
    return result
