"""The model that a plan carries, simulated beside a trial: driven by pressures, or in closed loop; fits nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from pmabench.analysis.shared import replay
from pmabench.model.pid import PID
from pmabench.model.presets import Described
from pmabench.model.regulator import constant
from pmabench.store.records import Array, RunData, TrialData

LEAST_MASS = 0.5
"""Moving mass where the record tells none [kg]."""


CALMED = 0.05
"""Time over which the measured pressure is averaged before it drives a model with friction [s]."""


def _calm(P: Array, width: int) -> Array:
    """Moving mean over `width` samples, ends held."""
    if width <= 1:
        return P
    padded = np.concatenate((np.full(width // 2, P[0]), P, np.full(width - 1 - width // 2, P[-1])))
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


@dataclass(frozen=True)
class _Coefficients:
    """A described muscle as `replay` takes it."""

    model: Described

    @property
    def coulomb(self) -> float:
        """Coulomb friction while it slides [N]."""
        return self.model.muscle.friction.F_c

    def values(self, symbol: str, P: Array) -> Array:
        """A coefficient [SI] at pressures P [Pa]."""
        return np.asarray(getattr(self.model.muscle, symbol).values(P))


def model_of(run: RunData) -> Described | None:
    """The model in a run's plan; None where it has none."""
    model = (run.plan.get("settings") or {}).get("model")
    return Described.of(model) if isinstance(model, Mapping) else None


def load_of(trial: TrialData) -> tuple[float, float]:
    """F_L [N] and moving mass [kg] of a trial."""
    return float(trial.point.get("load", 0.0)), float(trial.point.get("mass", 0.0)) or LEAST_MASS


def from_measured_pressure(
    model: Described, trials: Sequence[TrialData], period: float, origins: Sequence[float]
) -> list[Array]:
    """Contractions [m], each as long as its trial: the muscle of the model, driven by the measured pressure from
    rest at `origins` [m].

    All trials are stepped side by side every `period` [s]. Where the model has friction the pressure is averaged over
    `CALMED`: its noise would shake the muscle loose.
    """
    if not trials:
        return []
    grids = [np.arange(trial.t[0], trial.t[-1] + 0.5 * period, period) for trial in trials]
    P = np.empty((max(map(len, grids)), len(trials)))
    width = round(CALMED / period) if model.muscle.friction.F_c > 0 else 1
    for column, (trial, grid) in enumerate(zip(trials, grids, strict=True)):
        measured = trial.channels["pressure"]
        ok = trial.usable & np.isfinite(measured)
        P[: len(grid), column] = _calm(np.interp(grid, trial.t[ok], measured[ok]), width)
        P[len(grid) :, column] = P[len(grid) - 1, column]
    loads, masses = np.array([load_of(trial) for trial in trials]).T
    x = replay.run(_Coefficients(model), P, period, loads, masses, np.maximum(0.0, origins)).x
    return [
        np.interp(trial.t, grid, x[: len(grid), i]) for i, (trial, grid) in enumerate(zip(trials, grids, strict=True))
    ]


def from_commanded_pressure(model: Described, trial: TrialData, origin: float = 0.0) -> Array:
    """Contraction [m], shape (n,): muscle and regulator of the model, driven by the pressures that were commanded.

    It rests at `origin` [m] before.
    """
    load, mass = load_of(trial)
    start = float(trial.t[0])
    plant = model.plant(load, mass)
    plant.x = min(max(0.0, origin), model.muscle.stop)
    for command in trial.commands:
        if command.output == "pressure" and command.kind == "set" and command.t <= trial.t[-1]:
            plant.command(constant(max(0.0, command.t - start), command.value))
    times = np.round(trial.t - start, 9)
    return np.asarray(plant.advance(float(times[-1]), times).x)


@dataclass(frozen=True)
class Loop:
    """A simulated loop at the times of a trial: contraction [m] and command [Pa], shape (n,)."""

    x: Array
    command: Array


def closed_loop(model: Described, trial: TrialData, law: Mapping[str, Any], period: float, origin: float = 0.0) -> Loop:
    """The controller of a trial around the model, sampled every `period` [s] as the bench does.

    `law` is what the law `pid` wrote down. Before, it rests without pressure at `origin` [m].
    """
    load, mass = load_of(trial)
    begin, end = float(law["t0"]), float(law["t1"])
    controller = PID(
        float(law["K_p"]),
        inf if law.get("T_i") is None else float(law["T_i"]),
        float(law.get("T_d") or 0.0),
        N=float(law["N"]),
        low=float(law["low"]),
        high=float(law["high"]),
        anti_windup=str(law["anti_windup"]),
        tracking=None if law.get("tracking") is None else float(law["tracking"]),
        start=float(law["start"]),
    )
    setpoint = float(law["setpoint"])
    plant = model.plant(load, mass, float(law["start"]))
    plant.x = min(max(0.0, origin), model.muscle.stop)
    count = round((end - begin) / period) + 1
    x, command = np.empty(count), np.empty(count)
    sent = float(law["start"])
    for k in range(count):
        x[k] = plant.x
        wanted = controller.update(period, setpoint, plant.x)
        if wanted != sent:
            plant.command(constant(plant.time, wanted))
            sent = wanted
        command[k] = wanted
        plant.reach(round((k + 1) * period, 9))
    times = begin + period * np.arange(count)
    late = np.minimum(np.searchsorted(times, trial.t + 1e-6, side="right") - 1, count - 1)
    before = late < 0
    late = np.maximum(late, 0)
    return Loop(
        np.where(before, max(0.0, origin), np.interp(trial.t, times, x)),
        np.where(before, float(law["start"]), command[late]),
    )
