"""Commands of the tests that this program knows, read off the columns of a file that it did not record.

Steps, ramps and sines of the commanded channel (of the measured one where no command was recorded) get the names of
phases that a protocol of the kind gives them. Pure functions of arrays; what was not commanded in a column, such as
what a search found, is not made up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from pmabench.store.importers import motion
from pmabench.store.records import Array

SMALLEST = {"pressure": 1e3, "displacement": 0.2e-3}
"""Smallest change of a command that counts [SI], where the map gives none."""
DIGITS = 4
"""Significant digits of a commanded value: a converter gives 299.99 for 300 kPa."""
MOVING = 0.05
"""A ramp is seen over so many seconds, and at least so many samples on either side: `MOVING_SAMPLES`."""
MOVING_SAMPLES = 2
STILL = 1e-3
"""Share of the span of a channel that it may move over that time and be held (a measured one: `NOISY`)."""
NOISY = 0.01
AT_ONCE = 0.06
"""A change that is over in this time [s] is a step."""
LIFTED = 0.02e-3
"""A load is off its support where the displacement exceeds its rest by this [m]."""
AROUND = 0.05
"""Samples so far from that moment [s] are averaged."""
FEWEST = 20
LIKE = 0.02
"""Loads measured by the cell that differ by less than this share are one."""


@dataclass(frozen=True)
class Change:
    """A change of a command: when it begins and ends [s], from and to which value [SI]."""

    t: float
    end: float
    before: float
    value: float

    def command(self, output: str, phase: str) -> dict[str, Any]:
        """Data of a `command` event, with `t`."""
        told = {"t": self.t, "output": output, "value": self.value, "before": self.before, "phase": phase}
        if self.end - self.t <= AT_ONCE:
            return {**told, "type": "set"}
        return {**told, "type": "ramp", "rate": abs(self.value - self.before) / (self.end - self.t)}


Named = tuple[list[dict[str, Any]], dict[str, float]]
"""Commands of a trial, and what of its operating point they tell."""


def read(kind: str, t: Array, channels: Mapping[str, Array], smallest: float | None) -> Named:
    """The commands of one trial of a kind, and its operating point as far as they tell it.

    `t` [s] rises; `channels` [SI] by name, shape (n,) each. `smallest` [Pa]: smallest step of pressure.
    """
    if kind not in _READ or len(t) < 2 * MOVING_SAMPLES + 2:
        return [], {}
    output, name = _READ[kind]
    channel = f"{output}_command" if f"{output}_command" in channels else output
    if channel not in channels:
        return [], {}
    least = smallest if smallest and output == "pressure" else SMALLEST[output]
    if kind == "sinusoidal-displacement":
        return _sine(t, channels, channel, least)
    found = changes(t, channels[channel], least, measured=channel == output)
    if not found:
        return [], {**_held(channels), "side": -1.0} if kind == "free-contraction" else {}
    if channel == output:  # ends that were measured lie within noise of each other from cycle to cycle
        grid = 10.0 ** np.floor(np.log10(float(np.ptp(channels[channel])))) / 40.0
        found = [Change(c.t, c.end, grid * round(c.before / grid), grid * round(c.value / grid)) for c in found]
    commands, point = name(found, t, channels)
    if channel == output:
        commands = [{**command, "found": 1.0} for command in commands]
    return commands, point


def changes(t: Array, values: Array, smallest: float, *, measured: bool = False) -> list[Change]:
    """Changes from one held or turning value to the next, by at least `smallest`.

    Their beginnings and ends are extrapolated from where a tenth and nine tenths of them are reached.
    """
    period = float(np.median(np.diff(t)))
    if not period > 0 or not np.isfinite(values).all():
        return []
    reach = max(MOVING_SAMPLES, round(MOVING / 2 / period)) if measured else MOVING_SAMPLES
    span = float(np.ptp(values))
    moved = np.zeros(len(values))
    moved[reach:-reach] = values[2 * reach :] - values[: -2 * reach]
    still = (NOISY if measured else STILL) * span
    if not measured:
        # a slow ramp goes on by less than `still` from sample to sample: what never rests is a ramp, too
        jumps = np.abs(np.diff(values))
        still = min(still, 0.5 * float(jumps[jumps > 0].min(initial=np.inf)))
    way = np.sign(moved) * (np.abs(moved) > still)
    edges = np.flatnonzero(np.diff(np.concatenate([[0.0], way, [0.0]])))
    found: list[Change] = []
    for first, last in pairwise(edges.tolist()):
        if way[first] == 0:
            continue
        begin, end = max(0, first - reach), min(len(values) - 1, last - 1 + reach)
        change = _change(t, values, begin, end, smallest)
        if change is not None:
            found.append(change)
    return found


def _change(t: Array, values: Array, begin: int, end: int, smallest: float) -> Change | None:
    part = values[begin : end + 1]
    low, high = int(np.argmin(part)), int(np.argmax(part))
    first, last = sorted((low, high))
    before, value = float(part[first]), float(part[last])
    size = value - before
    if abs(size) < smallest:
        return None
    share = (part[first : last + 1] - before) / size
    times = t[begin + first : begin + last + 1]
    rising = np.maximum.accumulate(share)
    step = int(np.argmax(np.diff(share)))
    if float(np.diff(share)[step]) > 0.8:  # at once: somewhere between two samples
        middle = 0.5 * float(times[step] + times[step + 1])
        return Change(middle, middle, _rounded(before), _rounded(value))
    at = [float(np.interp(level, rising, times)) for level in (0.1, 0.9)]
    slack = 0.125 * (at[1] - at[0])
    return Change(at[0] - slack, at[1] + slack, _rounded(before), _rounded(value))


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _contraction(found: list[Change], t: Array, channels: Mapping[str, Array]) -> Named:
    lowest, highest = min(c.value for c in found), max(c.value for c in found)
    lowest = min(lowest, found[0].before)
    edge = lowest + 0.02 * (highest - lowest)

    def phase(change: Change) -> str:
        return "contract" if change.value > change.before else "vent" if change.value <= edge else "relax"

    return [c.command("pressure", phase(c)) for c in found], {"pressure": highest}


def _ramps(found: list[Change], t: Array, channels: Mapping[str, Array]) -> Named:
    commands = [c.command("displacement", "contract" if c.value > c.before else "expand") for c in found]
    ends = [end for c in found for end in (c.before, c.value)]
    speed = float(np.median([abs(c.value - c.before) / max(c.end - c.t, 1e-9) for c in found]))
    point = {"lower": min(ends), "upper": max(ends), "speed": float(f"{speed:.3g}"), "cycles": float(len(found) // 2)}
    return commands, {**point, **_held(channels)}


def _steps(found: list[Change], t: Array, channels: Mapping[str, Array]) -> Named:
    start = found[0].before
    commands = []
    for c in found:
        away = abs(c.value - start) > abs(c.before - start)
        commands.append({**c.command("displacement", "step" if away else "back"), "type": "ramp"})
    for command, c in zip(commands, found, strict=True):
        command.setdefault("rate", abs(c.value - c.before) / max(c.end - c.t, 1e-3))
    speed = float(np.median([command["rate"] for command in commands]))
    size = float(np.median([abs(c.value - c.before) for c in found]))
    point = {"start": start, "step": _rounded(size), "speed": float(f"{speed:.3g}")}
    return commands, {**point, **_held(channels)}


def _fill(found: list[Change], t: Array, channels: Mapping[str, Array]) -> Named:
    top = max(c.value for c in found)

    def phase(change: Change) -> str:
        if change.value >= 0.95 * top:
            return "fill"
        return "empty" if change.before >= 0.95 * top else "rest"

    point = {}
    if "displacement" in channels:
        middle = float(np.median(channels["displacement"]))
        point["contraction"] = round(middle, 4)
    return [c.command("pressure", phase(c)) for c in found], point


def _free(found: list[Change], t: Array, channels: Mapping[str, Array]) -> Named:
    """Up to the pressure, or beyond it and down to it; then at rest, and away."""
    last = found[-1] if len(found) > 1 else None
    if last is not None and t[-1] - last.end > last.t - found[-2].end:
        last = None  # it rests longer after it than before: it was not vented but brought there
    commands = []
    for c in found:
        phase = "vent" if c is last else "fill" if c.value > c.before else "empty"
        commands.append({**c.command("pressure", phase), "type": "ramp"})
        commands[-1].setdefault("rate", abs(c.value - c.before) / max(c.end - c.t, 1e-3))
    pressure = last.before if last is not None else found[-1].value
    before = found if last is None else found[:-1]
    return commands, {"pressure": pressure, "side": 1.0 if len(before) > 1 else -1.0}


def _lifts(found: list[Change], t: Array, channels: Mapping[str, Array]) -> Named:
    return [c.command("pressure", "lift" if c.value > c.before else "set-down") for c in found], {}


def lift_and_set_down(t: Array, channels: Mapping[str, Array]) -> list[dict[str, Any]]:
    """Where a load leaves its support for the last time, and where it comes back: data of `found` events, with `t`.

    The displacement passes `LIFTED` (five times its noise where that is more); pressure, displacement and force are
    those of a straight line through the samples `AROUND` it, so that their noise averages out. Of several approaches
    the last counts. `t` [s] rises, `channels` [SI] have shape (n,).
    """
    if "displacement" not in channels or len(t) < FEWEST:
        return []
    x = channels["displacement"]
    rest = x[: max(FEWEST, len(x) // 100)]
    level = float(np.median(rest)) + max(LIFTED, 5.0 * float(np.std(rest)))
    up = x > level
    rises, falls = np.flatnonzero(~up[:-1] & up[1:]), np.flatnonzero(up[:-1] & ~up[1:])
    if not len(rises):
        return []
    top = int(np.argmax(np.where(t >= t[rises[0]], x, -np.inf)))
    ways = [("lift", rises[rises <= top]), ("set-down", falls[falls >= top])]
    told = []
    for phase, rows in ways:
        if not len(rows):
            continue
        at = float(t[rows[-1]])
        near = np.abs(t - at) <= AROUND
        result: dict[str, Any] = {"found": True, "t": at}
        for name in ("pressure", "displacement", "force"):
            if name in channels and near.sum() >= 3:
                result[name] = float(np.polyfit(t[near] - at, channels[name][near], 1)[1])
        if "pressure" in result:
            told.append({"t": at, "phase": phase, "law": "displacement of the file", "result": result})
    return told


def _sine(t: Array, channels: Mapping[str, Array], channel: str, smallest: float) -> Named:
    waves = motion.waves(t, channels[channel], smallest)
    if not waves:
        return [], {}
    wave = max(waves, key=lambda wave: wave.end - wave.begin)
    cycles = (wave.end - wave.begin) * wave.frequency
    command = {
        "t": wave.begin, "output": "displacement", "type": "sine", "value": wave.mean, "before": wave.mean,
        "phase": "sine", "amplitude": wave.amplitude, "frequency": wave.frequency, "cycles": cycles,
    }  # fmt: skip
    point = {
        "frequency": float(f"{wave.frequency:.4g}"),
        "mean": round(wave.mean, 5),
        "amplitude": round(wave.amplitude, 5),
        **_held(channels),
    }
    return [command], point


def _held(channels: Mapping[str, Array]) -> dict[str, float]:
    """The pressure at which a test was made: as commanded, else as measured, to three digits."""
    for name, digits in (("pressure_command", DIGITS), ("pressure", 3)):
        if name in channels:
            return {"pressure": float(f"{float(np.median(channels[name])):.{digits}g}")}
    return {}


_READ: dict[str, tuple[str, Callable[[list[Change], Array, Mapping[str, Array]], Named]]] = {
    "contraction-relaxation": ("pressure", _contraction),
    "isobaric-ramp": ("displacement", _ramps),
    "step-displacement": ("displacement", _steps),
    "isometric-pressurisation": ("pressure", _fill),
    "free-contraction": ("pressure", _free),
    "sinusoidal-displacement": ("displacement", _ramps),
    "static-load": ("pressure", _lifts),
}
"""Kind -> what is commanded in it, and how its changes are named. Searches and loops leave no such trace."""


def cell_load(t: Array, force: Array, commands: list[dict[str, Any]]) -> float | None:
    """The weight that hangs, from the cell [N]: median over the last fifth of the longest hold; None without a hold."""
    times = [float(command["t"]) for command in commands] + [float(t[-1])]
    holds = [(b - a, a, b) for a, b in pairwise(times)]
    if not holds:
        return None
    length, begin, end = max(holds)
    rows = (t >= end - 0.2 * length) & (t < end)
    return float(np.median(force[rows])) if rows.sum() >= 8 and begin < end else None


def alike(loads: list[float]) -> list[float]:
    """Loads that differ by less than `LIKE` (1 N at least) as their mean, in the same order."""
    order = np.argsort(loads)
    values = np.array(loads, dtype=np.float64)
    groups: list[list[int]] = []
    for place in order:
        last = values[groups[-1][-1]] if groups else -np.inf
        if groups and values[place] - last <= max(1.0, LIKE * abs(last)):
            groups[-1].append(int(place))
        else:
            groups.append([int(place)])
    for group in groups:
        values[group] = _rounded(float(values[group].mean()))
    return [float(value) for value in values]
