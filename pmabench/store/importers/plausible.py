"""Checks whether the channels of a file agree with each other and with its map; functions of arrays.

A channel with constant scatter that suddenly repeats one value exactly is frozen. A channel that rests on whole counts
is frozen only where it should have moved, judged by its values elsewhere at the same pressures.

The force of a held muscle follows its pressure within some hundredths of a second. Friction looks like a lag on ramps,
but not where the pressure stops or reverses: there a delayed force continues to change for the time of the delay. A
muscle that moves before its pressure shows that the time stamps of the pressure are late.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pmabench.base.quantities import show
from pmabench.store.importers import magnitude, midfile, motion, scales
from pmabench.store.importers.found import Bools, Checked, Found, Report, Rows, in_words, slope
from pmabench.store.importers.magnitude import Muscle
from pmabench.store.importers.map_file import Question
from pmabench.store.records import UNUSABLE, Array, Flag, Flags

SCATTERS = 0.3
"""A channel counts as always scattering if less than this share of samples repeats the one before."""
SAMPLES, LONGER = 25, 10.0
"""Such a channel is frozen if it repeats one value for this many samples, and this many times longer than usual."""
SECONDS = 0.1
"""Shortest time of a frozen channel [s]."""
SLOW = 0.5
"""The same for a channel that rests on counts [s]: friction may hold it still."""
SHOULD = 0.25
"""Least motion expected of a channel that rests on counts before it counts as frozen, as a share of its span."""
LEAP = 0.05
"""The same if it then jumps to its expected value."""
BINS = 40
"""Number of pressure classes for the usual reading."""
LOOKED_AT = 200
"""Number of longest stretches that are examined."""
CLIPPED = 10
"""Least number of samples at a channel's highest reading for it to be clipped."""
PILED = 0.04
"""Least expected motion beyond the end, as a share of the channel's span."""


def usual(pressure: Array, other: Array) -> tuple[Array, Array]:
    """Usual reading over pressure: medians of pressure and of the channel in each class, shape (k,), k <= 40."""
    low, high = float(pressure.min()), float(pressure.max())
    place = np.minimum((BINS * (pressure - low) / ((high - low) or 1.0)).astype(np.intp), BINS - 1)
    begins = np.flatnonzero(np.diff(np.sort(place), prepend=-1))
    ends = np.append(begins[1:], len(place))
    ordered = (values[np.lexsort((values, place))] for values in (pressure, other))
    at, reads = (0.5 * (values[(begins + ends - 1) // 2] + values[(begins + ends) // 2]) for values in ordered)
    return at, reads


def frozen(report: Report, channel: Checked, other: Checked, rows: Rows, follows: bool) -> None:
    """Flag the samples among `rows`, shape (m,), where a channel repeats its reading while `other` moves.

    `follows`: one of the two follows the other without delay, so that the expected reading is known.
    """
    t, raw, si, ref = report.t[rows], channel.raw[rows], channel.si[rows], other.si[rows]
    changes = np.flatnonzero(np.diff(raw) != 0) + 1
    begins, ends = np.concatenate([[0], changes]), np.concatenate([changes, [len(raw)]])
    lengths = ends - begins
    if len(changes) < 10:
        return
    seconds = t[ends - 1] - t[begins]
    scatters = 1.0 - len(changes) / len(raw) < SCATTERS
    longest = max(SAMPLES, LONGER * float(np.quantile(lengths, 0.99)))
    pause = 5.0 * float(np.median(np.diff(t[changes])))
    likely = np.flatnonzero((seconds > max(SECONDS, pause)) & (lengths >= CLIPPED))
    likely = likely[np.argsort(-lengths[likely], kind="stable")][:LOOKED_AT]
    low, high = float(si.min()), float(si.max())
    where = np.zeros(len(rows), dtype=bool)
    moved = 0.0
    for run in likely.tolist():
        begin, end = int(begins[run]), int(ends[run])
        sure = scatters and lengths[run] >= longest and si[begin] not in (low, high, 0.0)
        if sure or (follows and seconds[run] > SLOW and _should_move(si, ref, begin, end)):
            where[begin:end] = True
            moved = max(moved, float(np.ptp(ref[begin:end])))
    if where.any():
        longest_time = float(seconds[likely].max())
        by = show(moved, other.rule.quantity, 3)
        text = f"repeats one reading exactly for up to {longest_time:.3g} s while {other.rule.role} moves by {by}"
        report.mark(rows[where], Flag.STALE, "doubt", "frozen", f"{text}: it was frozen", channel.rule.role)


def _should_move(si: Array, ref: Array, begin: int, end: int) -> bool:
    """Whether a channel should have moved from `begin` to `end`, judged by its readings elsewhere at equal `ref`."""
    rest = np.ones(len(si), dtype=bool)
    rest[begin:end] = False
    if rest.sum() < 2 * BINS or np.ptp(ref[begin:end]) <= 0.02 * np.ptp(ref):
        return False
    at, reads = usual(ref[rest], si[rest])
    expected = np.interp(ref[begin:end], at, reads)
    span = float(np.ptp(np.quantile(si, [0.002, 0.998])))
    should = float(np.ptp(np.quantile(expected, [0.025, 0.975])))
    if should > SHOULD * span:
        return True
    after, before = si[end : end + 3], si[max(0, begin - 3) : begin]
    if len(after) == 0 or should <= LEAP * span:
        return False
    leap = float(abs(np.median(after) - si[begin]))
    steps = np.abs(np.diff(si[rest]))
    nearby = max(float(np.quantile(steps, 0.995)), float(abs(si[begin] - before[-1])) if len(before) else 0.0)
    return leap > max(0.5 * should, LEAP * span, 3.0 * nearby)


def clipped(report: Report, channel: Checked, other: Checked, rows: Rows) -> None:
    """Flag the samples among `rows` that stay at a channel's highest reading while `other` moves on."""
    raw, si, ref = channel.raw[rows], channel.si[rows], other.si[rows]
    top = float(si.max())
    at_top = si == top
    below = ~at_top
    if at_top.sum() < CLIPPED or below.sum() < 4 * SAMPLES or len(np.unique(raw[:10_000])) < 5:
        return
    run = max(end - begin for begin, end in motion.runs(at_top))
    span, moves = float(top - np.quantile(si, 0.002)), float(np.ptp(np.quantile(ref[at_top], [0.02, 0.98])))
    if run < CLIPPED or span <= 0 or moves <= 0.05 * float(np.ptp(ref)):
        return
    near = below & (si > top - 0.15 * span)
    if near.sum() < SAMPLES:
        near = below & (si > top - 0.4 * span)
    if near.sum() < SAMPLES or np.ptp(ref[near]) == 0:
        return
    onward = (slope(ref[near], si[near]) or 0.0) * moves
    if onward <= max(PILED * span, 3.0 * float(np.diff(np.unique(si)[-3:]).max())):
        return
    end, by = show(top, channel.rule.quantity, 4), show(moves, other.rule.quantity, 3)
    text = f"stays at its highest reading, {end}, while {other.rule.role} moves by {by}: it is clipped, or at a stop"
    report.mark(rows[at_top], Flag.OVERRANGE, "doubt", "clipped", text, channel.rule.role)


LEAST = 0.15
"""Smallest lag that is reported [s]; tubes, filters and slow load cells cause smaller ones."""
MOST = 5.0
"""Largest lag that is searched [s], and at most an eighth of the file."""
PERIOD = 0.02
"""Samples closer than this are averaged [s] ..."""
POINTS = 20_000
"""... and at most this many points are compared."""
SMOOTH = (5, 15, 50)
"""Numbers of points for rates of change; the smallest for which force and pressure correlate is used."""
BETTER = 0.02
"""Least gain in correlation at the lag, compared with zero lag."""
ALIKE = 0.5
"""Least correlation of the rates at the lag."""
GOES_ON = 0.4
"""Least change of the delayed channel after a stop of the other, relative to its change over an equal time before."""
STOPS = 0.3
"""At a stop or reversal the rate of the leading channel falls below this share of its former value."""
MATTERS = 0.01
"""Relative change of the slope [1] above which results are withheld."""


def late(report: Report, force: Checked, pressure: Checked, good: Bools) -> bool:
    """Report a lag or lead of force against pressure above `LEAST`; returns whether there is. `good`: shape (n,)."""
    rows = np.flatnonzero(good & motion.later(report.t))
    seconds, period, (F, P) = _behind(report.t[rows], (force.si[rows], pressure.si[rows]), PERIOD)
    if abs(seconds) < max(LEAST, 3.0 * period):
        return False
    shift = max(2, round(0.5 * abs(seconds) / period))  # half of the lag: another reversal may follow
    if _goes_on(*((P, F) if seconds > 0 else (F, P)), shift) < GOES_ON:
        return False
    moved = np.interp(report.t[rows] + seconds, report.t[rows], force.si[rows])
    as_is, shifted = (magnitude.slope_of(pressure.si[rows], pulls) for pulls in (force.si[rows], moved))
    change = as_is / shifted - 1.0 if as_is is not None and shifted else 0.0
    way = "later" if seconds > 0 else "earlier"
    text = f"follows {show(abs(seconds), 'time', 3)} {way} than the pressure that makes it"
    if as_is is not None and shifted is not None:
        text += f"; slope over pressure {in_words(as_is, 'force')} so, {in_words(shifted, 'force')} without the lag"
    if abs(change) > MATTERS:
        text += "; which stamps are right no rule can say: mend the times of one column, and import it again"
        report.withhold("lag", text, "force")
    else:
        report.add("doubt", "lag", text, "force")
    return True


def _behind(
    t: Array, pair: tuple[Array, Array], finest: float, *, alone: bool = False
) -> tuple[float, float, tuple[Array, Array]]:
    """Time [s] by which the first channel of a `pair`, shape (n,), follows the other, 0 where that is not known; the
    period of the comparison [s], `finest` at least; and both channels at even times.
    """
    if len(t) < 200:
        return 0.0, 0.0, pair
    usual = float(np.median(np.diff(t)))
    period = max(usual, finest, float(t[-1] - t[0]) / POINTS)
    grid = np.arange(t[0], t[-1], period)
    one, other = (np.interp(grid, t, motion.averaged(y, max(1, round(period / usual)))) for y in pair)
    most = int(min(MOST / period, len(grid) / 8))
    known = most >= 3 and np.ptp(one) > 0 and np.ptp(other) > 0
    return _lag(one, other, most, alone=alone) * period if known else 0.0, period, (one, other)


LED = 0.03
"""Least lead [s] of pressure over its command that is reported, if also three samples: commands are polled, too."""


def led(report: Report, pressure: Checked, command: Checked, good: Bools) -> None:
    """Report a measured pressure that moves before its command; only `good` samples count, shape (n,)."""
    rows = np.flatnonzero(good & motion.later(report.t))
    seconds, period, _ = _behind(report.t[rows], (command.si[rows], pressure.si[rows]), 0.0, alone=True)
    if seconds < max(LED, 3.0 * period):
        return
    text = f"moves {show(seconds, 'time', 3)} before its command: the columns of command and measured pressure look "
    report.add("doubt", "led", f"{text}exchanged, or the command is recorded late", "pressure")


def _lag(F: Array, P: Array, most: int, *, alone: bool = False) -> float:
    """Lag of `F` behind `P`, both of shape (n,), in points; 0 where a lag does not fit better.

    `alone`: also 0 where a lead fits as well, as for a sine.
    """
    shifts = np.arange(-most, most + 1)
    for smooth in SMOOTH:
        a, b = F[smooth:] - F[:-smooth], P[smooth:] - P[:-smooth]
        a, b = a - a.mean(), b - b.mean()
        size = 1 << (2 * len(a)).bit_length()
        together = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        alike = together[shifts] / (float(np.sqrt((a @ a) * (b @ b))) or 1.0)
        best = int(np.argmax(alike))
        if alike[best] >= ALIKE:
            others = alike[: most + 1] if alone else alike[most]
            return float(shifts[best]) if alike[best] >= np.max(others) + BETTER else 0.0
    return 0.0


def _goes_on(first: Array, second: Array, shift: int) -> float:
    """Change of `second` in `shift` points after stops or reversals of `first`, relative to that before; else 0."""
    moved, rest = first[shift:] - first[:-shift], np.zeros(shift)
    before, after = np.concatenate([rest, moved]), np.concatenate([moved, rest])
    large = np.abs(before) > 0.3 * float(np.max(np.abs(before)))
    stops = large & (np.sign(before) * after < STOPS * np.abs(before))
    stops[-shift:] = False
    shares = []
    for begin, end in motion.runs(stops):
        full = np.abs(before[begin:end])
        at = begin + int(np.flatnonzero(full >= 0.95 * full.max())[-1])  # the stop: the full rate ends here
        if at < shift or at + shift >= len(second):
            continue
        past = second[at] - second[at - shift]
        if past * before[at] > 0 and abs(past) >= 0.02 * np.ptp(second):
            shares.append(float((second[at + shift] - second[at]) / past))
    return float(np.median(shares)) if shares else 0.0


SHARE = 0.1
"""Smallest step of the pressure, as a share of its span."""
FAST = 0.5
"""Longest duration of a step [s]; at the turning points of slow waves nothing is reported."""
BEFORE, AFTER = 0.5, 0.5
"""Time before and after a step that is examined [s]."""
REST = 0.15
"""Time before the step that does not count as rest, because the motion may have begun [s]."""
GONE, NOISE = 0.05, 5.0
"""A channel moves once it left its rest by this share of its travel and this many standard deviations."""
FEWEST = 5


def pressure_late(t: Array, values: Mapping[str, Array], flags: Flags) -> Found | None:
    """A doubt if at any step displacement moves at least one sample before the measured pressure; else None.

    `t` [s], `values` [SI] by channel and `flags` have shape (n,). Polled channels lag their time stamps by different
    times; a delay between them then is too short, or negative.
    """
    good = (flags & np.uint16(Flag.DROPOUT | Flag.TIME_JUMP | Flag.SUSPECT | Flag.OVERRANGE)) == 0
    good &= motion.later(t)
    pressure = values["pressure"][good]
    if good.sum() < 50 or "displacement" not in values:
        return None
    low, high = (float(end) for end in np.quantile(pressure, [0.005, 0.995]))
    rows, times = np.flatnonzero(good), t[good]
    leads = []
    for step in motion.levels(times, pressure, SHARE * (high - low)) if high > low else []:
        first = _moves(times, values["displacement"][good], step.t) if step.settled - step.t <= FAST else None
        if first is not None and (lead := step.t - float(times[first])) >= step.within:
            leads.append((lead, int(rows[first])))
    if not leads:
        return None
    lead, row = max(leads, key=lambda found: found[0])
    text = f"pressure: displacement moves {lead * 1e3:.3g} ms before it at {float(t[row]):.3f} s: pressure is late, as "
    text += 'where channels are polled one after the other; say "late_by"'
    return Found("doubt", "late", text, "pressure", 1, row, float(t[row]))


def _moves(t: Array, values: Array, step: float) -> int | None:
    """First sample at which a channel has left its rest at a step (time [s]); None where it does not move."""
    rest = (t > step - BEFORE) & (t < step - REST)
    then = (t > step + AFTER) & (t < step + 2 * AFTER)
    if rest.sum() < FEWEST or then.sum() < FEWEST:
        return None
    level, scatter = float(np.median(values[rest])), float(np.std(values[rest]))
    way = float(np.median(values[then])) - level
    if abs(way) < 2 * NOISE * scatter or way == 0:
        return None
    gone = (values - level) * np.sign(way) > max(GONE * abs(way), NOISE * scatter)
    near = np.flatnonzero(gone & (t >= step - REST) & (t < step + AFTER))
    return int(near[0]) if len(near) else None


CONDEMNED = 0.5
"""Share of unusable samples above which a file is not examined further: its faults are known."""


@np.errstate(all="ignore")  # damaged files hold numbers of any size
def stopped(t: Array, channels: Sequence[Checked], flags: Flags, held: bool) -> tuple[Flags, list[Found]]:
    """Flags, shape (n,), with frozen and clipped samples added, and findings; for all or a part of a file, `t` [s].

    `held`: the length of the muscle is constant, so that force follows pressure.
    """
    report = Report(t, flags.copy())
    pair = _pair(channels, held)
    good = _good(flags, channels)
    rows = np.flatnonzero(good)
    if pair is not None and good.mean() > 1.0 - CONDEMNED and len(rows) >= 4 * SAMPLES:
        for one, other in (pair, pair[::-1]):
            frozen(report, one, other, rows, follows=held)
            if held:
                clipped(report, one, other, rows)
    return report.flags, report.found


def judge(
    t: Array, channels: Sequence[Checked], flags: Flags, muscle: Muscle, confirmed: Collection[str] = (),
    set_length: Checked | None = None,
) -> tuple[list[Found], list[Question]]:  # fmt: skip
    """Findings and open questions for a whole file, samples at `t` [s], shape (n,); no samples are flagged.

    `confirmed`: kinds of findings that were checked and confirmed: they become notes, and withhold nothing.
    `set_length`: the column of contractions that were set.
    """
    report = Report(t, flags)
    _judge(report, channels, muscle, set_length)
    return answered(report.found, confirmed), [each for each in report.questions if each.what not in confirmed]


@np.errstate(all="ignore")  # damaged files hold numbers of any size
def _judge(report: Report, channels: Sequence[Checked], muscle: Muscle, set_length: Checked | None) -> None:
    roles = {channel.rule.role: channel for channel in channels}
    good = _good(report.flags, channels)
    if good.mean() <= 1.0 - CONDEMNED or "pressure" not in roles:
        return
    scales.compare(report, roles if set_length is None else {**roles, "set length": set_length}, good)
    pair = _pair(channels, muscle.held)
    if "pressure_command" in roles:
        led(report, roles["pressure"], roles["pressure_command"], good)
    if not midfile.swapped(report, channels, good) and pair is not None:
        changed = midfile.jumped(report, *pair, good, follows=muscle.held)
        if muscle.held and not changed and not midfile.regained(report, *pair, good):
            late(report, *pair, good)
    magnitude.judge(report, roles, good, muscle, set_length)


def _pair(channels: Sequence[Checked], held: bool) -> tuple[Checked, Checked] | None:
    """The channel that follows pressure (force of a held muscle, else displacement), and pressure; None if missing."""
    roles = {channel.rule.role: channel for channel in channels}
    follower = roles.get("force" if held else "displacement")
    return (follower, roles["pressure"]) if follower is not None and "pressure" in roles else None


def _good(flags: Flags, channels: Sequence[Checked]) -> Bools:
    """Mask of usable samples with finite values in every channel."""
    finite = [np.isfinite(channel.si) for channel in channels]
    return np.asarray(np.logical_and.reduce([(flags & np.uint16(UNUSABLE)) == 0, *finite]))


def answered(found: Sequence[Found], confirmed: Collection[str]) -> list[Found]:
    """The findings, with those of confirmed kinds changed to notes."""

    def noted(one: Found) -> Found:
        return replace(one, level="note", withholds=False, text=f"{one.text} (confirmed in the map)")

    return [noted(each) if each.kind in confirmed else each for each in found]
