"""What is wrong with samples: dropouts, gaps, time jumps, stale and impossible values; flags and reports it.

Pure functions of arrays; must not know files or runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers import outliers
from pmabench.store.importers.effect import add_effects
from pmabench.store.importers.found import Bools, Checked, Found, Report
from pmabench.store.records import Array, Flag, Flags

NOT_WHOLE = 0.05
"""Counts further than this from a whole number were never counts."""
WHOLE_SHARE = 0.01
"""Share of such readings above which the file was not recorded with the scale that the map says."""
SLOW = 4.0
"""A channel that changes only every so many samples is reported."""
OFTEN = 0.1
"""Share of samples out of range above which the scale or the column itself is doubtful."""
LARGEST = 1e30
"""No device gives a reading beyond this, or one that is smaller than its inverse and not 0."""
OPPOSITE = -0.5
"""Correlation below which a channel seems to have the wrong sign."""


def inspect(
    t: Array, channels: Sequence[Checked], rate: tuple[float, float], gap: float, leap: float
) -> tuple[Flags, list[Found]]:
    """Flags of shape (n,) and findings for samples at `t` [s] as the file has them, not sorted.

    `rate` [Hz] is what is expected, `gap` and `leap` [s] are distances of neighbours that are a gap, or an error of
    the clock. One flag is for the whole row, for rows are what fits use.
    """
    report = Report(t, np.zeros(len(t), dtype=np.uint16))
    with np.errstate(over="ignore", invalid="ignore"):  # damaged files hold infinite numbers
        _time(report, rate, gap, leap)
        _twice(report, channels)
        for channel in channels:
            _channel(report, channel)
        add_effects(report, channels)
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
        report.found.append(Found("note", "same-time", text, "", int(same.sum()), first, float(t[first])))


def _twice(report: Report, channels: Sequence[Checked]) -> None:
    """Rows that repeat the one before, time and all."""
    same = np.concatenate([[False], np.diff(report.t) == 0])
    for channel in channels:
        same &= np.concatenate([[False], np.diff(channel.raw) == 0])
    if channels:
        report.mark(same, Flag.SUSPECT, "note", "twice", "the row before is repeated")


def _channel(report: Report, channel: Checked) -> None:
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
    looked_at = outliers.codes(report, channel, ~out)
    if rule.whole:
        _whole(report, channel, looked_at)
    low, high = rule.low, rule.high
    with np.errstate(invalid="ignore"):
        if rule.whole:
            beyond = ((channel.si <= low) | (channel.si >= high)) & looked_at
        else:
            beyond = ((channel.si < low) | (channel.si > high)) & looked_at
    bounds = f"{show(low, rule.quantity, 4)} to {show(high, rule.quantity, 4)}"
    level = "doubt" if float(np.mean(beyond)) > OFTEN else "note"
    report.mark(beyond, Flag.OVERRANGE, level, "out-of-range", f"is at or beyond its range, {bounds}", name)
    if rule.stale_after is not None:
        _stale(report, channel, rule.stale_after)
    outliers.spikes(report, channel, outliers.bursts(report, channel, looked_at & ~beyond))


def _equals(raw: Array, value: float) -> Bools:
    return np.asarray(np.abs(raw - value) <= 1e-6 * max(1.0, abs(value)))


def whole_counts(raw: Array) -> Bools:
    """Which readings are whole numbers."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(raw - np.round(raw)) <= NOT_WHOLE)


def _whole(report: Report, channel: Checked, looked_at: Bools) -> None:
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


def _stale(report: Report, channel: Checked, longest: float) -> None:
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
