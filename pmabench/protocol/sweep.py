"""Sweeps: matrix, zip or concat of explicit lists and ranges, ordered and repeated, expanded statically and bounded."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby, product
from math import prod
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import Discriminator, Field, Tag, model_validator

from pmabench.base.errors import InvalidFile, Problem
from pmabench.base.quantities import show
from pmabench.files.document import Document, Location, Strict
from pmabench.files.quantity import Angle, AngularSpeed, Frequency, Length, Pressure, Speed

MOST_POINTS = 20_000
USUAL_POINTS = 60
"""A range of more values than this gets a warning: its step may be in the wrong unit."""

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
    """One operating point of a sweep: raw values by axis, where each is in the file, and the repeat's number."""

    values: dict[str, Any]
    places: dict[str, Location]
    repeat: int = 0


def long_ranges(sweep: Any, document: Document, at: Location = ("sweep",)) -> Iterator[str]:
    """A line for each range of so many values that its step may be mistaken, with its place."""
    if not isinstance(sweep, Sweep):
        return
    for index, part in enumerate(sweep.concat or ()):
        yield from long_ranges(part, document, (*at, "concat", index))
    for form in ("matrix", "zip"):
        for name, axis in getattr(sweep, form) or ():
            if isinstance(axis, PressureRange) and (count := len(axis.values())) > USUAL_POINTS:
                start, stop, step = (show(value, "pressure") for value in (axis.start, axis.stop, axis.step))
                yield (
                    f"{document.where((*at, form, name))}  {start} to {stop} by {step} makes {count} values; "
                    "are the units of start, stop and step what you mean?"
                )


def expand(sweep: Sweep[Any], document: Document, at: Location = ("sweep",)) -> list[Point]:
    """Every point of the sweep in the order of running; `InvalidFile` where it is too large or does not fit."""
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
    """Values of each axis in the order of the file, and the place of the i-th."""
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
