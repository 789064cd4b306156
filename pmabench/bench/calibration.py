"""Calibration files to straight lines with their uncertainty; knows no bench."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

from pmabench.base.errors import InvalidFile
from pmabench.base.quantities import show
from pmabench.bench.files import CalibrationFile
from pmabench.bench.interface import CalibrationRecord, Scale
from pmabench.files.document import document_text, read_document, validate
from pmabench.files.quantity import unit_factor

MOST = 1e100
"""Largest number that is believed; its square can still be reckoned with."""


@dataclass(frozen=True)
class Calibration:
    """A channel's scale, where it comes from, the unit of its raw readings, what it covers, and the file's text."""

    scale: Scale = field(default_factory=Scale)
    record: CalibrationRecord = field(default_factory=CalibrationRecord)
    raw_unit: str = ""
    text: str = ""
    low: float = 0.0
    """Lowest reference value [SI]."""
    high: float = 0.0
    """Highest reference value [SI]."""


def read_calibration(path: Path, quantity: str) -> Calibration:
    """The calibration in a file, for a channel that measures `quantity`; raises `InvalidFile` with every problem."""
    document = read_document(path)
    file = validate(CalibrationFile, document)
    problems = []
    raw_unit = file.points[0][0][1]
    raw: list[float] = []
    value: list[float] = []
    if file.id != path.stem:
        raise InvalidFile([document.problem(("id",), f'the id "{file.id}" is not the name of the file, "{path.stem}"')])
    if file.quantity != quantity:
        raise InvalidFile([document.problem(("quantity",), f"is of {file.quantity}, the channel measures {quantity}")])
    for index, (reading, reference) in enumerate(file.points):
        if reading[1] != raw_unit:
            problems.append(document.problem(("points", index, 0), f"all readings in one unit, here {raw_unit}"))
        raw.append(reading[0])
        try:
            value.append(reference[0] * unit_factor(reference[1], quantity))
        except ValueError as error:
            problems.append(document.problem(("points", index, 1), str(error)))
    if file.valid_until is not None and file.valid_until < file.date:
        problems.append(document.problem(("valid_until",), "ends before the calibration was made"))
    try:
        uncertainty = file.expanded_uncertainty[0] * unit_factor(file.expanded_uncertainty[1], quantity)
        if uncertainty < 0:
            raise ValueError("an uncertainty is not below zero")
    except ValueError as error:
        problems.append(document.problem(("expanded_uncertainty",), str(error)))
    if problems:
        raise InvalidFile(problems)
    try:
        scale = fit_line(raw, value)
    except ValueError as error:
        raise InvalidFile([document.problem(("points",), str(error))]) from error
    bend = max(abs(scale.to_si(r) - v) for r, v in zip(raw, value, strict=True))
    if bend > max(uncertainty, 1e-9 * max(abs(v) for v in value)):
        message = f"bend away from a straight line by {show(bend, quantity)}, more than the uncertainty"
        raise InvalidFile([document.problem(("points",), message)])
    text = document_text(document)
    record = CalibrationRecord(
        id=file.id,
        reference=file.reference,
        date=file.date.isoformat(),
        valid_until=file.valid_until.isoformat() if file.valid_until else "",
        offset_uncertainty=uncertainty,
        gain_uncertainty=file.gain_uncertainty,
        sensor_lag=file.sensor_lag,
        sha256=hashlib.sha256(text.encode()).hexdigest(),
    )
    return Calibration(scale, record, raw_unit, text, min(value), max(value))


def fit_line(raw: list[float], value: list[float]) -> Scale:
    """Least-squares line through reference points, value against raw; ValueError where they make none."""
    if any(abs(number) > MOST for number in (*raw, *value)):
        raise ValueError("a number is out of all range")
    n = len(raw)
    raw_mean, value_mean = sum(raw) / n, sum(value) / n
    spread = sum((r - raw_mean) ** 2 for r in raw)
    if spread == 0:
        raise ValueError("all readings are the same: they make no line")
    slope = sum((r - raw_mean) * (v - value_mean) for r, v in zip(raw, value, strict=True)) / spread
    if slope == 0:
        raise ValueError("the readings do not change with the reference: they make no line")
    return Scale(slope, value_mean - slope * raw_mean)
