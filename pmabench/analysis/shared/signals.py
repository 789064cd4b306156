"""Processing of one signal: spikes, smoothing, correction of a sensor's lag, peaks, and oscillations.

An oscillation has extremes, swings, growth per half period, period, and a damped mode. The response to one set-point
has rise time, overshoot and settling time, which refer to the step, from the position at rest to the set-point,
steady-state error, limit cycle, and IAE, the integral of |set-point - x|.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import Held, left, noise_of
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
"""Number of first swings that are left out, because they contain faster modes."""
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


SMALLEST = 1e-4
"""Share of the set-point above which a cycle counts, if it also exceeds the noise and two counts."""
SUSTAINED = 0.5
"""Size of the last cycle over that of the first above which an oscillation is sustained [1]."""
OVERDUE = 1.5
"""Number of periods without a further cycle after which an oscillation has died out [1]."""
FEWEST = 2
"""Fewest whole cycles of a limit cycle."""
STILL = 0.01
"""Motion within a fortieth of a cycle, over its size, below which it is at rest; a sine is so for 8 % of the time."""
PART = 0.02
"""Relative error of size and period of a cycle from smoothing."""
LONGEST, FADES = 1e3, 0.5
"""A motion in the window is extrapolated over the logarithm of time until the first [s], where its slope over that is
more than the second share of the slope before: muscles creep so."""
STICKS = 0.3
"""Share of the time at rest from which on a cycle is stick-slip."""


@dataclass(frozen=True)
class Cycle:
    """A sustained oscillation around the set-point."""

    size: float
    """Mean peak to peak [m]."""
    period: float
    """[s]."""
    count: int
    """Whole cycles seen."""
    at_rest: float
    """Share of the time at rest [1]."""

    @property
    def sticks(self) -> bool:
        """Whether it is a stick-slip cycle."""
        return self.at_rest >= STICKS


@dataclass(frozen=True)
class Response:
    """Response to a step of the set-point from rest; times are counted from the step."""

    rise: float | None
    """Time from 10 % to 90 % of the step [s]; None where 90 % is not reached by more than the noise."""
    overshoot: float
    """Largest excess over the set-point, over the step [1]; 0 for none."""
    settling: float | None
    """Time after which it stays in the band around the set-point [s]; None where it leaves the band less the noise."""
    error: float
    """Mean of set-point minus x in the window [m]."""
    IAE: float
    """Integral of |set-point - x| over the whole hold [m.s]."""
    cycle: Cycle | None
    wander: float
    """Peak to peak in the window [m]; above `smallest` without a cycle it is a drift, or slower than the window."""
    smallest: float
    """Smallest cycle that can be detected, peak to peak [m]."""
    unsure: Unsure


@dataclass(frozen=True)
class Unsure:
    """Half widths from sampling, noise and motion in the window, for values of `Response` and `Cycle`."""

    rise: float
    overshoot: float
    settling: float
    """Difference between the settling times of a band that is narrower and one that is wider by the noise."""
    IAE: float
    size: float
    period: float
    error: float
    """Possible difference of the mean in the window from that at rest, or over whole cycles [m]."""
    moves: bool
    """Whether a motion in the window is significant."""
    creep: float
    """Possible further motion over the logarithm of time until `LONGEST` [m]; 0 where it decays faster."""


def respond(
    t: Array,
    x: Array,
    setpoint: float,
    window: tuple[float, float],
    band: float,
    *,
    origin: float = 0.0,
    resolution: float = 0.0,
    lag: float = 0.0,
) -> Response:
    """Response to a step of the set-point, from samples `x` [m] at `t` [s after the step], shape (n,), until the hold
    ends.

    `window` [s] is for error and cycle; `band` is over the step [1]; `origin`: position at rest before [m];
    `resolution`: one count of the channel [m]; `lag`: time constant of its sensor, which is corrected [s]. Raises
    ValueError with fewer than 8 samples in the window, or where `origin` is not below the set-point.
    """
    period = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    inside = (t >= window[0]) & (t <= window[1])
    if inside.sum() < 8 or period <= 0:
        raise ValueError(f"fewer than 8 samples from {window[0]:g} s to {window[1]:g} s")
    step = setpoint - origin
    if step <= 0:
        raise ValueError("it rested beyond the set-point already")
    noise, place = noise_of(x[inside]), smooth(t, x, lag)
    at, rest = place.y, SURE * noise * place.gain + 0.5 * resolution

    def settled(limit: float) -> float | None:
        outside = np.flatnonzero(np.abs(at - setpoint) > limit)
        return 0.0 if not len(outside) else float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None

    smallest = max(SEEN * noise * max(1.0, place.gain), 2 * resolution, SMALLEST * setpoint)
    cycle, wander = cycle_of(t[inside], x[inside], smallest, lag), float(np.ptp(at[inside]))
    rise, open_ = _rise(t, at - origin, step, rest)
    near, wide = settled(band * step - rest), settled(band * step + rest)
    # noise of standard deviation s about rest makes |x| larger by 0.8 s, and by nothing far from it
    rectified = sqrt(2 / pi) * noise * place.gain * period * float(np.sum(np.abs(at - setpoint) < rest))
    further = left([Held.of(t[inside], x[inside], float(window[0]))])
    if cycle is not None:
        error = 0.5 * cycle.size * min(1.0, cycle.period / (window[1] - window[0]))
    else:
        error = max(further.most, wander if wander > smallest else 0.0)
    unsure = Unsure(
        rise=hypot(period + SMOOTHED / 2, *open_),
        overshoot=rest / step,
        settling=period + (near - wide if near is not None and wide is not None else 0.0),
        IAE=rectified,
        size=2 * rest + 2 * PART * (0.0 if cycle is None else cycle.size),
        period=0.0 if cycle is None else period + PART * cycle.period / cycle.count,
        error=max(error, 0.5 * resolution),
        moves=cycle is not None or further.seen or wander > smallest,
        creep=_creep(t, x, window) if further.seen and cycle is None else 0.0,
    )
    overshoot = max(0.0, place.against(setpoint).peak(noise) / step)
    settling = settled(band * step) if near is not None else None
    IAE = float(np.trapezoid(np.abs(setpoint - at), t)) - 0.5 * rectified
    off = setpoint - float(x[inside].mean())
    return Response(rise, overshoot, settling, off, IAE, cycle, wander, smallest, unsure)


def _creep(t: Array, x: Array, window: tuple[float, float]) -> float:
    """Possible further motion over the logarithm of time [m]; 0 where the motion decays faster."""

    def by_log(low: float, high: float) -> float:
        rows = (t >= low) & (t <= high) & (t > 0)
        return abs(float(np.polyfit(np.log(t[rows]), x[rows], 1)[0])) if rows.sum() > FEWEST else 0.0

    inside = by_log(*window)
    if inside < FADES * by_log(0.5 * window[0], window[0]):
        return 0.0
    return inside * max(0.0, float(np.log(LONGEST / np.mean(window))))


def _rise(t: Array, x: Array, step: float, rest: float) -> tuple[float | None, list[float]]:
    """Rise time from 10 to 90 % of the step [s] and the uncertainty of both times [s]; None where 90 % is not certain.

    The uncertainty is the time between passing one standard deviation (a third of `rest`) below and above a level.
    """

    def reached(level: float) -> float | None:
        rows = np.flatnonzero(x >= level)
        return float(t[rows[0]]) if len(rows) else None

    low, high = reached(0.1 * step), reached(0.9 * step)
    if low is None or high is None or reached(0.9 * step + rest) is None:
        return None, []
    ends = [[reached(share * step + more / SURE) or 0.0 for more in (-rest, rest)] for share in (0.1, 0.9)]
    return high - low, [late - early for early, late in ends]


def cycle_of(t: Array, x: Array, smallest: float, lag: float = 0.0) -> Cycle | None:
    """The sustained oscillation of `x` [m] at `t` [s], shape (n,); None without one larger than `smallest` [m].

    `lag`: time constant of the sensor, which is corrected [s]. Cycles are from one upward crossing of the middle to the
    next, with a hysteresis of a tenth of the size, so that corners of a stick-slip cycle do not matter.
    """
    period = float(np.median(np.diff(t)))
    at = smooth(t, x, lag).y
    low, high = float(at.min()), float(at.max())
    if high - low <= smallest:
        return None
    ups = _upward(at, 0.5 * (low + high), 0.1 * (high - low))
    if len(ups) < FEWEST + 1:
        return None
    parts = [at[a : b + 1] for a, b in pairwise(ups)]
    sizes = np.array([float(np.ptp(part)) for part in parts])
    if sizes[-1] < SUSTAINED * sizes[0] or sizes.mean() <= smallest:
        return None
    length = float(t[ups[-1]] - t[ups[0]]) / len(parts)
    if t[-1] - t[ups[-1]] > OVERDUE * length:
        return None
    whole = x[ups[0] : ups[-1] + 1]
    step = max(1, round(length / 40 / period))
    means = whole[: len(whole) // step * step].reshape(-1, step).mean(axis=1)
    still = np.abs(np.diff(means)) < STILL * sizes.mean()
    return Cycle(float(sizes.mean()), length, len(parts), float(still.mean()) if len(still) else 0.0)


def _upward(x: Array, middle: float, hysteresis: float) -> list[int]:
    """Indices at which `x` crosses `middle` upwards, between values `hysteresis` below and `hysteresis` above it."""
    far = np.flatnonzero(np.abs(x - middle) > hysteresis)
    above = x[far] > middle
    reached, below = far[1:][above[1:] & ~above[:-1]], np.flatnonzero(x < middle)
    return [int(place) + 1 for place in below[np.searchsorted(below, reached) - 1]]
