"""The trials of free contraction at rest, the repeats of each set-point, and the curve of contraction over pressure.

Each trial has a pressure and a contraction; along the curve it is carried to the commanded pressure.
Knows samples, commands and a fitted sigmoid, no coefficient.
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
from pmabench.analysis.shared.isometric_lines import spread
from pmabench.analysis.shared.samples import (
    FINE,
    OF_TWO,
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
"""Share of each rest at its end whose mean counts."""
FEWEST = 5
"""Samples that it needs."""
CHANNELS = ("displacement", "pressure")
UNUSABLE_SHARE = 0.5
CLEAR = 6.0
"""A contraction counts where it is larger than so many standard deviations of its noise."""
NOTHING = 1.0
"""Set-points up to this are 0 [Pa]."""
VENTED = 3.0
"""At set-point 0, a mean pressure within so many of its standard deviations is that of a muscle that is vented."""
SCATTERED = 3.0
"""So many times the variance of their noise the pressures of one set-point must have, to differ at all."""
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
    """Contraction at rest without pressure, before [m]."""
    hold: Held
    """Contraction along the second half of the hold [m]."""
    noise: float
    """Standard deviation of `start` and x [m]."""
    last: Array
    """Samples whose mean is x [m]."""
    changes: Array
    """Of the pressure from sample to sample along the second half of the hold, where there is one [Pa]."""
    coarse: float = 0.0
    """By how much the steps in which they are read may move x [m]."""

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
    """Of each repeat, the trials of all sides."""

    @property
    def rests(self) -> tuple[Rest, ...]:
        """All trials."""
        return tuple(rest for repeat in self.whole for rest in repeat)

    @cached_property
    def pressure(self) -> float:
        """Measured, the mean [Pa]."""
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
        """What x would still change by [m]."""
        return left([rest.hold for rest in self.rests])

    @cached_property
    def apart(self) -> Left:
        """What `gaps` would still change by [m]."""
        sides = [left([rest.hold for rest in self.rests if rest.side == side]) for side in (1.0, -1.0)]
        return Left(sides[0].size - sides[1].size, sum(one.most for one in sides), any(one.seen for one in sides))

    @property
    def off(self) -> float:
        """Largest contraction that was left without pressure before a trial [m]."""
        return max(abs(rest.start) for rest in self.rests)

    @property
    def coarse(self) -> float:
        """What the steps in which the displacement is read make of x, at the most: all repeats meet the same [m]."""
        return max(rest.coarse for rest in self.rests)

    def reached(self, side: float) -> float:
        """Mean contraction reached from one side [m]; nan where there is none."""
        values = [rest.x for rest in self.rests if rest.side == side]
        return float(np.mean(values)) if values else float("nan")

    def at(self, pressure: float, shape: Shape) -> Point:
        """With the contraction of each trial as it would be at `pressure` [Pa], by a curve.

        Each for itself: where the curve is bent, as a root is near 0, the mean contraction is not that at the mean
        pressure.
        """
        further = float(shape(np.array([pressure]))[0]) - shape(self._of("pressure"))
        by = dict(zip(self.rests, further.tolist(), strict=True))
        return self.changed(lambda rest: replace(rest, x=rest.x + by[rest], pressure=pressure))

    def bent(self, shape: Shape) -> float:
        """What the mean contraction is off where noise of the pressures is taken through a bent curve [m]."""
        P, noise = self._of("pressure"), self._of("pressure_noise")
        below, at, above = (shape(np.maximum(P + way * noise, 0.0)) for way in (-1.0, 0.0, 1.0))
        return float(np.mean(np.abs(above + below - 2 * at)))

    def without_noise(self) -> Point:
        """The pressures of the trials nearer to their mean, by the share of their scatter that is noise of the samples.

        Of a muscle that is vented nothing but noise is read: its pressure is 0.
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
        """A number of each trial."""
        return np.array([getattr(rest, name) for rest in self.rests])

    def changed(self, change: Callable[[Rest], Rest]) -> Point:
        """With each trial changed."""
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
    """With what the steps in which a run is read make of each x: one trial may show too few of them.

    The mean of a pressure that is read less often than it is recorded has the noise of few values.
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
    """Samples (n,) from the first change to the last: values that are held there are so for their whole time."""
    changed = np.flatnonzero(np.diff(y)) + 1
    return y[changed[0] : changed[-1]] if len(changed) else y[:0]


def noise_by(changes: Array) -> float:
    """Standard deviation of values at rest by their changes (n,) from one to the next; 0 without any."""
    return float(np.sqrt(0.5 * np.mean(changes**2))) if len(changes) else 0.0


def points_of(runs: Sequence[RunData]) -> tuple[list[Point], list[Dropped]]:
    """The pressures, rising, and the trials that cannot be used."""
    every, dropped = measured_trials(runs, measure)
    every, points = _as_read(every), []
    for pressure, rests in sorted(grouped(every, lambda rest: round(rest.trial.point["pressure"])).items()):
        by: dict[object, dict[float, Rest]] = {}
        order, sides = Counter[object](), {rest.side for rest in rests}
        for rest in rests:  # trials of one file are repeats too, where nothing else tells them apart
            side = rest.run.id, rest.trial.repeat, rest.side
            by.setdefault((rest.run.id, rest.trial.repeat, order[side]), {})[rest.side] = rest
            order[side] += 1
        lost = [rest for repeat in by.values() if set(repeat) != sides for rest in repeat.values()]
        dropped += [Dropped(r.trial.name, r.trial.point, "the other side of its repeat is lost") for r in lost]
        if whole := [tuple(repeat.values()) for repeat in by.values() if set(repeat) == sides]:
            points.append(Point(float(pressure), tuple(whole)).without_noise())
    return points, dropped


UNEQUAL = 0.25
"""Share of half the width between both sides by which their mean may be off: friction, and a curve, are not the same
both ways."""
BENDS = {True: 0.2, False: 1.0}
"""What the way from the measured pressure to the commanded one may be off, as a share: along a sigmoid that fits, and
along a curve through the points only."""


@dataclass(frozen=True, eq=False)
class Level:
    """One commanded pressure: its trials at the pressure that was measured, and as they would be at the commanded."""

    point: Point
    there: Point
    shape: Shape
    fits: bool
    """Whether `shape` is a sigmoid that fits."""
    zero: float
    """By which the zero of the pressure is open [Pa]."""
    apart: float
    """What the difference of both sides changes by on the way to one pressure, where no form says the curve [m]."""

    @classmethod
    def of(cls, point: Point, shape: Shape, zero: float, *, fits: bool) -> Level:
        """A point, by the curve of all."""
        there = point.at(point.set, shape)
        apart = 0.0 if fits or not len(point.gaps) else abs(float(there.gaps.mean() - point.gaps.mean()))
        return cls(point.at(point.pressure, shape), there, shape, fits, zero, apart)

    def rise(self, by: float) -> float:
        """Change of the contraction by the pressure, a change of which by `by` [Pa] is looked at [m/Pa]."""
        P = max(self.point.pressure, 0.0)
        x = self.shape(np.array([max(P - by, 0.0), P, P + by]))
        return float(np.abs(np.diff(x)).max()) / by

    @property
    def method(self) -> float:
        """What the way to the commanded pressure, noise and zero of the measured one may do to the contraction [m]."""
        way = hypot(BENDS[self.fits] * (self.there.x - self.point.x), UNEQUAL * self.apart / 2)
        return hypot(way, *(by * self.rise(by) for by in (2 * self.point.pressure_noise, self.zero) if by > 0))


def curve_of(points: Sequence[Point]) -> tuple[Array, Array]:
    """Measured pressure [Pa] and mean contraction [m] of each point."""
    return np.array([point.pressure for point in points]), np.array([point.x for point in points])


def highest(model: Model) -> float:
    """Pressure up to which a model holds [Pa]."""
    return next(p.high for p in model.parameters if p.name == "pressure")


def sigmoid(fit: ModelFit) -> Shape:
    """Contraction by the fitted sigmoid, but for a constant."""
    most, known = highest(fit.model), {**fit.fixed, **fit.values}

    def shape(P: Array) -> Array:
        return -np.asarray(fit.model.evaluate({**known, "pressure": np.clip(P, 0.0, most)})["length"])

    return shape


def through(points: Sequence[Point], fit: ModelFit | None) -> Shape:
    """The sigmoid, where there is one, and what the points are off it by monotone cubics over the root of the pressure.

    On a root the curve begins: without pressure it is steep.
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
    """By how much friction keeps the contraction of each point (n,) short where both sides came from one [m].

    Nothing is above the highest pressure: where friction shows at the pressure next to it, and not there, both sides
    came from below. Nothing is below a muscle that is vented: what is left of a contraction is no mean of both ways.
    """
    short = np.zeros(len(points))
    if len(points) < 2 or not all(len(point.gaps) for point in (points[0], *points[-2:])):
        return short
    gaps = [abs(float(point.gaps.mean())) for point in (points[0], *points[-2:])]
    if gaps[2] <= 0.5 * gaps[1] and gaps[1] > _clear(points[-2]):
        short[-1] = 0.5 * gaps[1]
    if points[0].set <= NOTHING and gaps[0] > _clear(points[0]):
        short[0] = -0.5 * gaps[0]
    return short


def _clear(point: Point) -> float:
    """Difference of both sides of a point that anything but friction may make [m]."""
    noise = CLEAR * max(rest.noise for rest in point.rests)
    starts = float(np.ptp([rest.start for rest in point.rests]))
    return max(noise, spread(point.gaps) or 0.0, OF_TWO * point.coarse, point.apart.most, starts)


def zero_of(points: Sequence[Point]) -> float:
    """What the zero of the pressure may be by what is read at set-point 0 [Pa]; 0 where that is noise.

    No gauge pressure is below 0: the zero is at most the least that was read.
    """
    first = points[0] if points else None
    if first is None or first.set > NOTHING:
        return 0.0
    least = min(rest.pressure for rest in first.rests)
    return least if abs(least) > VENTED * first.pressure_noise else 0.0


def zeroed(points: Sequence[Point], zero: float) -> list[Point]:
    """The points with pressures from another zero [Pa]."""
    moved = [point.changed(lambda rest: replace(rest, pressure=rest.pressure - zero)) for point in points]
    return [moved[0].without_noise(), *moved[1:]]
