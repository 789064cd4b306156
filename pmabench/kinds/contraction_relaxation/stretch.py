"""What a muscle does over stretches of consecutive segments, as a linear answer to the force that drives it.

    M x'' + B(P) x' + K(P) x = f,   f = F_ce(P) - F_c sign(x') - F_L

with the pressure that was measured is linear in f and in the start. From sample to sample the coefficients are held at
their value for the mean pressure, and the step is exact for them (matrix exponential). Many stretches are worked on
side by side. Knows a fit and segments; minimises nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pmabench.analysis.shared.samples import Noise
from pmabench.analysis.shared.simulated import LEAST, Coefficients
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.store.records import Array

ROOM = 4_000_000
"""Most numbers in the answers of stretches that are worked on together."""
FEWEST = 2
"""Fewest segments of a stretch."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """One stretch of n segments with w samples in all; steps lie between samples, shape (w - 1,)."""

    rows: slice
    """Its segments."""
    way: float
    mean: Array
    """Simulated contraction [m], mean over each segment, from the measured start; shape (n,)."""
    answer: Array
    """Change of those means by the force on each step [m/N], shape (n, w - 1)."""
    start: Array
    """Change of those means by the contraction at the start, and with a mass by the speed; shape (n, 1 or 2)."""
    P: Array
    """Pressure [Pa] of each step."""
    x: Array
    """Simulated contraction [m] of each step."""
    v: Array
    """Simulated speed [m/s] of each step."""
    slope: Array
    """Change of the force by the pressure at each sample [N/Pa], shape (w,)."""
    cell: bool
    """The force was measured."""
    samples: int
    """Of a segment."""

    def covariance(self, noise: Noise, least: float = 0.0) -> Array:
        """Of the means [m^2], from white noise of the channels, shape (n, n); `least` [N] of the drive at a sample."""
        pressure = np.abs(self.slope) * noise.pressure
        force = noise.force if self.cell else 0.0
        shaken = np.zeros((len(self.mean), len(self.slope)))
        shaken[:, 1:] += 0.5 * self.answer  # a step is driven by the mean of both its ends
        shaken[:, :-1] += 0.5 * self.answer
        shaken *= np.sqrt(np.maximum(pressure**2 + force**2, least**2))
        own = noise.displacement**2 / self.samples * np.eye(len(self.mean))
        return np.asarray(shaken @ shaken.T + own)


def answers(segments: Segments, fit: Coefficients) -> Iterator[Stretch]:
    """Every stretch of at least `FEWEST` segments, the longest first."""
    pieces = sorted(_pieces(segments), key=lambda piece: piece.stop - piece.start, reverse=True)
    s = segments.v.shape[1]
    while pieces:
        most = pieces[0].stop - pieces[0].start
        count = max(1, ROOM // (most * most * s))
        yield from _together(segments, fit, pieces[:count])
        pieces = pieces[count:]


def _pieces(segments: Segments) -> Iterator[slice]:
    """Rows of consecutive segments of one trial that go one way without a gap."""
    if not len(segments):
        return
    length = segments.v.shape[1] * segments.dt
    apart = (
        (np.diff(segments.trial) != 0) | (np.diff(segments.way) != 0)
        | (np.abs(np.diff(segments.t) - length) > 0.5 * segments.dt)
    )  # fmt: skip
    edges = [0, *(np.flatnonzero(apart) + 1).tolist(), len(segments)]
    for first, last in pairwise(edges):
        if last - first >= FEWEST:
            yield slice(first, last)


def _together(segments: Segments, fit: Coefficients, pieces: list[slice]) -> Iterator[Stretch]:
    """Stretches side by side, one in each column; the shorter ones go on as they end."""
    s, m = segments.v.shape[1], len(pieces)
    most = pieces[0].stop - pieces[0].start
    index = np.stack([np.minimum(np.arange(p.start, p.start + most), p.stop - 1) for p in pieces], axis=1)

    def samples(field: Array) -> Array:
        return np.asarray(field[index].transpose(0, 2, 1).reshape(most * s, m))

    first = index[0]
    half = (segments.x.shape[1] - s) // 2
    P, F = samples(segments.P_mid), samples(segments.F_mid)
    way, mass = segments.way[first], segments.mass[first]
    inertia = bool((mass > 0).any())
    F_ce, K, B = _coefficients(fit, P, way)
    middle = [0.5 * (values[1:] + values[:-1]) for values in (P, F, F_ce, K, B)]
    P_step, drive = middle[0], middle[2] - middle[1] - way * fit.coulomb
    step = _Step.of(middle[3], middle[4], mass, segments.dt, inertia)
    x = step.run(drive, segments.x[first, half], segments.v[first, 0])
    answer, start = step.answer(most, s)
    x_step = 0.5 * (x[1:] + x[:-1])
    v_step = np.diff(x, axis=0) / segments.dt
    slope = _slope(fit, P, x, way, v_step)
    means = x.reshape(most, s, m).mean(axis=1)
    for column, piece in enumerate(pieces):
        n = piece.stop - piece.start
        w = n * s
        yield Stretch(
            rows=piece,
            way=float(way[column]),
            mean=means[:n, column],
            answer=answer[: w - 1, :n, column].T,
            start=start[:, :n, column].T,
            P=P_step[: w - 1, column],
            x=x_step[: w - 1, column],
            v=v_step[: w - 1, column],
            slope=slope[:w, column],
            cell=mass[column] <= 0,
            samples=s,
        )


def _coefficients(fit: Coefficients, P: Array, way: Array) -> tuple[Array, Array, Array]:
    """F_ce [N], K [N/m] and the B [N.s/m] of the way that each column goes."""
    B = np.where(way > 0, fit.values("B_c", P), fit.values("B_r", P))
    return fit.values("F_ce", P), np.maximum(fit.values("K", P), LEAST), np.maximum(B, LEAST)


def _slope(fit: Coefficients, P: Array, x: Array, way: Array, v_step: Array) -> Array:
    """d(F_ce - K x - B v)/dP [N/Pa] along the motion."""
    by = 1e3
    v = np.vstack([v_step, v_step[-1:]])
    high, low = (_coefficients(fit, P + sign * by, way) for sign in (1, -1))
    return np.asarray(((high[0] - low[0]) - (high[1] - low[1]) * x - (high[2] - low[2]) * v) / (2 * by))


@dataclass(frozen=True, eq=False)
class _Step:
    """From sample to sample, x' = a x + b v + g f and v' = c x + d v + e f; shape (steps, stretches) each.

    Without a mass there is no v, and b, c, d and e are 0.
    """

    a: Array
    g: Array
    b: Array
    c: Array
    d: Array
    e: Array
    inertia: bool

    @classmethod
    def of(cls, K: Array, B: Array, mass: Array, dt: float, inertia: bool) -> _Step:
        if not inertia:
            fade = -np.expm1(-K / B * dt)
            none = np.zeros((len(K), 1))
            return cls(1 - fade, fade / K, none, none, none, none, False)
        # eigenvalues -s +- w: exp(A dt) = e^(-s dt) [cosh + s sinh/w, sinh/w; -K/M sinh/w, cosh - s sinh/w]
        s = 0.5 * B / mass
        w = np.sqrt((s * s - K / mass).astype(np.complex128))
        w = np.where(np.abs(w) * dt < 1e-6, 1e-6 / dt, w)
        slow, fast = np.exp(-(K / mass) / (s + w) * dt), np.exp(-(s + w) * dt)
        cosh, sinh = (0.5 * (slow + fast)).real, (0.5 * (slow - fast) / w).real
        a = cosh + s * sinh
        return cls(a, (1 - a) / K, sinh, -K / mass * sinh, cosh - s * sinh, sinh / mass, True)

    def run(self, drive: Array, x: Array, v: Array) -> Array:
        """Contraction [m] at the samples under the force of each step [N], from x [m] and, with a mass, v [m/s]."""
        found = np.empty((len(drive) + 1, drive.shape[1]))
        pushed, kicked = self.g * drive, self.e * drive
        found[0] = x
        for i in range(len(drive)):
            if self.inertia:
                x, v = self.a[i] * x + self.b[i] * v + pushed[i], self.c[i] * x + self.d[i] * v + kicked[i]
            else:
                x = self.a[i] * x + pushed[i]
            found[i + 1] = x
        return found

    def answer(self, n: int, s: int) -> tuple[Array, Array]:
        """Change of the mean contraction of n segments of s samples each by the force on a step, and by the start.

        Shapes (steps, n, stretches) [m/N] and (1 or 2, n, stretches). Backwards in time (adjoint): what a sample's
        contraction is worth to each mean.
        """
        steps, m = self.a.shape
        worth, worth_v = np.zeros((n, m)), np.zeros((n, m))
        found = np.empty((steps, n, m))
        worth[n - 1] += 1 / s
        for i in range(steps - 1, -1, -1):
            if self.inertia:
                found[i] = self.g[i] * worth + self.e[i] * worth_v
                worth, worth_v = self.a[i] * worth + self.c[i] * worth_v, self.b[i] * worth + self.d[i] * worth_v
            else:
                np.multiply(self.g[i], worth, out=found[i])
                worth *= self.a[i]
            worth[i // s] += 1 / s
        return found, np.stack([worth, worth_v]) if self.inertia else worth[None]
