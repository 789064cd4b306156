"""Trials in which nothing can move, predicted from what is expected of the specimen; and the protocol without them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from textwrap import wrap
from typing import Any

from pmabench.base.errors import UsageError
from pmabench.base.quantities import show
from pmabench.bench.files.specimen import ExpectedFile
from pmabench.files.document import Document
from pmabench.protocol.driven import believed
from pmabench.protocol.plan import Plan, TrialRecord
from pmabench.protocol.sweep import Point, expand

STATIC = 1.5
"""Static over Coulomb friction, where nothing is known of it: strands of a braid stick a little before they slide."""
DOUBTFUL = 2.0
"""A margin of fewer times the Coulomb friction than this may not move the load."""
KEPT = "\u00a0"
"""A value and its unit are on one line."""


@dataclass(frozen=True)
class Idle:
    """What a plan cannot do."""

    idle: tuple[int, ...]
    """Indices of trials whose force does not reach the load."""
    doubtful: tuple[int, ...]
    """Indices of trials that lift by a margin that friction may take."""
    first: str
    """The first idle trial in words; empty without."""

    @property
    def all(self) -> frozenset[int]:
        """Trials that are better left out."""
        return frozenset((*self.idle, *self.doubtful))


def idle_trials(plan: Plan, expected: ExpectedFile) -> Idle:
    """Trials at a load and a pressure that cannot lift it: F_ce(P) - F_s at most F_L (static friction).

    F_ce beyond the expected points is that of the last one's line (`force_at`).
    """
    static = STATIC * expected.F_c
    idle, doubtful, first = [], [], ""
    for trial in plan.trials:
        if not {"load", "pressure"} <= set(trial.point):
            continue
        margin = force_at(expected, trial.point["pressure"]) - trial.point["load"]
        if margin <= static:
            idle.append(trial.index)
            first = first or _words(trial, expected, static)
        elif margin < DOUBTFUL * expected.F_c:
            doubtful.append(trial.index)
    return Idle(tuple(idle), tuple(doubtful), first)


def force_at(expected: ExpectedFile, pressure: float) -> float:
    """F_ce [N] at a pressure [Pa], by straight lines, beyond the points straight on, never below 0."""
    points = sorted(expected.points, key=lambda point: point.pressure)
    if len(points) > 1 and not points[0].pressure <= pressure <= points[-1].pressure:
        one, two = points[:2] if pressure < points[0].pressure else points[-2:]
        slope = (two.F_ce - one.F_ce) / (two.pressure - one.pressure)
        return float(max(0.0, one.F_ce + slope * (pressure - one.pressure)))
    return believed(expected, pressure).F_ce


def _words(trial: TrialRecord, expected: ExpectedFile, static: float) -> str:
    load, pressure = trial.point["load"], trial.point["pressure"]
    known = sorted((point.pressure, point.F_ce) for point in expected.points)
    enough = next(
        (P0 + (load + static - F0) * (P1 - P0) / (F1 - F0)
         for (P0, F0), (P1, F1) in pairwise(known) if F0 < load + static <= F1),
        None,
    )  # fmt: skip
    needs = f"needs {show(enough, 'pressure', 3)}" if enough else "is more than is expected of it at any pressure"
    return f"trial {trial.index + 1}: {show(load, 'force', 3)} {needs}, commanded are {show(pressure, 'pressure', 3)}"


def without(document: Document, sweep: Any, text: str, left_out: Iterable[int]) -> str:
    """The protocol's `text` with a sweep of the points that are left, pair by pair, in the order of its first repeat.

    A point is left out where all its repeats are. Raises UsageError where nothing is left, or the protocol has no
    `sweep` that can be written so.
    """
    points = expand(sweep, document)
    count = sweep.repeat.count
    gone = set(left_out)
    by_point: dict[tuple[tuple[str, Any], ...], list[int]] = {}
    for index, point in enumerate(points):
        by_point.setdefault(tuple(point.values.items()), []).append(index)
    first = {places[0]: points[places[0]] for places in by_point.values() if not set(places) <= gone}
    kept = [first[index] for index in sorted(first)]
    repeat = f"{{count: {count}, as: {sweep.repeat.as_}}}"
    return _with_points(document, text, kept, "trials that can move, in their order", repeat)


def chosen(document: Document, sweep: Any, text: str, trials: Sequence[int]) -> str:
    """The protocol's `text` with a sweep of some of its points in this order, pair by pair; one may come several times.

    `trials` are numbers of points in the order of the sweep. Raises UsageError as `without` does.
    """
    points = expand(sweep, document)
    return _with_points(document, text, [points[n] for n in trials], "trials that were chosen, in their order", "")


def _with_points(document: Document, text: str, kept: Sequence[Point], why: str, repeat: str) -> str:
    block = re.search(r"^sweep:.*?(?=^\S|\Z)", text, re.MULTILINE | re.DOTALL)
    if not kept or block is None:
        raise UsageError("no trial would be left" if not kept else "this protocol has no sweep that can be shortened")
    lines = ["sweep:", f"  zip:                                         # {why}"]
    for name in kept[0].values:
        values = ", ".join(_written(document, point, name).replace(" ", KEPT) for point in kept)
        listed = wrap(f"{name}: [{values}]", 110, initial_indent="    ", subsequent_indent="      ")
        lines += [line.replace(KEPT, " ") for line in listed]
    lines += [f"  repeat: {repeat}"] if repeat else []
    return text[: block.start()] + "\n".join(lines) + "\n\n" + text[block.end() :]


def _written(document: Document, point: Point, name: str) -> str:
    """The value of an axis as the file has it; one of a range in its unit."""
    data: Any = document.data
    for part in point.places[name]:
        data = data[part]
    return show(point.values[name], "pressure") if isinstance(data, dict) else str(data)
