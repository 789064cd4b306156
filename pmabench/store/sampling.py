"""How evenly the samples of a run were taken: from their own times, over all trials; pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmabench.store.records import Flag, TrialData


@dataclass(frozen=True)
class Sampling:
    """Of all intervals between neighbouring samples of the trials."""

    rows: int
    rate: float
    """Samples by time from the first to the last one of each trial [Hz]."""
    interval: float
    """Median [s]."""
    jitter: float
    """Standard deviation of the intervals before which nothing is missing, about the median [s]."""
    longest: float
    """[s]"""
    late: int
    """Samples that were taken late."""
    gaps: int
    """Samples before which others are missing."""


def sampling(trials: Sequence[TrialData]) -> Sampling | None:
    """None where no trial has two samples."""
    trials = [trial for trial in trials if len(trial.t) > 1]
    if not trials:
        return None
    steps = np.concatenate([np.diff(trial.t) for trial in trials])
    flags = np.concatenate([trial.flags[1:] for trial in trials])
    whole = steps[(flags & np.uint16(Flag.GAP)) == 0]
    middle = float(np.median(steps))
    return Sampling(
        rows=sum(len(trial.t) for trial in trials),
        rate=len(steps) / float(steps.sum()),
        interval=middle,
        jitter=float(np.sqrt(np.mean((whole - middle) ** 2))) if len(whole) else 0.0,
        longest=float(steps.max()),
        late=int(np.count_nonzero(flags & np.uint16(Flag.LATE))),
        gaps=int(np.count_nonzero(flags & np.uint16(Flag.GAP))),
    )
