"""Whether what should move in a trial moved, or a channel shows nothing but its noise."""

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
MOVES = {
    **dict.fromkeys(
        (
            "contraction-relaxation",
            "static-load",
            "sinusoidal-displacement",
            "ultimate-gain",
            "positioning",
            "validation",
            "isobaric-ramp",
            "step-displacement",
            "closed-volume",
            "free-contraction",
        ),
        "displacement",
    ),
    "isometric-pressurisation": "force",
    "arm-angle": "angle",
}
"""Kind of run -> the channel that changes in each of its trials."""
DRIVEN = ("frequency", "speed", "step", "amplitude", "lower", "upper", "setpoint")
"""Entries of an operating point that say that the free end is driven."""
Holds = Callable[[float, float], bool]
"""Whether the muscle at a pressure [Pa] does not lift a load [N]."""


def never(_pressure: float, _load: float) -> bool:
    """`Holds` of a muscle of which nothing is known: it is meant to lift every load."""
    return False


def not_moved(kind: str, trial: TrialData, holds: Holds) -> str:
    """The channel that should have changed in a trial of this kind and did not; empty where it changed.

    Nothing moves without pressure, nor under a load that the muscle `holds`, unless the free end is driven.
    """
    channel, pressure = MOVES.get(kind, ""), trial.point.get("pressure")
    if pressure is not None and not any(name in trial.point for name in DRIVEN):
        load = trial.point.get("load")
        if (load is not None and holds(pressure, load)) or (pressure <= 0 and "from" not in trial.point):
            return ""
    return channel if channel and nothing_moved(trial, channel) else ""


def with_motion(analysis: Analysis, runs: Sequence[RunData]) -> Analysis:
    """The analysis with a doubt where nothing moved in a trial that lifts its load by the F_ce that it found."""
    found = {e.at["pressure"]: e.value for e in analysis.estimates if e.symbol == "F_ce" and "pressure" in e.at}
    known = sorted((pressure, value) for pressure, value in found.items() if value is not None)
    friction = max((abs(e.value) for e in analysis.estimates if e.symbol == "F_c" and e.value is not None), default=0.0)

    def holds(pressure: float, load: float) -> bool:
        pulls = [value for at, value in known if at >= pressure - 1.0]  # F_ce grows with the pressure
        return bool(pulls) and min(pulls) - load <= 2 * friction

    trials = [(run.kind, t) for run in runs for t in run.trials if t.status == "finished" and not t.again]
    still = [(trial.name, channel) for kind, trial in trials if (channel := not_moved(kind, trial, holds))]
    if not still:
        return analysis
    names = ", ".join(name for name, _ in still[:MOST_NAMES]) + (" ..." if len(still) > MOST_NAMES else "")
    text = (
        f"nothing moved in {len(still)} of {len(trials)} trials ({names}): {still[0][1]} changed by less than its "
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
