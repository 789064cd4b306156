"""Channels that repeat one reading although they have noise: a device that answers, and does not measure any more.

Compares a channel with itself only. A channel that rests on whole counts, or at an end of what it reads, is not named.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from pmabench.analysis.shared.samples import noise_of
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array, ChannelInfo, RunData, TrialData

LASTS, SAMPLES = 1.0, 25
"""Least time [s] and number of samples with one reading from which on it counts as repeated; two in a row are usual."""
RATE, WINDOW = 20.0, 20
"""Samples a second in which noise is looked for, and their number: they must reverse often, and all readings in their
time as well, which a motion does not.
"""
REVERSES = 0.4
"""Share of reversals from which on a window shows noise [1]; white noise has 2/3."""
VALUES, SMALL = 5, 0.05
"""Least number of readings in such a window, so that it is no toggling of the last digit, and its largest span as a
share of the channel's range [1]."""
WINDOWS = 3
"""Least number of windows with noise."""


@dataclass(frozen=True)
class _Still:
    """A stretch with one reading [SI]: its trial and its duration [s]."""

    trial: TrialData
    seconds: float
    value: float


def repeated(runs: Iterable[RunData]) -> tuple[Finding, ...]:
    """One doubt for each channel of a run that repeats one reading where its noise at rest is larger.

    Imported runs are left out: their import looks at this with the map of the file.
    """
    own = [run for run in runs if not run.manifest.get("imported")]
    return tuple(Finding("doubt", text) for run in own for text in _of_run(run))


def _of_run(run: RunData) -> Iterator[str]:
    for name, info in run.channels.items():
        if name.endswith("_command"):
            continue
        measured = [_Measured(trial, trial.channels[name], info.rate) for trial in run.trials if name in trial.channels]
        if still := [stretch for one in measured for stretch in one.stretches()]:
            values = np.concatenate([one.some for one in measured])
            still = [stretch for stretch in still if stretch.value not in (0.0, np.nanmin(values), np.nanmax(values))]
            small = SMALL * (info.high - info.low)
            noise = [scatter for one in measured for scatter in one.noise(small)] if still else []
            if len(noise) >= WINDOWS:
                yield _sentence(run, info, still, float(np.median(noise)))


def _sentence(run: RunData, info: ChannelInfo, still: Sequence[_Still], noise: float) -> str:
    numbers = list(dict.fromkeys(str(one.trial.number) for one in still))
    longest = max(still, key=lambda one: one.seconds)
    where = f"trial{'s' * (len(numbers) > 1)} {', '.join(numbers[:9])}{' and more' * (len(numbers) > 9)}"
    return (
        f"{run.id}: {info.name} repeats {show(longest.value, info.quantity, 5)} exactly, for up to "
        f"{longest.seconds:.3g} s ({where}), and scatters by {show(noise, info.quantity, 2)} at rest elsewhere: "
        "it was not measured then"
    )


class _Measured:
    """A channel in one trial [SI]; `rate` of its own stream [Hz], 0 if that is unknown."""

    def __init__(self, trial: TrialData, values: Array, rate: float) -> None:
        self._trial, self._values = trial, values
        span = float(trial.t[-1] - trial.t[0]) if len(trial.t) else 0.0
        every = self._every = max(1, round(len(values) / (RATE * span))) if span > 0 else 1
        self._own = min(every, ceil(len(values) / span / rate - 0.1)) or 1 if span * rate > 0 else 1
        """Samples from one reading of its own stream to the next; those between are interpolated."""
        self.some = values[::every][trial.usable[::every]]
        """`RATE` usable samples a second."""

    def stretches(self) -> Iterator[_Still]:
        """Stretches of at least `LASTS` and `SAMPLES` with one reading, of usable samples."""
        if not len(self.some) or _longest(self.some) < 0.7 * LASTS * RATE:
            return
        trial, values = self._trial, self._values
        changes = np.flatnonzero((np.diff(values) != 0) | ~trial.usable[1:]) + 1
        begins, ends = np.concatenate(([0], changes)), np.concatenate((changes, [len(values)]))
        seconds = trial.t[ends - 1] - trial.t[begins]
        for place in np.flatnonzero((seconds >= LASTS) & (ends - begins >= SAMPLES)).tolist():
            yield _Still(trial, float(seconds[place]), float(values[begins[place]]))

    def noise(self, small: float) -> list[float]:
        """Standard deviation of the noise in each window that shows it at rest and spans at most `small` [SI]."""
        kept, size = self._values[self._trial.usable], self._every * WINDOW
        blocks = kept[: len(kept) // size * size].reshape(-1, size)
        windows = blocks[:, :: self._every]
        different = 1 + np.count_nonzero(np.diff(np.sort(windows)), axis=1)
        noisy = (_reversing(windows) >= REVERSES) & (np.ptp(windows, axis=1) <= small) & (different >= VALUES)
        readings = blocks[noisy, :: self._own]
        return [noise_of(one) for one in readings[_reversing(readings) >= REVERSES]]


def _reversing(samples: Array) -> Array:
    """Share of reversals along the last axis [1]."""
    steps = np.sign(np.diff(samples))
    return np.asarray(np.mean(steps[..., 1:] * steps[..., :-1] < 0, axis=-1))


def _longest(values: Array) -> int:
    """Number of samples in the longest stretch with one value."""
    changes = np.flatnonzero(np.diff(values) != 0)
    return int(np.diff(np.concatenate(([-1], changes, [len(values) - 1]))).max())
