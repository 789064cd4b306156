"""Simulation of trials with a fitted muscle or with the model in a plan.

Many intervals are integrated in parallel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import inf, sqrt
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pmabench.analysis.shared.samples import Noise, Samples
from pmabench.store.records import Array, RunData, TrialData

if TYPE_CHECKING:  # plants import scipy, which takes longer than a reduction that needs none
    from pmabench.model.presets import Described

SUBSTEPS = 2
"""Integration steps per sample."""
GOLDEN = (1 + sqrt(5)) / 2
"""Multiples of this, modulo 1, fill the interval between two steps evenly."""
BLOCK = 128
"""Samples that are prepared at once: few enough to stay in the fast memory of the processor."""
TOGETHER = 16
"""Columns that are filled at once: each line of the processor's memory is then written a few times, not eight."""
LEAST = 1.0
"""Lower limit of stiffness [N/m] and damping [N.s/m] in a simulation."""
SURE = 1e30
"""Times any speed or contraction more than any force or speed: what moves does not turn within a step, and what lies
on its support does not move down."""


class Coefficients(Protocol):
    """A muscle given by its coefficients over pressure."""

    @property
    def coulomb(self) -> float:
        """Coulomb friction [N]."""
        ...

    def coefficients(self, P: Array) -> Array:
        """F_ce [N], K [N/m], B_c and B_r [N.s/m] at pressures P [Pa] of any shape; shape (4, *P.shape)."""
        ...


@dataclass(frozen=True)
class Replayed:
    """Simulated contraction [m] and force at the cell [N], shape (n, m) for m intervals."""

    x: Array
    force: Array


def run(
    fit: Coefficients, P: Array, dt: float, load: Array, mass: Array, x: Array, substeps: int = SUBSTEPS,
    more: Callable[[Array, Array], Array] | None = None,
) -> Replayed:  # fmt: skip
    """Integrate M x'' = F_ce(P) - K(P) x - B(P) x' - F_c sign(x') - F_L with x >= 0, from rest.

    Each step is exact for the damping and trapezoidal for the spring, with coefficients at the middle, and so stable
    for any mass. A muscle at rest stays until the unbalanced force exceeds F_c. The cell reads F_L + M x''.

    Parameters
    ----------
    P
        Pressure [Pa], shape (n, m): sample, stretch. Straight lines between samples.
    dt
        Sampling period [s].
    load, mass, x
        F_L [N], moving mass [kg] and contraction at the start [m] of each stretch, shape (m,).
    more
        Force [N] in addition to F_ce - K x, from contraction [m] and pressure [Pa], shape (m,).
    """
    h = dt / substeps
    all_x, all_v, force = np.empty(P.shape), np.zeros(P.shape), np.empty(P.shape)

    def steps(first: int) -> Iterator[tuple[tuple[Array, ...], ...]]:
        """From each of `BLOCK` samples to the next the steps in between."""
        rows = slice(first, first + BLOCK + 1)
        F, *others = fit.coefficients(P[rows])
        np.minimum(F, load, out=force[rows])
        begins = [F, *(np.maximum(values, LEAST, out=values) for values in others), P[rows]]
        changes = [np.diff(values, axis=0) for values in begins]
        return zip(*(at_middles(part, zip(begins, changes, strict=True)) for part in range(substeps)), strict=True)

    def at_middles(part: int, courses: Iterable[tuple[Array, Array]]) -> Iterator[tuple[Array, ...]]:
        """Force, stiffness, pressure; for each direction what becomes of speed and force: speed and way in a step."""
        F, k, *dampings, at = (begin[:-1] + (part + 0.5) / substeps * change for begin, change in courses)
        damping = np.stack(dampings, axis=1) + (0.5 * h * k)[:, None]
        rate = damping / mass
        fade = np.expm1(-rate * h)
        slower = fade / rate
        return zip(F - load, k, at, 1 + fade, -fade / damping, -slower, (h + slower) / damping, strict=True)

    # speeds, ways and forces up and down, shape (2, m); results in place and no scalar among them take half the time
    v, way, pull, part = (np.zeros((2, P.shape[1])) for _ in range(4))
    (up, down), (rise, fall), (pull_up, pull_down), other = v, way, pull, v[::-1]
    x, drive, F_c, all_x[0] = x.copy(), np.empty(P.shape[1]), np.full(P.shape[1], max(0.0, fit.coulomb)), x
    none, sure, opposite = np.zeros(v.shape), np.full(v.shape, SURE), -F_c
    multiply, subtract, at_least = np.multiply, np.subtract, np.maximum
    for i, parts in enumerate(chain.from_iterable(map(steps, range(0, max(1, len(P) - 1), BLOCK))), 1):
        for F, k, at, slowed, gained, by_speed, by_force in parts:
            subtract(F, multiply(k, x, drive), drive)
            if more is not None:
                drive += more(x, at)
            subtract(drive, F_c, pull_up)
            subtract(opposite, drive, pull_down)
            pull -= multiply(other, sure, part)
            multiply(v, by_speed, way)
            way += multiply(pull, by_force, part)
            v *= slowed
            v += multiply(pull, gained, part)
            at_least(way, none, out=way)
            at_least(v, none, out=v)
            x += rise
            x -= fall
            at_least(x, none[0], out=x)
            np.minimum(down, multiply(x, sure[0], drive), out=down)
        all_x[i] = x
        subtract(up, down, all_v[i])
    gained = np.gradient(all_v, dt, axis=0)
    np.add(load, np.multiply(mass, gained, out=gained), out=force, where=all_x > 0)
    return Replayed(all_x, force)


@dataclass(frozen=True)
class Stretches:
    """Intervals of trials of equal length, each starting at rest, as columns of `P` (n, m) [Pa]; others (m,), SI."""

    source: tuple[Samples, ...]
    P: Array
    load: Array
    mass: Array
    x: Array
    dt: float


def as_columns(courses: Sequence[Array]) -> Array:
    """Arrays of different length as columns, shape (n, m); shorter ones are extended by their last value."""
    columns = np.empty((max(map(len, courses)), len(courses)))
    for first in range(0, len(courses), TOGETHER):
        some = courses[first : first + TOGETHER]
        rows = np.empty((len(some), len(columns)))
        for row, one in zip(rows, some, strict=True):
            row[: len(one)], row[len(one) :] = one, one[-1]
        columns[:, first : first + TOGETHER] = rows.T
    return columns


def stretches(pieces: Sequence[tuple[Samples, slice]], dt: float, rest: int) -> Stretches:
    """Intervals of trials, sampled every `dt` [s], as columns; shorter ones are extended by their last pressure.

    Each starts at rest at the mean contraction of the `rest` samples before it.
    """
    courses, source, start = list[Array](), list[Samples](), list[float]()
    for samples, rows in pieces:
        size, whole = rows.stop - rows.start, samples.P
        if samples.ok.any() and not samples.ok.all():  # what drives a replay has no gap
            whole = np.interp(samples.t, samples.t[samples.ok], samples.P[samples.ok])
        courses.append(whole[rows])
        before = slice(max(0, rows.start - rest), rows.start + 1)
        still = samples.x[before][samples.ok[before]]
        start.append(max(0.0, float(np.mean(still))) if len(still) else 0.0)
        t, ok = dt * np.arange(size), samples.ok[rows]
        source.append(replace(samples, t=t, P=whole[rows], x=samples.x[rows], force=None, ok=ok))
    load, mass = (np.array([getattr(samples, name) for samples, _ in pieces]) for name in ("load", "mass"))
    return Stretches(tuple(source), as_columns(courses), load, mass, np.array(start), dt)


def measured(
    work: Stretches, replayed: Replayed, noise: Noise, cell: bool, count: int, step: float = 0.0
) -> Iterator[list[Samples]]:
    """The simulated samples `count` times with other `noise`, with a force where there is a `cell`; reproducible.

    Pressure is quantised in steps of `step` [Pa], with another offset each time; not at all where that is 0.
    """
    parts = list[Array]()
    for samples, *simulated in zip(work.source, replayed.x.T, replayed.force.T, strict=True):
        parts += [samples.P, *(column[: len(samples.t)] for column in simulated)]
    exact, sizes = np.concatenate(parts), [len(part) for part in parts]
    size = np.repeat(np.resize(tuple(vars(noise).values()), len(sizes)), sizes)
    for seed in range(count):
        values = np.random.default_rng(seed).standard_normal(len(exact))
        values *= size
        values += exact
        columns, result = iter(np.split(values, np.cumsum(sizes)[:-1])), list[Samples]()
        for samples, P, x, force in zip(work.source, columns, columns, columns, strict=True):
            read = step * (np.round(P / step + seed / GOLDEN) - seed / GOLDEN) if step else P
            result.append(replace(samples, P=read, x=x, force=force if cell else None))
        yield result


def between_steps(P: Array, step: float) -> Array:
    """Reconstruct a pressure (n,) that was quantised in steps of `step` [as P].

    It is straight between successive crossings of the middle between two readings, and constant while a reading lasts
    much longer than its neighbours. Where noise repeats a crossing, the mean of the first and last time is used.
    """
    return np.asarray(0.5 * step * (_passed(P / step) + _passed(P[::-1] / step)[::-1]))


def _passed(read: Array) -> Array:
    """Reconstruction in units of the step, from the first time of each crossing."""
    now, found = float(read[0]), list[tuple[float, float]]()
    for place in (np.flatnonzero(np.diff(read)) + 1).tolist():
        to = min(max(now, read[place] - 0.5), read[place] + 0.5)
        if to != now:
            jump = to - now
            found.append((place - 0.5, to - 0.5 * float(np.sign(jump)) * max(0.0, abs(jump) - 1)))
            now = to
    if len(found) < 2:
        return read
    at, value = np.array(found).T
    lasts = np.diff(at)
    around = np.maximum(np.append(0.0, lasts[:-1]), np.append(lasts[1:], 0.0))
    long = np.concatenate(([True], lasts > 2 * around, [True]))
    edges = np.concatenate(([0], np.ceil(at).astype(int), [len(read)]))
    level = np.add.reduceat(read, edges[:-1]) / np.diff(edges)
    begins = at + np.append(lasts[0], lasts)  # a level is reached as fast as the reading before it was passed
    ends = at - np.append(lasts, lasts[-1])
    t = np.concatenate((at, ends[long[:-1]], begins[long[1:]]))
    values = np.concatenate((value, level[:-1][long[:-1]], level[1:][long[1:]]))
    order = np.argsort(t)
    return np.asarray(np.interp(np.arange(len(read)), t[order], values[order]), dtype=np.float64)


LEAST_MASS = 0.5
"""Moving mass [kg] where none is recorded."""


CALMED = 0.05
"""Averaging time of the measured pressure that drives a model with friction [s]."""


def _calm(P: Array, width: int) -> Array:
    """Moving mean over `width` samples, same shape; ends are extended by their values."""
    if width <= 1:
        return P
    padded = np.concatenate((np.full(width // 2, P[0]), P, np.full(width - 1 - width // 2, P[-1])))
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


@dataclass(frozen=True)
class _Coefficients:
    """Coefficients of a described muscle, for `run`."""

    model: Described

    @property
    def coulomb(self) -> float:
        """Coulomb friction while it slides [N]."""
        return self.model.muscle.friction.F_c

    def coefficients(self, P: Array) -> Array:
        """As in `Coefficients`."""
        muscle = self.model.muscle
        return np.array([curve.values(P) for curve in (muscle.F_ce, muscle.K, muscle.B_c, muscle.B_r)])


def model_of(run: RunData) -> Described | None:
    """The model in a run's plan; None without one."""
    from pmabench.model.presets import Described

    model = (run.plan.get("settings") or {}).get("model")
    return Described.of(model) if isinstance(model, Mapping) else None


def load_of(trial: TrialData) -> tuple[float, float]:
    """F_L [N] and moving mass [kg] of a trial."""
    mass = float(trial.point.get("mass", 0.0))
    return float(trial.point.get("load", 0.0)), mass if mass > 0 else LEAST_MASS


def from_measured_pressure(
    model: Described, trials: Sequence[TrialData], period: float, origins: Sequence[float]
) -> list[Array]:
    """Contraction [m] of the model for each trial, driven by the measured pressure from rest at `origins` [m].

    All trials are integrated in parallel with steps of `period` [s]. For a model with friction the pressure is averaged
    over `CALMED`, because its noise would release the muscle.
    """
    if not trials:
        return []
    driving = []
    for trial in trials:
        ok = trial.usable & np.isfinite(trial.channels["pressure"])
        driving.append((trial.t[ok], trial.channels["pressure"][ok]))
    if model.surface is not None:
        from pmabench.model.identified.plant import free_run

        # its hysteresis is a spring for small moves: the noise of the pressure does not shake it loose
        return [
            free_run(model.surface, trial.t, np.interp(trial.t, *known), *load_of(trial), origin)[0]
            for trial, known, origin in zip(trials, driving, origins, strict=True)
        ]
    grids = [np.arange(trial.t[0], trial.t[-1] + 0.5 * period, period) for trial in trials]
    width = round(CALMED / period) if model.muscle.friction.F_c > 0 else 1
    P = as_columns([_calm(np.interp(grid, *known), width) for known, grid in zip(driving, grids, strict=True)])
    loads, masses = np.array([load_of(trial) for trial in trials]).T
    x = run(_Coefficients(model), P, period, loads, masses, np.maximum(0.0, origins)).x
    return [
        np.interp(trial.t, grid, x[: len(grid), i]) for i, (trial, grid) in enumerate(zip(trials, grids, strict=True))
    ]


def from_commanded_pressure(model: Described, trial: TrialData, origin: float = 0.0) -> Array:
    """Contraction [m], shape (n,), of muscle and regulator of the model, driven by the commanded pressures.

    It starts at rest at `origin` [m].
    """
    from pmabench.model.regulator import constant

    load, mass = load_of(trial)
    start = float(trial.t[0])
    plant = model.plant(load, mass, x=origin)
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
    """Simulate a trial's PID controller with the model, sampled every `period` [s].

    `law` holds the recorded parameters of the law `pid`. The model starts at rest at `origin` [m], with the recorded
    start pressure.
    """
    from pmabench.model.pid import PID
    from pmabench.model.regulator import constant

    begin, end, setpoint, sent = (float(law[name]) for name in ("t0", "t1", "setpoint", "start"))
    tracking = None if law.get("tracking") is None else float(law["tracking"])
    ranges = {name: float(law[name]) for name in ("N", "low", "high", "start")}
    T_i = inf if law.get("T_i") is None else float(law["T_i"])
    controller = PID(
        float(law["K_p"]), T_i, float(law.get("T_d") or 0.0), **ranges, anti_windup=str(law["anti_windup"]),
        tracking=tracking,
    )  # fmt: skip
    plant = model.plant(*load_of(trial), sent, origin)
    count = round((end - begin) / period) + 1
    x, command = np.empty(count), np.empty(count)
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
