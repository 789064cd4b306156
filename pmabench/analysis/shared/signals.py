"""Processing of one signal: spikes, smoothing, correction of a sensor's lag, peaks, and oscillations.

An oscillation has extremes, swings, growth per half period, period, and a damped mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import show
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array, Flag, RunData, TrialData
from pmabench.store.spikes import ALONE, FEW, spike_limit

SMOOTHED = 0.02
"""Averaging time [s]; one time constant of the sensor where that is longer."""
LENGTHS = (5.0, 1.0, 0.5)
"""Lengths of the fitted parabolas over that time [1]: long ones for slow peaks, short ones for quick peaks."""
SURE = 3.0
"""Standard deviations of noise by which the largest of many samples may be off."""


@dataclass(frozen=True, eq=False)
class Smooth:
    """A signal at the times of its samples, smoothed and corrected for the lag of its sensor."""

    y: Array
    """Means over `SMOOTHED`, shape (n,)."""
    gain: float
    """Standard deviation of the noise in `y` over that of the samples [1]."""
    fitted: Array
    """Fits by parabolas of `LENGTHS`, shape (3, n), which unlike a mean keep the height of a peak (Savitzky and Golay
    1964)."""
    gains: tuple[float, ...]
    """As `gain`, for each row of `fitted`."""
    reach: int
    """Number of samples before and after that are averaged."""

    def part(self, rows: NDArray[np.bool_]) -> Smooth:
        """The signal at the samples of `rows`, a mask of shape (n,)."""
        return replace(self, y=self.y[rows], fitted=self.fitted[:, rows])

    def against(self, reference: Array | float, sign: float = 1.0) -> Smooth:
        """The signal minus `reference`, times `sign`."""
        return replace(self, y=sign * (self.y - reference), fitted=sign * (self.fitted - reference))

    def peak(self, noise: float) -> float:
        """Largest value [as y], where the samples have noise of standard deviation `noise`.

        The largest of many noisy values is biased, so it only gives the place. The height there is that of the longest
        parabola from which no shorter one differs by more than noise.
        """
        at = int(np.argmax(self.y))
        heights = self.fitted[:, max(0, at - self.reach) : at + self.reach + 1].max(axis=1)
        alike = np.abs(heights[:, None] - heights) <= (SURE + 1) * noise * np.array(self.gains)
        longer_or_itself = np.tri(len(heights), dtype=bool)
        return float(heights[np.argmax((alike | longer_or_itself).all(axis=1))])


def smooth(t: Array, y: Array, lag: float = 0.0) -> Smooth:
    """Smooth samples `y` at `t` [s], shape (n,), and correct a first-order filter of time constant `lag` [s].

    The input of the filter is y + lag y'; the slope is that of a line over the length of the mean or parabola.
    """
    period = float(np.median(np.diff(t)))
    grid = t[0] + period * np.arange(round((t[-1] - t[0]) / period) + 1)
    even = np.interp(grid, t, y)
    half = 0.5 * max(SMOOTHED, lag) / period
    reach = max(1, round(half))
    kernels = [_kernel(reach, 0, lag / period)]
    kernels += [_kernel(max(2, round(length * half)), 2, lag / period) for length in LENGTHS]
    mean, *fitted = [np.interp(t, grid, _convolved(even, kernel)) for kernel in kernels]
    gain, *gains = [sqrt(float(kernel @ kernel)) for kernel in kernels]
    return Smooth(mean, gain, np.array(fitted), tuple(gains), reach)


def _kernel(half: int, order: int, lag: float) -> Array:
    """Weights of 2 half + 1 samples for their middle: a mean (order 0) or a parabola (2), plus `lag` times the slope.

    `lag` is in samples.
    """
    at = np.arange(-half, half + 1.0)
    n, second, fourth = (float(np.sum(at**power)) for power in (0, 2, 4))
    value = np.full(len(at), 1 / n) if order == 0 else (fourth - second * at**2) / (n * fourth - second**2)
    return np.asarray(value + lag * at / second)


def _convolved(y: Array, kernel: Array) -> Array:
    """Weighted sums about each sample, shape (n,); the signal is extended by means of its first and last samples."""
    half = len(kernel) // 2
    ends = float(y[: half + 1].mean()), float(y[-half - 1 :].mean())
    return np.correlate(np.pad(y, half, constant_values=ends), kernel, "valid")


HARMONICS = 3
"""Number of fitted harmonics of a damped mode."""
SKIPPED = 2
"""First swings that are left out, because they contain faster modes."""
SEEN = 12.0
"""Standard deviations of the noise above which a swing, peak to peak, counts."""


def extremes(t: Array, y: Array, threshold: float) -> tuple[Array, Array]:
    """Times [s] and values of successive maxima and minima of `y`, each more than `threshold` from the last.

    An extreme is refined by the vertex of a parabola through the samples within a tenth of a period around it.
    """
    places: list[int] = []
    top = bottom = 0
    seeking = 0
    for i in range(1, len(y)) if len(y) > 2 else ():
        if y[i] > y[top]:
            top = i
        if y[i] < y[bottom]:
            bottom = i
        if seeking >= 0 and y[top] - y[i] > threshold:
            places.append(top)
            seeking, bottom = -1, i
            top = i
        elif seeking <= 0 and y[i] - y[bottom] > threshold:
            places.append(bottom)
            seeking, top = 1, i
            bottom = i
    if not places:
        return np.empty(0), np.empty(0)
    reach = 0.2 * float(np.median(np.diff(t[places]))) if len(places) > 1 else 0.0
    times, values = t[places].astype(float), y[places].astype(float)
    for k, place in enumerate(places):
        near = np.abs(t - t[place]) <= reach
        if near.sum() < 5:
            continue
        shift = t[near] - t[place]
        c2, c1, c0 = np.polyfit(shift, y[near], 2)
        vertex = -c1 / (2 * c2) if c2 != 0 else 0.0
        if abs(vertex) <= reach:
            times[k], values[k] = t[place] + vertex, c0 + c1 * vertex + c2 * vertex**2
    return times, values


@dataclass(frozen=True)
class Swinging:
    """An oscillation, described by its swings (half periods)."""

    times: Array
    """Times of the extremes [s]."""
    sizes: Array
    """Peak to peak of each half period, one fewer than `times`."""
    log_ratio: float
    """Mean natural logarithm of the ratio of successive swings [1]."""
    period: float
    """[s]."""
    period_variation: float
    """Standard deviation of single periods over their mean [1]."""

    @property
    def root(self) -> complex:
        """The mode s = (2/T)(ln ratio + j pi) with this growth and period [1/s]."""
        return complex(self.log_ratio, np.pi) * 2.0 / self.period


def describe(t: Array, y: Array, noise: float) -> Swinging | None:
    """Growth and period of the swings of `y` at `t` [s], without the first `SKIPPED`; None with fewer than four left.

    ln(size) is fitted by a line in the count of half periods, weighted with the squared size (noise of equal size on
    every extreme), together with a term that alternates (unequal halves, drift).
    """
    times, values = extremes(t, y, SEEN * noise)
    sizes = np.abs(np.diff(values))
    times, sizes = times[SKIPPED:], sizes[SKIPPED:]
    if len(sizes) < 4:
        return None
    count = np.arange(len(sizes), dtype=float)
    columns = [np.ones_like(count), count] + ([(-1.0) ** count] if len(sizes) >= 5 else [])
    design = np.column_stack(columns)
    weight = sizes / sizes.max()
    fitted, *_ = np.linalg.lstsq(design * weight[:, None], np.log(sizes) * weight, rcond=None)
    place = np.arange(len(times), dtype=float)
    clock = np.column_stack([np.ones_like(place), place, (-1.0) ** place])
    half, *_ = np.linalg.lstsq(clock, times, rcond=None)
    whole = times[2:] - times[:-2]
    return Swinging(times, sizes, float(fitted[1]), 2.0 * float(half[1]), float(np.std(whole, ddof=1) / np.mean(whole)))


def mode_amplitudes(t: Array, signals: Array, root: complex) -> tuple[Array, Array]:
    """Means and complex amplitudes of the damped mode `root` [1/s] and its harmonics in `signals`, shape (n, ...).

    Least squares of c0 + c1 t + exp(sigma t) (a_k cos k omega t + b_k sin k omega t). Returns the mean of c0 + c1 t,
    shape (...), and a_k - j b_k, shape (3, ...), so that the signal is Re(amplitude exp(s t)).
    """
    growth = np.exp(root.real * t)
    columns = [np.ones_like(t), t - t.mean()]
    for k in range(1, HARMONICS + 1):
        columns += [growth * np.cos(k * root.imag * t), growth * np.sin(k * root.imag * t)]
    fitted, *_ = np.linalg.lstsq(np.column_stack(columns), signals, rcond=None)
    return np.asarray(fitted[0]), np.asarray(fitted[2::2] - 1j * fitted[3::2])


AT_ONCE = 200_000
"""Samples whose medians are computed at once, which limits memory."""


def without_spikes(runs: Sequence[RunData]) -> tuple[list[RunData], list[Finding]]:
    """The runs with spikes flagged as suspect, and a doubt for each measured channel that has some."""
    cleaned, counts = [], dict[str, tuple[int, int, float, str]]()
    for run in runs:
        trials = []
        for trial in run.trials:
            flags = trial.flags.copy()
            for name, channel in run.channels.items():
                if name.endswith("_command") or name not in trial.channels:
                    continue
                where, most = _spikes(trial, name)
                flags[where] |= np.uint16(Flag.SUSPECT)
                found, of, furthest, _ = counts.get(name, (0, 0, 0.0, ""))
                counts[name] = (found + len(where), of + len(trial.t), max(furthest, most), channel.quantity)
            trials.append(replace(trial, flags=flags))
        cleaned.append(replace(run, trials=tuple(trials)))
    text = "{} of {} samples of the {} stand out alone, by up to {}, and are left out: a loose wire, or a disturbance?"
    return cleaned, [
        Finding("doubt", text.format(found, of, name, show(most, quantity, 2)))
        for name, (found, of, most, quantity) in counts.items()
        if found
    ]


def _spikes(trial: TrialData, name: str) -> tuple[NDArray[np.intp], float]:
    """Indices of the samples of a trial with a spike in a channel, and the largest distance of one [SI]."""
    rows = np.flatnonzero(trial.usable & np.isfinite(trial.channels[name]))
    if len(rows) < FEW:
        return rows[:0], 0.0
    values = trial.channels[name][rows]
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, ALONE, mode="edge"), 2 * ALONE + 1)
    parts = [np.median(around[at : at + AT_ONCE], axis=1) for at in range(0, len(values), AT_ONCE)]
    apart = np.abs(values - np.concatenate(parts))  # 0 for a ramp, and for an edge
    out = apart > spike_limit(values, apart)
    return rows[out], float(apart[out].max(initial=0.0))
