"""Noise taken off samples, the first-order filter of their sensor undone, and peaks that neither makes lower.

Knows samples and times, no test.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

SMOOTHED = 0.02
"""Samples are averaged over so long [s], over one time constant of the sensor where that is longer."""
LENGTHS = (5.0, 1.0, 0.5)
"""Lengths of the parabolas over that time [1]: on a slow peak noise averages out, a quick one is not flattened."""
SURE = 3.0
"""Standard deviations that the largest of many samples may lie off."""


@dataclass(frozen=True, eq=False)
class Smooth:
    """A signal at the times of its samples, without noise and without the lag of its sensor."""

    y: Array
    """Means over `SMOOTHED`, shape (n,)."""
    gain: float
    """Standard deviation of the noise left in them over that of the samples [1]."""
    fitted: Array
    """By parabolas of `LENGTHS`, shape (3, n): a mean takes its curvature off a peak, they do not (Savitzky and Golay
    1964)."""
    gains: tuple[float, ...]
    """As `gain`, of each."""
    reach: int
    """A mean is over so many samples before and after."""

    def part(self, rows: NDArray[np.bool_]) -> Smooth:
        """The samples of `rows`."""
        return replace(self, y=self.y[rows], fitted=self.fitted[:, rows])

    def against(self, reference: Array | float, sign: float = 1.0) -> Smooth:
        """Its excess over `reference`, or with -1 what it lacks."""
        return replace(self, y=sign * (self.y - reference), fitted=sign * (self.fitted - reference))

    def peak(self, noise: float) -> float:
        """The largest value [as y], where the samples have noise of standard deviation `noise`.

        The largest of many noisy samples lies high, so only its place counts, which a mean shifts by less than its
        length. The height there is that of the longest parabola from which no shorter one differs by more than noise
        can make it.
        """
        at = int(np.argmax(self.y))
        heights = self.fitted[:, max(0, at - self.reach) : at + self.reach + 1].max(axis=1)
        alike = np.abs(heights[:, None] - heights) <= (SURE + 1) * noise * np.array(self.gains)
        longer_or_itself = np.tri(len(heights), dtype=bool)
        return float(heights[np.argmax((alike | longer_or_itself).all(axis=1))])


def smooth(t: Array, y: Array, lag: float = 0.0) -> Smooth:
    """Samples `y` at `t` [s], shape (n,), of a sensor with a first-order filter of time constant `lag` [s].

    Where it reads y, y + lag y' was there: the slope is that of a line over as long as the mean or the parabola.
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
    """Weights of 2 half + 1 samples for their middle: a mean (order 0) or a parabola (2), and `lag` times the slope.

    `lag` is in samples.
    """
    at = np.arange(-half, half + 1.0)
    n, second, fourth = (float(np.sum(at**power)) for power in (0, 2, 4))
    value = np.full(len(at), 1 / n) if order == 0 else (fourth - second * at**2) / (n * fourth - second**2)
    return np.asarray(value + lag * at / second)


def _convolved(y: Array, kernel: Array) -> Array:
    """Weighted sums about each sample; before and after the samples it rests at the mean of the first and last."""
    half = len(kernel) // 2
    ends = float(y[: half + 1].mean()), float(y[-half - 1 :].mean())
    return np.correlate(np.pad(y, half, constant_values=ends), kernel, "valid")
