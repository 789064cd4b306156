"""The trials of contraction-relaxation runs that can be reduced together, their strokes and noise; fits nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import Noise, Samples
from pmabench.analysis.shared.skew import STAMPED, apart
from pmabench.kinds.contraction_relaxation.segments import Gate, noise_of_means, noise_seen, samples_of
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import RunData, TrialData


@dataclass(frozen=True, eq=False)
class Campaign:
    """The usable trials of all runs, numbered through; `cells` holds each trial's cell (load, pressure)."""

    runs: tuple[RunData, ...]
    trials: tuple[TrialData, ...]
    samples: tuple[Samples, ...]
    cells: NDArray[np.intp]
    rate: float
    cell: bool
    """A load cell was recorded."""
    noise: Noise
    steps: Noise
    """The part of the noise that the steps of the channels' values make."""
    noise_of_means: Noise
    """The noise that means over a segment show, where that is larger: smooth noise, as of filters."""

    @property
    def late(self) -> Noise:
        """How much the times of single samples scatter [s]: those of devices that are polled, by the computer's stamps.

        They are late by the time of an answer, which scatters by as much as it is on the mean, or more.
        """
        found = {}
        for channel in ("pressure", "displacement", *(("force",) if self.cell else ())):
            streams = [(run, run.channels[channel].stream) for run in self.runs if channel in run.channels]
            clocks = [run.clocks[stream] for run, stream in streams if stream in run.clocks]
            found[channel] = max((clock.uncertainty for clock in clocks if clock.how == STAMPED), default=0.0)
        return Noise(**found)

    def name(self, number: int) -> str:
        """`run/number` of a trial."""
        return self.trials[number].name

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that the fit uses."""
        return ("pressure", "displacement", *(("force",) if self.cell else ()))

    @property
    def skew(self) -> float:
        """Bound of the time between any two of these channels [s]."""
        return apart(self.runs, self.channels)

    @property
    def tested(self) -> tuple[float, ...]:
        """Pressures of the trials [Pa], rising."""
        return tuple(sorted({trial.point["pressure"] for trial in self.trials}))


def gather(runs: Sequence[RunData]) -> tuple[Campaign | None, list[Dropped]]:
    """The usable trials of the runs, None without one, and the others with the reason."""
    dropped: list[Dropped] = []
    members: list[tuple[RunData, TrialData]] = []
    for run in runs:
        for trial in run.trials:
            reason = _unusable(run, trial, runs[0].rate)
            if reason:
                dropped.append(Dropped(trial.name, trial.point, reason))
            else:
                members.append((run, trial))
    if not members:
        return None, dropped
    samples = tuple(samples_of(run, trial, number) for number, (run, trial) in enumerate(members))
    still = [settled(trial) for _, trial in members]
    noise, steps = noise_seen(samples, still, _every(runs))
    keys = [(round(trial.point.get("load", 0.0), 3), round(trial.point["pressure"])) for _, trial in members]
    numbers = {key: number for number, key in enumerate(sorted(set(keys)))}
    return (
        Campaign(
            runs=tuple(runs),
            trials=tuple(trial for _, trial in members),
            samples=samples,
            cells=np.array([numbers[key] for key in keys], dtype=np.intp),
            rate=runs[0].rate,
            cell=all(s.force is not None for s in samples),
            noise=noise,
            steps=steps,
            noise_of_means=noise_of_means(samples, still, Gate().samples(runs[0].rate)[0], noise),
        ),
        dropped,
    )


def _every(runs: Sequence[RunData]) -> dict[str, int]:
    """Field of `Samples` -> how many rows lie between two samples of a slower stream that it comes from."""
    found: dict[str, int] = {}
    for field, channel in (("P", "pressure"), ("x", "displacement"), ("force", "force")):
        infos = [(run.rate, run.channels[channel].rate) for run in runs if channel in run.channels]
        found[field] = max((round(rate / own) for rate, own in infos if own > 0), default=1) or 1
    return found


def _unusable(run: RunData, trial: TrialData, rate: float) -> str:
    """Why a trial cannot be used; empty where it can."""
    if trial.status != "finished":
        return f"the trial is {trial.status}"
    if trial.again:
        return "reference trial, done again when the run went on: compared with the first, in no fit"
    for channel in ("pressure", "displacement"):
        if channel not in trial.channels:
            return f"the {channel} is not recorded"
    if "pressure" not in trial.point:
        return "the trial names no pressure: a column of the commanded pressure gives it"
    if "force" not in trial.channels and "load" not in trial.point:
        return "neither the force nor the load is known: a column `is: force` or `point: {load: ...}` gives it"
    if abs(run.rate - rate) > 1e-6 * rate:
        return f"sampled at {run.rate:g} Hz, the first run at {rate:g} Hz: reduce them apart"
    if len(trial.t) < 2 or not trial.usable.any():
        return "no sample is usable"
    if not strokes(trial):
        return "no pressure command lies within its samples"
    return ""


def strokes(trial: TrialData) -> list[slice]:
    """Rows between one pressure command and the next; the whole trial where commands are not recorded."""
    times = [c.t for c in trial.commands if c.output == "pressure" and c.t >= trial.t[0] - 1e-9]
    edges = [int(np.searchsorted(trial.t, t - 1e-9)) for t in times] or [0]
    return [slice(first, last) for first, last in zip(edges, [*edges[1:], len(trial.t)], strict=True) if last > first]


def settled(trial: TrialData, number: int = 0) -> slice:
    """The last fifth of the hold at pressure, or of that after a later command; empty where there is none."""
    rows = strokes(trial)[number : number + 1]
    return slice(rows[0].stop - max(8, (rows[0].stop - rows[0].start) // 5), rows[0].stop) if rows else slice(0, 0)
