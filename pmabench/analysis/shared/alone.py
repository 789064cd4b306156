"""Samples that stand out alone, as a loose wire or a disturbance gives them: left out where a reduction withholds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Flag, RunData, TrialData
from pmabench.store.spikes import ALONE, FEW, spike_limit

AT_ONCE = 200_000
"""Samples whose neighbours are sorted at one time, for their memory."""


def without_spikes(runs: Sequence[RunData]) -> tuple[list[RunData], list[Finding]]:
    """The runs with their spikes flagged as suspect, and a sentence on each measured channel that has some."""
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


def _spikes(trial: TrialData, name: str) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], float]:
    """Rows of a trial in which a channel has a spike, and how far the furthest stands out [SI]."""
    rows = np.flatnonzero(trial.usable & np.isfinite(trial.channels[name]))
    if len(rows) < FEW:
        return rows[:0], 0.0
    values = trial.channels[name][rows]
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, ALONE, mode="edge"), 2 * ALONE + 1)
    parts = [np.median(around[at : at + AT_ONCE], axis=1) for at in range(0, len(values), AT_ONCE)]
    apart = np.abs(values - np.concatenate(parts))  # 0 for a ramp, and for an edge
    out = apart > spike_limit(values, apart)
    return rows[out], float(apart[out].max(initial=0.0))
