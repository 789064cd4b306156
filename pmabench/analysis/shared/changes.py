"""Changes of a sensor in the middle of a run: its scale or zero, by hand, by a slip or by drift.

Trials at one operating point repeat each other: where they differ by a step or a line in time, other operating points,
which lie wholly before or after it, are off by as much although their own trials agree. And the displacement of a
driven end follows its command in each trial alike: a sensor whose scale or zero is changed, a mount that slips, or a
drive that does not go where it is sent show in the difference of both; the record does not say which.

Which part of the run was right is unknown. So the reduction is repeated with the whole channel changed by as much, and
each value holds the difference in its interval, or is withheld.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import inf, isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.imported import import_of
from pmabench.analysis.shared import student
from pmabench.analysis.shared.form import MOST_HIDDEN, Doubt, weighed
from pmabench.analysis.shared.trials import grouped, point_of, six_digits
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Analysis, Estimate, Finding
from pmabench.store.records import Array, RunData, TrialData

SENT = "displacement_command"
LEAST = 0.01
"""Relative change of values at one operating point from which on it counts [1]."""
DRIFTS = 0.02
"""The same for a line in time that is significant, but not `SURE`."""
BENT = 0.25
"""Share of what the rate of motion changes that may differ from a line."""
SURE = 8.0
"""Standard errors above which a step or a line in time is a change."""
RELATIVE = 0.2
"""Share of the largest value below which values are left out."""
APART = 0.1
"""Least rms distance of values from the mean of their cell, of the time or of a step [1]."""
LARGEST = 0.5
"""Largest change for that [1]."""
FEWEST = 6
"""Fewest values."""
BINS, PIECES = 20, 8
"""Number of places at which the force is compared; most values of a trial."""
TRAVEL = 1e-3
"""Least travel of a command [m]."""
SWEPT = ("speed", "frequency", "cycles")
"""Coordinates of an operating point that change the force at a place little."""


@dataclass(frozen=True)
class Change:
    """Change of a channel of a run: y becomes y + offset + gain (y - about); the sentence that describes it."""

    channel: str
    gain: float
    offset: float
    about: float
    text: str
    name: str = ""
    """Its line in a budget; else `change of the <channel> in the run`."""
    most: float = MOST_HIDDEN
    """Effect, as a share of a value, above which that is withheld."""
    throughout: bool = field(default=False, kw_only=True)
    """Whether the channel is off in the whole run alike, which repeats do not show."""

    def of(self, trial: TrialData) -> TrialData:
        """The trial with the channel changed throughout."""
        y = trial.channels.get(self.channel)
        if y is None:
            return trial
        return replace(trial, channels={**trial.channels, self.channel: y + self.offset + self.gain * (y - self.about)})


def with_changes(
    analysis: Analysis, runs: Sequence[RunData], reduction: Callable[[Sequence[RunData]], Analysis],
    found: Callable[[RunData], Iterable[Sequence[Change]]],
) -> Analysis:  # fmt: skip
    """The analysis with the effect of changes in each interval, and a doubt about each; `found` gives those of a run,
    each with all that it may be.
    """
    findings = list[Finding]()
    ways = dict[tuple[str, str, int], dict[str, Change]]()
    for run in runs:
        for changes in found(run):
            if (doubt := Finding("doubt", changes[0].text)) not in findings:
                findings.append(doubt)
            for number, change in enumerate(one for one in changes if one.gain or one.offset):
                ways.setdefault((change.channel, change.name, number), {})[run.id] = change
    doubts: list[dict[str, Doubt]] = [{} for _ in analysis.estimates]
    for (channel, own, _), changed in ways.items():
        name = own or f"change of the {channel} in the run"
        others = reduction([_changed(run, changed.get(run.id)) for run in runs]).estimates
        widest = max(changed.values(), key=lambda one: abs(one.gain))
        shifts = [_apart(e, others, widest) for e in analysis.estimates]
        largest = dict[tuple[str, str], tuple[float, float]]()
        for e, half in zip(analysis.estimates, shifts, strict=True):
            if e.value is not None and half is not None:
                most, size = largest.get((e.symbol, e.method), (0.0, 0.0))
                largest[e.symbol, e.method] = max(most, half), max(size, abs(e.value))
        for e, mine, shift in zip(analysis.estimates, doubts, shifts, strict=True):
            most, size = largest.get((e.symbol, e.method), (0.0, 0.0))
            share = max(abs(widest.gain), most / size if size else 0.0)
            half = share * abs(e.value or 0.0) if shift is None else shift
            if name not in mine or half > mine[name].half:
                mine[name] = Doubt(name, "drift", half, True, widest.text, widest.most)
    weighted = (weighed(e, mine.values()) for e, mine in zip(analysis.estimates, doubts, strict=True))
    return replace(analysis, estimates=tuple(weighted), findings=(*analysis.findings, *findings))


def _changed(run: RunData, change: Change | None) -> RunData:
    return run if change is None else replace(run, trials=tuple(change.of(trial) for trial in run.trials))


def _apart(e: Estimate, others: Sequence[Estimate], change: Change) -> float | None:
    """Difference of an estimate from that of `others`, taken to the same contraction along their values; None where
    they have none at its operating point.

    A value that is given for the commanded contraction is the same there; it is off by its slope over the contraction.
    """
    if e.value is None:
        return 0.0

    def key(one: Estimate) -> tuple[object, ...]:
        return one.symbol, one.method, one.coordinate, six_digits(one.at, "contraction")

    alike = sorted(
        (one.at.get("contraction", 0.0), one.value) for one in others if key(one) == key(e) and one.value is not None
    )
    if not alike:
        return None
    x, values = np.array(alike).T
    place, slopes = e.at.get("contraction", 0.0), np.gradient(values, x) if len(set(x)) == len(x) > 1 else 0 * x
    near = int(np.argmin(np.abs(x - place)))
    half = abs(float(values[near] + slopes[near] * (place - x[near])) - e.value)
    if change.channel == "displacement" and half < 1e-9 * abs(e.value):
        half = abs(float(slopes[near]) * (change.offset + change.gain * (place - change.about)))
    return half


def of_values(run: RunData, channel: str, what: str, values: tuple[Array, Array, Array]) -> Iterator[list[Change]]:
    """The change that one value of each trial shows, as one of the scale of a channel: cell, time and value as in
    `Rows`.
    """
    if found := Rows(*values, np.zeros(len(values[0]))).change():
        yield [Change(channel, found.size, 0.0, 0.0, found.text(run, what))]


def of_forces(run: RunData) -> Iterator[list[Change]]:
    """The change that the force of a driven end shows, as one of the scale or of the zero of its cell."""
    if found := _forces(run).change():
        text = found.text(run, "force at the same places")
        offset = found.size * found.level
        yield [Change("force", found.size, 0.0, 0.0, text), Change("force", 0.0, offset, 0.0, text)]


@dataclass(frozen=True)
class Found:
    """A change in time."""

    size: float
    """As a share of the values before or after it, the larger one [1]."""
    time: float
    """Time of a step [s]; nan of a line."""
    level: float
    """Largest mean of the cells that show it [as the value]."""

    def text(self, run: RunData, what: str) -> str:
        """The sentence that describes it."""
        when = "from the first trial to the last" if np.isnan(self.time) else f"from about {self.time:.0f} s on"
        return (
            f"{run.id}: at one operating point the {what} changed by {self.size:+.2g} of it {when}: a sensor or the "
            "specimen, and values at other operating points lie wholly before or after it. Look for the cause, and "
            "measure again"
        )


@dataclass(frozen=True)
class Rows:
    """Values that repeat each other within a cell, arrays of shape (n,).

    `cell` numbers operating points, `t` is the time [s], `rate` is what the value may depend on within a cell.
    """

    cell: Array
    t: Array
    value: Array
    rate: Array

    def change(self) -> Found | None:
        """The step or the line in time that explains most of what the values differ within cells; None without one."""
        mean = self._mean(self.value)
        good = mean > RELATIVE * mean.max(initial=0.0)
        rows = Rows(self.cell[good], self.t[good], self.value[good], self.rate[good])
        cells, mean = len(set(rows.cell.tolist())), mean[good]
        free = len(mean) - 2 * cells - 1
        if len(mean) < FEWEST or cells < 2 or free < 1:
            return None
        times = np.unique(rows.t)[1:]
        since = (rows.t >= times[:, None]) * 1.0
        within = 0.5 * (since + (rows.t > times[:, None]))  # a step while the first of these values was measured
        tried = np.vstack([(rows.t - rows.t.min()) / np.ptp(rows.t), since, within])
        off, rate, tried = rows.value / mean - 1, rows.rate - rows._mean(rows.rate), tried - rows._mean(tried)
        by_rate = rate * (np.unique(rows.cell)[:, None] == rows.cell)
        by_rate = by_rate[by_rate.any(axis=1)]
        by_rate /= np.linalg.norm(by_rate, axis=1)[:, None]
        line = off @ by_rate.T @ by_rate
        least = max(LEAST, BENT * float(np.ptp(line)))
        off, tried = off - line, tried - tried @ by_rate.T @ by_rate
        power = np.sum(tried**2, axis=1)
        power[0] = power[0] if power[0] > len(off) * APART**2 else 0.0
        known = power > APART**2
        sizes = np.where(known, tried @ off / np.where(known, power, 1.0), 0.0)
        left = off @ off - sizes**2 * power
        error = np.sqrt(np.maximum(left, 1e-12) / free / np.where(known, power, np.inf))
        best = int(np.argmin(left))
        if abs(sizes[best]) <= max(least, SURE * error[best]):
            if abs(sizes[0]) <= max(DRIFTS, least, float(student.ppf(0.975, free)) * error[0]):
                return None
            best = 0
        level = float(mean[np.abs(tried[best]) > APART].max())
        size = float(sizes[best])
        return Found(
            size / (1 - min(abs(size), LARGEST)), nan if best == 0 else float(times[(best - 1) % len(times)]), level
        )

    def _mean(self, of: Array) -> Array:
        """Mean of `of`, shape (..., n), over the cell of each row."""
        mine = (self.cell[:, None] == np.unique(self.cell)).astype(np.float64)
        return np.asarray((of @ mine / mine.sum(axis=0)) @ mine.T)


def _forces(run: RunData) -> Rows:
    """Mean force of the cycles of each driven trial, over that of its cell at the same places and directions [N].

    A cell has the repeats of an operating point; without repeats, trials of all speeds.
    """
    needed = {SENT, "force"}
    trials = [one for one in run.trials if one.status == "finished" and not one.again and needed <= set(one.channels)]
    repeated = len({point_of(one) for one in trials}) < len(trials)
    cells = grouped(trials, lambda one: tuple(p for p in point_of(one) if repeated or p[0] not in SWEPT))
    rows = [row for number, mine in enumerate(cells.values()) for row in _shares(number, mine)]
    return Rows(*np.array(rows).reshape(-1, 4).T)


def _shares(number: int, trials: Sequence[TrialData]) -> Iterator[tuple[float, float, float, float]]:
    """Cell, time, mean force and speed of the cycles of each trial of a cell, in at most `PIECES` pieces."""
    parts = []
    for trial in trials:
        sent, force = trial.channels[SENT], trial.channels["force"]
        good = trial.usable & np.isfinite(sent) & np.isfinite(force)
        if found := cycles(sent[good]):
            parts.append((trial.t[good], sent[good], force[good], found))
    if not parts:
        return
    low, high = min(float(p[1].min()) for p in parts), max(float(p[1].max()) for p in parts)
    places = [2 * np.round(BINS * (sent - low) / (high - low)).astype(np.intp) + (side(sent) > 0)
              for _, sent, _, _ in parts]  # fmt: skip
    where, forces = np.concatenate(places), np.concatenate([force for _, _, force, _ in parts])
    usual = np.bincount(where, forces) / np.maximum(np.bincount(where), 1)
    level = float(forces.mean())
    for (t, sent, force, found), place in zip(parts, places, strict=True):
        for some in np.array_split(np.arange(len(found)), min(PIECES, len(found))):
            rows = np.concatenate([found[n] for n in some])
            share = float(force[rows].sum() / usual[place[rows]].sum())
            lasts = float(t[rows[-1]] - t[rows[0]])
            yield number, float(t[rows[0]]), share * level, len(some) * float(np.ptp(sent[rows])) / lasts


def side(sent: Array) -> Array:
    """1 after a motion (n,) was in the upper quarter of its range and until it is in the lower one, where it is -1; 0
    before.
    """
    place = (sent - sent.min()) / max(float(np.ptp(sent)), 1e-12)
    event = np.where(place > 0.75, 1, np.where(place < 0.25, -1, 0))
    last = np.maximum.accumulate(np.where(event != 0, np.arange(len(event)), 0))
    return np.asarray(event[last])


def cycles(sent: Array) -> list[NDArray[np.intp]]:
    """Rows of each whole cycle of a motion, from one rise to the next; noise of a command that is read is none."""
    if len(sent) < FEWEST or np.ptp(sent) < TRAVEL:
        return []
    up = side(sent) > 0
    return [np.arange(begin, end) for begin, end in pairwise(np.flatnonzero(up[1:] & ~up[:-1]) + 1)]


MOVED = "displacement"
SCALE, PLACE = 2e-3, 2e-4
"""Changes of scale [1] and place [m] of the displacement, compared with the command, that are no change of a sensor."""
FAR, AWAY = 0.01, 1e-3
"""Constant differences of scale [1] and place [m] that are not reported."""
SURELY = 3.0
"""Declared uncertainties of the zero above which a constant difference of place is reported, in place of `AWAY`."""
MORE = 1.2
"""Factor on a constant difference: at the end of a curve a value changes by less than elsewhere."""
OTHER = 0.3
"""Difference of scale from which on the command counts as that of something else."""
CLEAR = 4.0
"""Usual differences between successive trials above which a difference is a change."""
BY_LAG = 0.5
"""Share of the effect of the drive's lag on the scale that its form leaves open."""
FEWEST_SAMPLES = 20
"""Fewest samples of a trial."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Displacement of a cycle, or of half a trial, compared with its command."""

    trial: TrialData
    t: float
    """Its start [s]."""
    centre: float
    """Mean of the command [m]."""
    place: float
    """Displacement minus command there [m]."""
    rest: float
    """Rms residual of that comparison [m]; it is large where the sensor changed meanwhile."""
    scale: float = nan
    """Share of the commanded travel that is measured [1]; nan where nothing travelled."""
    open: float = 0.0
    """Uncertainty of `scale` by the lag of the drive [1]."""
    noise: float = 0.0
    """Largest error of `scale` by noise [1]."""
    reach: float = 0.0
    """Half of the commanded travel [m]."""

    @classmethod
    def all_of(cls, trial: TrialData) -> Iterator[Followed]:
        """The comparisons of all cycles of a trial; of both halves where there are no cycles."""
        if trial.status != "finished" or not {MOVED, SENT} <= set(trial.channels):
            return
        x, sent = trial.channels[MOVED], trial.channels[SENT]
        good = trial.usable & np.isfinite(x) & np.isfinite(sent)
        if np.count_nonzero(good) < FEWEST_SAMPLES:
            return
        t, x, sent = trial.t[good], x[good], sent[good]
        speed = np.gradient(sent, t)
        for part in cycles(sent) or np.array_split(np.arange(len(t)), 2):
            if len(part) >= FEWEST_SAMPLES // 2 and (one := cls.of(trial, t[part], x[part], sent[part], speed[part])):
                yield one

    @classmethod
    def of(cls, trial: TrialData, t: Array, x: Array, sent: Array, speed: Array) -> Followed | None:
        """The comparison for samples of a trial, shape (n,); None where the command is that of something else."""
        centre, reach = float(sent.mean()), 0.5 * float(np.ptp(sent))
        if 2 * reach < TRAVEL:
            return cls(trial, float(t[0]), centre, float(np.median(x - sent)), float(np.std(x - sent)))
        # a drive that follows with a lag T is T times its speed behind; at a frequency w it also loses (w T)^2
        design = np.column_stack([np.ones_like(t), sent - centre, speed])
        terms, *_ = np.linalg.lstsq(design, x, rcond=None)
        scale, lag = float(terms[1]), float(terms[2] / terms[1])
        if abs(scale - 1) > OTHER:
            return None
        lost = lag**2 * float(np.mean(speed**2) / np.mean((sent - centre) ** 2))
        place, rest = float(terms[0]) - centre, float(np.std(x - design @ terms))
        noise = CLEAR * rest * float(np.sqrt(np.linalg.pinv(design.T @ design)[1, 1]))
        return cls(trial, float(t[0]), centre, place, rest, scale * (1 + lost), BY_LAG * lost, noise, reach)


def followed(run: RunData) -> Change | None:
    """Change of the displacement compared with its command within a run, or throughout."""
    every = [one for trial in run.trials for one in Followed.all_of(trial)]
    if not every:
        return None
    info, first = run.channels.get(MOVED), every[0]
    gain, zero = (0.0, 0.0) if info is None else (info.gain_uncertainty, info.offset_uncertainty)
    travelled = [one for one in every if isfinite(one.scale)]
    steady = travelled[0] if travelled else replace(first, scale=1 + _slope(every))
    most = max(SCALE, gain, CLEAR * _usual([one.scale for one in travelled]))
    far = max(PLACE, zero, CLEAR * _usual([one.place for one in every]))

    def before(sent: Any) -> Any:
        """Displacement minus command at the beginning of the run, where the drive is sent to [m]."""
        return first.place + (steady.scale - 1) * (sent - first.centre)

    moved = [one.place - before(one.centre) for one in every]
    open_, noise = steady.open, steady.noise
    changed = [one for one in travelled if abs(one.scale - steady.scale) > most + one.open + open_ + one.noise + noise]
    slipped = [
        one for one, by in zip(every, moved, strict=True) if abs(by) > far + most * abs(one.centre - first.centre)
    ]
    if not changed and not slipped:
        return _constant(run, every, gain, zero, steady)
    whole = CLEAR * float(np.median([one.rest for one in every]))
    size = [
        (one.rest <= whole, abs(by) + (abs(one.scale - steady.scale) * one.reach if one in changed else 0.0))
        if one in changed or one in slipped else (False, 0.0)
        for one, by in zip(every, moved, strict=True)
    ]  # fmt: skip
    place = max(range(len(every)), key=size.__getitem__)
    worst = every[place]
    by, offset = worst.scale - steady.scale if worst in changed else 0.0, moved[place]
    begun = min((*changed, *slipped), key=lambda one: one.t).trial
    x, sent = (np.nan_to_num(begun.channels[name]) for name in (MOVED, SENT))
    when = _since(begun.t, x - sent - before(sent), offset + by * (sent - worst.centre))
    scaled = f" by {by:+.1%} of the way that the drive was sent, and" if by else ""
    text = (
        f"{run.id}: from {when:.0f} s on, in trial {begun.number}, the displacement changed{scaled} by "
        f"{show(offset, 'length', 2)} at {show(worst.centre, 'length', 3)} compared with its command: the scale or the "
        "zero of its sensor, a mount that slipped, or a drive that does not go where it is sent. Look for the cause, "
        "and measure again"
    )
    return Change(MOVED, by, offset, worst.centre, text)


def _slope(every: Sequence[Followed]) -> float:
    """Slope over the place of the difference between displacement and command [1]; 0 with fewer than three places."""
    centres, places = np.array([(one.centre, one.place) for one in every]).T
    return float(np.polyfit(centres, places, 1)[0]) if len(set(np.round(centres / TRAVEL))) > 2 else 0.0


def _usual(values: Sequence[float]) -> float:
    """Median difference of successive values without the two largest: a step within a value changes two of them."""
    apart = np.sort(np.abs(np.diff(values)))[:-2]
    return float(np.median(apart)) if len(apart) else 0.0


def _since(t: Array, off: Array, size: Array) -> float:
    """Time [s] from which on `off` has the change `size`, all of shape (n,)."""
    gained = np.cumsum((2 * off * size - size * size)[::-1])[::-1]
    return float(t[int(np.argmax(gained))])


def _constant(run: RunData, every: Sequence[Followed], gain: float, offset: float, steady: Followed) -> Change | None:
    """The change that brings a displacement that is off in all trials alike to its command: either may be right, and
    intervals hold both.

    The zero of an imported command is not known; where its sign is another one, nothing is.
    """
    scales = [one.scale for one in every if isfinite(one.scale) and one.open < FAR] or [steady.scale]
    scale, place = float(np.median(scales)) - 1, float(np.median([one.place for one in every]))
    own, away = not import_of(run), max(PLACE, SURELY * offset) if offset else AWAY
    said = [f"{scale:+.1%} of the way that the drive was sent"] if abs(scale) > max(FAR, gain) else []
    by = 1 / (1 + MORE * scale) - 1 if said else 0.0
    said += [f"{show(place, 'length', 2)} off the place where it was sent"] if own and abs(place) > away else []
    if not said:
        return None
    text = f"{run.id}: the displacement reads {' and '.join(said)}: sensor or drive is wrong"
    text += ". Intervals hold either. Compare the sensor with another one"
    moved = -steady.place if own and by else -place if own and abs(place) > away else 0.0
    return Change(MOVED, by, moved, steady.centre, text, "displacement against command", inf, throughout=True)
