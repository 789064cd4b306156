"""What white noise of the channels makes of the rows of segments; knows segments and slopes, no fit.

Neighbours share samples: the displacement at the end of one segment is that at the begin of the next, with the other
sign in the velocity, so that much of its noise cancels in a stretch; means that overlap go the same way.
"""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.samples import Noise
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.store.records import Array

ON_TIME = Noise()
"""Samples that a device stamps by its own clock: how far that is off is no noise."""


def covariance(
    segments: Segments, slope: Array, K: Array, B: Array, noise: Noise, late: Noise = ON_TIME
) -> tuple[Array, Array]:
    """Variance of each row [N^2], shape (n,), and covariance of each with the next, shape (n - 1,).

    `late` is the standard deviation of the time of single samples of each channel [s], which is noise while it moves.

    A row is F_L + M x'' + K x + B x' - F_ce. `slope` is its change by the pressure [N/Pa], with K [N/m] and B [N.s/m]
    at each segment, shape (n,).
    """
    s, dt = segments.v.shape[1], segments.dt
    m = (segments.x.shape[1] - s) // 2
    # shares of the samples from start - m - 1 on; the next segment begins s later
    mean, speed, gained = (np.zeros(2 * s) for _ in range(3))
    mean[1 : s + 2 * m + 1] = segments.weights
    speed[2 * m + 1 : s + 2 * m + 1] += 1 / (2 * m * s * dt)
    speed[1 : s + 1] -= 1 / (2 * m * s * dt)
    for place, sign in ((s + 2 * m + 1, 1), (s + 1, -1), (2 * m, -1), (0, 1)):
        gained[place] += sign / (2 * m * dt * (s + 1) * dt)
    x = K[:, None] * mean + B[:, None] * speed + segments.mass[:, None] * gained
    moving = np.hypot(noise.displacement, segments.v.mean(axis=1) * late.displacement)
    pressing = slope * np.hypot(noise.pressure, _rate(segments.P, dt) * late.pressure)
    pulling = np.hypot(noise.force, _rate(segments.F_mid, dt) * late.force)
    force = np.where(segments.mass > 0, 0.0, pulling)
    own = moving**2 * np.sum(x**2, axis=1)
    own += (pressing**2 + force**2) * (mean @ mean)
    shared = float(mean[s:] @ mean[:s])
    after = moving[:-1] * moving[1:] * np.sum(x[:-1, s:] * x[1:, :s], axis=1)
    after += (pressing[:-1] * pressing[1:] + force[:-1] * force[1:]) * shared
    near = (np.diff(segments.trial) == 0) & (np.abs(np.diff(segments.t) - s * dt) < 0.5 * dt)
    return np.asarray(own), np.where(near, after, 0.0)


def _rate(values: Array, dt: float) -> Array:
    """Change of a channel over each segment per second, shape (n,), of `values` (n, w)."""
    return np.asarray((values[:, -1] - values[:, 0]) / (max(1, values.shape[1] - 1) * dt))
