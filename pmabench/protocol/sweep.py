"""Sweeps: matrix, zip or concat of lists and ranges, with order and repeats, expanded in advance and limited in size.

Also trials in which nothing can move, predicted from the specimen's expected values, and a sweep without them.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, product
from math import prod
from textwrap import wrap
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import Discriminator, Field, Tag, model_validator

from pmabench.base.errors import InvalidFile, Problem, UsageError
from pmabench.base.quantities import show
from pmabench.bench.files.specimen import ExpectedFile
from pmabench.files.document import Document, Location, Strict
from pmabench.files.quantity import Angle, AngularSpeed, Frequency, Length, Pressure, Speed
from pmabench.protocol.driven import believed
from pmabench.protocol.plan import Plan

MOST_POINTS = 20_000

Axes = TypeVar("Axes", bound=Strict)


class PressureRange(Strict):
    """Pressures from start to stop, both included, in equal steps."""

    start: Pressure
    stop: Pressure
    step: Pressure

    def values(self) -> list[float]:
        """The pressures [Pa]; ValueError where the step does not lead from start to stop."""
        if self.step <= 0:
            raise ValueError("the step must be above zero")
        count = abs(self.stop - self.start) / self.step
        if count > MOST_POINTS:
            raise ValueError(f"makes {count + 1:.0f} values; at most {MOST_POINTS} are allowed")
        if abs(count - round(count)) > 1e-6:
            raise ValueError("the step does not lead from start to stop in whole steps")
        sign = 1.0 if self.stop >= self.start else -1.0
        return [self.start + sign * index * self.step for index in range(round(count) + 1)]


def _shape(value: object) -> str:
    return "range" if isinstance(value, dict) else "list"


PressureAxis = Annotated[
    Annotated[Annotated[list[Pressure], Field(min_length=1)], Tag("list")] | Annotated[PressureRange, Tag("range")],
    Discriminator(_shape),
]
FrequencyAxis = Annotated[list[Frequency], Field(min_length=1)]
LengthAxis = Annotated[list[Length], Field(min_length=1)]
SpeedAxis = Annotated[list[Speed], Field(min_length=1)]
AngleAxis = Annotated[list[Angle], Field(min_length=1)]
AngularSpeedAxis = Annotated[list[AngularSpeed], Field(min_length=1)]


class Repeat(Strict):
    """Number of repeats, and whether the whole grid is repeated or each point."""

    count: Annotated[int, Field(ge=1, le=1000)] = 1
    as_: Annotated[Literal["blocks", "adjacent"], Field(alias="as")] = "blocks"


class Sweep(Strict, Generic[Axes]):
    """One of matrix (every combination, first axis outermost), zip (pairwise) or concat (one after another)."""

    matrix: Axes | None = None
    zip: Axes | None = None
    concat: list[Sweep[Axes]] | None = None
    order: Literal["as-written", "snake", "random"] = "as-written"
    seed: int = 0
    repeat: Repeat = Repeat()

    @model_validator(mode="after")
    def _one_form(self) -> Sweep[Axes]:
        if sum(form is not None for form in (self.matrix, self.zip, self.concat)) != 1:
            raise ValueError("a sweep has exactly one of matrix, zip, concat")
        return self


@dataclass(frozen=True)
class Point:
    """One operating point of a sweep: values by axis [SI], the place of each in the file, and the repeat's number."""

    values: dict[str, Any]
    places: dict[str, Location]
    repeat: int = 0


def expand(sweep: Sweep[Any], document: Document, at: Location = ("sweep",)) -> list[Point]:
    """Every point of the sweep in the order of execution; `InvalidFile` for too many points or unequal lists."""
    points = list(_once(sweep, document, at))
    if len(points) * sweep.repeat.count > MOST_POINTS:
        total = len(points) * sweep.repeat.count
        raise InvalidFile([document.problem(at, f"makes {total} trials; at most {MOST_POINTS} are allowed")])
    if sweep.repeat.as_ == "adjacent":
        ordered = _ordered(points, sweep, 0)
        return [Point(p.values, p.places, repeat) for p in ordered for repeat in range(sweep.repeat.count)]
    return [
        Point(p.values, p.places, repeat)
        for repeat in range(sweep.repeat.count)
        for p in _ordered(points, sweep, repeat)
    ]


def _once(sweep: Sweep[Any], document: Document, at: Location) -> Iterator[Point]:
    if sweep.concat is not None:
        total = 0
        for index, part in enumerate(sweep.concat):
            points = expand(part, document, (*at, "concat", index))
            total += len(points)
            if total > MOST_POINTS:
                raise InvalidFile([document.problem(at, f"makes more than {MOST_POINTS} trials")])
            yield from points
        return
    form = "matrix" if sweep.matrix is not None else "zip"
    axes = _axes(getattr(sweep, form), document, (*at, form))
    lengths = [len(values) for values, _ in axes.values()]
    if form == "zip":
        if len(set(lengths)) > 1:
            shown = ", ".join(f"{name} {len(values)}" for name, (values, _) in axes.items())
            raise InvalidFile([document.problem((*at, form), f"lists of unlike length: {shown}")])
        combinations: Iterator[tuple[int, ...]] = ((i,) * len(axes) for i in range(lengths[0]))
    else:
        if prod(lengths) > MOST_POINTS:
            problem = f"makes {prod(lengths)} trials; at most {MOST_POINTS} are allowed"
            raise InvalidFile([document.problem((*at, form), problem)])
        combinations = product(*(range(length) for length in lengths))
    for indices in combinations:
        chosen = dict(zip(axes, indices, strict=True))
        yield Point(
            {name: axes[name][0][i] for name, i in chosen.items()},
            {name: axes[name][1](i) for name, i in chosen.items()},
        )


def _axes(model: Strict, document: Document, at: Location) -> dict[str, tuple[list[Any], Callable[[int], Location]]]:
    """Axes in the order of the file: values [SI], and a function that gives the place of the i-th value."""
    written: Any = document.data
    for part in at:
        written = written[part]
    found: dict[str, tuple[list[Any], Callable[[int], Location]]] = {}
    problems: list[Problem] = []
    for name in [*written, *(name for name in type(model).model_fields if name not in written)]:
        axis = getattr(model, name)
        if axis is None:
            continue
        place: Location = (*at, name)
        if isinstance(axis, PressureRange):
            try:
                found[name] = (axis.values(), lambda _i, place=place: place)  # type: ignore[misc]
            except ValueError as error:
                problems.append(document.problem(place, str(error)))
        else:
            found[name] = (list(axis), lambda i, place=place: (*place, i))  # type: ignore[misc]
    if problems:
        raise InvalidFile(problems)
    return found


def _ordered(points: list[Point], sweep: Sweep[Any], repeat: int) -> list[Point]:
    if sweep.order == "random":
        shuffled = list(points)
        random.Random(f"{sweep.seed}/{repeat}").shuffle(shuffled)
        return shuffled
    if sweep.order == "snake" and sweep.matrix is not None and points:
        outer = next(iter(points[0].values))
        rows = [list(row) for _, row in groupby(points, key=lambda point: point.values[outer])]
        if repeat % 2:
            rows.reverse()
        return [p for index, row in enumerate(rows) for p in (row[::-1] if index % 2 else row)]
    return points


STATIC = 1.5
"""Assumed ratio of static to Coulomb friction: strands of a braid stick a little before they slide."""
DOUBTFUL = 2.0
"""With a margin below this many times the Coulomb friction the load may not move."""
KEPT = "\u00a0"
"""No-break space: keeps a value and its unit on one line."""


@dataclass(frozen=True)
class Idle:
    """Trials of a plan that cannot, or may not, lift their load."""

    idle: tuple[int, ...]
    """Indices of trials whose force does not exceed load and static friction."""
    doubtful: tuple[int, ...]
    """Indices of trials whose margin of force may be lost to friction."""

    @property
    def all(self) -> frozenset[int]:
        """Trials that are better left out."""
        return frozenset((*self.idle, *self.doubtful))


def idle_trials(plan: Plan, expected: ExpectedFile) -> Idle:
    """Trials that cannot lift their load: F_ce(P) - F_s <= F_L, with the static friction F_s.

    F_ce beyond the expected points is extrapolated (`force_at`).
    """
    static = STATIC * expected.F_c
    idle, doubtful = [], []
    for trial in plan.trials:
        if not {"load", "pressure"} <= set(trial.point):
            continue
        margin = force_at(expected, trial.point["pressure"]) - trial.point["load"]
        if margin <= static:
            idle.append(trial.index)
        elif margin < DOUBTFUL * expected.F_c:
            doubtful.append(trial.index)
    return Idle(tuple(idle), tuple(doubtful))


def force_at(expected: ExpectedFile, pressure: float) -> float:
    """F_ce [N] at a pressure [Pa]: linear between the expected points, extrapolated beyond them, never below 0."""
    points = sorted(expected.points, key=lambda point: point.pressure)
    if len(points) > 1 and not points[0].pressure <= pressure <= points[-1].pressure:
        one, two = points[:2] if pressure < points[0].pressure else points[-2:]
        slope = (two.F_ce - one.F_ce) / (two.pressure - one.pressure)
        return float(max(0.0, one.F_ce + slope * (pressure - one.pressure)))
    return believed(expected, pressure).F_ce


def without(document: Document, sweep: Any, text: str, left_out: Iterable[int]) -> str:
    """The protocol's `text` with a `zip` of the remaining points as its sweep, in the order of the first repeat.

    A point is left out if all its repeats are. Raises UsageError where no point remains, or the protocol has no `sweep`
    section to replace.
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
    """The protocol's `text` with its sweep replaced by a `zip` of the points `trials`, in this order.

    `trials` are indices of points in the order of the sweep, and may repeat. Raises UsageError as `without` does.
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
    """The value of an axis as written in the file; one from a range with its display unit."""
    data: Any = document.data
    for part in point.places[name]:
        data = data[part]
    return show(point.values[name], "pressure") if isinstance(data, dict) else str(data)
