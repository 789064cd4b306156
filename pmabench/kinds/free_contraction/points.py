"""The trials of free contraction at rest, the repeats of each set-point, and the curve of contraction over pressure.

Each trial has a pressure and a contraction, which is moved along the curve to the commanded pressure. Uses samples,
commands and a fitted sigmoid; gives no coefficient.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot

import numpy as np
from scipy.interpolate import PchipInterpolator

from pmabench.analysis.model_fit import ModelFit
from pmabench.analysis.shared.samples import (
    FINE,
    Held,
    Left,
    NotUsable,
    ends,
    fresh,
    left,
    noise_of,
    refuse_incomplete,
    step_of,
    unresolved,
)
from pmabench.analysis.shared.trials import grouped, measured_trials
from pmabench.model.library.description import Model
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import Array, RunData, TrialData

LAST = 0.2
"""Last share of each rest over which the mean is taken."""
FEWEST = 5
"""Fewest samples of that mean."""
CHANNELS = ("displacement", "pressure")
UNUSABLE_SHARE = 0.5
CLEAR = 6.0
"""A contraction is significant above this many standard deviations of its noise."""
NOTHING = 1.0
"""Set-points up to this are 0 [Pa]."""
VENTED = 3.0
"""At set-point 0 the muscle counts as vented if the mean pressure is within this many of its standard deviations."""
SCATTERED = 3.0
"""Pressures of one set-point count as different where their variance is this many times that of their noise."""
Shape = Callable[[Array], Array]
"""Contraction [m] over pressure [Pa]."""


@dataclass(frozen=True, eq=False)
class Rest:
    """One trial: what was measured at rest."""

    run: RunData
    trial: TrialData
    pressure: float
    """[Pa]."""
    pressure_noise: float
    """Its standard deviation by the noise of the samples [Pa]."""
    x: float
    """Contraction [m]."""
    start: float
    """Contraction at rest without pressure, before the trial [m]."""
    hold: Held
    """Contraction along the second half of the hold [m]."""
    noise: float
    """Standard deviation of `start` and x [m]."""
    last: Array
    """Samples whose mean is x [m]."""
    changes: Array
    """Nonzero changes of the pressure from sample to sample in the second half of the hold [Pa]."""
    coarse: float = 0.0
    """Possible error of `x` because the displacement is read in steps [m]."""

    @property
    def side(self) -> float:
        """-1 reached from below, 1 from above; 0 where the protocol has no sides."""
        return self.trial.point.get("side", 0.0)


@dataclass(frozen=True, eq=False)
class Point:
    """One commanded pressure: all its trials."""

    set: float
    """[Pa]."""
    whole: tuple[tuple[Rest, ...], ...]
    """For each repeat, the trials from all sides."""

    @property
    def rests(self) -> tuple[Rest, ...]:
        """All trials."""
        return tuple(rest for repeat in self.whole for rest in repeat)

    @cached_property
    def pressure(self) -> float:
        """Mean measured pressure [Pa]."""
        return float(self._of("pressure").mean())

    @cached_property
    def pressure_noise(self) -> float:
        """Standard deviation of `pressure` by the noise of the samples [Pa]; 0 where the muscle is vented."""
        return float(np.linalg.norm(self._of("pressure_noise"))) / len(self.rests)

    @cached_property
    def repeats(self) -> Array:
        """Contraction of each repeat, the mean of its sides [m]."""
        return np.array([np.mean([rest.x for rest in repeat]) for repeat in self.whole])

    @cached_property
    def gaps(self) -> Array:
        """Contraction reached from above minus from below, of each repeat that has both [m]."""
        by = [{rest.side: rest.x for rest in repeat} for repeat in self.whole]
        return np.array([one[1.0] - one[-1.0] for one in by if {1.0, -1.0} <= set(one)])

    @property
    def x(self) -> float:
        """Mean contraction [m]."""
        return float(self.repeats.mean())

    @cached_property
    def left(self) -> Left:
        """Change of `x` still to come [m]."""
        return left([rest.hold for rest in self.rests])

    @cached_property
    def apart(self) -> Left:
        """Change of `gaps` still to come [m]."""
        sides = [left([rest.hold for rest in self.rests if rest.side == side]) for side in (1.0, -1.0)]
        return Left(sides[0].size - sides[1].size, sum(one.most for one in sides), any(one.seen for one in sides))

    @property
    def off(self) -> float:
        """Largest contraction that was left without pressure before a trial [m]."""
        return max(abs(rest.start) for rest in self.rests)

    @property
    def coarse(self) -> float:
        """Largest error of `x` because the displacement is read in steps; not reduced by repeats, which meet the same
        steps [m].
        """
        return max(rest.coarse for rest in self.rests)

    def reached(self, side: float) -> float:
        """Mean contraction reached from one side [m]; nan where there is none."""
        values = [rest.x for rest in self.rests if rest.side == side]
        return float(np.mean(values)) if values else float("nan")

    def at(self, pressure: float, shape: Shape) -> Point:
        """The point with the contraction of each trial moved along a curve to `pressure` [Pa].

        Each trial separately: where the curve is bent, like a root near 0, the mean contraction is not that at the mean
        pressure.
        """
        further = float(shape(np.array([pressure]))[0]) - shape(self._of("pressure"))
        by = dict(zip(self.rests, further.tolist(), strict=True))
        return self.changed(lambda rest: replace(rest, x=rest.x + by[rest], pressure=pressure))

    def bent(self, shape: Shape) -> float:
        """Error of the mean contraction due to noise of the pressure where the curve is bent [m]."""
        P, noise = self._of("pressure"), self._of("pressure_noise")
        below, at, above = (shape(np.maximum(P + way * noise, 0.0)) for way in (-1.0, 0.0, 1.0))
        return float(np.mean(np.abs(above + below - 2 * at)))

    def without_noise(self) -> Point:
        """The point with the pressures of the trials drawn to their mean by the share of their scatter that is noise.

        A vented muscle shows only noise; its pressure is set to 0.
        """
        P, noise = self._of("pressure"), self._of("pressure_noise")
        if self.set <= NOTHING and abs(self.pressure) <= VENTED * self.pressure_noise:
            return self.changed(lambda rest: replace(rest, pressure=0.0, pressure_noise=0.0))
        if len(P) < 2:
            return self
        share = float(np.mean(noise**2)) / max(float(np.var(P, ddof=1)), 1e-12)
        real = 1.0 - share if share < 1 / SCATTERED else 0.0
        return self.changed(lambda rest: replace(rest, pressure=self.pressure + real * (rest.pressure - self.pressure)))

    def _of(self, name: str) -> Array:
        """One attribute of each trial."""
        return np.array([getattr(rest, name) for rest in self.rests])

    def changed(self, change: Callable[[Rest], Rest]) -> Point:
        """The point with a function applied to each trial."""
        return Point(self.set, tuple(tuple(map(change, repeat)) for repeat in self.whole))


def measure(run: RunData, trial: TrialData) -> Rest:
    """One trial at rest; raises `NotUsable`."""
    refuse_incomplete(trial, *CHANNELS)
    if "pressure" not in trial.point:
        raise NotUsable("its point names no pressure")
    x, P = (trial.channels[name] for name in CHANNELS)
    good = trial.usable & np.isfinite(x) & np.isfinite(P)
    if float(np.mean(~good)) > UNUSABLE_SHARE:
        raise NotUsable(f"{np.mean(~good):.0%} of the samples are flagged or missing")
    ramps = [c for c in trial.commands if c.output == "pressure" and c.kind == "ramp"]
    t = trial.t
    end = min((c.t for c in ramps if c.phase == "vent" and c.t >= t[0]), default=float(t[-1]))
    moved = [c for c in ramps if c.phase != "vent" and t[0] - 1e-9 <= c.t <= end]
    begin = moved[0].t if moved else end
    paced = [c for c in moved if c.data.get("rate", 0.0) > 0]
    there = max(map(ends, paced), default=t[0])
    first = good & (t >= begin - LAST * (begin - t[0])) & (t < begin - 1e-9)
    last = good & (t >= end - LAST * (end - there)) & (t <= end)
    if min(first.sum(), last.sum()) < FEWEST or end <= there:
        raise NotUsable(f"fewer than {FEWEST} samples at the end of a rest")
    half = good & (t >= 0.5 * (there + end)) & (t <= end)
    noise, of_pressure = noise_of(x[last]) / np.sqrt(min(first.sum(), last.sum())), noise_of(P[last])
    hold = Held.of(t[half], x[half], end - LAST * (end - there))
    means = float(P[last].mean()), of_pressure / float(np.sqrt(last.sum())), float(x[last].mean())
    changes = np.diff(P[half])
    return Rest(run, trial, *means, float(x[first].mean()), hold, noise, x[last], changes[changes != 0])


def _as_read(rests: Sequence[Rest]) -> list[Rest]:
    """The rests with `coarse` and `pressure_noise` from all trials of their run, since one trial may show too few
    steps.

    The mean of a pressure that is read less often than recorded has the noise of few values.
    """
    found = []
    for mine in grouped(rests, lambda rest: rest.run.id).values():
        x = np.concatenate([_usable(rest, "displacement") for rest in mine])
        P = np.concatenate([_between_changes(_usable(rest, "pressure")) for rest in mine])
        step, new = step_of(x), float(np.mean(fresh(P))) if len(P) else 1.0
        noise = noise_by(np.concatenate([rest.changes for rest in mine])) if new < 1 else 0.0
        for rest in mine:
            coarse = unresolved(rest.last, step)
            of_mean = noise / np.sqrt(max(1.0, new * len(rest.last))) if noise else rest.pressure_noise
            found.append(replace(rest, coarse=coarse if coarse > FINE * step else 0.0, pressure_noise=float(of_mean)))
    return found


def _usable(rest: Rest, channel: str) -> Array:
    y = rest.trial.channels[channel][rest.trial.usable]
    return np.asarray(y[np.isfinite(y)])


def _between_changes(y: Array) -> Array:
    """Samples (n,) from the first change to the last, between which values are held for their whole time."""
    changed = np.flatnonzero(np.diff(y)) + 1
    return y[changed[0] : changed[-1]] if len(changed) else y[:0]


def noise_by(changes: Array) -> float:
    """Standard deviation of values at rest from their changes (n,) from one to the next; 0 without any."""
    return float(np.sqrt(0.5 * np.mean(changes**2))) if len(changes) else 0.0


def points_of(runs: Sequence[RunData]) -> tuple[list[Point], list[Dropped]]:
    """The points by ascending pressure, and the trials that cannot be used."""
    every, dropped = measured_trials(runs, measure)
    every, points = _as_read(every), []
    for pressure, rests in sorted(grouped(every, lambda rest: round(rest.trial.point["pressure"])).items()):
        by: dict[object, dict[float, Rest]] = {}
        order, sides = Counter[object](), {rest.side for rest in rests}
        for rest in rests:  # in one file, trials without distinct numbers are repeats, too
            side = rest.run.id, rest.trial.repeat, rest.side
            by.setdefault((rest.run.id, rest.trial.repeat, order[side]), {})[rest.side] = rest
            order[side] += 1
        lost = [rest for repeat in by.values() if set(repeat) != sides for rest in repeat.values()]
        dropped += [Dropped(r.trial.name, r.trial.point, "the other side of its repeat is lost") for r in lost]
        if whole := [tuple(repeat.values()) for repeat in by.values() if set(repeat) == sides]:
            points.append(Point(float(pressure), tuple(whole)).without_noise())
    return points, dropped


UNEQUAL = 0.25
"""Share of half the gap between both sides by which their mean may be off, since friction and curve differ between
directions.
"""
BENDS = {True: 0.2, False: 1.0}
"""Possible error of the correction from measured to commanded pressure, as a share: along a sigmoid that fits (True),
or along a curve through the points only (False).
"""


@dataclass(frozen=True, eq=False)
class Level:
    """One commanded pressure: trials at the measured pressure (`point`) and moved to the commanded one (`there`)."""

    point: Point
    there: Point
    shape: Shape
    fits: bool
    """Whether `shape` is a sigmoid that fits."""
    zero: float
    """Uncertainty of the zero of the pressure [Pa]."""
    apart: float
    """Change of the gap between both sides by the correction to one pressure, without a fitted form [m]."""

    @classmethod
    def of(cls, point: Point, shape: Shape, zero: float, *, fits: bool) -> Level:
        """A point, by the curve of all."""
        there = point.at(point.set, shape)
        apart = 0.0 if fits or not len(point.gaps) else abs(float(there.gaps.mean() - point.gaps.mean()))
        return cls(point.at(point.pressure, shape), there, shape, fits, zero, apart)

    def rise(self, by: float) -> float:
        """Slope of the contraction over pressure, by differences of `by` [Pa], the steeper side [m/Pa]."""
        P = max(self.point.pressure, 0.0)
        x = self.shape(np.array([max(P - by, 0.0), P, P + by]))
        return float(np.abs(np.diff(x)).max()) / by

    @property
    def method(self) -> float:
        """Method part of the contraction [m]: correction to the commanded pressure; noise, zero of the measured one."""
        way = hypot(BENDS[self.fits] * (self.there.x - self.point.x), UNEQUAL * self.apart / 2)
        return hypot(way, *(by * self.rise(by) for by in (2 * self.point.pressure_noise, self.zero) if by > 0))


def curve_of(points: Sequence[Point]) -> tuple[Array, Array]:
    """Measured pressure [Pa] and mean contraction [m] of each point."""
    return np.array([point.pressure for point in points]), np.array([point.x for point in points])


def highest(model: Model) -> float:
    """Highest pressure of a model's range [Pa]."""
    return next(p.high for p in model.parameters if p.name == "pressure")


def sigmoid(fit: ModelFit) -> Shape:
    """Contraction by the fitted sigmoid, but for a constant."""
    most, known = highest(fit.model), {**fit.fixed, **fit.values}

    def shape(P: Array) -> Array:
        return -np.asarray(fit.model.evaluate({**known, "pressure": np.clip(P, 0.0, most)})["length"])

    return shape


def through(points: Sequence[Point], fit: ModelFit | None) -> Shape:
    """The sigmoid, if any, plus the remainder of the points interpolated by monotone cubics over the root of the
    pressure.

    The root, because the curve is steep where it starts without pressure.
    """
    base = np.zeros_like if fit is None else sigmoid(fit)
    P, x = curve_of([point.at(point.pressure, base) for point in points])
    root = np.sqrt(np.maximum(P, 0.0))
    if len(points) < 2 or not bool((np.diff(root) > 0).all()):
        return base
    off = PchipInterpolator(root, x - base(P))

    def shape(P: Array) -> Array:
        asked = np.sqrt(np.maximum(P, 0.0))
        within = np.clip(asked, root[0], root[-1])
        return np.asarray(base(P) + off(within) + off(within, 1) * (asked - within))

    return shape


def one_way(points: Sequence[Point]) -> Array:
    """Contraction that friction may hold back at each point (n,) where both sides were approached from one direction
    [m].

    Nothing is above the highest pressure: friction there is taken as half the gap at the next lower one. Nothing is
    below vented: half the remaining contraction.
    """
    short = np.zeros(len(points))
    if len(points) > 1 and all(len(point.gaps) for point in (points[0], points[-2])):
        short[-1] = 0.5 * abs(float(points[-2].gaps.mean()))
        short[0] = -0.5 * abs(float(points[0].gaps.mean())) * (points[0].set <= NOTHING)
    return short


def zero_of(points: Sequence[Point]) -> float:
    """Possible zero error of the pressure from readings at set-point 0 [Pa]; 0 where these are noise.

    No gauge pressure is below 0, so the zero is at most the lowest reading.
    """
    first = points[0] if points else None
    if first is None or first.set > NOTHING:
        return 0.0
    least = min(rest.pressure for rest in first.rests)
    return least if abs(least) > VENTED * first.pressure_noise else 0.0


def zeroed(points: Sequence[Point], zero: float) -> list[Point]:
    """The points with a zero subtracted from their pressures [Pa]."""
    moved = [point.changed(lambda rest: replace(rest, pressure=rest.pressure - zero)) for point in points]
    return [moved[0].without_noise(), *moved[1:]]
