"""Channels of a bench file with their calibrations, which are found next to the file that names them."""

from __future__ import annotations

import re
from pathlib import Path

from pmabench.base.errors import InvalidFile, did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY
from pmabench.bench.calibration import Calibration, read_calibration
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import CalibrationRecord, ChannelRecord, Scale
from pmabench.files.document import Location

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
"""What a calibration may be called: it is a file's name."""


def channels(c: Compilation) -> dict[str, ChannelRecord]:
    """Every channel that has no problem, by name."""
    return {name: channel for name in c.bench.channels if (channel := _channel(c, name))}


def _channel(c: Compilation, name: str) -> ChannelRecord | None:
    file = c.bench.channels[name]
    at: Location = ("channels", name)
    quantity = CHANNEL_QUANTITY.get(name)
    if quantity is None:
        c.fault(at, f'no channel is called "{name}"{did_you_mean(name, CHANNEL_QUANTITY)}', key=True)
        return None
    before = len(c.problems)
    c.unknown((*at, "device"), "device", file.device, c.bench.devices)
    if file.calibration is not None:
        found = _calibration(c, file.calibration, quantity, (*at, "calibration"))
        if found is None:
            return None
        c.calibrated[name] = (found.low, found.high)
        scale, record, raw_unit = found.scale, found.record, found.raw_unit
    else:
        raw_unit, record = file.unit or "", CalibrationRecord()
        scale = Scale(c.si((1.0, raw_unit), quantity, (*at, "unit")), 0.0)
    if len(c.problems) > before:
        return None
    ends = [
        scale.to_si(reading[0]) if reading[1] == raw_unit else c.si(reading, quantity, (*at, "range", index))
        for index, reading in enumerate(file.range)
    ]
    if len(c.problems) > before:
        return None
    if ends[0] == ends[1]:
        c.fault((*at, "range"), "the two ends are the same")
        return None
    raw_type = "int32" if raw_unit in {"count", "counts"} else "float64"
    low, high = min(ends), max(ends)
    return ChannelRecord(
        name, quantity, file.device, file.input, raw_type, raw_unit, scale, low, high, file.reference, record
    )


def _calibration(c: Compilation, name: str, quantity: str, location: Location) -> Calibration | None:
    if not NAME.fullmatch(name):
        c.fault(location, "the id of a calibration is expected: letters, digits, points and dashes")
        return None
    folders = _folders(c, location)
    path = next((folder / f"{name}.yaml" for folder in folders if (folder / f"{name}.yaml").is_file()), None)
    if path is None:
        near = sorted({file.stem for folder in folders if folder.is_dir() for file in folder.glob("*.yaml")})
        c.fault(location, f'no calibration "{name}" in calibrations/{did_you_mean(name, near)}')
        return None
    try:
        found = read_calibration(path, quantity)
    except InvalidFile as error:
        c.problems.extend(problem for problem in error.problems if problem not in c.problems)
        return None
    c.texts[f"calibrations/{name}.yaml"] = found.text
    return found


def _folders(c: Compilation, location: Location) -> list[Path]:
    """Where calibrations may lie: next to the file that names the calibration, then next to every file of the bench."""
    files = [c.bench_document.place(location)[0], *c.bench_document.texts]
    parents = dict.fromkeys(Path(file).resolve().parent for file in files)
    return [folder for parent in parents for folder in (parent / "calibrations", parent.parent / "calibrations")]
