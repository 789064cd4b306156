"""Comparison of measured trials with an identified muscle and with its straight form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import on_time
from pmabench.analysis.shared.simulated import from_measured_pressure
from pmabench.analysis.surface.trials import RATE, rows_of
from pmabench.model.identified.plant import force_along
from pmabench.model.presets import Described
from pmabench.store.records import Array, RunData, TrialData

FEWEST = 25
"""Fewest usable samples or rows of a trial."""
SLACK = 0.02
"""Share of the largest force below which a driven muscle is slack; these rows are not compared."""


@dataclass(frozen=True, eq=False)
class Replay:
    """Measured and computed values of one trial: arrays of shape (n,), SI."""

    trial: TrialData
    quantity: str
    """`displacement` for a free end under its load, `force` for a driven one."""
    t: Array
    P: Array
    measured: Array
    surface: Array
    straight: Array
    counts: NDArray[np.bool_]
    """Mask of rows that are compared."""
    beyond: bool
    """Whether pressures or contractions lie outside the range of the fit."""

    @property
    def off(self) -> tuple[float, float]:
        """Rms error of the surface and of the straight form [SI of the quantity]."""
        off = [(one - self.measured)[self.counts] for one in (self.surface, self.straight)]
        return float(np.sqrt(np.mean(off[0] ** 2))), float(np.sqrt(np.mean(off[1] ** 2)))


def together(replays: Sequence[Replay]) -> tuple[float, float]:
    """Rms error over all compared rows of all trials, of the surface and of the straight form."""
    count = np.array([one.counts.sum() for one in replays])
    square = np.array([one.off for one in replays]) ** 2
    surface, lines = np.sqrt(count @ square / count.sum())
    return float(surface), float(lines)


def replayed(model: Described, run: RunData, trial: TrialData) -> Replay | str:
    """Compare a trial with a model that has a surface; returns a reason as text where that is not possible.

    For a free end with a known load the motion is simulated from the measured pressure; for a driven end the force is
    computed from the measured length. Both start at rest.
    """
    if trial.status != "finished":
        return f"it is {trial.status}"
    if {"pressure", "displacement"} - set(trial.channels):
        return "pressure or displacement was not recorded"
    P, x = (on_time(run, trial, name) for name in ("pressure", "displacement"))
    ok = trial.usable & np.isfinite(P) & np.isfinite(x)
    if ok.sum() < FEWEST:
        return f"fewer than {FEWEST} samples can be used"
    if "load" in trial.point:
        return _free(model, run, trial, P, x, ok)
    if "force" not in trial.channels:
        return "neither the load nor the force is known"
    return _driven(model, run, trial)


def _free(model: Described, run: RunData, trial: TrialData, P: Array, x: Array, ok: NDArray[np.bool_]) -> Replay:
    origin, models = max(0.0, float(np.mean(x[ok][:5]))), (model, replace(model, surface=None))
    surface, lines = (from_measured_pressure(one, [trial], 1.0 / run.rate, [origin])[0] for one in models)
    beyond = _beyond(model, P[ok], surface[ok])
    return Replay(trial, "displacement", trial.t, P, x, surface, lines, ok, beyond)


def _driven(model: Described, run: RunData, trial: TrialData) -> Replay | str:
    P, x, F = (on_time(run, trial, name) for name in ("pressure", "displacement", "force"))
    t, P, x, F, v = rows_of(trial.t, P, x, F, trial.usable, RATE)
    if len(t) < FEWEST or model.surface is None:
        return f"fewer than {FEWEST} rows of {1 / RATE:.2g} s can be used"
    lines = model.muscle
    straight = lines.pull(P, x) - lines.damping(P, v) * v - lines.friction.F_c * np.sign(v)
    counts = np.asarray(F > SLACK * float(F.max()))
    surface = force_along(model.surface, t, P, x, v)
    return Replay(
        trial, "force", t, P, F, surface, np.maximum(straight, 0.0), counts, _beyond(model, P[counts], x[counts])
    )


def _beyond(model: Described, P: Array, x: Array) -> bool:
    low, high = (0.0, inf) if model.surface is None else model.surface.reach
    room_P, room_x = 0.02 * (model.domain[1] - model.domain[0]), 0.02 * (high - low)
    return bool(P.max() > model.domain[1] + room_P or x.max() > high + room_x or x.min() < low - room_x)
