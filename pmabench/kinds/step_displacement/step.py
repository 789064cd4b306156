"""One step of displacement at constant pressure: force and pressure before, at the peak, relaxed, and their recovery.

Uses trials and their samples; gives no coefficient.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from pmabench.analysis.shared import samples
from pmabench.analysis.shared.gaps import highest
from pmabench.analysis.shared.lines import left_by
from pmabench.analysis.shared.samples import UNDECLARED, Held, NotUsable, ends, lags_of, noise_of
from pmabench.store.records import Array, Command, RunData, TrialData

LAST = 0.2
"""Last share of each rest whose mean counts as relaxed."""
SEEN = 6.0
"""Size of a recovery, in standard deviations of noise, from which on it is significant."""
THERE = 0.01
"""Distance from the end, as a share of the step, at which the motion counts as over."""
FEWEST = 8
"""Samples that a recovery needs within three time constants."""
LAGS = 6.0
"""Lags of a sensor after which its effect has decayed, and up to which a recovery may be caused by it."""
GOES_ON = 3.0
"""Lags of a sensor for which it goes on after a motion: ln(1 + slope of the way / slope of the way back)."""
SAME = 0.4
"""Largest relative difference of the time constants of force and pressure if one causes the other."""


@dataclass(frozen=True, eq=False)
class Recovery:
    """y = end + size exp(-t/tau) after the motion; size in the unit of y, tau [s]."""

    size: float
    tau: float
    apart: float
    """Difference of tau to that of the later part, from half a time constant on, or to that of a fit with a drift [s]:
    large if the course is not a single exponential.
    """


@dataclass(frozen=True, eq=False)
class Relaxation:
    """One step, there or back. Forces [N], pressures [Pa]; positive steps contract."""

    moved: float
    """Measured displacement of the step [m]."""
    before: float
    peak: float
    relaxed: float
    earlier: Held
    """Force in the second half of the rest before [N]."""
    later: Held
    """Force in the second half of the rest after [N]."""
    filter: float
    """Time constant of the force cell's filter [s]: declared, or assumed if undeclared."""
    after: Mapping[str, float]
    """Channel -> time for which it goes on away after the measured motion, if that is longer than its filter explains
    [s]: one that nobody declared, or a delay; else 0.
    """
    blunted: Mapping[str, float]
    """Channel -> change of its peak by a filter as slow as `filter`, the recovery (`fast`) or `after` [SI]."""
    unseen: Mapping[str, float]
    """Channel -> height that its peak may have above the samples because some are missing [SI]; inf if unknown."""
    sampled: float
    """Change of the force in the sample interval before its peak [N], by which the actual peak may exceed it."""
    pressure_peak: float
    """Largest difference of the pressure from the rest before; nan where it is not recorded."""
    pressure_after: float
    """The same from the rest after."""
    pressure_noise: float
    """Noise of the pressure [Pa], which gives the largest deviation if the pressure is constant."""
    force_back: Recovery | None
    pressure_back: Recovery | None
    noise: float
    """Noise of the force [N]."""
    pressures: tuple[float, float]
    """Mean pressure of the rests before and after [Pa]; nan where it is not recorded."""
    unresolved: Mapping[str, float]
    """Channel -> error of a rest's mean because it is read in steps [SI]."""
    missed: Mapping[str, float]
    """Polled channel that is updated less often than a step takes -> time between two new values [s]."""

    @property
    def fast(self) -> float:
        """Time constant of a recovery of the force that its filter may cause [s]; 0 where the pressure shows the same.

        A pressure with the same recovery causes that of the force; slower recoveries are not of a filter.
        """
        back, pressure = self.force_back, self.pressure_back
        if back is None or back.tau > LAGS * self.filter:
            return 0.0
        shown = pressure is not None and abs(back.tau - pressure.tau) < SAME * pressure.tau
        return 0.0 if shown else back.tau

    def constant(self, channel: str) -> float:
        """Largest time constant that a filter of a channel may have [s]; 0 for none."""
        return max(self.after[channel], *((self.filter, self.fast) if channel == "force" else (0.0,)))

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
    first: Relaxation
    """The first step of the trial, which may be among those left out."""


def measure(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Steps:
    """One trial from its samples, without the first cycles that `options`, else the plan, discard.

    Raises `NotUsable` where it ended early, lacks a channel or a whole step.
    """
    samples.refuse_unusable(trial, "displacement", "force")
    found: dict[str, list[Relaxation]] = {"step": [], "back": []}
    ramps = [c for c in trial.commands if c.output == "displacement" and c.kind == "ramp" and c.phase in found]
    if not ramps:
        raise NotUsable("it holds no step")
    until = [*(c.t for c in ramps[1:]), float(trial.t[-1]) + 1e-9]
    begins = [float(trial.t[0]), *(c.t for c in ramps[:-1])]
    values = {name: samples.on_time(run, trial, name) for name in ("displacement", "force", "pressure")}
    steps = {name: samples.step_of(trial.channels[name][trial.usable]) for name in values if name in trial.channels}
    between = {name: samples.between_new(trial.t, trial.channels[name])[1] for name in steps}
    for ramp, begin, end in zip(ramps, begins, until, strict=True):
        one = _one(run, trial, values, steps, ramp, begin, end)
        missed = {name: time for name, time in between.items() if time > _arrives(ramp) - ramp.t and time > 0}
        found[ramp.phase].append(replace(one, missed=missed))
    discard = int(samples.settings_of(run, options).get("discard", 1))
    first = found["step"][:1]
    found = {phase: each[discard:] for phase, each in found.items()}
    if not found["step"] or not found["back"]:
        raise NotUsable("it holds no step there and back beyond those left out")
    place = max(i for i, ramp in enumerate(ramps) if ramp.phase == "step")
    rows = (trial.t >= ramps[place].t - 0.1 * (until[place] - ramps[place].t)) & (trial.t < until[place]) & trial.usable
    last = {name: column[rows] for name, column in values.items() if np.isfinite(column).all()}
    return Steps(
        run, trial, tuple(found["step"]), tuple(found["back"]), {"t": trial.t[rows] - ramps[place].t, **last}, *first
    )


def _arrives(ramp: Command) -> float:
    """Time at which a command has reached its end [s]."""
    return ends(ramp) if ramp.data.get("rate", 0.0) > 0 else ramp.t


def _one(
    run: RunData, trial: TrialData, values: dict[str, Array], steps: Mapping[str, float], ramp: Command, begin: float,
    end: float,
) -> Relaxation:  # fmt: skip
    """The step of one command; `begin` [s] starts the rest before it, `end` [s] ends the rest after it."""
    arrived = _arrives(ramp)
    t, good = trial.t, trial.usable
    since, until = ramp.t - LAST * (ramp.t - begin), end - LAST * (end - arrived)
    before, after = good & (t >= since) & (t < ramp.t - 1e-9), good & (t >= until) & (t < end)
    moving = good & (t >= ramp.t) & (t < end)
    rest = good & (t > arrived + 1e-9) & (t < end)
    if min(before.sum(), after.sum()) < 3 or rest.sum() < 2 * FEWEST:
        raise NotUsable("fewer than 3 samples at the end of a rest")
    x, F, P = (values[name] for name in ("displacement", "force", "pressure"))
    level, relaxed = float(F[before].mean()), float(F[after].mean())
    moved = float(x[after].mean() - x[before].mean())
    if abs(moved) <= 6 * noise_of(x[rest]) or moved == 0:
        raise NotUsable("the displacement does not move above its noise")
    away, way = F[moving] - level, -np.sign(moved)
    place = int(np.argmax(way * away))
    new = good & samples.fresh(trial.channels["force"])  # noise of a held value would look like a motion
    early = new & (t >= 0.5 * (begin + ramp.t)) & (t < ramp.t - 1e-9)
    late = new & (t >= 0.5 * (arrived + end)) & (t < end)
    known = bool(np.isfinite(P[before | moving | rest]).all())
    # the measured motion is over when it stays within `THERE` of its end; not before the command
    beyond = t[moving][np.abs(x[moving] - float(x[after].mean())) > THERE * abs(moved)]
    still = rest & (t > (max(float(beyond[-1]), arrived) if len(beyond) else arrived))
    if still.sum() < 2 * FEWEST:
        raise NotUsable("the displacement comes to rest too late")
    on_way = t[still] - t[still][0]
    most, from_after = (_farthest(P[moving] - float(P[rows].mean())) for rows in (before, after))
    off = P[moving] - float(P[before].mean())
    back = recovery(on_way, F[still])
    peaks = {"force": way * away} | ({"pressure": np.sign(most) * off} if known else {})
    lags, over = lags_of(run, trial), float(t[still][0])
    one = Relaxation(
        moved=moved,
        before=level,
        peak=level + float(away[place]),
        relaxed=relaxed,
        earlier=Held.of(t[early], F[early], since),
        later=Held.of(t[late], F[late], until),
        filter=lags["force"] or UNDECLARED,
        after={name: _after(t[moving], y, over, lags[name] or UNDECLARED) for name, y in peaks.items()},
        blunted={},
        unseen={name: _unseen(t[moving], y, ramp.t, over) for name, y in peaks.items()},
        sampled=abs(float(away[place] - away[max(0, place - 1)])),
        pressure_peak=most,
        pressure_after=from_after,
        pressure_noise=noise_of(P[moving]) if known else 0.0,
        force_back=back,
        pressure_back=recovery(on_way, P[still]) if known else None,
        noise=noise_of(F[rest]),
        pressures=(float(P[before].mean()), float(P[after].mean())),
        unresolved={
            name: max(samples.unresolved(trial.channels[name][rows], step) for rows in (before, after))
            for name, step in steps.items()
        },
        missed={},
    )
    return replace(one, blunted={name: _blunted(t[moving], y, one.constant(name)) for name, y in peaks.items()})


def _farthest(off: Array) -> float:
    """The value (n,) that is farthest from 0; nan if one is."""
    return float(off[np.argmax(np.abs(off))])


def _after(t: Array, y: Array, over: float, lag: float) -> float:
    """Time from the end of the motion, at `over` [s], to the peak of `y` (n,); 0 if a filter of `lag` [s] does that, or
    if `y` does not come back from there.
    """
    end, peak, rest = int(np.searchsorted(t, over)), int(np.argmax(y)), int((1 - LAST) * len(y))
    others = max(float(part.mean()) for part in (y[max(0, end - 2) : end + 3], y[rest:]))
    time = float(t[peak]) - over
    return time if y[peak] - others > SEEN * noise_of(y) and time > GOES_ON * lag else 0.0


def _unseen(t: Array, y: Array, begin: float, over: float) -> float:
    """Height above the samples of a peak of `y` (n,) from 0 at `begin`, where samples are missing; inf if unknown.

    The motion, over at `over` [s], makes the peak: a gap across its end hides that.
    """
    t, y = np.append(begin, t), np.append(0.0, y)
    top = highest(t, y, float(np.median(np.diff(t))), int(np.searchsorted(t, over)))
    return max(0.0, float(top.max() - y.max()))


def _blunted(t: Array, y: Array, constant: float) -> float:
    """Reduction of the peak of `y` (n,) at `t` (n,) by one more first-order filter; 0 for none."""
    if constant <= 0:
        return 0.0
    keep = float(np.exp(-np.median(np.diff(t)) / constant))
    slower = np.asarray(lfilter([1 - keep], [1, -keep], y - y[0]) + y[0])
    return abs(float(np.max(y) - np.max(slower)))


def recovery(t: Array, y: Array) -> Recovery | None:
    """Exponential by which `y` comes to rest after `t` = 0 [s]; None if it is not significant."""
    tau, inside = _time_constant(t, y)
    design = np.column_stack([np.ones_like(t), np.exp(-t / tau)])
    terms, *_ = np.linalg.lstsq(design, y, rcond=None)
    size, left = float(terms[1]), float(np.mean((y - design @ terms) ** 2))
    if not inside or np.count_nonzero(t < 3 * tau) < FEWEST:
        return None
    if abs(size) < max(SEEN * noise_of(y), 3 * left**0.5, 1e-6 * float(np.max(np.abs(y)))):
        return None
    late = t >= 0.5 * tau
    others = [_time_constant(t, y, 1)[0]]
    if late.sum() > FEWEST:
        others.append(_time_constant(t[late] - t[late][0], y[late])[0])
    return Recovery(size, tau, max(abs(other - tau) for other in others))


def _time_constant(t: Array, y: Array, order: int = 0) -> tuple[float, bool]:
    """Time constant with the least residual [s], and whether it is inside the search range."""
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
