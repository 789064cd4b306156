"""Frequency response of command to displacement straight from open-loop steps, without a model: it contradicts a loop
that was fitted in parts and lacks one, as of a muscle that creeps.

For a record that begins and ends at rest, the transform of the displacement's changes over that of the steps is the
response at any frequency. Uses commands and displacement alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, inf, pi

import numpy as np

from pmabench.analysis.shared.form import Doubt
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.kinds.ultimate_gain.open_loop_fit import Step
from pmabench.model.loop import ComplexArray, Loop, ultimate
from pmabench.store.records import Array

AROUND = np.linspace(0.75, 1.3, 23)
"""Frequencies at which the response is compared, over that of the ultimate gain [1]."""
CHANCE = 0.003
"""Difference of K_u or T_u beyond the scatter of the cycles that has no meaning, as a share [1]."""
MOST = 0.1
"""Difference from which on the fitted loop is wrong, as a share [1]."""
UNREADABLE = "the displacement's own response to the steps cannot be read near 1 / T_u: take other holds between them"
REASON = (
    "the displacement alone, without a model, gives K_u {:+.0%} and T_u {:+.0%} off the fitted loop: the muscle "
    "creeps, or has parts that the loop has not. Find K_u in a closed loop"
)


def without_model(
    t: Array, x: Array, cycles: Sequence[Sequence[Step]], loop: Loop
) -> tuple[Doubt, tuple[float, float]]:
    """Doubt about K_u and T_u of `loop`, and their difference from those of the displacement `x` [m] at even times [s].

    The dead time of `loop` has half a sample for the hold, which open-loop steps have not.
    """
    truth, hold = ultimate(loop), 0.5 * float(t[1] - t[0])
    omega = 2 * pi / truth.period
    w = AROUND * omega
    made = loop.response(np.asarray(1j * w, dtype=np.complex128))
    lag = np.array([loop.phase_lag(one) for one in w])
    found = []
    for cycle in cycles:
        lasts = cycle[-1].t - cycle[-2].t
        rows = (t >= cycle[0].t - 0.1 * lasts) & (t < cycle[-1].t + lasts)
        response, power = _response(t[rows], x[rows], cycle, w)
        off = np.log(response * np.exp(-1j * w * hold) / made)
        size, turn = (np.polyfit(w - omega, part, 1, w=power) for part in (off.real, off.imag))
        crossing = float(np.interp(pi, lag - np.polyval(turn, w - omega), w))
        gain = float(np.interp(crossing, w, np.log(np.abs(made)))) + float(np.polyval(size, crossing - omega))
        found.append((exp(-gain) / truth.gain - 1, omega / crossing - 1))
    if not np.isfinite(found).all():
        return Doubt("response without a model", "method", 0.0, True, UNREADABLE, MOST), (inf, inf)
    K, T = np.mean(found, axis=0).tolist()
    by_K, by_T = (spread([one[i] for one in found]) or 0.0 for i in (0, 1))
    seen = abs(K) > by_K + CHANCE or abs(T) > by_T + CHANCE
    doubt = Doubt("response without a model", "method", 0.0, seen, REASON.format(K, T), MOST)
    return doubt, (abs(K) + by_K, abs(T) + by_T)


def _response(t: Array, x: Array, steps: Sequence[Step], w: Array) -> tuple[ComplexArray, Array]:
    """Response [m/Pa] at angular frequencies `w` (k,) [rad/s], and the steps' content there, (k,)."""
    middle, period = 0.5 * (t[1:] + t[:-1]), float(t[1] - t[0])
    changes = np.exp(-1j * np.outer(w, middle)) @ np.diff(x) / np.sinc(w * period / (2 * pi))
    times, heights = (np.array([getattr(step, name) for step in steps]) for name in ("t", "height"))
    sent = np.exp(-1j * np.outer(w, times)) @ heights
    return changes / sent, np.abs(sent)
