"""One step of displacement: force before, at its peak and relaxed, how force and pressure come back; no campaign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from pmabench.analysis.shared.projection import left_by
from pmabench.analysis.shared.samples import (
    UNDECLARED,
    Held,
    NotUsable,
    ends,
    noise_of,
    on_time,
    refuse_flagged,
    refuse_incomplete,
    settings_of,
)
from pmabench.store.records import Array, Command, RunData, TrialData

LAST = 0.2
"""Share of each rest at its end whose mean counts as relaxed."""
SEEN = 6.0
"""A recovery counts where it is larger than so many standard deviations of the noise."""
THERE = 0.01
"""Share of the step by which the displacement may still be off when its motion counts as over."""
FEWEST = 8
"""Samples that a recovery needs within three time constants."""


@dataclass(frozen=True, eq=False)
class Recovery:
    """y = end + size exp(-t/tau) after the motion; size as y, tau [s]."""

    size: float
    tau: float
    apart: float
    """How far tau is from that of the later part of the way back, from half a time constant on, or from that of a
    fit with a drift [s]: a course that is no single exponential shows in it."""


@dataclass(frozen=True, eq=False)
class Relaxation:
    """One step, there or back. Forces [N], pressures [Pa]; above 0 it contracts."""

    moved: float
    """Measured displacement of the step [m]."""
    before: float
    peak: float
    relaxed: float
    earlier: Held
    """The force along the second half of the rest before [N]."""
    later: Held
    """The same of the rest after [N]."""
    blunted: float
    """What a filter of the force cell of `filter_of` would change the peak by [N]."""
    sampled: float
    """Change of the force over the sample before its peak [N]: so far the peak may lie beyond it."""
    pressure_peak: float
    """Largest difference of the pressure from that before; nan where it is not recorded."""
    pressure_noise: float
    """Of the pressure [Pa]: the largest difference is that of the noise where the pressure stays."""
    force_back: Recovery | None
    pressure_back: Recovery | None
    noise: float
    """Of the force [N]."""

    @property
    def static(self) -> float:
        """Stiffness from relaxed forces [N/m]."""
        return -(self.relaxed - self.before) / self.moved

    @property
    def instant(self) -> float:
        """Stiffness from the peak [N/m]: damping and pressure are in it."""
        return -(self.peak - self.before) / self.moved


@dataclass(frozen=True, eq=False)
class Steps:
    """The steps of one trial, and the samples around the last step away from the start."""

    run: RunData
    trial: TrialData
    there: tuple[Relaxation, ...]
    back: tuple[Relaxation, ...]
    last: dict[str, Array]
    """`t` from the command on [s], `force`, `displacement`, `pressure` where it is recorded."""


def measure(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Steps:
    """One trial from its samples, without the cycles at its start that `options`, else the plan, `discard`.

    Raises `NotUsable` where it ended early, lacks a channel or a whole step.
    """
    refuse_incomplete(trial, "displacement", "force")
    refuse_flagged(trial.usable)
    ramps = [c for c in trial.commands if c.output == "displacement" and c.kind == "ramp" and c.phase in _PHASES]
    if not ramps:
        raise NotUsable("it holds no step")
    ends = [*(c.t for c in ramps[1:]), float(trial.t[-1]) + 1e-9]
    begins = [float(trial.t[0]), *(c.t for c in ramps[:-1])]
    values = {name: on_time(run, trial, name) for name in ("displacement", "force", "pressure")}
    found: dict[str, list[Relaxation]] = {"step": [], "back": []}
    for ramp, begin, end in zip(ramps, begins, ends, strict=True):
        found[ramp.phase].append(_one(run, trial, values, ramp, begin, end))
    discard = int(settings_of(run, options).get("discard", 1))
    found = {phase: steps[discard:] for phase, steps in found.items()}
    if not found["step"] or not found["back"]:
        raise NotUsable("it holds no step there and back beyond those left out")
    place = max(i for i, ramp in enumerate(ramps) if ramp.phase == "step")
    rows = (trial.t >= ramps[place].t - 0.1 * (ends[place] - ramps[place].t)) & (trial.t < ends[place]) & trial.usable
    last = {name: column[rows] for name, column in values.items() if np.isfinite(column).all()}
    return Steps(run, trial, tuple(found["step"]), tuple(found["back"]), {"t": trial.t[rows] - ramps[place].t, **last})


_PHASES = ("step", "back")


def _one(
    run: RunData, trial: TrialData, values: dict[str, Array], ramp: Command, begin: float, end: float
) -> Relaxation:
    """The step of one command; `begin` and `end` [s] are those of the rests before and after it."""
    arrived = ends(ramp) if ramp.data.get("rate", 0.0) > 0 else ramp.t
    t, good = trial.t, trial.usable
    before = good & (t >= ramp.t - LAST * (ramp.t - begin)) & (t < ramp.t - 1e-9)
    after = good & (t >= end - LAST * (end - arrived)) & (t < end)
    moving = good & (t >= ramp.t) & (t < end)
    rest = good & (t > arrived + 1e-9) & (t < end)
    if min(before.sum(), after.sum()) < 3 or rest.sum() < 2 * FEWEST:
        raise NotUsable("fewer than 3 samples at the end of a rest")
    x, F, P = values["displacement"], values["force"], values["pressure"]
    level, relaxed = float(F[before].mean()), float(F[after].mean())
    moved = float(x[after].mean() - x[before].mean())
    noise = noise_of(F[rest])
    if abs(moved) <= 6 * noise_of(x[rest]) or moved == 0:
        raise NotUsable("the displacement does not move above its noise")
    away = F[moving] - level
    place = int(np.argmax(-np.sign(moved) * away))
    earlier, later = (
        Held.of(t[rows], F[rows], since)
        for rows, since in (
            (good & (t >= 0.5 * (begin + ramp.t)) & (t < ramp.t - 1e-9), ramp.t - LAST * (ramp.t - begin)),
            (good & (t >= 0.5 * (arrived + end)) & (t < end), end - LAST * (end - arrived)),
        )
    )
    known = bool(np.isfinite(P).all())
    still = rest & (t > _arrival(t[moving], x[moving], float(x[after].mean()), abs(moved), arrived))
    if still.sum() < 2 * FEWEST:
        raise NotUsable("the displacement comes to rest too late")
    since = t[still] - t[still][0]
    pressure_peak = float("nan")
    if known:
        off = P[moving] - float(P[before].mean())
        pressure_peak = float(off[np.argmax(np.abs(off))])
    return Relaxation(
        moved=moved,
        before=level,
        peak=level + float(away[place]),
        relaxed=relaxed,
        earlier=earlier,
        later=later,
        blunted=_blunted(t[moving], away, moved, filter_of(run)),
        sampled=abs(float(away[place] - away[max(0, place - 1)])),
        pressure_peak=pressure_peak,
        pressure_noise=noise_of(P[moving]) if known else 0.0,
        force_back=recovery(since, F[still]),
        pressure_back=recovery(since, P[still]) if known else None,
        noise=noise,
    )


def filter_of(run: RunData) -> float:
    """Time constant of the force cell's filter [s], as declared, or what one may have where none is."""
    info = run.channels.get("force")
    return info.sensor_lag if info is not None and info.sensor_lag > 0 else UNDECLARED


def _blunted(t: Array, away: Array, moved: float, constant: float) -> float:
    """How much lower the peak is once more behind a filter of first order, shape (n,) both."""
    keep = float(np.exp(-np.median(np.diff(t)) / constant))
    slower = np.asarray(lfilter([1 - keep], [1, -keep], away - away[0]) + away[0])
    way = -np.sign(moved)
    return abs(float(np.max(way * away) - np.max(way * slower)))


def _arrival(t: Array, x: Array, end: float, size: float, arrived: float) -> float:
    """When the measured motion is over [s]: from then on it stays within `THERE` of its end; not before the command."""
    late = t[np.abs(x - end) > THERE * size]
    return max(float(late[-1]), arrived) if len(late) else arrived


def recovery(t: Array, y: Array) -> Recovery | None:
    """The exponential by which `y` comes to rest, from `t` = 0 [s] on; None where none shows above the noise."""
    noise = noise_of(y)
    tau, inside = _time_constant(t, y)
    terms, left = _exponential(t, y, tau)
    size = float(terms[1])
    if not inside or np.count_nonzero(t < 3 * tau) < FEWEST:
        return None
    if abs(size) < max(SEEN * noise, 3 * left**0.5, 1e-6 * float(np.max(np.abs(y)))):
        return None
    late = t >= 0.5 * tau
    others = [_time_constant(t, y, 1)[0]]
    if late.sum() > FEWEST:
        others.append(_time_constant(t[late] - t[late][0], y[late])[0])
    return Recovery(size, tau, max(abs(other - tau) for other in others))


def _exponential(t: Array, y: Array, tau: float) -> tuple[Array, float]:
    """Constant and size of an exponential through y, and the mean square of what is left."""
    design = np.column_stack([np.ones_like(t), np.exp(-t / tau)])
    terms, *_ = np.linalg.lstsq(design, y, rcond=None)
    return np.asarray(terms), float(np.mean((y - design @ terms) ** 2))


def _time_constant(t: Array, y: Array, order: int = 0) -> tuple[float, bool]:
    """The time constant that leaves least [s], and whether it is within the range that is looked at."""
    step = float(np.median(np.diff(t)))
    grid = np.log(np.geomspace(step, 0.5 * float(t[-1]), 30))
    fixed = np.stack([np.ones_like(t), *[t] * order])

    def left(logarithms: Array) -> Array:
        return left_by(fixed, np.exp(-t / np.exp(logarithms)[:, None])[:, None], y) / len(t)

    best = int(np.argmin(left(grid)))
    low, high = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    found = minimize_scalar(
        lambda s: left(np.array([s]))[0], bounds=(low, high), method="bounded", options={"xatol": 1e-5}
    )
    return float(np.exp(found.x)), best not in (0, len(grid) - 1)


def stiffness_of(run: RunData, trial: TrialData) -> float:
    """Stiffness of one trial's steps away from the start, by relaxed forces [N/m]; raises `NotUsable`."""
    return float(np.mean([step.static for step in measure(run, trial, {}).there]))
