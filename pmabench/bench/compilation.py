"""A bench and a specimen while they are compiled: their models, where each value is written, every problem found."""

from __future__ import annotations

import datetime
from collections.abc import Collection
from math import isfinite
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.bench.files.bench import BenchFile
from pmabench.bench.files.specimen import SpecimenFile, any_specimen
from pmabench.bench.interface import ChannelRecord, OutputRecord, ValveRecord
from pmabench.files.document import Document, Location, Strict, document_text, validate
from pmabench.files.quantity import unit_factor


class Compilation:
    """A bench being compiled: files, records and problems so far; `InvalidFile` where a file does not fit its model."""

    def __init__(self, bench: Document, specimen: Document | None, today: datetime.date) -> None:
        self.bench_document, self.specimen_document, self.today = bench, specimen, today
        self.problems: list[Problem] = []
        self.texts = {"bench.yaml": document_text(bench)}
        """Name in a run's snapshot -> text; calibrations are added."""
        self.calibrated: dict[str, tuple[float, float]] = {}
        """Channel -> lowest and highest value [SI] that its calibration covers."""
        self.extrapolated: list[str] = []
        """Trips beyond what a calibration covers, each with how well it is known there."""
        self.channels: dict[str, ChannelRecord] = {}
        """Every channel that has no problem, by name; outputs and valves likewise."""
        self.outputs: dict[str, OutputRecord] = {}
        self.valves: dict[str, ValveRecord] = {}
        self.driver_lacks: list[str] = []
        """Warnings about devices' options; each line goes on after "this bench has"."""
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
        """Mounted length of the specimen [m]; None where the bench is looked at alone."""
        return self.specimen.mounted.length if self.specimen_document is not None else None

    def fault(self, location: Location, message: str, *, key: bool = False) -> None:
        """A problem at a value of the bench file, or at its key."""
        self.problems.append(self.bench_document.problem(location, message, key=key))

    def unknown(self, location: Location, what: str, name: str, known: Collection[str]) -> bool:
        """Whether `name` is not among the known ones, which is then a problem."""
        if name in known:
            return False
        self.fault(location, f'no {what} "{name}"{did_you_mean(name, known)}')
        return True

    def si(self, reading: tuple[float, str], quantity: str, location: Location) -> float:
        """A reading of the bench file in SI; 0 where it is a problem."""
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
