"""Whether a channel changed at all in a trial, or shows nothing but its noise; knows no kind of test."""

from __future__ import annotations

import numpy as np

from pmabench.store.records import TrialData

BLOCKS = 40
"""The trial is averaged in at most so many parts ..."""
LEAST_SAMPLES = 10
"""... of at least so many samples, so that noise averages out and motion does not."""
SPREADS = 3.0
"""Standard deviations of the noise that a change must exceed."""
LEAST = {"displacement": 20e-6}
"""Channel -> smallest change [SI] that counts as one: a gauge is repeatable to this."""


def nothing_moved(trial: TrialData, channel: str) -> bool:
    """Whether a channel of a trial changed by less than its noise.

    The change is the range of the means over parts of the trial; the noise is the scatter of neighbouring samples.
    False where there are too few samples to say.
    """
    if channel not in trial.channels:
        return False
    y = trial.channels[channel][trial.usable]
    y = y[np.isfinite(y)]
    if len(y) < 2 * LEAST_SAMPLES:
        return False
    means = [float(part.mean()) for part in np.array_split(y, min(BLOCKS, len(y) // LEAST_SAMPLES))]
    noise = float(np.diff(y).std()) / np.sqrt(2.0)
    return bool(max(means) - min(means) <= max(SPREADS * noise, LEAST.get(channel, 0.0)))
