"""Finds steps, ramps and sines in signals.

Channels have shape (n,), times `t` [s] increase; changes smaller than `smallest` are ignored.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

FLAT = 0.1
"""A level is held where the signal stays within half the smallest step for this time [s] ..."""
FLAT_SAMPLES = 5
"""... and for at least this many samples."""
HELD = 5
"""A level is the median of its last samples, this many times as many as above."""
SETTLED = 3.0
"""Longest duration of a step from level to level [s]; longer changes are ramps."""
LEAVING = 0.05
"""A change begins where the signal has left its level by this share of the change."""
SAME_PERIOD, SAME_SIZE = 0.15, 0.25
"""Largest relative differences of the half cycles of one sine in period and size."""
ANOTHER, APART = 0.05, 2.0
"""Two sines are separate if frequency or amplitude differ by this share, or the rest between them lasts this many
cycles."""
HALF_CYCLES = 4
"""Least number of half cycles of a sine."""
SAMPLES = 8
"""Least number of samples per cycle of a sine."""
IMPURE = 0.3
"""Largest rms residual of a fitted sine, as a share of the signal's rms (square wave: 0.43, triangle: 0.12)."""


@dataclass(frozen=True)
class Level:
    """A change from one level to another: begin [s], uncertainty `within` before that [s], levels, and end [s]."""

    t: float
    within: float
    before: float
    value: float
    settled: float
    """When the new level is reached [s]."""


@dataclass(frozen=True)
class Cycle:
    """A rise and the fall after it: begin, begin of the fall and end [s]; for a rise alone `turn` is `end`."""

    begin: float
    turn: float
    end: float


@dataclass(frozen=True)
class Wave:
    """A stretch of one sine: begin and end [s], frequency [Hz], mean and amplitude."""

    begin: float
    end: float
    frequency: float
    mean: float
    amplitude: float
    left: float = 0.0
    """Rms residual of the fitted sine, relative to the signal's rms; 0.12 for a triangle."""

    def parted(self, after: Wave) -> bool:
        """Whether the following sine is another one, or comes after a rest."""
        other = abs(after.frequency - self.frequency) > ANOTHER * self.frequency
        other |= abs(after.amplitude - self.amplitude) > ANOTHER * self.amplitude
        return other or (after.begin - self.end) * self.frequency > APART


def later(t: Array) -> NDArray[np.bool_]:
    """Mask of times later than all before them, shape (n,)."""
    return np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])


def runs(where: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(First, one past the last) index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _parted(begin: int, end: int, at: NDArray[np.intp]) -> list[tuple[int, int]]:
    """The range from `begin` to `end`, split at the indices `at` inside it."""
    return list(pairwise([begin, *at[(at > begin) & (at < end)].tolist(), end]))


def levels(t: Array, values: Array, smallest: float) -> list[Level]:
    """Steps between held levels; drift and slow changes are left out."""
    n = len(t)
    if n < 3 * FLAT_SAMPLES:
        return []
    period = float(np.median(np.diff(t)))
    width = max(FLAT_SAMPLES, int(FLAT / period) if period > 0 else FLAT_SAMPLES)
    if n < 2 * width:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(values, width)
    quiet = windows.max(axis=1) - windows.min(axis=1) <= 0.5 * smallest
    flat = np.zeros(n, dtype=bool)
    for begin, end in runs(quiet):
        flat[begin : end + width - 1] = True
    jumps = np.flatnonzero(flat[:-1] & flat[1:] & (np.abs(np.diff(values)) > 0.5 * smallest)) + 1
    parts = [part for begin, end in runs(flat) for part in _parted(begin, end, jumps)]
    found = []
    for (begun, leave), (arrive, end) in pairwise(parts):
        before = float(np.median(values[max(begun, leave - HELD * width) : leave]))
        after = float(np.median(values[max(arrive, end - HELD * width) : end]))
        size = after - before
        if abs(size) < smallest or t[arrive] - t[leave - 1] > SETTLED:
            continue
        near = np.arange(max(0, leave - width), arrive + 1)
        moved = (values[near] - before) * np.sign(size)
        scatter = float(np.std(values[max(0, leave - 2 * width) : max(1, leave - width // 2)]))
        gone = near[moved > max(LEAVING * abs(size), 4 * scatter)]
        begin = max(int(gone[0]) if len(gone) else leave, 1)
        found.append(Level(float(t[begin]), float(t[begin] - t[begin - 1]), before, after, float(t[arrive])))
    return found


def turns(values: Array, smallest: float) -> list[int]:
    """Indices of alternating minima and maxima, each at least `smallest` from the one before."""
    found: list[int] = []
    low = high = 0
    rising: bool | None = None
    for k, value in enumerate(values.tolist()):
        if value > values[high]:
            high = k
        if value < values[low]:
            low = k
        if rising is not True and value - values[low] >= smallest:
            found.append(low)
            rising, high = True, k
        elif rising is not False and values[high] - value >= smallest:
            found.append(high)
            rising, low = False, k
        if rising is True and value >= values[high]:
            high = k
        if rising is False and value <= values[low]:
            low = k
    if rising is not None:
        found.append(high if rising else low)
    return found


def cycles(t: Array, values: Array, smallest: float) -> list[Cycle]:
    """Each rise with the fall after it; rest at the ends belongs to no cycle, rest at the top to the rise."""
    marks = turns(values, smallest)
    found = []
    for place, low in enumerate(marks[:-1]):
        high = marks[place + 1]
        if values[high] <= values[low]:
            continue
        size = float(values[high] - values[low])
        end = marks[place + 2] if place + 2 < len(marks) else high
        begin = low + int(np.flatnonzero(values[low : high + 1] <= values[low] + LEAVING * size)[-1])
        turn = high
        if end > high:
            fall = float(values[high] - values[end])
            turn = high + int(np.flatnonzero(values[high : end + 1] >= values[high] - LEAVING * fall)[-1])
            end = high + int(np.flatnonzero(values[high : end + 1] >= values[end] + LEAVING * fall)[-1]) + 1
        found.append(Cycle(float(t[begin]), float(t[turn]), float(t[min(end, len(t) - 1)])))
    return found


def waves(t: Array, values: Array, smallest: float) -> list[Wave]:
    """Stretches in which the signal is one sine of at least two cycles; `smallest`: least peak-to-peak size."""
    marks = turns(values, smallest)
    found: list[Wave] = []
    start = 1  # the part before the first turning point may be anything
    while start + HALF_CYCLES < len(marks):
        stop = start + 1
        while stop < len(marks) and _alike(t, values, marks, start, stop):
            stop += 1
        if stop - 1 - start >= HALF_CYCLES:
            with suppress(np.linalg.LinAlgError):  # damaged files hold numbers of any size
                found += _fitted(t, values, marks[start], marks[stop - 1], stop - 1 - start)
            start = stop - 1
        else:
            start += 1
    return found


def only_sine(t: Array, values: Array) -> float:
    """Frequency [Hz], to five digits, if at least 80 % of a signal is one sine; else 0."""
    found = waves(t, values, 0.25 * float(np.ptp(values))) if len(values) else []
    long = [wave for wave in found if wave.end - wave.begin > 0.8 * (t[-1] - t[0])]
    return float(f"{long[0].frequency:.5g}") if len(long) == 1 else 0.0


def _alike(t: Array, values: Array, marks: list[int], start: int, stop: int) -> bool:
    """Whether the half cycle that ends at `stop` matches those since `start` in period and size."""
    at = np.array(marks[start : stop + 1])
    periods, sizes = np.diff(t[at]), np.abs(np.diff(values[at]))
    if len(periods) < 2:
        return True
    period, size = float(np.median(periods[:-1])), float(np.median(sizes[:-1]))
    step = float(np.median(np.diff(t[at[0] : at[-1] + 1])))
    same = abs(periods[-1] - period) <= SAME_PERIOD * period + 2 * step
    return bool(same and abs(sizes[-1] - size) <= SAME_SIZE * size)


def _fitted(t: Array, values: Array, begin: int, end: int, halves: int) -> list[Wave]:
    """The sine of a stretch: frequency from turning points, refined by the phase drift; empty if none fits."""
    times, part = t[begin : end + 1], values[begin : end + 1]
    frequency = halves / 2 / float(times[-1] - times[0])
    for _ in range(2):
        count = halves // 2
        number = np.minimum(((times - times[0]) * frequency).astype(int), count - 1)
        each = [_amplitude(times[number == k], part[number == k], frequency)[1] for k in range(count)]
        phase = np.unwrap(np.angle(np.array(each)))
        if count > 1:
            frequency *= 1.0 + float(np.polyfit(np.arange(count), phase, 1)[0]) / (2 * np.pi)
    mean, amplitude = _amplitude(times, part, frequency)
    model = mean + np.real(amplitude * np.exp(2j * np.pi * frequency * times))
    resolved = 0 < frequency * SAMPLES * float(np.median(np.diff(times))) <= 1.0
    left = float(np.std(part - model) / np.std(part))
    if not resolved or left > IMPURE:
        return []
    return [Wave(float(times[0]), float(times[-1]), frequency, mean, abs(amplitude), left)]


def _amplitude(t: Array, values: Array, frequency: float) -> tuple[float, complex]:
    angle = 2 * np.pi * frequency * t
    table = np.column_stack([np.ones(len(t)), np.cos(angle), np.sin(angle)])
    mean, cosine, sine = np.linalg.lstsq(table, values, rcond=None)[0]
    return float(mean), complex(cosine, -sine)


def averaged(values: Array, width: int) -> Array:
    """Moving average over `width` samples, shape (n,)."""
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    return np.convolve(padded, np.full(width, 1 / width), "valid")


def medians(x: Array, together: int) -> Array:
    """Running median over `together` samples (an odd number), shape (n,)."""
    padded = np.pad(x, together // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, together), axis=1))
