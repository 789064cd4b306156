"""Frequency response of command to displacement straight from open-loop steps, without a model: it contradicts a loop
that was fitted in parts and lacks one, as of a muscle that creeps.

For a record that begins and ends at rest, the transform of the displacement's changes over that of the steps is the
response at any frequency. Uses commands and displacement alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from pmabench.analysis.shared.isometric_lines import spread
from pmabench.kinds.ultimate_gain.open_loop_fit import Step
from pmabench.model.loop import Loop, ultimate
from pmabench.store.records import Array, ComplexArray

AROUND = np.linspace(0.75, 1.3, 23)
"""Frequencies at which the response is compared, over that of the ultimate gain [1]."""
SURE = 0.003
"""Difference of K_u or T_u, as a share, that comes from the fit of single cycles by itself [1]."""


def contradicted(
    t: Array, x: Array, cycles: Sequence[Sequence[Step]], loop: Loop, hold: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """K_u and T_u over those of `loop` - 1, by the response of the displacement `x` [m] at even times `t` [s], beyond
    the scatter of the cycles (0 within it); and that scatter as half widths.

    `loop` has no sample hold; `hold` is that of the controller [s], by which T_u is later.
    """
    held = Loop(loop.gain, loop.dead_time + hold, loop.lags)
    truth = ultimate(held)
    omega = 2 * pi / truth.period
    w = AROUND * omega
    made = held.response(1j * w)
    phase = np.array([held.phase_lag(one) for one in w])
    found = []
    for cycle in cycles:
        lasts = cycle[-1].t - cycle[-2].t
        rows = (t >= cycle[0].t - 0.1 * lasts) & (t < cycle[-1].t + lasts)
        ratio, power = _response(t[rows], x[rows], cycle, w)
        off = np.log(ratio * np.exp(-1j * w * hold) / made)
        size, turn = (np.polyfit(w - omega, part, 1, w=power) for part in (off.real, off.imag))
        later = phase - np.polyval(turn, w - omega)  # phase lag of the displacement itself
        crossing = float(np.interp(pi, later, w))
        gain = float(np.interp(crossing, w, np.log(np.abs(made)))) + float(np.polyval(size, crossing - omega))
        found.append((np.exp(-gain) / truth.gain - 1, omega / crossing - 1))
    shares, halves = np.mean(found, axis=0), [spread([one[i] for one in found]) or 0.0 for i in (0, 1)]
    beyond = [float(share) if abs(share) > half + SURE else 0.0 for share, half in zip(shares, halves, strict=True)]
    return (beyond[0], beyond[1]), (halves[0], halves[1])


def _response(t: Array, x: Array, steps: Sequence[Step], w: Array) -> tuple[ComplexArray, Array]:
    """Response [m/Pa] at angular frequencies `w` (k,) [rad/s], and the steps' content there, (k,)."""
    middle, period = 0.5 * (t[1:] + t[:-1]), float(t[1] - t[0])
    changes = np.exp(-1j * np.outer(w, middle)) @ np.diff(x) / np.sinc(w * period / (2 * pi))
    times, heights = (np.array([getattr(step, name) for step in steps]) for name in ("t", "height"))
    sent = np.exp(-1j * np.outer(w, times)) @ heights
    return changes / sent, np.abs(sent)
