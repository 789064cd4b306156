"""What every reduction relies on: rising times, numbers in all usable samples, named operating points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench.analysis.shared.samples import NotUsable
from pmabench.base.text import clean
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import Flag, RunData, TrialData


class Point(dict[str, float]):
    """An operating point; a coordinate that it lacks makes its trial unusable."""

    def __missing__(self, name: str) -> float:
        raise NotUsable(f"its point names no {clean(name, 40)}")


def sound(runs: Sequence[RunData]) -> tuple[list[RunData], list[Dropped]]:
    """The runs without the trials that no reduction can use, and these with the reason.

    A sample with a channel that is no number is flagged as a gap; a channel without any number counts as not recorded.
    """
    kept: list[RunData] = []
    dropped: list[Dropped] = []
    for run in runs:
        trials = []
        for trial in run.trials:
            if reason := _unsound(trial):
                dropped.append(Dropped(trial.name, trial.point, reason))
            else:
                trials.append(_with_numbers(trial))
        kept.append(replace(run, trials=tuple(trials)))
    return kept, dropped


def _unsound(trial: TrialData) -> str:
    """Why no reduction can use the trial; empty where one may."""
    if not len(trial.t):
        return "no sample was recorded"
    if len(trial.t) < 2:
        return "it has only one sample"
    steps = np.diff(trial.t)
    if not (steps >= 0).all() or np.median(steps) <= 0:  # some files give neighbours the same time
        return "its times do not rise from sample to sample: look at the clock of its device, or the column of time"
    return ""


def _with_numbers(trial: TrialData) -> TrialData:
    found = {name: np.isfinite(values) for name, values in trial.channels.items()}
    odd = [name for name, finite in found.items() if not finite.all()]
    if not odd:
        return replace(trial, point=Point(trial.point))
    channels = {
        name: np.where(found[name], values, np.nan) if name in odd else values
        for name, values in trial.channels.items()
        if found[name].any()
    }
    lacks = ~np.all([found[name] for name in channels], axis=0) if channels else np.ones(len(trial.t), dtype=bool)
    flags = np.where(lacks, trial.flags | np.uint16(Flag.GAP), trial.flags)
    return replace(trial, channels=channels, flags=flags, point=Point(trial.point))
