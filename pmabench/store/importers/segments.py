"""Cuts an old file into trials: steps, ramps or sines, gaps in its time, or the whole; pure functions of arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pmabench.base.kind import Commanded
from pmabench.base.quantities import CHANNEL_QUANTITY
from pmabench.store.importers import motion
from pmabench.store.importers.commands import (
    LIKE,
    cell_load,
    commands_of,
    driven_waves,
    lift_and_set_down,
    sine_command,
)
from pmabench.store.importers.found import Bools
from pmabench.store.importers.map_rules import G, ImportMap
from pmabench.store.importers.motion import Level, later
from pmabench.store.records import UNUSABLE, Array, Flag, Flags

POINT = "point of "
Found = TypeVar("Found")


@dataclass(frozen=True)
class Segment:
    """One trial from `begin` to `end` [s]: operating point [SI], commands, and (begin [s], name) of its phases."""

    begin: float
    end: float
    point: Mapping[str, float]
    commands: tuple[Mapping[str, Any], ...] = ()
    """Data of `command` events, with `t`."""
    phases: tuple[tuple[float, str], ...] = ()
    found: tuple[Mapping[str, Any], ...] = ()
    """Data of `found` events, with `t`."""
    measured: tuple[str, ...] = ()
    """Coordinates of its point that were measured, and may be merged with nearly equal ones of other trials."""

    def at_levels(self, levels: Mapping[str, Mapping[float, float]]) -> Segment:
        """The trial with its measured coordinates replaced by levels: name -> measured value -> level [SI].

        The mass of a measured load is calculated if missing.
        """
        at = {name: levels[name].get(self.point[name], self.point[name]) for name in self.measured}
        point = {**self.point, **at}
        return replace(self, point={"mass": point["load"] / G, **point} if "load" in self.measured else point)


@dataclass(frozen=True)
class _Rows:
    """The samples of a file, all of shape (n,), with its map and operating point."""

    t: Array
    values: Mapping[str, Array]
    flags: Flags
    rules: ImportMap
    point: Mapping[str, float]

    @cached_property
    def good(self) -> Bools:
        """Mask of usable samples; where at least half of a file is suspect, that flag is ignored."""
        suspect = (self.flags & np.uint16(Flag.SUSPECT)) != 0
        wrong = Flag.DROPOUT | Flag.TIME_JUMP | (Flag.SUSPECT if suspect.mean() < 0.5 else Flag.OK)
        return np.asarray((self.flags & np.uint16(wrong)) == 0)

    @cached_property
    def rising(self) -> Bools:
        """Mask of good samples that are later than all samples before them."""
        return self.good & later(self.t)

    @property
    def whole(self) -> tuple[float, float]:
        """Times of the first and the last sample [s]."""
        return float(self.t.min()), float(self.t.max())

    def between(self, part: Segment) -> Bools:
        """Mask of the `rising` samples of a trial."""
        return np.asarray(self.rising & (self.t >= part.begin - 1e-9) & (self.t <= part.end + 1e-9))

    def of(self, part: Segment) -> tuple[Array, dict[str, Array]]:
        """Times of these samples [s], and their channels [SI] by name."""
        rows = self.between(part)
        return self.t[rows], {name: column[rows] for name, column in self.values.items() if name in CHANNEL_QUANTITY}

    @property
    def points(self) -> dict[str, Array]:
        """Columns with coordinates of the operating point, by coordinate."""
        return {name[len(POINT) :]: column for name, column in self.values.items() if name.startswith(POINT)}

    @property
    def smallest(self) -> float:
        """Smallest change of pressure that counts [Pa]."""
        return self.rules.trials.smallest or 0.0

    @property
    def driven(self) -> str:
        """Name of the pressure command, or of the measured pressure if none was recorded."""
        return "pressure_command" if "pressure_command" in self.values else "pressure"

    def steps(self) -> list[Level]:
        """Steps of the command; if none was recorded, of the measured pressure, rounded to a fourth of `smallest`."""
        if not self.smallest:
            return []
        if self.driven == "pressure":
            grid = self.smallest / 4
            return [
                replace(each, before=round(each.before / grid) * grid, value=round(each.value / grid) * grid)
                for each in self.found(motion.levels, "pressure")
            ]
        t, command = self.t[self.good], self.values[self.driven][self.good]
        at = np.flatnonzero(np.abs(np.diff(command)) >= self.smallest) + 1
        steps = zip(t[at - 1].tolist(), t[at].tolist(), command[at - 1].tolist(), command[at].tolist(), strict=True)
        return [Level(now, now - before, low, high, now) for before, now, low, high in steps]

    def found(self, motions: Callable[[Array, Array, float], list[Found]], channel: str) -> list[Found]:
        """Steps, cycles or sines of a channel, in its samples that are good and later than all before them."""
        return motions(self.t[self.rising], self.values[channel][self.rising], self.smallest)

    def command(self, step: Level) -> dict[str, Any]:
        """Data of a `command` event, with `t`; with `found` if it was detected in the measured pressure."""
        levels = {"t": step.t, "output": "pressure", "type": "set", "value": step.value, "before": step.before}
        found = {"found": 1.0} if self.driven == "pressure" else {}
        return {**levels, "phase": "step", "within": step.within, **found}

    def commanded_steps(self) -> list[dict[str, Any]]:
        """Commands of the recorded steps; empty without a recorded command."""
        return [self.command(step) for step in self.steps()] if self.driven == "pressure_command" else []

    def sine(self, frequency: float) -> list[dict[str, Any]]:
        """Data of a recorded sine of known frequency, with mean and amplitude from its extremes; else empty."""
        if self.driven == "pressure" or frequency <= 0 or not self.good.any():
            return []
        t, command = self.t[self.good], self.values[self.driven][self.good]
        low, high = float(command.min()), float(command.max())
        wave = motion.Wave(float(t[0]), float(t[-1]), frequency, (low + high) / 2, (high - low) / 2)
        return [{**sine_command(wave, "pressure"), "before": float(command[0])}]


def segments(
    t: Array, values: Mapping[str, Array], flags: Flags, rules: ImportMap, point: Mapping[str, float]
) -> tuple[list[Segment], list[str]]:
    """The trials of one file, and sentences about doubts.

    `t` [s], `values` [SI] by channel (and `phase`, `trial`, `point of NAME`) and `flags` have shape (n,). Steps, ramps,
    sines and phases are searched in samples without dropouts, spikes and time jumps.
    """
    rows = _Rows(t, values, flags, rules, point)
    phases = _phases(rows)
    found = CUTS[rules.trials.by](rows)
    inside = (tuple(phase for phase in phases if part.begin <= phase[0] <= part.end) for part in found)
    found = [replace(part, phases=part.phases or mine) for part, mine in zip(found, inside, strict=True)]
    return (found, []) if rules.test.recording else _as_own(found, rows)


def _as_own(found: Sequence[Segment], all_rows: _Rows) -> tuple[list[Segment], list[str]]:
    """The trials with commands and operating points as in runs of this program, and doubts.

    Coordinates come from the map, else from columns, else from the commands.
    """
    rules, how = all_rows.rules, all_rows.rules.test.commanded
    parts, doubts = list[Segment](), list[str]()
    hanging = 0
    if how and how.sine:
        found = [each for part in found for each in _sine_by_sine(part, how, all_rows)]
    for number, part in enumerate(found, 1):
        commands, known = commands_of(how, *all_rows.of(part), rules.trials.smallest) if how else ([], {})
        part = _at_one_point(part, commands, all_rows)
        rows, (t, mine) = all_rows.between(part), all_rows.of(part)
        columns: dict[str, float] = {}
        for name, column in all_rows.points.items():
            here = column[rows & np.isfinite(column)]
            if len(here) and np.ptp(here) <= 1e-6 * float(np.abs(here).max()):
                columns[name] = float(here[0])
            elif len(here):
                text = f"trial {number}: the column of {name} goes from {here.min():.6g} to {here.max():.6g} [SI] "
                doubts.append(f"{text}within it, so it is not taken: cut the file into trials in which it is the same")
        point = {**known, **columns, **part.point}
        if rules.test.loaded and "load" in point and "mass" not in point:
            point["mass"] = point["load"] / G
            hanging += "force" not in mine
        if rules.test.loaded and "load" not in point and "force" in mine:
            load = cell_load(t, mine, commands)
            known |= {} if load is None else {"load": load}
            point = {**known, **point}
        searched = lift_and_set_down(t, mine) if rules.test.lifted else []
        given = {*columns, *part.point, *(["pressure"] if "pressure_command" in all_rows.values else [])}
        own = tuple(name for name in known if name in LIKE and name not in given and np.isfinite(known[name]))
        made = tuple(commands) or part.commands
        parts.append(replace(part, point=point, commands=made, found=tuple(searched), measured=own))
    if hanging:
        text = f"the moving mass of {hanging} trials is not given, so that of the load is taken; what moves with it "
        doubts.append(f"{text}(hanger, carriage) belongs to it: a column or `point: {{mass: ...}}` gives it")
    return parts, doubts


def _sine_by_sine(part: Segment, how: Commanded, all_rows: _Rows) -> list[Segment]:
    """A trial of several successive sines, split halfway between them."""
    waves = driven_waves(how, *all_rows.of(part))
    cuts = [0.5 * (one.end + after.begin) for one, after in pairwise(waves) if one.parted(after)]
    return [replace(part, begin=begin, end=end) for begin, end in pairwise([part.begin, *cuts, part.end])]


def _at_one_point(part: Segment, commands: Sequence[Mapping[str, Any]], all_rows: _Rows) -> Segment:
    """A trial shortened before its first and after its last command to the time with an unchanged operating point.

    Between two trials a weight is exchanged and entered: that change belongs to neither trial.
    """
    if not commands:
        return part
    first, last = commands[0]["t"], commands[-1]["t"]
    if commands[-1]["type"] == "ramp":
        last += abs(commands[-1]["value"] - commands[-1]["before"]) / commands[-1]["rate"]
    t, begin, end = all_rows.t, part.begin, part.end
    for column in all_rows.points.values():
        rows = np.flatnonzero(all_rows.between(part) & np.isfinite(column))
        for n in np.flatnonzero(np.diff(column[rows])):
            before, after = float(t[rows[n]]), float(t[rows[n + 1]])
            if after <= first:
                begin = max(begin, after)
            elif before >= last:
                end = min(end, before)
    return replace(part, begin=begin, end=end)


def _by_step(rows: _Rows) -> list[Segment]:
    steps, lead, (begin, end) = rows.steps(), rows.rules.trials.lead, rows.whole
    parts = []
    for step, until in zip(steps, [*(step.t - lead - 1e-5 for step in steps[1:]), end], strict=False):
        point = {**rows.point, "from": step.before, "pressure": step.value}
        parts.append(Segment(max(step.t - lead, begin), until, point, (rows.command(step),)))
    return parts


def _by_level(rows: _Rows) -> list[Segment]:
    """Stretches of constant pressure, from the end of one step to the begin of the next."""
    (begin, end), changes = rows.whole, rows.found(motion.levels, rows.driven)
    begins = [begin, *(change.settled for change in changes)]
    ends = [*(change.t - 1e-5 for change in changes), end]
    return [Segment(at, until, rows.point) for at, until in zip(begins, ends, strict=True)]


def _by_ramp(rows: _Rows) -> list[Segment]:
    """Rises of the measured pressure, `fill`, each with the fall after it, `exhaust`.

    For tests whose phases come from commands, trials include half of the rest before the rise and after the fall.
    """
    seen = rows.rising & ((rows.flags & np.uint16(Flag.OVERRANGE)) == 0)
    cycles = motion.cycles(rows.t[seen], rows.values["pressure"][seen], rows.smallest)
    if cycles and not rows.rules.test.recording:
        begin, end = rows.whole
        cuts = [begin, *(0.5 * (one.end + after.begin) for one, after in pairwise(cycles)), end]
        return [Segment(cut, until - 1e-5, rows.point) for cut, until in pairwise(cuts)]
    named = "phase" in rows.values or bool(rows.rules.trials.phases)
    parts = []
    for cycle in cycles:
        own = ((cycle.begin, "fill"), *(((cycle.turn, "exhaust"),) if cycle.end > cycle.turn else ()))
        parts.append(Segment(cycle.begin, cycle.end, rows.point, phases=() if named else own))
    return parts


def _by_sine(rows: _Rows) -> list[Segment]:
    """Stretches of one sine of the command, else of the measured pressure; the point is its frequency."""
    parts = []
    for wave in rows.found(motion.waves, rows.driven):
        point = {**rows.point, "frequency": float(f"{wave.frequency:.4g}")}
        parts.append(Segment(wave.begin, wave.end, point, (sine_command(wave, "pressure"),)))
    return parts


def _by_gap(rows: _Rows) -> list[Segment]:
    commands = rows.commanded_steps()
    cuts = np.flatnonzero(np.diff(rows.t) > (rows.rules.trials.longer_than or np.inf)) + 1
    parts = []
    for part in np.split(np.arange(len(rows.t)), cuts):
        begin, end = float(rows.t[part].min()), float(rows.t[part].max())
        length = _length(rows, part)
        inside = tuple(command for command in commands if begin < command["t"] <= end)
        parts.append(Segment(begin, end, {**rows.point, **length}, inside, measured=tuple(length)))
    return parts


def _by_file(rows: _Rows) -> list[Segment]:
    wanted = "contraction" in rows.rules.test.point and "contraction" not in rows.point
    length = _length(rows, np.arange(len(rows.t))) if wanted else {}
    point = {**rows.point, **length}
    open_frequency = "frequency" in rows.rules.test.point and "frequency" not in point
    seen = rows.rising
    if open_frequency and (frequency := motion.only_sine(rows.t[seen], rows.values[rows.driven][seen])):
        point["frequency"] = frequency
    steps = [] if open_frequency else rows.commanded_steps()
    return [Segment(*rows.whole, point, tuple(steps or rows.sine(point.get("frequency", 0.0))), measured=tuple(length))]


def _by_column(rows: _Rows) -> list[Segment]:
    """Stretches with one number in the column of trials; 0 and NaN are no trial."""
    number = np.where(np.isfinite(rows.values["trial"]), rows.values["trial"], 0.0)
    edges = np.flatnonzero(np.diff(number, prepend=0.0, append=0.0))
    parts = (rows.t[first:last] for first, last in pairwise(edges) if number[first] != 0)
    return [Segment(float(t.min()), float(t.max()), rows.point) for t in parts]


def _by_command(rows: _Rows) -> list[Segment]:
    """From each rise of the pressure command out of its lowest level, with `lead` before it, to the next."""
    steps, lead, (begin, end) = rows.steps(), rows.rules.trials.lead, rows.whole
    lowest = min((min(step.before, step.value) for step in steps), default=0.0)
    begins = [step.t - lead for step in steps if step.before < lowest + rows.smallest < step.value]
    ends = [following - 1e-5 for following in begins[1:]] + [end]
    return [Segment(max(at, begin), until, rows.point) for at, until in zip(begins, ends, strict=False)]


CUTS: Mapping[str, Callable[[_Rows], list[Segment]]] = {
    "step": _by_step,
    "level": _by_level,
    "ramp": _by_ramp,
    "sine": _by_sine,
    "gap": _by_gap,
    "file": _by_file,
    "column": _by_column,
    "command": _by_command,
}
"""`by` of the map -> function that cuts a file into trials."""


def _length(rows: _Rows, part: NDArray[np.intp]) -> dict[str, float]:
    """Contraction at which a part was held [m]; empty without a displacement."""
    usable = part[(rows.flags[part] & np.uint16(UNUSABLE)) == 0]
    if "displacement" not in rows.values or not len(usable):
        return {}
    return {"contraction": float(np.median(rows.values["displacement"][usable]))}


def _phases(rows: _Rows) -> list[tuple[float, str]]:
    """Begin [s] and name of each phase, from the phase column, else from the times in the map."""
    column = rows.rules.column("phase")
    if column is not None and "phase" in rows.values and rows.good.any():
        marks, times = rows.values["phase"][rows.good], rows.t[rows.good]
        first = np.concatenate([[True], marks[1:] != marks[:-1]])
        begins = zip(times[first].tolist(), marks[first].tolist(), strict=True)
        return [(at, column.marks[mark]) for at, mark in begins if mark in column.marks]
    return [(max(rows.whole[0], at), name) for name, at in rows.rules.trials.phases.items()]
