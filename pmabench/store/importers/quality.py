"""What is wrong with samples: dropouts, gaps, time jumps, stale and impossible values; flags and tells, mends nothing.

Pure functions of arrays; must not know files or runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.store.importers.map_rules import ColumnRule
from pmabench.store.records import Array, Flag, Flags

NOT_WHOLE = 0.05
"""Counts further than this from a whole number were never counts."""
WHOLE_SHARE = 0.01
"""Share of such readings above which the file was not recorded with the scale that the map says."""
SLOW = 4.0
"""A channel that changes only every so many samples is told."""
AROUND = 12
"""Neighbours on either side that a spike is held against ..."""
ALONE = 3
"""... without those nearer than this, since a spike may be three samples long."""
SPIKE = 4.0
"""A spike lies so many times further out than all but the most scattered samples."""
SMALLEST = 0.02
"""Share of the span of a channel below which nothing is a spike."""
SCATTERED = 0.005
"""Share of the samples that are the most scattered; at least six."""
ENOUGH = 100_000
"""Values that tell resolution and span of a channel; of more only so many are looked at, evenly spread."""
FEW = 50
"""With fewer samples scatter cannot be told from spikes."""
OFTEN = 0.1
"""Share of samples out of range above which the scale or the column itself is doubtful."""
LARGEST = 1e30
"""No device gives a reading beyond this, or one that is smaller than its inverse and not 0."""
OPPOSITE = -0.5
"""Correlation below which a channel seems to have the wrong sign."""

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Found:
    """One finding: how many samples, the first of them, and a sentence."""

    level: str
    """`note`, `doubt` or `fault`."""
    kind: str
    text: str
    channel: str = ""
    count: int = 0
    index: int | None = None
    """Row of the first sample, from 0."""
    t: float | None = None
    """Its time stamp [s]."""


@dataclass(frozen=True)
class Checked:
    """One channel: raw readings and SI values, both of shape (n,), and its rule."""

    rule: ColumnRule
    raw: Array
    si: Array


@dataclass
class _Report:
    """Flags and findings while they are gathered."""

    t: Array
    flags: Flags
    found: list[Found] = field(default_factory=list)

    def mark(self, where: Bools, flag: Flag, level: str, kind: str, text: str, channel: str = "") -> None:
        """Flag samples and tell of them; nothing happens where there are none."""
        count = int(np.count_nonzero(where))
        if count == 0:
            return
        self.flags[where] |= np.uint16(flag)
        first = int(np.argmax(where))
        samples = f"{count} sample" + ("s" if count > 1 else "")
        told = f"{channel}: {text}" if channel else text
        self.found.append(
            Found(
                level,
                kind,
                f"{told}; {samples}, first at {self.t[first]:.3f} s (row {first + 1})",
                channel,
                count,
                first,
                _at(self.t, first),
            )
        )


def _at(t: Array, index: int) -> float:
    return float(t[index])


def inspect(
    t: Array, channels: Sequence[Checked], rate: tuple[float, float], gap: float, leap: float
) -> tuple[Flags, list[Found]]:
    """Flags of shape (n,) and findings for samples at `t` [s] as the file has them, not sorted.

    `rate` [Hz] is what is expected, `gap` and `leap` [s] are distances of neighbours that are a gap, or an error of
    the clock. One flag stands for the whole row, for rows are what fits use.
    """
    report = _Report(t, np.zeros(len(t), dtype=np.uint16))
    with np.errstate(over="ignore", invalid="ignore"):  # damaged files hold infinite numbers
        _time(report, rate, gap, leap)
        _twice(report, channels)
        for channel in channels:
            _channel(report, channel)
    return report.flags, report.found


def _time(report: _Report, rate: tuple[float, float], gap: float, leap: float) -> None:
    t = report.t
    steps = np.diff(t, prepend=t[0])
    forward = steps[1:][steps[1:] > 0]
    if len(forward) == 0:
        report.mark(np.ones(len(t), bool), Flag.TIME_JUMP, "fault", "time-jump", "the time never advances")
        return
    seen = 1.0 / float(np.median(forward))
    if not rate[0] <= seen <= rate[1]:
        text = f"the median rate is {seen:.4g} Hz, expected {rate[0]:g} to {rate[1]:g} Hz: is the unit of time right?"
        report.found.append(Found("doubt", "rate", text))
    latest = np.maximum.accumulate(t)
    back = steps < 0
    if back.any():
        first = int(np.argmax(back))
        text = f"the time jumps back by {-steps[first]:.3g} s; what follows has time stamps that were there before"
        behind = np.concatenate([[False], t[1:] <= latest[:-1]]) & (np.cumsum(back) > 0)
        report.mark(back | behind, Flag.TIME_JUMP, "fault", "time-jump", text)
    ahead = steps > leap
    text = f"the time leaps ahead by up to {steps.max():.3g} s"
    report.mark(ahead, Flag.TIME_JUMP, "fault", "leap", text)
    between = (steps > gap) & ~ahead
    text = f"samples are missing before these, for up to {steps[~ahead].max():.3g} s"
    report.mark(between, Flag.GAP, "note", "gap", text)
    same = np.concatenate([[False], steps[1:] == 0])
    if same.any():
        first = int(np.argmax(same))
        text = f"{int(same.sum())} time stamps equal the one before, first at {t[first]:.3f} s (row {first + 1})"
        report.found.append(Found("note", "same-time", text, "", int(same.sum()), first, _at(t, first)))


def _twice(report: _Report, channels: Sequence[Checked]) -> None:
    """Rows that repeat the one before, time and all."""
    same = np.concatenate([[False], np.diff(report.t) == 0])
    for channel in channels:
        same &= np.concatenate([[False], np.diff(channel.raw) == 0])
    if channels:
        report.mark(same, Flag.SUSPECT, "note", "twice", "the row before is repeated")


def _channel(report: _Report, channel: Checked) -> None:
    rule, raw, name = channel.rule, channel.raw, channel.rule.role
    nothing = ~np.isfinite(raw) | ~np.isfinite(channel.si)
    report.mark(nothing, Flag.DROPOUT, "note", "missing", "no value in the file", name)
    with np.errstate(invalid="ignore"):
        absurd = ((np.abs(raw) > LARGEST) | ((np.abs(raw) < 1.0 / LARGEST) & (raw != 0))) & ~nothing
    text = f"reads below {1 / LARGEST:.0e} or above {LARGEST:.0e}, as no device does: the file is damaged here"
    report.mark(absurd, Flag.SUSPECT, "fault", "absurd", text, name)
    out = nothing | absurd
    if rule.dropout is not None:
        cut = _equals(raw, rule.dropout)
        text = f"reads {rule.dropout:g} {rule.raw_unit}, as a cut wire does"
        report.mark(cut, Flag.DROPOUT, "doubt", "dropout", text, name)
        out = out | cut
    if rule.blip is not None:
        here = _equals(raw, rule.blip)
        alone = here & ~np.roll(here, 1) & ~np.roll(here, -1)
        alone[[0, -1]] = False
        text = f"reads {rule.blip:g} {rule.raw_unit} in a single sample between others"
        report.mark(alone, Flag.DROPOUT, "note", "blip", text, name)
        out = out | alone
    if rule.whole:
        _whole(report, channel, ~out)
    low, high = rule.low, rule.high
    with np.errstate(invalid="ignore"):
        if rule.whole:
            beyond = ((channel.si <= low) | (channel.si >= high)) & ~out
        else:
            beyond = ((channel.si < low) | (channel.si > high)) & ~out
    bounds = f"{show(low, rule.quantity, 4)} to {show(high, rule.quantity, 4)}"
    level = "doubt" if float(np.mean(beyond)) > OFTEN else "note"
    report.mark(beyond, Flag.OVERRANGE, level, "out-of-range", f"is at or beyond its range, {bounds}", name)
    if rule.stale_after is not None:
        _stale(report, channel, rule.stale_after)
    _spikes(report, channel, ~(out | beyond))


def _spikes(report: _Report, channel: Checked, looked_at: Bools) -> None:
    """Up to three samples in a row that stand out from their neighbours as nothing else in the channel does."""
    rule = channel.rule
    si = channel.si[looked_at]
    if len(si) < FEW:
        return
    apart = beyond_neighbours(si, swings=not rule.role.endswith("command"))
    limit = rule.spike if rule.spike is not None else spike_limit(si, apart)
    where = np.zeros(len(channel.si), dtype=bool)
    where[looked_at] = apart > limit
    text = f"lies beyond all its neighbours by more than {show(limit, rule.quantity, 3)}, alone"
    report.mark(where, Flag.SUSPECT, "doubt", "spike", text, rule.role)


def beyond_neighbours(values: Array, swings: bool = True) -> Array:
    """How far each value stands out alone, shape (n,): the lesser of two distances, none below 0.

    Beyond all of its neighbours, the 3rd to the 12th on either side; from the running median of seven, which three in
    a row do not move. Of what `swings`, as no command does, the difference of the levels before and after is taken off,
    since what swings over after a step is no spike. Steps, ramps and waves stay near 0. At the ends, where neighbours
    stand on one side only, so much is taken off as these move.
    """
    low, high = _extremes(values)
    beyond = np.fmax(values - high, low - values)
    out = np.zeros(len(values))
    padded = np.pad(values, AROUND, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)
    outside = np.flatnonzero(beyond > 0)  # all others lie among their neighbours: 0
    for begin in range(0, len(outside), 100_000):
        rows = outside[begin : begin + 100_000]
        around = windows[rows]
        near = around[:, AROUND - ALONE : AROUND + ALONE + 1]
        median = np.partition(near, ALONE, axis=1)[:, ALONE]
        cut = np.isnan(near).any(axis=1)
        median[cut] = np.nanmedian(near[cut], axis=1)
        before = _level(around[:, AROUND - ALONE - 2 : AROUND - ALONE + 1])
        after = _level(around[:, AROUND + ALONE : AROUND + ALONE + 3])
        end = np.isnan(before - after)
        step = np.where(end, high[rows] - low[rows], np.abs(before - after))
        off = step if swings else np.where(end, step, 0.0)
        out[rows] = np.minimum(beyond[rows], np.abs(values[rows] - median)) - off
    return np.maximum(out, 0.0)


def _extremes(values: Array) -> tuple[Array, Array]:
    """The lowest and the highest of the neighbours of each value, the 3rd to the 12th on either side."""
    wide, ends = AROUND - ALONE + 1, []
    for least, nothing in ((np.fmin, np.inf), (np.fmax, -np.inf)):
        run = np.pad(values, AROUND, constant_values=nothing)
        done = 1
        while done < wide:  # the extreme of so many values in a row, from that of fewer
            more = min(done, wide - done)
            run, done = least(run[:-more], run[more:]), done + more
        ends.append(least(run[: len(values)], run[AROUND + ALONE :][: len(values)]))
    return ends[0], ends[1]


def _level(around: Array) -> Array:
    """The middle of three neighbours; NaN where one is beyond the end."""
    low, high = np.minimum(around[:, 0], around[:, 1]), np.maximum(around[:, 0], around[:, 1])
    return np.asarray(np.maximum(low, np.minimum(high, around[:, 2])))


def spike_limit(values: Array, apart: Array) -> float:
    """From which distance on a sample is a spike: far beyond scatter, resolution and 2 % of the channel's span."""
    count = max(6, int(SCATTERED * len(apart)))
    above = apart[apart > 0]
    scatter = float(np.partition(above, -count)[-count]) if len(above) >= count else 0.0
    some = values[:: 1 + len(values) // ENOUGH]
    marks = np.unique(some)
    resolution = float(np.diff(marks).min()) if len(marks) > 20 else 0.0
    low, high = (float(end) for end in np.quantile(some, [SCATTERED, 1.0 - SCATTERED]))
    return max(SPIKE * scatter, SPIKE * resolution, SMALLEST * (high - low)) + 1e-9 * float(np.abs(values).max())


def _equals(raw: Array, value: float) -> Bools:
    return np.asarray(np.abs(raw - value) <= 1e-6 * max(1.0, abs(value)))


def whole_counts(raw: Array) -> Bools:
    """Which readings are whole numbers."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(raw - np.round(raw)) <= NOT_WHOLE)


def _whole(report: _Report, channel: Checked, looked_at: Bools) -> None:
    """Readings that cannot be counts: the file was not made with the scale that the map says."""
    odd = looked_at & ~whole_counts(channel.raw)
    share = float(odd.sum()) / max(1, int(looked_at.sum()))
    name = channel.rule.role
    if share > WHOLE_SHARE:
        text = (
            f"{share:.0%} of the readings are no whole counts: this file was not recorded with the scale that the map "
            "says, or was rewritten; nothing of it enters a fit"
        )
        report.mark(looked_at, Flag.SUSPECT, "fault", "not-whole", text, name)
    else:
        report.mark(odd, Flag.SUSPECT, "doubt", "not-whole", "the reading is no whole count", name)


def _stale(report: _Report, channel: Checked, longest: float) -> None:
    t, raw = report.t, channel.raw
    fresh = np.concatenate([[True], raw[1:] != raw[:-1]])
    changed = np.flatnonzero(fresh)
    age = t - t[changed[np.cumsum(fresh) - 1]]
    text = f"has not changed for more than {longest:g} s"
    report.mark(age > longest, Flag.STALE, "doubt", "stale", text, channel.rule.role)
    if len(changed) > 10:
        usual, period = float(np.median(np.diff(t[changed]))), float(np.median(np.diff(t)))
        if period > 0 and usual > SLOW * period:
            text = f"{channel.rule.role}: changes every {usual:.3g} s only, the log runs every {period:.2g} s"
            report.found.append(Found("note", "slow", text, channel.rule.role))


def against_sign(flags: Flags, values: Mapping[str, Array], channel: str) -> Found | None:
    """A doubt where `channel` falls while pressure rises; both of shape (n,), SI."""
    good = (flags & np.uint16(Flag.DROPOUT | Flag.OVERRANGE | Flag.TIME_JUMP | Flag.SUSPECT)) == 0
    pressure, other = values["pressure"][good], values[channel][good]
    if len(pressure) < 10 or np.ptp(pressure) == 0 or np.ptp(other) == 0:
        return None
    together = float(np.corrcoef(pressure, other)[0, 1])
    if together > OPPOSITE:
        return None
    text = f"{channel}: falls while pressure rises (correlation {together:.2f}): its sign, or the column, may be wrong"
    return Found("doubt", "sign", text, channel)


# -- among files ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Summary:
    """What is compared between files at the same point: the peak of each channel [SI]."""

    point: tuple[tuple[str, float], ...]
    peaks: Mapping[str, float]
    numbers: Mapping[str, float]
    """The same peaks as the numbers that stand in the file."""
    trusted: bool
    """False where the file was found wrong already."""


UNIT_FACTORS: Mapping[str, Mapping[str, float]] = {
    "force": {"kilograms for newtons": 9.80665, "pounds for newtons": 4.4482, "a factor of 1000": 1000.0},
    "pressure": {"psi for kPa": 6.8948, "bar for kPa": 100.0, "a factor of 10": 10.0, "a factor of 1000": 1000.0},
    "length": {"inches for mm": 25.4, "a factor of 10": 10.0, "a factor of 1000": 1000.0},
}


def compare(files: Sequence[Summary], allowed: Mapping[str, float]) -> list[list[Found]]:
    """Findings per file: peaks that lie further than `allowed` [1] from those of its siblings.

    With three or more the median tells which is wrong (`fault`); of two that nobody doubts either may be (`doubt`).
    """
    found: list[list[Found]] = [[] for _ in files]
    for index, file in enumerate(files):
        group = [other for other in files if other.point == file.point]
        for channel, share in allowed.items():
            peaks = [o.peaks[channel] for o in group if channel in o.peaks and o.trusted]
            others = [o.peaks[channel] for o in group if o is not file and channel in o.peaks and o.trusted]
            if channel not in file.peaks or not others:
                continue
            usual = float(np.median(peaks if len(peaks) > 2 else others))
            ratio = file.peaks[channel] / usual if usual else float("inf")
            if abs(ratio - 1.0) <= share:
                continue
            sure = len(peaks) > 2 or not file.trusted
            quantity = CHANNEL_QUANTITY[channel]
            text = (
                f"{channel}: peak {show(file.peaks[channel], quantity, 4)}, that of its siblings "
                f"{show(usual, quantity, 4)}: implausible{_hint(ratio, quantity)}"
            )
            if not sure:
                text += "; which of the two is wrong cannot be told"
            found[index].append(Found("fault" if sure else "doubt", "sibling", text, channel))
        found[index] += _swapped(file, [other for other in group if other is not file and other.trusted], allowed)
    return found


def _swapped(file: Summary, others: Sequence[Summary], allowed: Mapping[str, float]) -> list[Found]:
    """Pairs of columns whose numbers look like each other's in the siblings, and not like their own."""
    if not others:
        return []
    usual = {
        channel: float(np.median([other.numbers[channel] for other in others]))
        for channel in file.numbers
        if all(other.numbers.get(channel) for other in others)
    }

    def like(channel: str, other: str) -> bool:
        share = max(allowed.get(channel, 0.3), allowed.get(other, 0.3))
        return abs(file.numbers[channel] / usual[other] - 1.0) <= share

    found = []
    for a, b in combinations(sorted(usual), 2):
        if like(a, b) and like(b, a) and not like(a, a) and not like(b, b):
            text = f"{a} and {b} look swapped: each reads what the other reads in the sibling files"
            found.append(Found("fault", "swap", text, a))
    return found


def _hint(ratio: float, quantity: str) -> str:
    if ratio <= 0:
        return ", the sign may be wrong"
    for text, factor in UNIT_FACTORS.get(quantity, {}).items():
        if min(abs(ratio / factor - 1.0), abs(ratio * factor - 1.0)) < 0.03:
            return f" (is it {text}?)"
    return ""


def plain(found: Found) -> dict[str, Any]:
    """A finding as the manifest keeps it."""
    return asdict(found)
