"""Files that `pmabench export` wrote: the record next to them answers all that a guess would ask."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pmabench.base.errors import invalid
from pmabench.store.exported import NAME as RECORD
from pmabench.store.exported import Known, read_record
from pmabench.store.importers.guess.record import Guess


def as_exported(guess: Guess, files: Sequence[Path]) -> bool:
    """Whether the files are samples that `pmabench export` wrote with their record, which then leaves no question."""
    place = files[0].resolve().parent / RECORD
    if not place.is_file():
        return False
    record = read_record(place)
    if record.file not in {path.name for path in files}:
        return False
    if len(files) > 1:
        raise invalid(place, f"goes with {record.file} alone: import that file, the others hold no samples of trials")
    if record.kind not in guess.kinds:
        raise invalid(place, f'is of a run of kind "{record.kind}", which cannot be imported here')
    guess.kind, guess.trials = record.kind, {"by": "record"}
    guess.exported, guess.simulated = True, record.simulated
    text = f"{RECORD} next to it says what {record.run} commanded and found, trial by trial"
    guess.reasons["trials"] = [text]
    for column in guess.columns:
        known = record.columns.get(column.name)
        column.role, column.doubts, column.question, column.reasons = "ignore", [], "", ["the record has it"]
        if column.name == "t [s]":
            column.role, column.reasons = "time", []
        elif column.name in ("flags", "simulated"):
            column.role, column.reasons = column.name, []
        elif known is not None:
            column.role, column.reasons = known.channel, []
            column.extra = _as_known(known, column.unit)
    specimen = record.about.get("specimen")
    if isinstance(specimen, dict):
        guess.specimen = {key: str(specimen[key]) for key in ("make", "type", "serial") if specimen.get(key)}
    return True


def _as_known(known: Known, unit: str) -> list[str]:
    """Lines of a map for what a record knows of the calibration of a channel."""
    lines = {
        f"expanded_uncertainty: {known.offset_uncertainty:.9g} {unit}": known.offset_uncertainty,
        f"gain_uncertainty: {100 * known.gain_uncertainty:.9g} %": known.gain_uncertainty,
        f"sensor_lag: {known.sensor_lag:.9g} s": known.sensor_lag,
    }
    return [line for line, value in lines.items() if value]
