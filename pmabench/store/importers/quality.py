"""Flags and reports faulty samples of single channels and of the clock; functions of arrays.

Dropouts, gaps, time jumps, stale and impossible values, codes for "no value", bursts, briefly held values, spikes.
Every rule uses numbers alone and reports the samples that it flags.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers.found import Bools, Checked, Found, Report, correlation
from pmabench.store.importers.motion import runs
from pmabench.store.records import Array, Flag, Flags
from pmabench.store.spikes import ENDS, FEW, MANY, SPIKE, beyond_neighbours, resolution, some_of, spike_limit

CODES = (
    *(0.0, -1.0, 99.99, 999.0, 999.9, 999.99, 999.25, 9999.0, 9999.9, 9999.99, 99999.0, 999999.0, 9999999.0),
    *(32767.0, 32768.0, 65535.0, 8388607.0, 8388608.0, 16777215.0, 2147483647.0, 2147483648.0, 4294967295.0),
    *(1e9, 1e10, 1e20, 9.9e37, 9.91e37, 6999.0, 7999.0, 8888.0, 88888.0),
)
"""Numbers that loggers, meters and converters write for "no value" or "out of range", with either sign."""
BEYOND = 0.05
"""A code is outside the channel's other readings by this share of their span, or is entered and left by a jump."""
LEAP = 4.0
"""A jump is this many times larger than other changes nearby ..."""
NEARBY = 30
"""... within this many samples on either side."""
BURST = 5
"""Longest burst [samples] of different values ..."""
HELD = 50
"""... and of equal values."""
BRIEF = 1.0
"""Longest held value that counts as a fault [s]; longer ones may be a level of the test."""
MOVES = 20.0
"""A channel counts as moving if its span is this many times the change from sample to sample."""
AS_LARGE = 0.25
"""After a burst the signal must come back to its former level within this share of the jump."""
NOT_WHOLE = 0.05
"""Readings further than this from a whole number are not counts."""
WHOLE_SHARE = 0.01
"""Largest share of such readings; above it the file was not recorded with the scale of the map."""
OFTEN = 0.1
"""Share of samples out of range above which the scale or the column is doubtful."""
LARGEST = 1e30
"""Largest possible reading of a device; its inverse is the smallest one other than 0."""
OPPOSITE = -0.5
"""Correlation below which a channel seems to have the wrong sign."""


def codes(report: Report, channel: Checked, looked_at: Bools) -> Bools:
    """Flag codes for "no value" that are distinct from a channel's other readings.

    Returns the samples of `looked_at`, shape (n,), that remain.
    """
    left, numbers, command = looked_at.copy(), channel.numbers, channel.rule.role.endswith("command")
    hits = _hits(numbers, looked_at)
    others = numbers[np.logical_and.reduce([looked_at, *(~here for here in hits.values())])]
    if not hits or len(others) < 2:
        return left
    low, high = float(others.min()), float(others.max())
    span = max(high - low, 1e-9 * max(abs(low), abs(high)))
    outside = (3.0 if command else BEYOND) * span
    for code, here in hits.items():
        if code == 0.0:
            brief = here & ~_longer(here, BURST)
            where = brief & _leaps(numbers, brief, left, BEYOND * span)
        elif abs(code) > 100 and (code < low - outside or code > high + outside):
            where = here
        else:
            where = here & _leaps(numbers, here, left, BEYOND * span)
        if where is here or not command:
            text = (
                f"reads exactly {code:.10g}, far from its other readings: a code for no value, or for beyond the range"
            )
            report.mark(where, Flag.DROPOUT, "doubt", "sentinel", text, channel.rule.role)
            left &= ~where
    return left


def bursts(report: Report, channel: Checked, looked_at: Bools) -> Bools:
    """Flag short stretches far from the signal, except in commands; returns the samples of `looked_at` that remain."""
    role, quantity = channel.rule.role, channel.rule.quantity
    if role.endswith("command"):
        return looked_at
    far = _far(channel.si, looked_at)
    left = looked_at & ~far
    if far.any():
        low, high = (show(float(end), quantity, 4) for end in (channel.si[left].min(), channel.si[left].max()))
        text = f"leaps out of all that it reads else, {low} to {high}, for at most {HELD} samples at a time"
        report.mark(far, Flag.SUSPECT, "doubt", "burst", text, role)
    held = _held(report.t, channel.si, left)
    text = "leaps to one value, stays exactly there for some samples and leaps back: no reading, but a value held"
    report.mark(held, Flag.SUSPECT, "doubt", "held", text, role)
    return left & ~held


def _hits(numbers: Array, looked_at: Bools) -> dict[float, Bools]:
    """Mask of the samples equal to each code, to seven digits, because other programs may have rounded it."""
    every = np.array(sorted({sign * code for code in CODES for sign in (1.0, -1.0)} - {1.0}))
    place = np.minimum(np.searchsorted(every, numbers - 1e-7 * np.abs(numbers)), len(every) - 1)
    rows = np.flatnonzero(looked_at & (np.abs(numbers - every[place]) <= 1e-7 * np.abs(every[place])))
    hit = np.full(len(numbers), np.nan)
    hit[rows] = every[place[rows]]
    return {code: hit == code for code in np.unique(hit[rows]).tolist()}


def _longer(where: Bools, most: int) -> Bools:
    """Mask of the runs of True that are longer than `most` samples."""
    begins, ends = np.array(runs(where), dtype=int).reshape(-1, 2).T
    longer = ends - begins > most
    steps = np.zeros(len(where) + 1, dtype=np.int8)
    steps[begins[longer]], steps[ends[longer]] = 1, -1
    return np.asarray(np.cumsum(steps[:-1]) > 0)


def _leaps(numbers: Array, here: Bools, looked_at: Bools, least: float) -> Bools:
    """Mask of runs of `here` that are entered and left by a jump above `least` and return to the same level."""
    out = np.zeros(len(here), dtype=bool)
    rows = np.flatnonzero(looked_at & ~here)
    for begin, end in runs(here):
        if begin and abs(numbers[begin] - numbers[begin - 1]) <= least:
            continue
        at = int(np.searchsorted(rows, begin))
        before, after = numbers[rows[max(0, at - NEARBY) : at]], numbers[rows[at : at + NEARBY]]
        enough = len(before) >= 3 and len(after) >= 3
        out[begin:end] = enough and _comes_back(before, (numbers[begin], numbers[end - 1]), after, least, 1.0)
    return out


def _comes_back(before: Array, ends: tuple[float, float], after: Array, least: float, slack: float) -> bool:
    """Whether a stretch with these `ends` is entered and left by a jump above `least`, between about the same level.

    `slack`: allowed difference of the level, in the largest changes nearby.
    """
    usual = max(float(np.abs(np.diff(side)).max()) for side in (before, after))
    size = min(abs(ends[0] - before[-1]), abs(ends[1] - after[0]))
    returns = abs(after[0] - before[-1]) <= AS_LARGE * size + slack * usual
    return bool(size > max(LEAP * usual, least) and returns)


def _far(si: Array, looked_at: Bools) -> Bools:
    """Mask of short runs of readings farther from all others than the span of these, if the others move."""
    out = np.zeros(len(si), dtype=bool)
    rows = np.flatnonzero(looked_at)
    if len(rows) < FEW:
        return out
    values = si[rows]
    most = max(1, int(MANY * len(rows)))
    low, high = (float(end) for end in np.quantile(some_of(values), [MANY, 1.0 - MANY]))
    for sign, beyond in ((1.0, low - values.min()), (-1.0, values.max() - high)):
        if beyond <= high - low:
            continue  # not far beyond the inner readings, so not beyond all others
        tail = np.sort(np.partition(sign * values, most)[: most + 1])
        gaps = np.diff(tail)
        widest = int(np.argmax(gaps))
        rest = sign * values >= tail[widest + 1]
        kept = values[rest & ~out[rows]]
        span = float(np.ptp(kept)) if len(kept) else 0.0
        ordinary = float(np.quantile(np.abs(np.diff(kept)), 0.9)) if len(kept) > 2 else 0.0
        if span <= 0 or span < MOVES * ordinary or gaps[widest] <= span:
            continue
        far = ~rest
        for begin, end in runs(far):
            if end - begin > (HELD if np.all(values[begin:end] == values[begin]) else BURST):
                far[begin:end] = False
        out[rows[far]] = True
    return out


def _held(t: Array, si: Array, looked_at: Bools) -> Bools:
    """Mask of two or more equal readings in a row that are entered and left by a jump, from about the same level."""
    out = np.zeros(len(si), dtype=bool)
    rows = np.flatnonzero(looked_at)
    if len(rows) < FEW:
        return out
    values = si[rows]
    least = max(BEYOND * float(np.ptp(np.quantile(some_of(values), ENDS))), SPIKE * resolution(values))
    steps = np.abs(np.diff(values))
    if np.count_nonzero(steps > least) < 2:
        return out
    changes = np.flatnonzero(steps > 0) + 1
    begins, ends = changes[:-1], changes[1:]
    leap = np.minimum(steps[begins - 1], steps[np.minimum(ends, len(values) - 1) - 1])
    lengths = ends - begins
    brief = t[rows[np.minimum(ends, len(rows) - 1)]] - t[rows[begins]] <= BRIEF
    likely = brief & (lengths >= 2) & (lengths <= HELD) & (leap > least)
    for begin, end in zip(begins[likely].tolist(), ends[likely].tolist(), strict=True):
        before, after = values[max(0, begin - NEARBY) : begin], values[end : end + NEARBY]
        enough = len(before) >= BURST and len(after) >= BURST
        out[rows[begin:end]] = enough and _comes_back(before, (values[begin],) * 2, after, 0.0, 0.0)
    return out


def spikes(report: Report, channel: Checked, looked_at: Bools) -> None:
    """Flag up to three samples in a row that differ from their neighbours much more than any others."""
    rule = channel.rule
    si = channel.si[looked_at]
    if len(si) < FEW:
        return
    apart = beyond_neighbours(si, swings=not rule.role.endswith("command"))
    limit = rule.spike if rule.spike is not None else spike_limit(si, apart)
    text = f"lies beyond all its neighbours by more than {show(limit, rule.quantity, 3)}, alone"
    report.mark(np.flatnonzero(looked_at)[apart > limit], Flag.SUSPECT, "doubt", "spike", text, rule.role)


def inspect(
    t: Array, channels: Sequence[Checked], rate: tuple[float, float], gap: float, leap: float
) -> tuple[Flags, list[Found]]:
    """Flags, shape (n,), and findings for samples at `t` [s] in the order of the file, not sorted.

    `rate` [Hz]: expected least and largest rate. `gap`, `leap` [s]: longer intervals are a gap, or an error of the
    clock. A flag applies to the whole row, because fits use rows.
    """
    report = Report(t, np.zeros(len(t), dtype=np.uint16))
    with np.errstate(over="ignore", invalid="ignore"):  # damaged files hold infinite numbers
        _time(report, rate, gap, leap)
        _twice(report, channels)
        for channel in channels:
            _channel(report, channel)
    return report.flags, report.found


def _time(report: Report, rate: tuple[float, float], gap: float, leap: float) -> None:
    t = report.t
    steps = np.diff(t, prepend=t[0])
    forward = steps[1:][steps[1:] > 0]
    if len(forward) == 0:
        report.mark(np.ones(len(t), bool), Flag.TIME_JUMP, "fault", "time-jump", "the time never advances")
        return
    seen = 1.0 / float(np.median(forward))
    if not rate[0] <= seen <= rate[1]:
        text = f"the median rate is {seen:.4g} Hz, expected {rate[0]:g} to {rate[1]:g} Hz: is the unit of time right?"
        report.add("doubt", "rate", text)
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


def _twice(report: Report, channels: Sequence[Checked]) -> None:
    """Flag rows that repeat the one before, including the time."""
    same = np.logical_and.reduce([np.diff(values) == 0 for values in (report.t, *(each.raw for each in channels))])
    if channels:
        report.mark(np.flatnonzero(same) + 1, Flag.SUSPECT, "note", "twice", "the row before is repeated")


def _channel(report: Report, channel: Checked) -> None:
    rule, raw, name = channel.rule, channel.raw, channel.rule.role
    nothing = ~np.isfinite(raw) | ~np.isfinite(channel.si)
    text = "no value in the file"
    if often := float(np.mean(nothing)) > OFTEN:
        text += ": such rows are left out whole, of all channels; hold its last value if it was only read less often"
    report.mark(nothing, Flag.DROPOUT, "doubt" if often else "note", "missing", text, name)
    absurd = ((np.abs(raw) > LARGEST) | ((np.abs(raw) < 1.0 / LARGEST) & (raw != 0))) & ~nothing
    text = f"reads below {1 / LARGEST:.0e} or above {LARGEST:.0e}, as no device does: the file is damaged here"
    report.mark(absurd, Flag.SUSPECT, "fault", "absurd", text, name)
    out = nothing | absurd
    if rule.dropout is not None:
        cut = np.abs(raw - rule.dropout) <= 1e-6 * max(1.0, abs(rule.dropout))
        text = f"reads {rule.dropout:g} {rule.raw_unit}, as a cut wire does"
        report.mark(cut, Flag.DROPOUT, "doubt", "dropout", text, name)
        out = out | cut
    looked_at = codes(report, channel, ~out)
    if rule.whole:
        _whole(report, channel, looked_at)
    low, high = rule.low, rule.high
    beyond = (channel.si < low) | (channel.si > high) | (rule.whole & ((channel.si == low) | (channel.si == high)))
    beyond &= looked_at
    bounds = f"{show(low, rule.quantity, 4)} to {show(high, rule.quantity, 4)}"
    level = "doubt" if float(np.mean(beyond)) > OFTEN else "note"
    report.mark(beyond, Flag.OVERRANGE, level, "out-of-range", f"is at or beyond its range, {bounds}", name)
    if rule.stale_after is not None:
        _stale(report, channel, rule.stale_after)
    spikes(report, channel, bursts(report, channel, looked_at & ~beyond))


def whole_counts(raw: Array) -> Bools:
    """Mask of readings that are whole numbers, within `NOT_WHOLE`."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(raw - np.round(raw)) <= NOT_WHOLE)


def _whole(report: Report, channel: Checked, looked_at: Bools) -> None:
    """Flag readings that cannot be counts; many of them show that the scale of the map is wrong."""
    odd = looked_at & ~whole_counts(channel.raw)
    share = float(odd.sum()) / max(1, int(looked_at.sum()))
    name = channel.rule.role
    if share > WHOLE_SHARE:
        text = f"{share:.0%} of the readings are no whole counts: this file was not recorded with the scale that the "
        text += "map says, or was rewritten; nothing of it enters a fit"
        report.mark(looked_at, Flag.SUSPECT, "fault", "not-whole", text, name)
    else:
        report.mark(odd, Flag.SUSPECT, "doubt", "not-whole", "the reading is no whole count", name)


def _stale(report: Report, channel: Checked, longest: float) -> None:
    t, raw = report.t, channel.raw
    fresh = np.concatenate([[True], raw[1:] != raw[:-1]])
    changed = np.flatnonzero(fresh)
    age = t - t[changed[np.cumsum(fresh) - 1]]
    text = f"has not changed for more than {longest:g} s"
    report.mark(age > longest, Flag.STALE, "doubt", "stale", text, channel.rule.role)


def against_sign(flags: Flags, values: Mapping[str, Array], channel: str) -> Found | None:
    """A doubt if `channel` falls while pressure rises, both of shape (n,), SI; else None."""
    good = (flags & np.uint16(Flag.DROPOUT | Flag.OVERRANGE | Flag.TIME_JUMP | Flag.SUSPECT)) == 0
    together = correlation(values["pressure"][good], values[channel][good])
    if good.sum() < 10 or together > OPPOSITE:
        return None
    text = f"{channel}: falls while pressure rises (correlation {together:.2f}): its sign, or the column, may be wrong"
    return Found("doubt", "sign", text, channel)
