"""When something begins: dead times from the command to the pressure, and from there to the motion of a trial.

Knows samples and commands, no coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import noise_of
from pmabench.store.records import Array

SEEN = 6.0
"""A change counts where it exceeds this many standard deviations of the baseline."""
LEAST = {"pressure": 200.0, "displacement": 10e-6}
"""Least change that counts, where the baseline has less noise [SI]."""
RISE = 4.0
"""The line back to the baseline is laid through the samples up to this many times the threshold."""
KINDS = ("command-to-pressure", "pressure-to-motion", "command-to-motion")


def onset(t: Array, y: Array, command: float, least: float) -> float | None:
    """The moment [s] at which `y` leaves its level before `command` [s]; None if it does not.

    Threshold: `SEEN` times the noise of the samples before the command, at least `least`. From there a line through
    the first samples above it is followed back to the level; where it misses the last still sample by far, y has
    jumped from one sample to the next, at the latter.
    """
    before = y[t < command - 1e-9]
    if len(before) < 8:
        return None
    level = float(np.mean(before))
    threshold = max(least, SEEN * noise_of(before))
    rise = y - level
    above = np.flatnonzero((rise > threshold) & (t >= command - 1e-9))
    held = above[:-2][(above[2:] - above[:-2]) == 2]
    if not len(held):
        return None
    first = int(held[0])
    beyond = np.flatnonzero(rise[first:] > RISE * threshold)
    last = first + max(2, int(beyond[0]) if len(beyond) else 2)
    part = slice(first, last + 1)
    slope, height = np.polyfit(t[part] - t[first], rise[part], 1)
    still = np.flatnonzero(rise[:first] <= threshold / SEEN)
    reached, earliest = float(t[first]), float(t[still[-1]]) if len(still) else command
    at = reached - float(height / slope) if slope > 0 else command
    if at >= earliest - float(t[first] - t[first - 1]):
        return min(reached, max(earliest, at))
    return reached if rise[first] > RISE * threshold else earliest


def dead_times(t: Array, channels: Mapping[str, Array], usable: NDArray[np.bool_], command: float) -> dict[str, float]:
    """Times [s] between command, pressure and motion of a contraction that is commanded at `command` [s]."""
    near = usable & (t < command + 2.0)
    found = {name: onset(t[near], channels[name][near], command, least) for name, least in LEAST.items()}
    result = {}
    pressure, motion = found["pressure"], found["displacement"]
    if pressure is not None:
        result["command-to-pressure"] = pressure - command
    if motion is not None:
        result["command-to-motion"] = motion - command
        if pressure is not None:
            result["pressure-to-motion"] = motion - pressure
    return result
