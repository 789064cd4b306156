"""Uncertainty by the sensors in one step, besides calibration and lags: zeros, steps, noise; knows no model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.samples import between_new, count_of, fresh, lags_of, noise_of, unresolved
from pmabench.analysis.shared.signals import smooth
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Command, RunData, TrialData

CHANNELS = {"displacement": "length", "pressure": "pressure"}
"""Channel -> its quantity."""
SURE = 5.0
"""Standard errors from which on a reading at rest is significant."""
WHY = {
    "displacement": "its zero is off, or friction, creep or a load hold the muscle. Vent, wait and take the zero",
    "pressure": "its zero is off, or the regulator does not vent. Vent the muscle and take the zero of the gauge",
}


def step_of_pressure(trial: TrialData) -> Command | None:
    """The command of the step."""
    return next((c for c in trial.commands if c.output == "pressure" and c.phase == "step"), None)


def followed(run: RunData, trial: TrialData) -> TrialData:
    """The trial with the declared filters of its channels undone: for a reading y the input is y + lag y'.

    If they are read less often than recorded, the pressure is interpolated between new values, and the displacement is
    nan where it is not new.
    """
    channels, lags = dict(trial.channels), lags_of(run, trial)
    x = trial.channels["displacement"]
    channels["displacement"] = np.where(fresh(x), x, np.nan)
    channels["pressure"] = between_new(trial.t, trial.channels["pressure"])[0]
    for name in CHANNELS:
        if lags[name] > 0:
            y = channels[name].copy()
            ok = trial.usable & np.isfinite(y)
            y[ok] += smooth(trial.t[ok], y[ok], lags[name]).y - smooth(trial.t[ok], y[ok]).y
            channels[name] = y
    return replace(trial, channels=channels)


def apart(trial: TrialData) -> float:
    """Time between new values of a polled pressure [s]; 0 for others."""
    return between_new(trial.t, trial.channels["pressure"])[1]


def off_zero(run: RunData, trial: TrialData, channel: str) -> float:
    """Reading of a channel before a step from 0, if it exceeds calibration and noise [SI]; else 0."""
    command = step_of_pressure(trial)
    if command is None or command.before > 0:
        return 0.0
    values = trial.channels[channel]
    new = trial.usable & np.isfinite(values) & fresh(values)
    y = values[new & (trial.t < command.t)]
    if not len(y):
        return 0.0
    by_noise = SURE * max(noise_of(values[new]), float(y.std())) / sqrt(len(y))
    size = float(y.mean())
    return size if abs(size) > max(Scales.of([run]).offsets.get(channel, 0.0), by_noise) else 0.0


def coarse(run: RunData, trial: TrialData, channel: str, inside: NDArray[np.bool_]) -> float:
    """Error of a mean over the rows `inside` because a channel is read in steps [SI].

    Noise much smaller than a step does not average it out; and a converter that truncates reads half a step too low,
    unless it was calibrated to better than that.
    """
    step = count_of(run, trial, channel)
    if not 0 < step < inf:
        return 0.0
    cut = 0.5 * step if 0.5 * step > Scales.of([run]).offsets.get(channel, 0.0) else 0.0
    return cut + unresolved(trial.channels[channel][inside], step)


def off_zero_findings(steps: Sequence[Mapping[str, float]]) -> list[Finding]:
    """Doubts for channels that do not read 0 before the steps, from the results of `off_zero`."""
    found = []
    for channel, quantity in CHANNELS.items():
        sizes = [one[channel] for one in steps if one[channel]]
        if sizes:
            most = show(max(sizes, key=abs), quantity, 2)
            text = f"before {len(sizes)} of {len(steps)} steps the {channel} reads up to {most}, more than its"
            text += f" calibration and its noise allow: {WHY[channel]}. The intervals hold it"
            found.append(Finding("doubt", text))
    return found
