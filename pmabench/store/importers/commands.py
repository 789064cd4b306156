"""Commands of a test and coordinates of its operating point, derived from the columns of a file.

Steps, ramps and sines of the commanded channel (of the measured one if no command was recorded) become commands with
the phase names of the kind of test. Results that no column shows, such as those of a search, are not invented. Channels
have shape (n,), times `t` [s] increase.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile
from math import sqrt
from typing import Any

import numpy as np

from pmabench.base.kind import Commanded
from pmabench.store.importers.motion import Wave, averaged, medians, turns, waves
from pmabench.store.records import Array

SMALLEST = {"pressure": 1e3, "displacement": 0.2e-3}
"""Smallest change of a command that counts [SI], where the map gives none."""
DIGITS = 4
"""Significant digits of a commanded value: a converter gives 299.99 for 300 kPa."""
MOVING = 0.05
"""Window over which motion is detected [s], with at least `MOVING_SAMPLES` samples on either side."""
MOVING_SAMPLES = 2
STILL = 1e-3
"""Largest motion of a held command within the window, as a share of its span; `NOISY` for a measured channel."""
NOISY = 0.01
ABOVE, ABOVE_SPAN = 12.0, 0.02
"""Smallest size of a measured change: in standard deviations of the noise, and as a share of the span."""
MOST, LONGEST = 0.8, 0.1
"""Share of the travel that the changes must make up, and longest window of `changes` as a share of the record."""
CLEARLY = 3.0
"""Least motion of a clearly detected measured ramp within the window, as a multiple of that of a held value."""
OVERLAP = 0.2
"""A change that overlaps a larger one by more than this share is only an end of that."""
AT_ONCE = 0.06
"""Longest duration of a step [s]; longer changes are ramps."""
LIFTED = 0.02e-3
"""Displacement above rest at which a load has left its support [m], in the median of `TOGETHER` samples."""
TOGETHER = 5
AROUND = 0.05
"""Half width of the window of samples used at that moment [s]; at least two samples on either side."""
FEWEST = 20
LIKE = {"pressure": (2.5e3, 0.01, -2), "load": (1.0, 0.02, 2), "contraction": (0.2e-3, 0.01, 5)}
"""Measured coordinate -> largest difference [SI], or share if that is more, of values at one level, and decimals of a
level. Regulators (0.5 % of 500 kPa), load cells and stops do not repeat better."""


@dataclass(frozen=True)
class Change:
    """A change of a command: times of begin and end [s], values before and after [SI]."""

    t: float
    end: float
    before: float
    value: float

    def command(self, output: str, phase: str) -> dict[str, Any]:
        """Data of a `command` event, with `t`."""
        data = {"t": self.t, "output": output, "value": self.value, "before": self.before, "phase": phase}
        if self.end - self.t <= AT_ONCE:
            return {**data, "type": "set"}
        return {**data, "type": "ramp", "rate": self.speed}

    @property
    def speed(self) -> float:
        """Rate of change [SI/s]; a step counts as taking 1 ms."""
        return abs(self.value - self.before) / max(self.end - self.t, 1e-3)


Named = tuple[list[dict[str, Any]], dict[str, float]]
"""Commands of a trial, and the coordinates of its operating point that they show."""


def driven_waves(how: Commanded, t: Array, channels: Mapping[str, Array], smallest: float | None = None) -> list[Wave]:
    """Sines of the commanded channel, or of the measured one if no command was recorded; see `commands_of`."""
    channel = _channel(how, t, channels)
    return waves(t, channels[channel], _least(how, smallest)) if how.sine and channel else []


def _channel(how: Commanded, t: Array, channels: Mapping[str, Array]) -> str:
    """The commanded channel, or the measured one if no command was recorded; empty where there are too few samples."""
    channel = f"{how.output}_command" if f"{how.output}_command" in channels else how.output
    return channel if channel in channels and len(t) >= 2 * MOVING_SAMPLES + 2 else ""


def _least(how: Commanded, smallest: float | None) -> float:
    return smallest if smallest and how.output == "pressure" else SMALLEST[how.output]


def commands_of(how: Commanded, t: Array, channels: Mapping[str, Array], smallest: float | None) -> Named:
    """The commands of one trial, and the coordinates of its operating point that the channels show.

    `t` [s] increases; `channels` [SI] by name, shape (n,) each. `smallest` [Pa]: smallest step of pressure.
    """
    if not (channel := _channel(how, t, channels)):
        return [], {}
    measured = channel == how.output
    sines = driven_waves(how, t, channels, smallest)
    found = [] if how.sine else changes(t, channels[channel], _least(how, smallest), measured=measured)
    if not found and not sines and not how.still:
        return [], {}
    seen = Seen(tuple(found), t, channels, max(sines, key=lambda wave: wave.end - wave.begin, default=None))
    if measured and found:  # measured end values scatter from cycle to cycle
        grid = 10.0 ** np.floor(np.log10(float(np.ptp(channels[channel])))) / 40.0
        found = [Change(c.t, c.end, grid * round(c.before / grid), grid * round(c.value / grid)) for c in found]
    # levels of pressure are merged over all trials by `alike`, ends of strokes here
    exact, seen = seen, replace(seen, changes=tuple(found))
    of = exact if how.output == "pressure" else seen
    point = {name: value for name, way in how.point if (value := COORDINATES[way](of)) is not None}
    if seen.wave is not None:
        return [sine_command(seen.wave, how.output)], point
    commands = []
    for place, change in enumerate(found):
        phase = next(name for way, name in how.phases if CHANGES[way](seen, place))
        command = change.command(how.output, phase)
        if how.ramps and command["type"] == "set":
            command |= {"type": "ramp", "rate": change.speed}
        commands.append({**command, "found": 1.0} if measured else command)
    return commands, point


def changes(t: Array, values: Array, smallest: float, *, measured: bool = False) -> list[Change]:
    """Changes by at least `smallest` [SI] from one held value or turning point to the next.

    Their begin and end are extrapolated from the 10 % and 90 % points. A measured ramp may be so slow that it hardly
    moves within `MOVING`: the window is doubled until the changes make up most of the travel.
    """
    period = float(np.median(np.diff(t)))
    if not period > 0 or not np.isfinite(values).all():
        return []
    if not measured:
        return _changes(t, values, values, smallest, MOVING_SAMPLES, STILL)
    reach = max(MOVING_SAMPLES, round(MOVING / 2 / period))
    first: list[Change] | None = None
    while first is None or 2 * reach < len(values) * LONGEST:
        even = averaged(values, 2 * (reach // 2) + 1)  # so that noise alone does not look like a change
        least = max(smallest, ABOVE * _noise(even, reach), ABOVE_SPAN * float(np.ptp(even)))
        exact = values if ABOVE * _noise(values, reach) <= least else even  # averages cut off sharp turns
        travel = float(np.abs(np.diff(exact[turns(exact, least)])).sum())
        pieces = _changes(t, even, exact, least, reach, NOISY)
        found = [one for one in pieces if not _in_another(one, pieces)]
        travelled = sum(abs(one.value - one.before) for one in found)
        if found and MOST * travel <= travelled <= travel / MOST and _clear(even, reach):
            return found
        first = found if first is None else first
        reach *= 2
    return first


def _noise(values: Array, reach: int) -> float:
    """Standard deviation of the noise, from second differences over about `reach` samples, which are 0 for a ramp."""
    width = 2 * (reach // 2) + 1
    bent = values[2 * width :] - 2 * values[width:-width] + values[: -2 * width]
    return 1.48 * float(np.median(np.abs(bent))) / sqrt(6) if len(bent) else 0.0


def _moves(values: Array, reach: int) -> Array:
    """Change from `reach` samples before to `reach` samples after each value, shape (n,); 0 at both ends."""
    moved = np.zeros(len(values))
    moved[reach:-reach] = values[2 * reach :] - values[: -2 * reach]
    return moved


def _clear(values: Array, reach: int) -> bool:
    """Whether motion is clearly above the limit; near it, a slow ramp would be split into pieces."""
    moved, still = np.abs(_moves(values, reach)), NOISY * float(np.ptp(values))
    return bool((moved > still).any() and np.median(moved[moved > still]) > CLEARLY * still)


def _in_another(one: Change, found: list[Change]) -> bool:
    """Whether a change overlaps a larger one: it is then an end of that, detected twice."""
    length, size = one.end - one.t, abs(one.value - one.before)
    larger = (other for other in found if abs(other.value - other.before) > size)
    return any(min(one.end, other.end) - max(one.t, other.t) > OVERLAP * length for other in larger)


def _changes(t: Array, values: Array, exact: Array, smallest: float, reach: int, share: float) -> list[Change]:
    """Changes where `values` move by more than a `share` of their span within `reach` samples before and after.

    Their begin and end values are taken from `exact`.
    """
    moved, still = _moves(values, reach), share * float(np.ptp(values))
    if share == STILL:
        # a slow ramp moves by less than `still` from sample to sample: motion without rest is a ramp, too
        jumps = np.abs(np.diff(values))
        still = min(still, 0.5 * float(jumps[jumps > 0].min(initial=np.inf)))
    way = np.sign(moved) * (np.abs(moved) > still)
    edges = np.flatnonzero(np.diff(way, prepend=0.0, append=0.0)).tolist()
    moving = ((first, last) for first, last in pairwise(edges) if way[first] != 0)
    ends = ((max(0, first - reach), min(len(values) - 1, last - 1 + reach)) for first, last in moving)
    return [change for begin, end in ends if (change := _change(t, exact, begin, end, smallest)) is not None]


def _change(t: Array, values: Array, begin: int, end: int, smallest: float) -> Change | None:
    part = values[begin : end + 1]
    first, last = sorted((int(np.argmin(part)), int(np.argmax(part))))
    before, value = float(part[first]), float(part[last])
    size = value - before
    if abs(size) < smallest:
        return None
    share = (part[first : last + 1] - before) / size
    times = t[begin + first : begin + last + 1]
    rising = np.maximum.accumulate(share)
    step = int(np.argmax(np.diff(share)))
    if float(np.diff(share)[step]) > 0.8:  # a step, somewhere between two samples
        middle = 0.5 * float(times[step] + times[step + 1])
        return Change(middle, middle, _rounded(before), _rounded(value))
    at = [float(np.interp(level, rising, times)) for level in (0.1, 0.9)]
    slack = 0.125 * (at[1] - at[0])
    return Change(at[0] - slack, at[1] + slack, _rounded(before), _rounded(value))


def _rounded(value: float, digits: int = DIGITS) -> float:
    return float(f"{value:.{digits}g}")


@dataclass(frozen=True)
class Seen:
    """Detected commands of a trial, and its samples: `t` [s] and `channels` [SI] of shape (n,)."""

    changes: tuple[Change, ...]
    t: Array
    channels: Mapping[str, Array]
    wave: Wave | None = None

    @property
    def ends(self) -> list[float]:
        """Values before and after each change [SI]."""
        return [end for c in self.changes for end in (c.before, c.value)]

    @property
    def left(self) -> bool:
        """Whether the last change only leaves the held value: the rest before it is not shorter than after it."""
        if len(self.changes) < 2:
            return False
        before, last = self.changes[-2:]
        return float(self.t[-1]) - last.end <= last.t - before.end

    def held(self) -> float | None:
        """Pressure of the test [Pa]: the commanded one, else the measured one to three digits; None without either."""
        known = (each for each in (("pressure_command", DIGITS), ("pressure", 3)) if each[0] in self.channels)
        return next((_rounded(float(np.median(self.channels[name])), digits) for name, digits in known), None)

    def reached(self) -> float | None:
        """Last value at which the trial was held [SI]."""
        if not self.changes:
            return self.held()
        return self.changes[-1].before if self.left else self.changes[-1].value

    def usual(self, what: Callable[[Change], float], digits: int) -> float | None:
        """Median of a property over the changes; None without changes."""
        return _rounded(float(np.median([what(c) for c in self.changes])), digits) if self.changes else None

    def length(self) -> float | None:
        """Displacement of the test [m]; None without that channel."""
        here = self.channels.get("displacement")
        return None if here is None else round(float(np.median(here)), 4)


def _lowest(seen: Seen) -> float:
    """Upper bound of values that count as lowest: 2 % of the way to the highest one."""
    low = min(seen.changes[0].before, *(c.value for c in seen.changes))
    return low + 0.02 * (max(c.value for c in seen.changes) - low)


def _highest(seen: Seen) -> float:
    return 0.95 * max(c.value for c in seen.changes)


def _climbs(seen: Seen, k: int) -> bool:
    """Whether a change leads up to the highest value, directly or through further rises."""
    rising = takewhile(lambda change: change.value > change.before, seen.changes[k:])
    return any(change.value >= _highest(seen) for change in rising)


def _descends(seen: Seen, k: int) -> bool:
    """Whether a change leads down from the highest value, directly or after other falls."""
    falling = takewhile(lambda change: change.value < change.before, seen.changes[k::-1])
    return any(change.before >= _highest(seen) for change in falling)


CHANGES: Mapping[str, Callable[[Seen, int], bool]] = {
    "rises": lambda seen, k: seen.changes[k].value > seen.changes[k].before,
    "to the lowest": lambda seen, k: seen.changes[k].value <= _lowest(seen),
    "to the highest": lambda seen, k: seen.changes[k].value >= _highest(seen),
    "up to the highest": _climbs,
    "down from the highest": _descends,
    "away": lambda seen, k: (
        abs(seen.changes[k].value - seen.changes[0].before) > abs(seen.changes[k].before - seen.changes[0].before)
    ),
    "leaves": lambda seen, k: seen.left and k == len(seen.changes) - 1,
    "any": lambda seen, k: True,
}
"""Rule for the phase of a change -> whether change number k of a trial fulfils it."""
COORDINATES: Mapping[str, Callable[[Seen], float | None]] = {
    "highest": lambda seen: max((c.value for c in seen.changes), default=None),
    "lowest end": lambda seen: min(seen.ends, default=None),
    "highest end": lambda seen: max(seen.ends, default=None),
    "first": lambda seen: seen.changes[0].before if seen.changes else None,
    "size": lambda seen: seen.usual(lambda c: abs(c.value - c.before), DIGITS),
    "speed": lambda seen: seen.usual(lambda c: c.speed, 3),
    "pairs": lambda seen: float(len(seen.changes) // 2),
    "held": Seen.held,
    "length": Seen.length,
    "reached": Seen.reached,
    # from below after a single change, from above after it came down again
    "side": lambda seen: 1.0 if len(seen.changes) - seen.left > 1 else -1.0,
    "frequency": lambda seen: _rounded(seen.wave.frequency) if seen.wave else None,
    "mean": lambda seen: round(seen.wave.mean, 5) if seen.wave else None,
    "amplitude": lambda seen: round(seen.wave.amplitude, 5) if seen.wave else None,
}
"""Rule for a coordinate of the operating point -> its value [SI]; None where it cannot be determined."""


def sine_command(wave: Wave, output: str) -> dict[str, Any]:
    """Data of a `command` event for a sine, with `t`."""
    return {
        "t": wave.begin, "output": output, "type": "sine", "value": wave.mean, "before": wave.mean, "phase": "sine",
        "amplitude": wave.amplitude, "frequency": wave.frequency, "cycles": (wave.end - wave.begin) * wave.frequency,
    }  # fmt: skip


def lift_and_set_down(t: Array, channels: Mapping[str, Array]) -> list[dict[str, Any]]:
    """Last lift-off of a load from its support, and its set-down: data of `found` events, with `t`.

    They are where the displacement passes `LIFTED`, or five times its noise if that is more. Pressure, displacement and
    force come from straight lines through the samples `AROUND` that moment, to average out noise. Of several approaches
    the last counts. `t` [s] increases, `channels` [SI] have shape (n,).
    """
    if "displacement" not in channels or len(t) < FEWEST:
        return []
    x = channels["displacement"]
    rest = x[: max(FEWEST, len(x) // 100)]
    level = float(np.median(rest)) + max(LIFTED, 5.0 * float(np.std(rest)))
    up = medians(x, TOGETHER) > level  # a single stray sample does not count
    rises, falls = np.flatnonzero(~up[:-1] & up[1:]), np.flatnonzero(up[:-1] & ~up[1:])
    if not len(rises):
        return []
    top = int(np.argmax(np.where(t >= t[rises[0]], x, -np.inf)))
    found = []
    for phase, rows in (("lift", rises[rises <= top]), ("set-down", falls[falls >= top])):
        at = float(t[rows[-1]]) if len(rows) else np.nan
        near = np.abs(t - at) <= max(AROUND, 2.5 * float(np.median(np.diff(t))))
        result: dict[str, Any] = {"found": True, "t": at}
        for name in ("pressure", "displacement", "force"):
            if name in channels and near.sum() >= 3:
                result[name] = float(np.polyfit(t[near] - at, channels[name][near], 1)[1])
        if "pressure" in result:
            found.append({"t": at, "phase": phase, "law": "displacement of the file", "result": result})
    return found


def cell_load(t: Array, channels: Mapping[str, Array], commands: list[dict[str, Any]]) -> float | None:
    """Hanging weight from the load cell [N]: median over the last fifth of the longest hold; None without a hold.

    Only samples with more than half of the contraction count: before, a support carries the load.
    """
    x = channels.get("displacement")
    hangs = np.ones(len(t), dtype=bool) if x is None else x > 0.5 * float(x.min() + x.max())
    times = [float(command["t"]) for command in commands] + [float(t[-1])]
    for begin, end in sorted(pairwise(times), key=lambda hold: hold[0] - hold[1]):
        rows = hangs & (t >= end - 0.2 * (end - begin)) & (t < end)
        if rows.sum() >= 8:
            return float(np.median(channels["force"][rows]))
    return None


def alike(name: str, values: Iterable[float]) -> dict[float, float]:
    """Measured value of a coordinate -> its level, the mean of values that differ by less than `LIKE`.

    A group of close neighbours whose ends are more than twice as far apart is a staircase, and is split more finely.
    """
    least, share, decimals = LIKE[name]
    levels: dict[float, float] = {}
    parts = [(np.sort(np.array(list(values), dtype=np.float64)), 1.0)]
    while parts:
        every, fine = parts.pop()
        most = fine * np.maximum(least, share * np.abs(every))
        for group in np.split(every, np.flatnonzero(np.diff(every) > most[:-1]) + 1):
            if group[-1] - group[0] > 2.0 * fine * max(least, share * abs(float(group[0]))):
                parts.append((group, fine / 2))
            else:
                levels |= dict.fromkeys(group.tolist(), round(_rounded(float(group.mean())), decimals) + 0.0)
    return levels
