"""How a signal swings: extremes, swings, growth per half period, period, and its damped mode; knows no test kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmabench.store.records import Array

HARMONICS = 3
"""Of a damped mode that are fitted."""
SKIPPED = 2
"""Swings after a kick that do not count: faster modes are still in them."""
SEEN = 12.0
"""A swing, peak to peak, counts where it is larger than this many standard deviations of the noise."""


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
    """A stretch of oscillation, described by its swings (half periods)."""

    times: Array
    """Of the extremes [s]."""
    sizes: Array
    """Peak-to-peak of each half period, one fewer than `times`."""
    log_ratio: float
    """Mean natural logarithm of the ratio of successive swings [1]."""
    period: float
    """[s]."""
    period_variation: float
    """Standard deviation of single periods over their mean [1]."""

    @property
    def root(self) -> complex:
        """The mode s = (2/T)(ln ratio + j pi) [1/s] that swings like this."""
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
    """Means and complex amplitudes of the damped mode `root` [1/s] and its harmonics in `signals`, shape (n, m).

    Least squares of c0 + c1 t + exp(sigma t) (a_k cos k omega t + b_k sin k omega t). Returns the mean of c0 + c1 t,
    shape (m,), and a_k - j b_k, shape (3, m), so that the signal is Re(amplitude exp(s (t - t[0]))).
    """
    time = t - t[0]
    growth = np.exp(root.real * time)
    columns = [np.ones_like(time), time - time.mean()]
    for k in range(1, HARMONICS + 1):
        columns += [growth * np.cos(k * root.imag * time), growth * np.sin(k * root.imag * time)]
    fitted, *_ = np.linalg.lstsq(np.column_stack(columns), signals, rcond=None)
    return np.asarray(fitted[0]), np.asarray(fitted[2::2] - 1j * fitted[3::2])
