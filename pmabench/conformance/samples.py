"""Checks of samples on a good connection: their form, their times, and their values against the emulated plant."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import fmean, median
from time import monotonic
from typing import Any

from pmabench.base.quantities import show
from pmabench.bench.interface import COMPUTER, Block, ChannelRecord
from pmabench.conformance.rig import COLLECTS_WITHIN, Failed, Late, NotChecked, Rig, State
from pmabench.guard.limits import to_device

RATE = 50.0
"""Sampling rate [Hz]."""
FIRST = 3.0
"""Longest wait for the first samples [s]."""
WATCHED = 1.0
"""Duration of the check of sample times [s]."""
PAUSE = 0.6
"""A pause in collecting [s]."""
AT_ONCE = 20
"""Number of successive `collect` calls, which must take far less time than as many samples."""
SHARE = 0.001
"""Tolerance of values, as a fraction of the channel's range: converters, digits, rounded calibrations."""
STATES = (
    State(0.0, 0.0, 5.0),
    State(487.3e3, 0.0371, 211.0),
    State(487.3e3, 0.0371, 611.0),
    State(123.7e3, 0.0083, 27.0),
    State(0.0, 0.0, 5.0, supply=False),
)
SETTLES = 0.5
"""Time after which a channel follows within `WINDOW`, or rests [s]."""
WINDOW = 0.06
"""Range of time shifts searched between samples and plant [s]."""
SLOWEST = 0.018
"""Slowest speed of a drive [m/s]."""
DISTINCT = 20
"""A channel counts as checked if two states differ by this number of tolerances."""
SWEEP = 1.2
"""Duration of the motion while samples are compared one by one [s]; the emulator's plant keeps 2 s."""
GRID = 0.002
LAG = 0.75
"""Largest delay or advance of samples against the plant, as a fraction of their period."""
LOST = 0.5
"""Share of the borders between blocks at which a sample may be lost or repeated: a busy computer does it anywhere."""
RAGGED = 0.35
"""Largest mean deviation during the motion, as a fraction of the plant's change per sample period."""


@dataclass
class Recording:
    """Consecutive samples in raw units, and the bench time at which each block came [s]."""

    channels: Sequence[ChannelRecord]
    stamped: bool = False
    """Whether sample times are already bench time."""
    times: list[int] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=dict)
    borders: list[int] = field(default_factory=list)
    """Index of the first sample of each non-empty block."""
    collected: list[float] = field(default_factory=list)
    """When each of these blocks was collected [s, bench time]."""
    arrived: list[float] = field(default_factory=list)
    """When the newest sample of each of them arrived [s]; time of collecting if the driver does not report it."""
    kept: list[tuple[Block, tuple[list[int], dict[str, list[float]]]]] = field(default_factory=list)
    """The blocks, and copies of their contents at that time."""

    def take(self, block: Any, now: float) -> None:
        """Add a block that came at `now` [s]; raises Failed if pmabench could not record it."""
        self.values = self.values or {channel.name: [] for channel in self.channels}
        first = len(self.times)
        take(self.channels, block, self.times, self.values)
        if len(block.time):
            self.borders.append(first)
            before = self.collected[-1] if self.collected else now - 10.0
            self.collected.append(now)
            self.arrived.append(now if block.host == -1 else block.host / 1e9)
            self.kept.append((block, _copy(block)))
            if not before - 0.3 < self.arrived[-1] <= now + 0.001:
                collected = f"collected at {now:.3f} s of bench time, the one before at {before:.3f} s"
                raise Failed(f"Block.host is {block.host} ns, and the block was {collected}")

    def si(self, channel: ChannelRecord) -> list[float]:
        """The values of a channel [SI]."""
        return [float(channel.scale.to_si(value)) for value in self.values[channel.name]]

    def moments(self) -> list[float]:
        """Bench time of each sample [s]: device time, shifted by the block with the shortest delay."""
        if self.stamped:
            return [time / 1e9 for time in self.times]
        newest = [*self.borders[1:], len(self.times)]
        ahead = min(at - self.times[end - 1] / 1e9 for at, end in zip(self.arrived, newest, strict=True))
        return [time / 1e9 + ahead for time in self.times]


def _copy(block: Block) -> tuple[list[int], dict[str, list[float]]]:
    return [int(t) for t in block.time], {name: [float(v) for v in column] for name, column in block.columns.items()}


def take(channels: Sequence[ChannelRecord], block: Any, times: list[int], values: Mapping[str, list[float]]) -> None:
    """Append a block to earlier ones; raises Failed if pmabench could not record it."""
    if not isinstance(block, Block):
        raise Failed(f"collect() gave {type(block).__name__}; a Block is expected")
    count = len(block.time)
    for channel in channels:
        column = block.columns.get(channel.name)
        if column is None or len(column) != count:
            raise Failed(f"collect() gave {count} times and not as many values of {channel.name}")
        values[channel.name].extend(number(channel, value) for value in column)
    new = [int(t) for t in block.time]
    for earlier, later in zip([*times[-1:], *new], [*times[-1:], *new][1:], strict=False):
        if later <= earlier:
            raise Failed(f"the time of a sample, {later} ns, is not after that of the one before, {earlier} ns")
    times += new


def number(channel: ChannelRecord, value: Any) -> float:
    """A raw value as a number; NaN is accepted, as it is marked as out of range above the driver."""
    try:
        found = float(value)
    except (TypeError, ValueError):
        raise Failed(f"{channel.name} gave {value!r}; a number is expected") from None
    if channel.raw_type == "int32" and not (math.isnan(found) or (abs(found) < 2**31 and found == math.floor(found))):
        raise Failed(f"{channel.name} gave {found!r}; a count of at most 32 bits is expected")
    return found


def record(rig: Rig, seconds: float, recording: Recording | None = None) -> Recording:
    """Collect ten times a second for `seconds` [s], feeding the watchdog."""
    recording = recording or Recording(rig.record.channels)
    for _ in range(max(1, round(10 * seconds))):
        rig.pass_time(0.1)
        collect(rig, recording)
    return recording


def collect(rig: Rig, recording: Recording) -> None:
    """Collect one more block."""
    block = rig.call("collect()", rig.device.collect).good(COLLECTS_WITHIN)
    recording.take(block, rig.bench_clock.now())


def begin(rig: Rig) -> float:
    """Start sampling and wait for first samples; returns the rate that the driver reports [Hz]."""
    rate = rig.call("start()", rig.device.start, RATE).good(COLLECTS_WITHIN)
    if isinstance(rate, bool) or not isinstance(rate, float | int) or not 0 < rate < math.inf:
        raise Failed(f"start({RATE:g}) gave {rate!r}; the rate that the device uses is expected [Hz]")
    until, first = monotonic() + FIRST, Recording(rig.record.channels)
    while not first.times and monotonic() < until:
        rig.pass_time(0.1)
        collect(rig, first)
    if not first.times:
        raise Failed(f"no sample came within {FIRST:g} s")
    return float(rate)


# -- form and times -------------------------------------------------------------------------------------------------


def samples(rig: Rig) -> str:
    """Samples come by themselves, at once, at the rate that `start` says, on a clock that only goes forward."""
    rig.open()
    rate = begin(rig)
    found = record(rig, WATCHED)
    rig.pass_time(PAUSE)  # a busy engine collects late, and must lose nothing
    collect(rig, found)
    _at_once(rig, found, rate)
    _paced(found, rate)
    if rig.identity.clock == COMPUTER:
        late = found.collected[-1] - found.times[-1] / 1e9
        if not -0.01 <= late <= 1.0:
            raise Failed(f"by Identity.clock it stamps with bench time, and its newest sample is {late:.3g} s old")
    for block, before in found.kept:
        if _copy(block) != before:
            raise Failed("a block that collect() gave was changed later; give each block new lists or arrays")
    _ends(rig, found)
    return f"{len(found.times)} samples of {len(found.values)} channels at {rate:g} Hz"


def _at_once(rig: Rig, found: Recording, rate: float) -> None:
    """Raise Late if `collect` waits for samples."""
    began, lag = monotonic(), 0.0
    for _ in range(AT_ONCE):
        outcome = rig.call("collect()", rig.device.collect)
        found.take(outcome.good(COLLECTS_WITHIN), rig.bench_clock.now())
        lag = max(lag, outcome.lag)
    if (took := monotonic() - began) > 0.5 * AT_ONCE / rate + 3 * lag:
        raise Late(f"{AT_ONCE} calls of collect() in a row took {took:.2f} s: it waits for samples, and must not")


def _paced(found: Recording, rate: float) -> None:
    """Check the times of the samples against the rate and the computer's clock."""
    seconds = [time / 1e9 for time in found.times]
    steps = [later - earlier for earlier, later in pairwise(seconds)]
    if len(steps) < 10:
        raise Late(f"start() said {rate:g} Hz, and only {len(seconds)} samples came within {WATCHED:g} s")
    usual, period = median(steps), 1.0 / rate
    ends = [*found.borders[1:], len(seconds)]
    passed, shown = found.collected[-1] - found.collected[0], seconds[ends[-1] - 1] - seconds[ends[0] - 1]
    if not abs(shown - passed) <= 0.05 * passed + 2.5 * period:
        real = f"by the computer's clock it was {passed:.3g} s"
        raise Late(f"its samples' times say that {shown:.3g} s passed, and {real}")
    if not 0.85 * period <= usual <= 1.15 * period:
        raise Late(f"start() said {rate:g} Hz, and samples are {1e3 * usual:.3g} ms apart, not {1e3 * period:.3g} ms")
    wrong = []  # both: a delay by a busy computer must not hide faults of the driver
    for word, weights in (
        ("missing", [max(0, round(step / period) - 1) if step > 1.6 * period else 0 for step in steps]),
        ("there twice", [int(step < 0.4 * period) for step in steps]),
    ):
        if sum(weights) > max(2, 0.07 * len(steps)):
            wrong.append(f"{sum(weights)} of {len(steps)} samples are {word}, by their times")
    between = [steps[border - 1] for border in found.borders if 0 < border <= len(steps)]
    if sum(step > 1.6 * period for step in between) > max(2, LOST * len(between)):
        wrong.append("samples are missing between most blocks")
    if wrong:
        raise Late(", and ".join(wrong))


def _ends(rig: Rig, found: Recording) -> None:
    """Check that `stop` may be repeated, and that no old samples come after another `start`."""
    rig.call("stop()", rig.device.stop).nothing(COLLECTS_WITHIN)
    rig.call("stop() again", rig.device.stop).nothing(COLLECTS_WITHIN)
    rig.pass_time(0.3)
    rig.call("start() again", rig.device.start, RATE).good(COLLECTS_WITHIN)
    again = Recording(rig.record.channels)
    record(rig, 0.4, again)
    if not again.times:
        raise Failed("no sample comes after stop() and another start()")
    most = 0.45 + 0.15 + 0.1
    if again.times[-1] - again.times[0] > most * 1e9:
        raise Late("after stop() and another start() the first block has samples from before")


# -- values -----------------------------------------------------------------------------------------------------------


def values(rig: Rig) -> str:
    """Every channel shows what the emulated plant has, in SI, in states far apart and while it moves."""
    with rig.opened():
        stamped = rig.identity.clock == COMPUTER
        rate = begin(rig)
        known = {channel.name for channel in rig.record.channels} & {*rig.plant.quantities()}
        states = [_in_state(rig, state, known) for state in STATES]
        measured = [c for c in rig.record.channels if c.name in known and not c.name.endswith("_command")]
        checked = [channel.name for channel in measured if _agrees(channel, states)]
        seen = [channel for channel in measured if channel.name in checked]
        moved = _moves(rig, seen, rate, stamped=stamped)
    agree = f"{', '.join(checked) or 'nothing'} as in the plant, in states far apart"
    agree += f"; {', '.join(moved)} also sample by sample on the move" if moved else ""
    outputs = {f"{output.name}_command" for output in rig.record.outputs}  # checked with the set-points
    why = [
        f"{c.name} ({_why(c.name, known)})"
        for c in rig.record.channels
        if c.name not in checked and c.name not in outputs
    ]
    for output in rig.record.outputs:
        pair = [c for c in rig.record.channels if c.name in {output.name, f"{output.name}_command"}]
        if output.quantity == "length" and len(pair) == 2 and pair[0].scale == pair[1].scale:
            why.append(f"whether {pair[0].name} and {pair[1].name} are swapped (this drive follows without any error)")
    if seen and not moved:
        why.append("whether each sample belongs to its time (nothing moved enough, or this computer is too busy)")
    if why:
        raise NotChecked(f"{agree}; not checked: {', '.join(why)}")
    return agree


def _why(name: str, known: set[str]) -> str:
    return "it is the same in every state of this plant" if name in known else "the emulated plant has no such quantity"


@dataclass(frozen=True)
class _Seen:
    """Values of channels and of the plant in a state [SI]."""

    shown: Mapping[str, float]
    had: Mapping[str, float]
    off: Mapping[str, float]
    """Median deviation beyond the plant's values."""


def _bring(rig: Rig, state: State) -> float:
    """Bring the plant to a state, an end with the device's own drive; returns the time that this may take [s]."""
    rig.bring(state)
    seconds = SETTLES
    for output in rig.record.outputs:
        if output.quantity == "length":
            way = abs(state.position - rig.plant.quantities()["displacement"])
            value = to_device(output, min(max(state.position, output.low), output.high))
            rig.call("write()", rig.device.write, output.output, value).good()
            seconds += way / SLOWEST
    return seconds


def _in_state(rig: Rig, state: State, known: set[str]) -> _Seen:
    rig.pass_time(_bring(rig, state))
    rig.call("collect()", rig.device.collect).good(COLLECTS_WITHIN)
    found = record(rig, 0.3)
    if not found.times:
        raise Late("samples no longer come while the pressure changes")
    grid = _grid(rig, found)
    shown, had, off = {}, {}, {}
    for channel in rig.record.channels:
        if channel.name in known:
            seen, real = found.si(channel), [quantities[channel.name] for _, quantities in grid]
            shown[channel.name], had[channel.name] = median(seen), median(real)
            off[channel.name] = median(max(0.0, min(real) - s, s - max(real)) for s in seen)
            if any(math.isnan(s) for s in seen):
                raise Failed(f"{channel.name} is NaN, and the plant has {show(had[channel.name], channel.quantity)}")
    return _Seen(shown, had, off)


def tolerance(channel: ChannelRecord) -> float:
    """Tolerance of a value against the plant [SI]."""
    return SHARE * (channel.high - channel.low) + (1.5 * abs(channel.scale.slope) if channel.raw_type == "int32" else 0)


def _agrees(channel: ChannelRecord, states: Sequence[_Seen]) -> bool:
    """Whether a channel was seen in states far apart; raises Failed if its value is not the plant's."""
    had = [state.had[channel.name] for state in states]
    most = tolerance(channel)
    worst = max(states, key=lambda state: state.off[channel.name])
    if worst.off[channel.name] > most:
        shown, real = (show(value[channel.name], channel.quantity) for value in (worst.shown, worst.had))
        raise Failed(f"{channel.name} shows {shown} where the emulated plant has {real}")
    return max(had) - min(had) > DISTINCT * most


def _moves(rig: Rig, channels: Sequence[ChannelRecord], rate: float, *, stamped: bool) -> list[str]:
    """Compare samples with the plant in motion; returns the channels that moved enough."""
    rig.pass_time(_bring(rig, _swept(0.0)))
    rig.call("collect()", rig.device.collect).good(COLLECTS_WITHIN)
    found, began, due = Recording(rig.record.channels, stamped), rig.bench_clock.now(), 0.0
    while (since := rig.bench_clock.now() - began) < SWEEP:
        rig.bring(_swept(since))
        if since >= due:
            rig.feed()
            collect(rig, found)
            if not due:
                _bring(rig, replace(_swept(since), position=0.02))
            due += 0.1
        rig.wait(0.008)
    if not found.times:
        raise Late("samples no longer come while the pressure changes")
    grid = _grid(rig, found)
    return [channel.name for channel in channels if _follows(channel, found, grid, max(1.0 / rate, 1.0 / RATE))]


def _swept(since: float) -> State:
    """A triangle wave: a constant rate of change."""
    share = 2 * abs(since / 0.8 % 1.0 - 0.5)
    return State(360e3 - 300e3 * share, 0.02 - 0.018 * share, 210.0 - 200.0 * share)


def _grid(rig: Rig, found: Recording) -> list[tuple[float, Mapping[str, float]]]:
    """State of the plant around the samples: bench time [s], quantities."""
    moments, zero = found.moments(), rig.bench_clock.start
    first = moments[0] - WINDOW
    count = round((moments[-1] + WINDOW - first) / GRID)
    return [(first + i * GRID, rig.plant.at(zero + first + i * GRID)) for i in range(count + 1)]


def _follows(
    channel: ChannelRecord, found: Recording, grid: Sequence[tuple[float, Mapping[str, float]]], period: float
) -> bool:
    """Whether a channel moved enough; raises Late if its samples belong to other times."""
    moments, shown = found.moments(), found.si(channel)
    at, real = [time for time, _ in grid], [quantities[channel.name] for _, quantities in grid]

    def deviation(shift: float) -> float:
        places = (min(bisect_left(at, moment + shift), len(at) - 1) for moment in moments)
        return fmean(abs(s - real[place]) for s, place in zip(shown, places, strict=True))

    best = min([step * GRID for step in range(-round(WINDOW / GRID), round(WINDOW / GRID) + 1)], key=deviation)
    per_period = fmean(abs(b - a) for a, b in zip(real, real[round(period / GRID) :], strict=False))
    moving = sum(a != b for a, b in pairwise(real)) / len(real)
    if per_period < 2 * tolerance(channel) or moving < 0.03:
        return False
    if abs(best) > LAG * period + GRID:
        word = "old" if best < 0 else "early"
        raise Late(f"the samples of {channel.name} are {1e3 * abs(best):.0f} ms too {word}, at {1 / period:g} Hz")
    if (ragged := deviation(best) / per_period) > RAGGED:
        off = f"{ragged:.0%} of what the plant changes from one to the next; are values repeated, or lost?"
        raise Late(f"samples of {channel.name} do not belong to their times: they are off by {off}")
    same = [later == earlier for earlier, later in pairwise(found.values[channel.name])]
    between = [same[border - 1] for border in found.borders if 0 < border <= len(same)]
    if sum(between) > LOST * len(between) and sum(between) / len(between) > 2 * sum(same) / len(same):
        raise Late(f"most blocks of {channel.name} begin with the last value of the block before")
    return True
