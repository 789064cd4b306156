"""What the sensors of one step leave open, besides their calibration and lags: zeros, steps, noise; knows no model."""

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
"""Standard deviations of its mean from which on a reading at rest is none by noise."""
WHY = {
    "displacement": "its zero is off, or friction, creep or a load hold the muscle. Vent, wait and take the zero",
    "pressure": "its zero is off, or the regulator does not vent. Vent the muscle and take the zero of the gauge",
}


def step_of_pressure(trial: TrialData) -> Command | None:
    """The command of the step."""
    return next((c for c in trial.commands if c.output == "pressure" and c.phase == "step"), None)


def followed(run: RunData, trial: TrialData) -> TrialData:
    """The trial without the filters that its channels declare: where one reads y, y + lag y' was there.

    Where they are read less often than they are recorded, the pressure goes straight from one new value to the next,
    and the displacement is known only where it is new.
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
    """How far the new values of the pressure are apart where it is polled [s], else 0."""
    return between_new(trial.t, trial.channels["pressure"])[1]


def off_zero(run: RunData, trial: TrialData, channel: str) -> float:
    """What a channel reads before a step from 0, beyond its calibration and its noise [SI]; else 0."""
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
    """What the steps of a channel may make of a mean over the rows `inside` [SI].

    Noise that is small next to a step does not average it away, and a converter that cuts off reads half a step too
    low, which a calibration to less than that was not made through.
    """
    step = count_of(run, trial, channel)
    if not 0 < step < inf:
        return 0.0
    cut = 0.5 * step if 0.5 * step > Scales.of([run]).offsets.get(channel, 0.0) else 0.0
    return cut + unresolved(trial.channels[channel][inside], step)


def off_zero_findings(steps: Sequence[Mapping[str, float]]) -> list[Finding]:
    """Channels that read something else than 0 before the steps, by what `off_zero` gives for each of them."""
    found = []
    for channel, quantity in CHANNELS.items():
        sizes = [one[channel] for one in steps if one[channel]]
        if sizes:
            most = show(max(sizes, key=abs), quantity, 2)
            text = f"before {len(sizes)} of {len(steps)} steps the {channel} reads up to {most}, more than its"
            text += f" calibration and its noise allow: {WHY[channel]}. The intervals hold it"
            found.append(Finding("doubt", text))
    return found
