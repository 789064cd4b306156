"""The displacement of a recorded loop: the samples that count and how late they may be; measures nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import lag_open
from pmabench.analysis.shared.skew import off
from pmabench.store.records import RunData, TrialData

ALONE = "one run: no repeats part"
LONGEST_TRACE = 4000


def followed(trial: TrialData) -> bool:
    """Whether a trial went along a path to its end."""
    law = trial.found.get("position") or {}
    whole = trial.status == "finished" and law.get("ended") == "time" and "displacement" in trial.channels
    return bool(whole and law.get("path"))


def looped(trial: TrialData, law: Mapping[str, Any]) -> NDArray[np.bool_]:
    """The usable samples of the loop."""
    during = (trial.t >= float(law["t0"]) - 1e-6) & (trial.t <= float(law["t1"]) + 1e-6)
    return np.asarray(trial.usable & np.isfinite(trial.channels["displacement"]) & during)


def at_rest(trial: TrialData, law: Mapping[str, Any]) -> NDArray[np.bool_]:
    """The usable samples before the loop began."""
    known = trial.usable & np.isfinite(trial.channels["displacement"])
    return np.asarray(known & (trial.t < float(law["t0"]) - 1e-6))


def lag_of(run: RunData) -> float:
    """Declared time constant of the sensor of the displacement [s]."""
    return run.channels["displacement"].sensor_lag if "displacement" in run.channels else 0.0


def late(run: RunData) -> float:
    """What is open of the time between displacement and commands [s]: the sensor's filter and its clock."""
    return lag_open(run, "displacement") + off([run], "displacement")
