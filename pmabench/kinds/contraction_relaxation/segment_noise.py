"""What white noise of the channels makes of the rows of segments; knows segments and slopes, no fit.

Neighbours share samples: the displacement at the end of one segment is that at the begin of the next, with the other
sign in the velocity, so that much of its noise cancels in a stretch; means that overlap go the same way.
"""

from __future__ import annotations

import numpy as np

from pmabench.analysis.shared.samples import Noise
from pmabench.kinds.contraction_relaxation.segments import Segments
from pmabench.store.records import Array


def covariance(segments: Segments, slope: Array, K: Array, B: Array, noise: Noise) -> tuple[Array, Array]:
    """Variance of each row [N^2], shape (n,), and covariance of each with the next, shape (n - 1,).

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
    force = np.where(segments.mass > 0, 0.0, noise.force)
    own = noise.displacement**2 * np.sum(x**2, axis=1)
    own += ((slope * noise.pressure) ** 2 + force**2) * (mean @ mean)
    shared = float(mean[s:] @ mean[:s])
    after = noise.displacement**2 * np.sum(x[:-1, s:] * x[1:, :s], axis=1)
    after += (slope[:-1] * slope[1:] * noise.pressure**2 + force[:-1] * force[1:]) * shared
    near = (np.diff(segments.trial) == 0) & (np.abs(np.diff(segments.t) - s * dt) < 0.5 * dt)
    return np.asarray(own), np.where(near, after, 0.0)
