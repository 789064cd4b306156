"""Cuts an old file into trials: steps, ramps or sines, gaps in its time, or the whole; pure functions of arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from pmabench.base.quantities import CHANNEL_QUANTITY
from pmabench.store.importers import commanded, motion
from pmabench.store.importers.map_rules import G, ImportMap
from pmabench.store.records import UNUSABLE, Array, Flag, Flags

RECORDED = ("isometric", "recorded-step", "recorded-sine", "recorded-pull")
"""Kinds of recordings; the others are tests of this program."""
LOADED = ("contraction-relaxation", "static-load")
"""Kinds whose trials each hang from a load."""
POINT = "point of "


@dataclass(frozen=True)
class Segment:
    """One trial: from `begin` to `end` [s], its point [SI], its commands and the phases that begin in it."""

    begin: float
    end: float
    point: Mapping[str, float]
    commands: tuple[Mapping[str, Any], ...] = ()
    """As data of `command` events, with `t`."""
    phases: tuple[tuple[float, str], ...] = field(default=())
    found: tuple[Mapping[str, Any], ...] = ()
    """As data of `found` events, with `t`."""


@dataclass(frozen=True)
class _Step:
    t: float
    before: float
    value: float
    within: float
    """The step happened in this time before `t` [s]."""
    found: bool = False
    """It was found in the measured pressure; nobody recorded the command."""

    def command(self) -> dict[str, Any]:
        told = {
            "t": self.t,
            "output": "pressure",
            "type": "set",
            "value": self.value,
            "before": self.before,
            "phase": "step",
            "within": self.within,
        }
        return {**told, "found": 1.0} if self.found else told


_Span = tuple[float, float, dict[str, float], list[Mapping[str, Any]], list[tuple[float, str]]]
"""Begin and end [s], point, commands, phases of its own."""


def segments(
    t: Array, values: Mapping[str, Array], flags: Flags, rules: ImportMap, point: Mapping[str, float]
) -> tuple[list[Segment], list[str]]:
    """The trials of one file, and sentences about what is doubtful in them.

    `t` [s], `values` [SI] by channel (and `phase`, `trial`, `point of NAME`) and `flags` have shape (n,). Steps, ramps,
    sines and phases are looked for among samples that are neither dropouts nor spikes nor out of time.
    """
    good = _good(t, flags)
    phases = _phases(t, values, good, rules)
    cut = {
        "step": _by_step,
        "ramp": _by_ramp,
        "sine": _by_sine,
        "gap": _by_gap,
        "file": _by_file,
        "column": _by_column,
        "command": _by_command,
    }[rules.trials.by]
    found = [
        Segment(begin, end, here, tuple(commands), tuple(own or (p for p in phases if begin <= p[0] <= end)))
        for begin, end, here, commands, own in cut(t, values, flags, good, rules, point)
    ]
    if rules.kind in RECORDED:
        return found, []
    return _as_own(found, t, values, good & _later(t), rules)


def _as_own(
    found: Sequence[Segment], t: Array, values: Mapping[str, Array], good: Any, rules: ImportMap
) -> tuple[list[Segment], list[str]]:
    """The trials with commands and operating points as a test of the program's own has them.

    The operating point is what the map says, else what its columns say, else what the commands say.
    """
    parts: list[Segment] = []
    doubts: list[str] = []
    loads: dict[int, float] = {}
    hanging = 0
    channels = {name: column for name, column in values.items() if name in CHANNEL_QUANTITY}
    for number, part in enumerate(found):
        rows = good & (t >= part.begin - 1e-9) & (t <= part.end + 1e-9)
        mine = {name: column[rows] for name, column in channels.items()}
        commands, told = commanded.read(rules.kind, t[rows], mine, rules.trials.smallest)
        columns: dict[str, float] = {}
        for name, column in values.items():
            if not name.startswith(POINT):
                continue
            here = column[rows][np.isfinite(column[rows])]
            if len(here) and np.ptp(here) <= 1e-6 * float(np.abs(here).max()):
                columns[name.removeprefix(POINT)] = float(here[0])
            elif len(here):
                low, high = float(here.min()), float(here.max())
                doubts.append(
                    f"trial {number + 1}: the column of {name.removeprefix(POINT)} goes from {low:.6g} to {high:.6g} "
                    "[SI] within it, so it is not taken: cut the file into trials in which it is the same"
                )
        point = {**told, **columns, **part.point}
        if rules.kind in LOADED and "load" in point and "mass" not in point:
            point["mass"] = point["load"] / G
            hanging += "force" not in mine
        if rules.kind in LOADED and "load" not in point and "force" in mine:
            load = commanded.cell_load(t[rows], mine["force"], commands)
            if load is not None:
                loads[number] = load
        searched = commanded.lift_and_set_down(t[rows], mine) if rules.kind == "static-load" else []
        parts.append(replace(part, point=point, commands=tuple(commands) or part.commands, found=tuple(searched)))
    if hanging:
        doubts.append(
            f"the moving mass of {hanging} trials is not given, so that of the load is taken; what moves with it "
            "(hanger, carriage) belongs to it: a column or `point: {mass: ...}` gives it"
        )
    for number, load in zip(loads, commanded.alike(list(loads.values())), strict=True):
        parts[number] = replace(parts[number], point={"mass": load / G, **parts[number].point, "load": load})
    return parts, doubts


def _good(t: Array, flags: Flags) -> Any:
    """Samples that tell what happened, in the order of time; a file of which most is suspect is taken as it is."""
    wrong = Flag.DROPOUT | Flag.TIME_JUMP
    suspect = (flags & np.uint16(Flag.SUSPECT)) != 0
    if suspect.mean() < 0.5:
        wrong |= Flag.SUSPECT
    return (flags & np.uint16(wrong)) == 0


def _by_step(
    t: Array, values: Mapping[str, Array], flags: Flags, good: Any, rules: ImportMap, point: Mapping[str, float]
) -> list[_Span]:
    steps, lead = _steps(t, values, good, rules.trials.smallest), rules.trials.lead
    ends = [step.t - lead - 1e-5 for step in steps[1:]] + [float(t.max())]
    return [
        (
            max(step.t - lead, float(t.min())),
            end,
            {**point, "from": step.before, "pressure": step.value},
            [step.command()],
            [],
        )
        for step, end in zip(steps, ends, strict=False)
    ]


def _by_ramp(
    t: Array, values: Mapping[str, Array], flags: Flags, good: Any, rules: ImportMap, point: Mapping[str, float]
) -> list[_Span]:
    """Rises of the measured pressure, `fill`, each with the fall after it, `exhaust`."""
    rises = good & ((flags & np.uint16(Flag.OVERRANGE)) == 0) & _later(t)
    spans: list[_Span] = []
    for cycle in motion.cycles(t[rises], values["pressure"][rises], rules.trials.smallest or 0.0):
        own = [(cycle.begin, "fill"), *([(cycle.turn, "exhaust")] if cycle.end > cycle.turn else [])]
        marked = rules.column("phase") is not None and "phase" in values
        spans.append((cycle.begin, cycle.end, dict(point), [], [] if marked or rules.trials.phases else own))
    return spans


def _by_sine(
    t: Array, values: Mapping[str, Array], flags: Flags, good: Any, rules: ImportMap, point: Mapping[str, float]
) -> list[_Span]:
    """Stretches of one frequency, which is the point; of the command, else of the measured pressure."""
    channel = "pressure_command" if "pressure_command" in values else "pressure"
    rises = good & _later(t)
    spans: list[_Span] = []
    for wave in motion.waves(t[rises], values[channel][rises], rules.trials.smallest or 0.0):
        command = {
            "t": wave.begin,
            "output": "pressure",
            "type": "sine",
            "value": wave.mean,
            "before": wave.mean,
            "phase": "sine",
            "amplitude": wave.amplitude,
            "frequency": wave.frequency,
            "cycles": (wave.end - wave.begin) * wave.frequency,
        }
        spans.append((wave.begin, wave.end, {**point, "frequency": float(f"{wave.frequency:.4g}")}, [command], []))
    return spans


def _by_gap(
    t: Array, values: Mapping[str, Array], flags: Flags, good: Any, rules: ImportMap, point: Mapping[str, float]
) -> list[_Span]:
    steps = _steps(t, values, good, rules.trials.smallest) if "pressure_command" in values else []
    cuts = np.flatnonzero(np.diff(t) > (rules.trials.longer_than or np.inf)) + 1
    spans: list[_Span] = []
    for rows in np.split(np.arange(len(t)), cuts):
        begin, end = float(t[rows].min()), float(t[rows].max())
        inside: list[Mapping[str, Any]] = [step.command() for step in steps if begin < step.t <= end]
        spans.append((begin, end, {**point, **_measured(values, flags, rows)}, inside, []))
    return spans


def _by_file(
    t: Array, values: Mapping[str, Array], flags: Flags, good: Any, rules: ImportMap, point: Mapping[str, float]
) -> list[_Span]:
    steps = _steps(t, values, good, rules.trials.smallest) if "pressure_command" in values else []
    told: list[Mapping[str, Any]] = [step.command() for step in steps]
    if rules.kind == "recorded-sine" and "frequency" not in point:
        return _longest_sine(t, values, good, point)
    if rules.kind == "isometric":
        point = {**_measured(values, flags, np.arange(len(t))), **point}
    commands = told or list(_sine(t[good], values.get("pressure_command"), good, point))
    return [(float(t.min()), float(t.max()), dict(point), commands, [])]


def _by_column(
    t: Array, values: Mapping[str, Array], flags: Flags, good: Any, rules: ImportMap, point: Mapping[str, float]
) -> list[_Span]:
    """Where the column of trials holds the same number for a while; 0 and no number are no trial."""
    number = np.where(np.isfinite(values["trial"]), values["trial"], 0.0)
    edges = np.flatnonzero(np.diff(number, prepend=0.0, append=0.0))
    return [
        (float(t[first:last].min()), float(t[first:last].max()), dict(point), [], [])
        for first, last in pairwise(edges)
        if number[first] != 0
    ]


def _by_command(
    t: Array, values: Mapping[str, Array], flags: Flags, good: Any, rules: ImportMap, point: Mapping[str, float]
) -> list[_Span]:
    """From each rise of the pressure command out of its lowest level, with `lead` before it, to the next."""
    steps, lead = _steps(t, values, good, rules.trials.smallest), rules.trials.lead
    if not steps:
        return []
    smallest = rules.trials.smallest or 0.0
    lowest = min(min(step.before, step.value) for step in steps)
    begins = [step.t - lead for step in steps if step.before < lowest + smallest < step.value]
    ends = [begin - 1e-5 for begin in begins[1:]] + [float(t.max())]
    return [(max(begin, float(t.min())), end, dict(point), [], []) for begin, end in zip(begins, ends, strict=True)]


def _longest_sine(t: Array, values: Mapping[str, Array], good: Any, point: Mapping[str, float]) -> list[_Span]:
    """The whole file, with the frequency that it shows where it is one sine."""
    channel = "pressure_command" if "pressure_command" in values else "pressure"
    rises = good & _later(t)
    seen = values[channel][rises]
    waves = motion.waves(t[rises], seen, 0.25 * float(np.ptp(seen))) if rises.any() else []
    whole = 0.8 * float(t.max() - t.min())
    found = [wave for wave in waves if wave.end - wave.begin > whole]
    here = {**point, "frequency": float(f"{found[0].frequency:.5g}")} if len(found) == 1 else dict(point)
    commands: list[Mapping[str, Any]] = [*_sine(t[good], values.get("pressure_command"), good, here)]
    return [(float(t.min()), float(t.max()), here, commands, [])]


def _later(t: Array) -> Any:
    """Samples that lie later than all before them."""
    return np.concatenate([[True], t[1:] > np.maximum.accumulate(t)[:-1]])


def _steps(t: Array, values: Mapping[str, Array], good: Any, smallest: float | None) -> list[_Step]:
    """Steps of the command; where none was recorded those of the measured pressure, to a fourth of `smallest`."""
    if smallest is None:
        return []
    command = values.get("pressure_command")
    if command is None:
        rises = good & _later(t)
        grid = smallest / 4
        return [
            _Step(each.t, round(each.before / grid) * grid, round(each.value / grid) * grid, each.within, found=True)
            for each in motion.levels(t[rises], values["pressure"][rises], smallest)
        ]
    t, command = t[good], command[good]
    at = np.flatnonzero(np.abs(np.diff(command)) >= smallest) + 1
    return [_Step(float(t[i]), float(command[i - 1]), float(command[i]), float(t[i] - t[i - 1])) for i in at]


def _sine(t: Array, command: Array | None, good: Any, point: Mapping[str, float]) -> list[dict[str, Any]]:
    """A sine of known frequency: mean and amplitude from the ends of the command."""
    frequency = point.get("frequency", 0.0)
    if command is None or frequency <= 0 or len(t) == 0:
        return []
    low, high = float(command[good].min()), float(command[good].max())
    return [
        {
            "t": float(t[0]),
            "output": "pressure",
            "type": "sine",
            "value": (low + high) / 2,
            "before": float(command[good][0]),
            "phase": "sine",
            "amplitude": (high - low) / 2,
            "frequency": frequency,
            "cycles": float(t[-1] - t[0]) * frequency,
        }
    ]


def _measured(values: Mapping[str, Array], flags: Flags, rows: Any) -> dict[str, float]:
    """The contraction at which a part was held, where the file has a displacement."""
    usable = (flags[rows] & np.uint16(UNUSABLE)) == 0
    if "displacement" not in values or not usable.any():
        return {}
    return {"contraction": float(np.median(values["displacement"][rows][usable]))}


def _phases(t: Array, values: Mapping[str, Array], good: Any, rules: ImportMap) -> list[tuple[float, str]]:
    """When each phase begins [s]: from the column that marks it, else from the map's times."""
    column = rules.column("phase")
    if column is not None and "phase" in values and good.any():
        marks, times = values["phase"][good], t[good]
        first = np.concatenate([[True], marks[1:] != marks[:-1]])
        return [
            (float(at), column.marks[float(mark)])
            for at, mark in zip(times[first], marks[first], strict=True)
            if float(mark) in column.marks
        ]
    begin = float(t.min())
    return [(max(begin, at), name) for name, at in rules.trials.phases.items()]
