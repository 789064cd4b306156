"""A bench and a specimen during compilation: their models, the place of each value, every problem found.

The key `to_confirm` lists values that a program derived and nobody has confirmed; comments are not read, so this has
to be data. A person confirms a value by deleting its entry; a bench file whose list is empty also needs a name under
`reviewed`, because the safety values were among them.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Collection, Iterator
from functools import partial
from math import isfinite
from typing import Any, NamedTuple

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY, OF_A_MUSCLE, without_number
from pmabench.bench.files.bench import BenchFile
from pmabench.bench.files.specimen import SpecimenFile, SpecimenLimits, any_specimen
from pmabench.bench.interface import ChannelRecord, OutputRecord, ValveRecord
from pmabench.files.document import Document, Location, Strict, document_text, validate
from pmabench.files.quantity import unit_factor

LIMITS = ("command", "command_low", "trip", "trip_low")


def known_places(c: Compilation) -> None:
    """Add a problem for each entry of `to_confirm` that is no key of its file."""
    for document in (c.bench_document, c.specimen_document):
        for index, name in enumerate(_entries(document)):
            data: Any = document.data if document is not None else {}
            for part in name.split("."):
                places = range(len(data) if isinstance(data, list) else 0)
                known = list(data) if isinstance(data, dict) else [str(place) for place in places]
                if part not in known:
                    message = f'there is no "{part}" in this file{did_you_mean(part, known)}'
                    c.problems.append(_problem(document, ("to_confirm", index), message))
                    break
                data = data[part] if isinstance(data, dict) else data[int(part)]


def unconfirmed(c: Compilation) -> Iterator[Problem]:
    """A problem for each value listed in `to_confirm`, and one if nobody reviewed the confirmed ones."""
    for document in (c.bench_document, c.specimen_document):
        for name in _entries(document):
            location = tuple(int(part) if part.isdecimal() else part for part in name.split("."))
            text = f'nobody has confirmed "{name}": look it up, correct it, and delete it from to_confirm'
            yield _problem(document, location, text)
    if c.bench.to_confirm is not None and c.bench.reviewed is None:
        text = "limits and safe state were derived by a program; who read them over: reviewed: {by: NAME, date: DAY}"
        yield c.bench_document.problem(("to_confirm",), text, key=True)


def _entries(document: Document | None) -> list[str]:
    found = document.data.get("to_confirm") if document is not None else None
    return [str(name) for name in found] if isinstance(found, list) else []


def _problem(document: Document | None, location: Location, message: str) -> Problem:
    assert document is not None  # noqa: S101  (it has the entries)
    return document.problem(location, message)


class Borne(NamedTuple):
    """Limits of a muscle, whose they are, and where they are written."""

    limits: SpecimenLimits
    whose: str
    place: Callable[..., str]
    """Function from the keys of a value to its `path:line:column`."""


class Compilation:
    """A bench during compilation: files, records, problems; raises `InvalidFile` if a file does not fit its model."""

    def __init__(self, bench: Document, specimen: Document | None, today: datetime.date) -> None:
        self.bench_document, self.specimen_document, self.today = bench, specimen, today
        self.problems: list[Problem] = []
        self.texts = {"bench.yaml": document_text(bench)}
        """Name in a run's snapshot -> text; calibrations are added."""
        self.calibrated: dict[str, tuple[float, float]] = {}
        """Channel -> lowest and highest calibrated value [SI]."""
        self.extrapolated: list[str] = []
        """Trips outside the calibrated range, each with its uncertainty, as text."""
        self.channels: dict[str, ChannelRecord] = {}
        """Every channel without a problem, by name; outputs and valves likewise."""
        self.outputs: dict[str, OutputRecord] = {}
        self.valves: dict[str, ValveRecord] = {}
        files: dict[type[Strict], Any] = {SpecimenFile: any_specimen()}
        if specimen is not None:
            self.texts["specimen.yaml"] = document_text(specimen)
        for model, document in ((BenchFile, bench), (SpecimenFile, specimen)):
            try:
                if document is not None:
                    files[model] = validate(model, document)
            except InvalidFile as error:
                self.problems.extend(error.problems)
        if self.problems:
            raise InvalidFile(self.problems)
        self.bench: BenchFile = files[BenchFile]
        self.specimen: SpecimenFile = files[SpecimenFile]

    @property
    def length(self) -> float | None:
        """Mounted length of the specimen [m]; None without a specimen."""
        return self.specimen.mounted.length if self.specimen_document is not None else None

    def fault(self, location: Location, message: str, *, key: bool = False) -> None:
        """Add a problem at a value of the bench file, or at its key."""
        self.problems.append(self.bench_document.problem(location, message, key=key))

    def unknown(self, location: Location, what: str, name: str, known: Collection[str]) -> bool:
        """Whether `name` is not in `known`; then a problem is added."""
        if name in known:
            return False
        self.fault(location, f'no {what} "{name}"{did_you_mean(name, known)}')
        return True

    @property
    def names(self) -> list[str]:
        """Valid channel names on this bench; with the muscle's number if there are several muscles."""
        alone = [name for name in CHANNEL_QUANTITY if name == without_number(name)[0]]
        if not self.bench.muscles:
            return alone
        shared = [name for name in alone if name not in OF_A_MUSCLE]
        return [f"{name}_{number}" for number in self.bench.muscles for name in OF_A_MUSCLE] + shared

    def borne(self, name: str) -> Iterator[Borne]:
        """Limits of the muscle of a channel or output: those in the bench file, if any, and those of the specimen."""
        if (number := without_number(name)[1][1:]) in self.bench.muscles:
            place = partial(self.place, "muscles", number, "limits")
            yield Borne(self.bench.muscles[number].limits, f"muscle {number}'s", place)
        yield Borne(self.specimen.limits, "the specimen's", partial(self.specimen_place, "limits"))

    @property
    def pressures(self) -> list[OutputRecord]:
        """Outputs without a problem that command the pressure of a muscle."""
        return [output for output in self.outputs.values() if output.quantity == "pressure"]

    @property
    def highest(self) -> OutputRecord | None:
        """The pressure output with the highest command limit; None without one."""
        return max(self.pressures, key=lambda output: output.high, default=None)

    def si(self, reading: tuple[float, str], quantity: str, location: Location) -> float:
        """A reading of the bench file in SI; 0 with a problem."""
        try:
            value = reading[0] * unit_factor(reading[1], quantity)
        except ValueError as error:
            self.fault(location, str(error))
            return 0.0
        if not isfinite(value):
            self.fault(location, f"{reading[0]:g} {reading[1]} is out of all range")
            return 0.0
        return value

    def place(self, *location: str | int) -> str:
        """`path:line:column` of a value of the bench file."""
        return self.bench_document.where(location)

    def specimen_place(self, *location: str | int) -> str:
        """`path:line:column` of a value of the specimen file."""
        return self.specimen_document.where(location) if self.specimen_document is not None else ""
