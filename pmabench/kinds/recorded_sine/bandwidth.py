"""Bandwidth (-3 dB) of contraction over recorded sines: where its gain has fallen to 1/sqrt(2) of that at the slowest.

The gain is that of the commanded pressure where it is recorded, else of the measured one. Between two frequencies
1/|G|^2 is a line over f^2, as it is for one lag; what a line in logarithms would give instead is the method part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp, hypot, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.form import change_over
from pmabench.analysis.shared.lines import mean_half
from pmabench.kinds.recorded_sine.form import slower
from pmabench.store.analyses.results import Estimate, Parts
from pmabench.store.records import Array

if TYPE_CHECKING:
    from pmabench.kinds.recorded_sine.reduction import Sine

COMMAND, PRESSURE = "bandwidth, by sines of command", "bandwidth, by sines of pressure"
FEWEST = 3
"""Frequencies that it needs."""


def crossing(f: Array, gain: Array) -> tuple[float, float] | None:
    """Where `gain` (n,) over rising f (n,) [Hz] first is 1/sqrt(2) of its first value, and the method part [Hz].

    None where it is above that everywhere.
    """
    share = gain / gain[0]
    below = np.flatnonzero(share < sqrt(0.5))
    if not len(below):
        return None
    i = int(below[0])
    (f_1, f_2), (g_1, g_2) = f[i - 1 : i + 1], 1 / share[i - 1 : i + 1] ** 2
    square = f_1**2 + (2.0 - g_1) / (g_2 - g_1) * (f_2**2 - f_1**2)
    straight = exp(log(f_1) + (log(2.0) - log(g_1)) / (log(g_2) - log(g_1)) * log(f_2 / f_1))
    return sqrt(square), abs(sqrt(square) - straight)


def bandwidth(groups: Mapping[float, Sequence[Sine]]) -> list[Estimate]:
    """f_b [Hz] from trials by frequency [Hz], without a value where the gain does not fall so far; none of few."""
    frequencies = sorted(groups)
    if len(frequencies) < FEWEST:
        return []
    sines = [sine for f in frequencies for sine in groups[f]]
    driven = "pressure_command" if all("pressure_command" in sine.amplitudes for sine in sines) else "pressure"
    gains, halves = [], list[float | None]()
    for f in frequencies:
        values = np.array([abs(s.amplitudes["displacement"] / s.amplitudes[driven]) for s in groups[f]])
        gains.append(float(values.mean()))
        by_cycle = [np.abs(s.cycles["displacement"] / s.cycles[driven]) for s in groups[f]]
        half, change = mean_half(values, by_cycle), change_over(by_cycle)
        halves.append(half if half is None or change is None or not change.seen else half + change.most)
    at, gain = np.array(frequencies), np.array(gains)
    names = tuple(sine.name for sine in sines)
    method = COMMAND if driven == "pressure_command" else PRESSURE
    found = crossing(at, gain) if np.isfinite(gain).all() and gain.min() > 0 else None
    if found is None:
        least = 20 * log(gain.min() / gain[0]) / log(10) if gain.min() > 0 else 0.0
        note = f"the gain falls by no more than {-least:.2g} dB, up to {frequencies[-1]:g} Hz"
        return [Estimate("f_b", None, "Hz", "frequency", method, {}, n=len(names), note=note, trials=names)]
    value, apart = found
    half = None
    if all(one is not None for one in halves):
        off = np.array(
            [hypot((one or 0.0) / g, (halves[0] or 0.0) / gain[0]) for one, g in zip(halves, gain, strict=True)]
        )
        moved = [crossing(at, np.concatenate([gain[:1], gain[1:] * (1 + way * off[1:])])) for way in (-1, 1)]
        half = max(abs(one[0] - value) for one in moved if one is not None) if any(moved) else None
    apart = hypot(apart, *_slow([groups[f][0] for f in frequencies], driven, at, gain, value))
    note = sentences(
        f"against the gain at {frequencies[0]:g} Hz", "" if half is not None else "no repeats part: single cycles"
    )
    return [
        Estimate(
            "f_b", value, "Hz", "frequency", method, {}, Parts(half, apart, 0.0), len(names), note=note, trials=names
        )
    ]


def _slow(sines: Sequence[Sine], driven: str, at: Array, gain: Array, value: float) -> list[float]:
    """Change of f_b [Hz] by what the time constant of each sensor is known to; `sines` is one for each frequency."""
    found = []
    for name, sign in (("displacement", 1), (driven, -1)):
        change = np.array([sign * slower(sine, name).real for sine in sines])
        moved = crossing(at, gain * (1 + change)) if change.any() else None
        found.append(0.0 if moved is None else abs(moved[0] - value))
    return found
