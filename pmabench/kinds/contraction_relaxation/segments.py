"""Trials cut into short segments of motion, the rows of the pooled fit; and the noise of the channels.

A segment is a stretch of about 40 ms in which the muscle moves in one direction, faster than a limit, off its support,
without a flagged sample. Averages over it give the equation of motion in weak form.

Neighbours share samples: the displacement at the end of one segment is that at the start of the next, with opposite
sign in the velocity, so that much of its noise cancels along a stretch; overlapping means behave in the same way.

A `Campaign` holds the trials of all runs that can be reduced together, with their noise. Fits nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import Noise, Samples, between_new, noise_of
from pmabench.analysis.shared.simulated import GOLDEN
from pmabench.analysis.shared.skew import STAMPED, apart
from pmabench.analysis.shared.trials import session_of
from pmabench.store.analyses.results import Dropped
from pmabench.store.records import Array, RunData, TrialData

CHANNELS = ("pressure", "displacement", "force")
FIELDS = ("P", "x", "force")
"""Fields of `Samples`, in the order of `CHANNELS`."""
ASSUMED_MASS = 0.5
"""Moving mass [kg] of a trial that gives none; it matters only without a force cell."""
FEWEST_STILL = 8
"""Fewest samples at rest from which noise is estimated."""
FEW, COUNTS = 256, 65536
"""Samples that usually show the step of a converter, and the largest number of its steps (16 bits)."""
SHOW = 24
"""Trials, spread without a period, that show the step of a converter: it is the same in all of them."""
LEVELS = 20
"""Fewest different values of a channel for taking their smallest distance as the step of its converter."""


@dataclass(frozen=True)
class Gate:
    """Conditions for a segment."""

    length: float = 0.04
    """[s]"""
    reach: float = 0.008
    """Half the window of the velocity x' = (x(t + reach) - x(t - reach)) / (2 reach) [s]."""
    speed: float = 2e-3
    """Least |x'| [m/s], above the speeds at which stiction turns into sliding friction."""
    lift: float = 50e-6
    """Least contraction that counts as lifted off the support [m]."""

    def samples(self, rate: float) -> tuple[int, int]:
        """Samples of a segment and of the reach, at `rate` [Hz]."""
        return max(4, round(self.length * rate)), max(1, round(self.reach * rate))


@dataclass(frozen=True)
class Segments:
    """Segments of a whole campaign, one per row.

    `P` [Pa] and `x` [m] have shape (n, w) and are averaged with `weights` (w,): the mean over the segment, smoothed
    like the velocity. `P_mid`, `v` [m/s] and `F_mid`, F_L from the cell or the weight [N], have shape (n, s) and are
    averaged evenly. The others have shape (n,): `force` is the mean F_L [N], smoothed in the same way, plus M x'' where
    F_L is a weight and there is no cell; `mass` is that M [kg], 0 with a cell; `way` is +1 contracting, -1 relaxing;
    `trial` the number of the trial, `t` its first time [s]. `dt` is the sampling period [s].
    """

    trial: NDArray[np.intp]
    t: Array
    way: Array
    P: Array
    x: Array
    P_mid: Array
    v: Array
    F_mid: Array
    force: Array
    mass: Array
    weights: Array
    dt: float

    def __len__(self) -> int:
        return len(self.way)

    @property
    def pressure(self) -> Array:
        """Mean pressure of each segment [Pa], shape (n,)."""
        return self.P @ self.weights

    @property
    def contraction(self) -> Array:
        """Mean contraction of each segment [m], shape (n,)."""
        return self.x @ self.weights

    @property
    def reach(self) -> int:
        """Number of samples by which `P` and `x` extend beyond the segment at either end."""
        return int(self.x.shape[1] - self.v.shape[1]) // 2

    @property
    def followed(self) -> NDArray[np.bool_]:
        """Whether the next segment starts directly after each one, in the same trial; shape (n - 1,)."""
        late = np.abs(np.diff(self.t) - self.v.shape[1] * self.dt)
        return np.asarray((np.diff(self.trial) == 0) & (late < 0.5 * self.dt))

    def where(self, rows: NDArray[np.bool_]) -> Segments:
        """Only some of the rows."""
        by_row = {name: values for name, values in vars(self).items() if name not in ("weights", "dt")}
        return replace(self, **{name: values[rows] for name, values in by_row.items()})

    def within(self, knots: Array) -> Segments:
        """Those in the pressure range of a fit with these knots [Pa]."""
        low, high = knots[0] - 1e3, knots[-1] + float(np.ptp(knots[-2:]))
        rows = (self.P.min(axis=1) >= low) & (self.P.max(axis=1) <= high)
        return self if rows.all() else self.where(rows)

    def shifted(self, channel: str, gain: float, offset: float | Array) -> Segments:
        """The segments if `channel` read (1 + gain) times as much, plus `offset` [SI], one or (n,)."""
        each = np.asarray(offset)[..., None]
        if channel == "pressure":
            return replace(self, P=self.P * (1 + gain) + each, P_mid=self.P_mid * (1 + gain) + each)
        if channel == "displacement":
            return replace(self, x=self.x * (1 + gain) + each, v=self.v * (1 + gain))
        cell = self.mass <= 0
        force = np.where(cell, self.force * (1 + gain) + offset, self.force)
        return replace(self, force=force, F_mid=np.where(cell[:, None], self.F_mid * (1 + gain) + each, self.F_mid))

    def pulled(self, by: Array) -> Segments:
        """The segments with `by` (n,) [N] added to F_L."""
        return replace(self, force=self.force + by, F_mid=self.F_mid + by[:, None])


Cut = Callable[[Sequence[Samples]], Segments]
"""Function that cuts samples into segments."""


def samples_of(run: RunData, trial: TrialData, number: int) -> Samples:
    """A trial's samples; a channel with a `sensor_lag` in the record is shifted earlier by it.

    A channel that is read less often than it is recorded, and held in between, is interpolated.
    """

    def channel(name: str) -> Array:
        lag = run.channels[name].sensor_lag if name in run.channels else 0.0
        values, _ = between_new(trial.t, trial.channels[name])
        return _later(trial.t, values, lag) if lag else values

    P, x = channel("pressure"), channel("displacement")
    force = channel("force") if "force" in trial.channels else None
    load, mass = trial.point.get("load", 0.0), trial.point.get("mass", ASSUMED_MASS)
    return _finite(Samples(number, trial.t, P, x, force, trial.usable, load, mass))


def moved(samples: Samples, channels: Sequence[str], by: float) -> Samples:
    """The samples for a clock of `channels` that is `by` [s] ahead of the others.

    Segments are cut by the displacement, so for it the others are shifted the opposite way. Next to a gap values are
    not shifted, so that no sample becomes unusable and the segments stay the same.
    """

    def later(values: Array, by: float) -> Array:
        taken = _later(samples.t, values, by)
        return np.where(np.isfinite(taken), taken, values)

    if "displacement" in channels:
        channels, by = [name for name in ("pressure", "force") if name not in channels], -by
    taken = {name: later(values, by) for name, values in samples.channels.items() if name in channels}
    return _finite(samples.having(taken))


def _later(t: Array, values: Array, by: float) -> Array:
    """Values [SI] at t + by [s], linear between neighbours; nan where samples are missing there."""
    taken, steps = np.interp(t + by, t, values), np.diff(t)
    if steps.max() > 1.5 * steps.min():
        right = np.clip(np.searchsorted(t, t + by), 1, len(t) - 1)
        taken[steps[right - 1] > 1.5 * float(np.median(steps))] = np.nan
    return taken


def _finite(samples: Samples) -> Samples:
    """The samples, of which those with a number in every channel are usable."""
    known = np.all([np.isfinite(values) for values in samples.channels.values()], axis=0)
    return samples if known[samples.ok].all() else replace(samples, ok=samples.ok & known)


def velocity(t: Array, x: Array, reach: int) -> Array:
    """Mean velocity [m/s] over `reach` samples on both sides of each sample; 0 at the ends; shape (n,)."""
    v = np.zeros(len(t))
    if len(t) > 2 * reach:
        v[reach:-reach] = (x[2 * reach :] - x[: -2 * reach]) / (t[2 * reach :] - t[: -2 * reach])
    return v


TOGETHER = 8_000
"""Samples that are cut at once: short stretches are cut faster together, long ones are copied slower."""


@dataclass(frozen=True, eq=False)
class Kept:
    """What was made last from equal inputs: a shifted channel changes neither the places of segments nor what rests on
    other channels.
    """

    last: dict[str, tuple[Sequence[object], Any]] = field(default_factory=dict)

    def of(self, name: str, inputs: Sequence[Any], make: Callable[[], Any]) -> Any:
        """What `make` gives or gave for these inputs: arrays, numbers or records."""
        known = self.last.get(name)
        if known is None or len(known[0]) != len(inputs) or not all(map(_equal, known[0], inputs)):
            known = self.last[name] = inputs, make()
        return known[1]


def _equal(one: Any, other: Any) -> bool:
    return one is other or np.array_equal(one, other)


def cut(stretches: Sequence[Samples], rate: float, gate: Gate, kept: Kept | None = None) -> Segments:
    """All segments of the stretches, in their order, contracting before relaxing in each; `kept` from one call to the
    next where these differ in some channels only.
    """
    n, m = gate.samples(rate)
    kept = kept or Kept()
    weights = np.convolve(np.ones(n), np.concatenate(([0.5], np.ones(2 * m - 1), [0.5]))) / (2 * m * n)
    group = np.cumsum([len(samples.t) for samples in stretches]) // TOGETHER
    edges = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), len(stretches)]
    groups = [stretches[first:last] for first, last in pairwise(edges)]
    moving = [one for s in stretches for one in (s.t, s.x, s.ok, s.force is None, s.mass, s.trial)]

    def motion() -> tuple[Sequence[Array], list[NDArray[Any]]]:
        starts, *columns = zip(*(_motion(group, n, m, gate) for group in groups), strict=True)
        return starts, list(map(np.concatenate, columns))

    starts, (trial, t, way, x, v, gained, mass) = kept.of("motion", moving, motion)

    def around(columns: Sequence[Sequence[Array]]) -> Array:
        """The samples of each segment and `m` to both sides, shape (segments, n + 2 m), from those of each group."""
        rows = np.arange(-m, n + m)
        return np.concatenate([_one(c)[start[:, None] + rows] for c, start in zip(columns, starts, strict=True)])

    pressures = [s.P for s in stretches]
    P = kept.of("pressure", (*moving, *pressures), lambda: around([[s.P for s in g] for g in groups]))
    pulls = around([[np.full(len(s.t), s.load) if s.force is None else s.force for s in g] for g in groups])
    inner, force = slice(m, m + n), pulls @ weights + mass * gained
    return Segments(trial, t, way, P, x, P[:, inner], v, pulls[:, inner], force, mass, weights, 1 / rate)


def _one(columns: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return columns[0] if len(columns) == 1 else np.concatenate(columns)


def _motion(stretches: Sequence[Samples], n: int, m: int, gate: Gate) -> tuple[NDArray[Any], ...]:
    """Of the segments of stretches the first sample among all; then trial, first time, direction, contraction around,
    velocity, change of velocity by time, and moving mass, 0 with a cell. Segments have `n` samples, the velocity is
    taken over `m` samples to both sides.
    """
    t, x, ok = (_one([getattr(s, name) for s in stretches]) for name in ("t", "x", "ok"))
    ends = np.cumsum([len(samples.t) for samples in stretches])
    with np.errstate(divide="ignore", invalid="ignore"):
        v = velocity(t, x, m)
    v[(ends[:-1, None] + np.arange(-m, m)).clip(0, len(v) - 1)] = 0.0  # no velocity across two stretches
    start, way = _places(ok & (x > gate.lift), v, n, m, gate)
    stretch = np.searchsorted(ends, start, side="right")
    order = np.lexsort((start, -way, stretch))
    start, way, stretch = start[order], way[order], stretch[order]
    mass = np.array([0.0 if s.force is not None else s.mass for s in stretches])[stretch]
    gained = (v[start + n] - v[start - 1]) / (t[start + n] - t[start - 1])
    number = np.array([samples.trial for samples in stretches], np.intp)[stretch]
    rows = start[:, None] + np.arange(-m, n + m)
    return start, number, t[start], way, x[rows], v[rows[:, m : m + n]], gained, mass


def _places(usable: NDArray[np.bool_], v: Array, n: int, m: int, gate: Gate) -> tuple[NDArray[np.intp], Array]:
    """Start and direction of the segments, shape (segments,) each, from the velocity `v` of all samples."""
    starts, ways = [], []
    inside = np.zeros(len(v) + 2, bool)
    for way, moving in ((1.0, v > gate.speed), (-1.0, v < -gate.speed)):
        np.logical_and(usable, moving, out=inside[1:-1])
        first, last = (inside[1:] != inside[:-1]).nonzero()[0].reshape(-1, 2).T
        begin = first + 2 * m + 1
        count = np.maximum(0, (last - m - begin) // n)
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        starts.append(np.repeat(begin, count) + n * within)
        ways.append(np.full(len(within), way))
    return np.concatenate(starts), np.concatenate(ways)


OF_MEDIANS = 5.6
"""Third differences for one degree of freedom of a median of `noise_of`: they overlap (2.3), and medians know less than
squares.
"""


def noise_seen(
    stretches: Sequence[Samples], still: Sequence[slice], every: Mapping[str, int] | None = None
) -> tuple[Noise, Noise, dict[str, float]]:
    """Noise of each channel, the part that the steps of its values alone make (step / sqrt(12)), and its degrees of
    freedom by field, as of a variance.

    The noise is the median over the stretches, each in its rows `still` where nothing moves, over the longest run of
    usable samples. It is at least that of the steps, the median over some stretches: rest does not show them. `every`
    gives k for channels with a new value only in every k-th row, interpolated in between: a mean of n rows then has
    n / k values, so their noise counts as white noise sqrt(k) times as large.
    """

    def typical(name: str) -> tuple[float, float, float]:
        k = (every or {}).get(name, 1)
        known = [(one.ok, column, rows) for one, column, rows in _at_rest(stretches, still, name) if one.ok.any()]
        few = range(len(known)) if len(known) <= SHOW else [int(n * GOLDEN % 1 * len(known)) for n in range(SHOW)]
        widths = [_step(column if ok.all() else column[ok]) for ok, column, _ in map(known.__getitem__, few)]
        width = float(np.sqrt(k / 12.0)) * _median(widths)
        rested = [rows for _, _, rows in known if len(rows) >= FEWEST_STILL * k]
        seen = [np.sqrt(k) * max(noise_of(rows[first::k]) for first in range(k)) for rows in rested]
        thirds = sum(len(rows) // k - 3 for rows in rested)
        return _median([max(one, width) for one in seen]), width, thirds / OF_MEDIANS

    noise, steps, freedom = zip(*map(typical, FIELDS), strict=True)
    return Noise(*noise), Noise(*steps), dict(zip(vars(Noise()), freedom, strict=True))


def noise_of_means(stretches: Sequence[Samples], still: Sequence[slice], over: int, least: Noise) -> Noise:
    """White noise for which means of `over` samples scatter as in the rows `still`; at least `least`.

    It is larger than `noise_seen` where noise is smooth from sample to sample, as after a filter or interpolation.
    """

    def typical(name: str) -> float:
        each = [rows[: len(rows) // over * over].reshape(-1, over) for _, _, rows in _at_rest(stretches, still, name)]
        return _median([np.sqrt(over) * noise_of(rows.mean(axis=1)) for rows in each])

    return Noise(*map(max, vars(least).values(), map(typical, FIELDS)))


def _at_rest(stretches: Sequence[Samples], still: Sequence[slice], name: str) -> Iterator[tuple[Samples, Array, Array]]:
    """Stretch, its samples of a channel, and their longest usable run in the rows `still`; for stretches with that
    channel.
    """
    for samples, rows in zip(stretches, still, strict=True):
        column = getattr(samples, name)
        if column is not None:
            yield samples, column, column[_unbroken(samples.ok, rows)]


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else 0.0


def _unbroken(ok: NDArray[np.bool_], rows: slice) -> slice:
    """The longest run of usable samples within `rows`, which have a start and a stop."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], ok[rows], [False])).astype(np.int8)))
    if not len(edges):
        return slice(0, 0)
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    first = range(len(ok))[rows].start
    return slice(first + int(edges[2 * longest]), first + int(edges[2 * longest + 1]))


def _step(column: Array) -> float:
    """Smallest difference between values: the step of a coarse converter, nearly 0 where noise fills it.

    0 for fewer than `LEVELS` values, since a quantity that jumps does not show its converter.
    """
    values = _levels(column)
    steps = np.diff(values)
    if np.count_nonzero(steps) + 1 < LEVELS:
        return 0.0
    return float(steps[steps > 1e-9 * (values[-1] - values[0])].min())


def _levels(column: Array) -> Array:
    """Sorted values of a channel, with or without duplicates. Values on a regular grid are sorted by index, which is
    faster.
    """
    few, low = np.diff(np.sort(column[:FEW])), column.min()
    step = few[few > 0].min(initial=np.inf)
    if (column.max() - low) / step < COUNTS:
        places = column - low
        places /= step
        counts = np.rint(places, out=places).astype(np.intp)
        levels = np.full(int(counts.max()) + 1, np.nan)
        levels[counts] = column
        if (levels.take(counts) == column).all():
            return np.asarray(levels[np.isfinite(levels)])
    return np.sort(column)


FILLED = 1.75
"""Ratio of noise to that of the steps alone from which on it fills them: 0.4 steps, where the error of means is 0.013
steps.
"""


@dataclass(frozen=True, eq=False)
class Campaign:
    """The usable trials of all runs, numbered consecutively; `cells` holds each trial's cell (load, pressure)."""

    runs: tuple[RunData, ...]
    trials: tuple[TrialData, ...]
    samples: tuple[Samples, ...]
    cells: NDArray[np.intp]
    rate: float
    cell: bool
    """Whether all trials have a force cell."""
    noise: Noise
    steps: Noise
    """The part of the noise due to the steps of the channels' values."""
    noise_of_means: Noise
    """White noise with the scatter of means over a segment, where larger: smooth noise, for instance after filters."""
    between: Mapping[str, float]
    """Channel -> time between new values [s] where it is read less often than recorded; 0 for others."""
    freedom: Mapping[str, float]
    """Channel -> degrees of freedom of its `noise`."""

    @property
    def pressure_step(self) -> float:
        """Step of the pressure's values [Pa]; 0 where noise fills it, so that means over segments do not show it."""
        step = self.steps.pressure
        return sqrt(12.0) * step if FILLED * step >= self.noise.pressure else 0.0

    @property
    def late(self) -> Noise:
        """Scatter of the times of single samples [s], for devices that are polled and stamped by the computer.

        They are late by the response time, whose scatter is at least as large as its mean.
        """
        found = {}
        for channel in self.channels:
            streams = [(run, run.channels[channel].stream) for run in self.runs if channel in run.channels]
            clocks = [run.clocks[stream] for run, stream in streams if stream in run.clocks]
            found[channel] = max((clock.uncertainty for clock in clocks if clock.how == STAMPED), default=0.0)
        return Noise(**found)

    def name(self, number: int) -> str:
        """`run/number` of a trial."""
        return self.trials[number].name

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that the fit uses."""
        return ("pressure", "displacement", *(("force",) if self.cell else ()))

    @property
    def skew(self) -> float:
        """Bound of the time between any two of these channels [s]."""
        return apart(self.runs, self.channels)

    @property
    def sessions(self) -> NDArray[np.intp]:
        """Number of the session of each trial, from 0; shape (trials,)."""
        names = {run.id: session_of(run) for run in self.runs}
        return np.unique([names[trial.run] for trial in self.trials], return_inverse=True)[1].astype(np.intp)

    @property
    def tested(self) -> tuple[float, ...]:
        """Pressures of the trials [Pa], ascending."""
        return tuple(sorted({trial.point["pressure"] for trial in self.trials}))


def gather(runs: Sequence[RunData]) -> tuple[Campaign | None, list[Dropped]]:
    """The usable trials of the runs, None without one, and the others with the reason."""
    dropped: list[Dropped] = []
    members: list[tuple[RunData, TrialData]] = []
    for run in runs:
        for trial in run.trials:
            if reason := _unusable(run, trial, runs[0].rate):
                dropped.append(Dropped(trial.name, trial.point, reason))
            else:
                members.append((run, trial))
    if not members:
        return None, dropped
    samples = tuple(samples_of(run, trial, number) for number, (run, trial) in enumerate(members))
    still = [settled(trial) for _, trial in members]
    between = {channel: _between([trial for _, trial in members], channel) for channel in CHANNELS}
    every = _every(runs, between)
    noise, steps, freedom = noise_seen(samples, still, every)
    if slow := [name for name, k in zip(freedom, every.values(), strict=True) if k > 1]:  # few values in one rest
        rests = [
            (one, half) for one, (_, trial) in zip(samples, members, strict=True) for half in _second_halves(trial)
        ]
        of_all, _, known = noise_seen([one for one, _ in rests], [half for _, half in rests], every)
        noise = replace(noise, **{name: getattr(of_all, name) for name in slow})
        freedom |= {name: known[name] for name in slow}
    keys = [(round(trial.point.get("load", 0.0), 3), round(trial.point["pressure"])) for _, trial in members]
    numbers = {key: number for number, key in enumerate(sorted(set(keys)))}
    rate, cells = runs[0].rate, np.array([numbers[key] for key in keys], dtype=np.intp)
    of_means = noise_of_means(samples, still, Gate().samples(rate)[0], noise)
    trials, cell = tuple(trial for _, trial in members), all(s.force is not None for s in samples)
    return Campaign(tuple(runs), trials, samples, cells, rate, cell, noise, steps, of_means, between, freedom), dropped


def _every(runs: Sequence[RunData], between: Mapping[str, float]) -> dict[str, int]:
    """Field of `Samples` -> rows from one new value to the next, in a slower stream or a held channel; 1 for others."""
    found: dict[str, int] = {}
    for name, channel in zip(FIELDS, CHANNELS, strict=True):
        infos = [(run.rate, run.channels[channel].rate) for run in runs if channel in run.channels]
        apart = [rate / own for rate, own in infos if own > 0] + [runs[0].rate * between[channel]]
        found[name] = max(map(round, apart)) or 1
    return found


SOME = 10


def _between(trials: Sequence[TrialData], channel: str) -> float:
    """As `Campaign.between`, from some trials; where almost nothing changes, a held value is not recognised."""
    some = [trial for trial in trials[:: 1 + len(trials) // SOME] if channel in trial.channels]
    return max((between_new(trial.t, trial.channels[channel])[1] for trial in some), default=0.0)


def _unusable(run: RunData, trial: TrialData, rate: float) -> str:
    """Why a trial cannot be used; empty where it can."""
    if trial.status != "finished":
        return f"the trial is {trial.status}"
    if trial.again:
        return "reference trial, done again when the run went on: compared with the first, in no fit"
    for channel in ("pressure", "displacement"):
        if channel not in trial.channels:
            return f"the {channel} is not recorded"
    if "pressure" not in trial.point:
        return "the trial names no pressure: a column of the commanded pressure gives it"
    if "force" not in trial.channels and "load" not in trial.point:
        return "neither the force nor the load is known: a column `is: force` or `point: {load: ...}` gives it"
    if abs(run.rate - rate) > 1e-6 * rate:
        return f"sampled at {run.rate:g} Hz, the first run at {rate:g} Hz: reduce them apart"
    if len(trial.t) < 2 or not trial.usable.any():
        return "no sample is usable"
    if not strokes(trial):
        return "no pressure command lies within its samples"
    return ""


def strokes(trial: TrialData) -> list[slice]:
    """Rows between one pressure command and the next; the whole trial where commands are not recorded."""
    times = [c.t - 1e-9 for c in trial.commands if c.output == "pressure" and c.t >= trial.t[0] - 1e-9]
    edges = np.searchsorted(trial.t, times).tolist() or [0]
    return [slice(first, last) for first, last in zip(edges, [*edges[1:], len(trial.t)], strict=True) if last > first]


def resting(samples: Samples, trial: TrialData) -> NDArray[np.bool_]:
    """Which samples are usable and before the first pressure command, shape (n,)."""
    first = min((c.t for c in trial.commands if c.output == "pressure"), default=-np.inf)
    return np.asarray(samples.ok & (samples.t < first))


def _second_halves(trial: TrialData) -> list[slice]:
    """The second half of the hold after each pressure command; where none is recorded, the end of the trial."""
    if not trial.commands:
        return [settled(trial)]
    return [slice((rows.start + rows.stop) // 2, rows.stop) for rows in strokes(trial)]


def settled(trial: TrialData, number: int = 0) -> slice:
    """The last fifth of the hold after pressure command `number`; empty where there is none."""
    rows = strokes(trial)[number : number + 1]
    return slice(rows[0].stop - max(8, (rows[0].stop - rows[0].start) // 5), rows[0].stop) if rows else slice(0, 0)
