"""Cuts an old file into trials: steps of its command, gaps in its time, or the whole; pure functions of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmabench.store.importers.map_rules import ImportMap
from pmabench.store.records import UNUSABLE, Array, Flag, Flags


@dataclass(frozen=True)
class Segment:
    """One trial: from `begin` to `end` [s], its point [SI], its commands and the phases that begin in it."""

    begin: float
    end: float
    point: Mapping[str, float]
    commands: tuple[Mapping[str, Any], ...] = ()
    """As data of `command` events, with `t`."""
    phases: tuple[tuple[float, str], ...] = field(default=())


@dataclass(frozen=True)
class _Step:
    t: float
    before: float
    value: float
    within: float
    """The step happened in this time before `t` [s]."""

    def command(self) -> dict[str, Any]:
        return {
            "t": self.t,
            "output": "pressure",
            "type": "set",
            "value": self.value,
            "before": self.before,
            "phase": "step",
            "within": self.within,
        }


def segments(
    t: Array, values: Mapping[str, Array], flags: Flags, rules: ImportMap, point: Mapping[str, float]
) -> list[Segment]:
    """The trials of one file; `t` [s], `values` [SI] by channel (and `phase`) and `flags` have shape (n,).

    Steps and phases are looked for among samples that are neither dropouts nor out of time.
    """
    good = (flags & np.uint16(Flag.DROPOUT | Flag.TIME_JUMP)) == 0
    phases = _phases(t, values, good, rules)
    command = values.get("pressure_command")
    smallest = rules.trials.smallest
    steps = [] if command is None or smallest is None else _steps(t[good], command[good], smallest)
    spans: list[tuple[float, float, dict[str, float], list[Mapping[str, Any]]]] = []
    if rules.trials.by == "step":
        lead = rules.trials.lead
        ends = [step.t - lead - 1e-5 for step in steps[1:]] + [float(t.max())]
        for step, end in zip(steps, ends, strict=False):
            here = {**point, "from": step.before, "pressure": step.value}
            spans.append((max(step.t - lead, float(t.min())), end, here, [step.command()]))
    elif rules.trials.by == "gap":
        cuts = np.flatnonzero(np.diff(t) > (rules.trials.longer_than or np.inf)) + 1
        for rows in np.split(np.arange(len(t)), cuts):
            begin, end = float(t[rows].min()), float(t[rows].max())
            measured = _measured(values, flags, rows)
            inside: list[Mapping[str, Any]] = [step.command() for step in steps if begin < step.t <= end]
            spans.append((begin, end, {**point, **measured}, inside))
    else:
        commands = [step.command() for step in steps] or _sine(t[good], command, good, point)
        spans.append((float(t.min()), float(t.max()), dict(point), list(commands)))
    return [
        Segment(begin, end, here, tuple(commands), tuple(p for p in phases if begin <= p[0] <= end))
        for begin, end, here, commands in spans
    ]


def _steps(t: Array, command: Array, smallest: float) -> list[_Step]:
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
