"""Whether what should move in a trial moved, or a channel shows nothing but its noise; knows no kind of test."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pmabench.analysis.results import Analysis, Finding
from pmabench.store.records import RunData, TrialData

BLOCKS = 40
"""The trial is averaged in at most so many parts ..."""
LEAST_SAMPLES = 10
"""... of at least so many samples, so that noise averages out and motion does not."""
MOST_NAMES = 3
"""So many trials are named in a sentence."""
SPREADS = 3.0
"""Standard deviations of the noise that a change must exceed."""
LEAST = {"displacement": 20e-6}
"""Channel -> smallest change [SI] that counts as one: a gauge is repeatable to this."""
DRIVEN = ("frequency", "speed", "step", "amplitude", "lower", "upper", "setpoint")
"""Entries of an operating point that say that the free end is driven."""
Holds = Callable[[float, float], bool]
"""Whether the muscle at a pressure [Pa] does not lift a load [N]."""


def never(_pressure: float, _load: float) -> bool:
    """`Holds` of a muscle of which nothing is known: it is meant to lift every load."""
    return False


def not_moved(channel: str, trial: TrialData, holds: Holds) -> bool:
    """Whether `channel`, which changes in each trial of its kind of test, should have changed and did not.

    Nothing moves without pressure, nor under a load that the muscle `holds`, unless the free end is driven.
    """
    pressure, load = trial.point.get("pressure"), trial.point.get("load")
    if pressure is None or any(name in trial.point for name in DRIVEN):
        return nothing_moved(trial, channel)
    held = load is not None and holds(pressure, load)
    return not held and (pressure > 0 or "from" in trial.point) and nothing_moved(trial, channel)


def with_motion(analysis: Analysis, runs: Sequence[RunData], channel: str) -> Analysis:
    """The analysis with a doubt where `channel` did not change in a trial that lifts its load by the F_ce found."""
    found = {e.at["pressure"]: e.value for e in analysis.estimates if e.symbol == "F_ce" and "pressure" in e.at}
    known = sorted((pressure, value) for pressure, value in found.items() if value is not None)
    friction = max((abs(e.value) for e in analysis.estimates if e.symbol == "F_c" and e.value is not None), default=0.0)

    def holds(pressure: float, load: float) -> bool:
        pulls = [value for at, value in known if at >= pressure - 1.0]  # F_ce grows with the pressure
        return bool(pulls) and min(pulls) - load <= 2 * friction

    trials = [trial for run in runs for trial in run.trials if trial.status == "finished" and not trial.again]
    still = [trial.name for trial in trials if not_moved(channel, trial, holds)]
    if not still:
        return analysis
    names = ", ".join(still[:MOST_NAMES]) + (" ..." if len(still) > MOST_NAMES else "")
    text = (
        f"nothing moved in {len(still)} of {len(trials)} trials ({names}): {channel} changed by less than its "
        "noise; look at its gauge, at the hose to the muscle and at the load"
    )
    return replace(analysis, findings=(*analysis.findings, Finding("doubt", text)))


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
