"""All files of a lab's folder from its answers."""

from __future__ import annotations

from pathlib import Path

from pmabench.base.errors import UsageError
from pmabench.bench.files.specimen import SpecimenFile
from pmabench.bench.lab.answers import Answers
from pmabench.bench.lab.bench_text import PLANT_FILE, bench_text, calibration_texts
from pmabench.bench.lab.daqs import NONE_YET
from pmabench.bench.lab.muscle_text import simulated_plant, specimen_text
from pmabench.bench.lab.protocol_text import protocol_text
from pmabench.files.document import Document, read_document, validate

CHANNEL_OF = {"pressure": "pressure", "length": "displacement", "force": "force"}
"""Quantity of a calibration -> channel."""


def lab_files(answers: Answers, shipped_protocol: str) -> dict[str, str]:
    """Path in the lab's folder -> text; `shipped_protocol` is the text that is made to fit.

    Raises
    ------
    UsageError
        Where a file that an answer names cannot be read.
    """
    own = _calibrations(answers)
    specimen = specimen_text(answers)
    files = {
        "bench.yaml": bench_text(answers, {channel: path.stem for channel, path in own.items()}),
        "specimen.yaml": specimen,
        **calibration_texts(answers, {channel: path.stem for channel, path in own.items()}),
        **{f"calibrations/{path.name}": path.read_text(encoding="utf-8") for path in own.values()},
    }
    if answers.text("daq") == NONE_YET:
        files[PLANT_FILE] = simulated_plant(answers)
    elif registers := answers.text("address").partition(",")[2].strip():
        files[f"registers/{Path(registers).name}"] = _text(Path(registers), "address")
    muscle = validate(SpecimenFile, Document("specimen.yaml", specimen))
    files["protocol.yaml"] = protocol_text(shipped_protocol, answers, muscle)
    return files


def _calibrations(answers: Answers) -> dict[str, Path]:
    """Channel -> the lab's calibration file for it."""
    if answers.text("daq") == NONE_YET or answers.text("calibration") == "none yet":
        return {}
    folder = Path(answers.text("calibration"))
    found = {}
    for path in sorted(folder.glob("*.yaml")):
        channel = CHANNEL_OF.get(str(read_document(path).data.get("quantity")))
        if channel is not None and channel not in found:
            found[channel] = path
    if not found:
        raise UsageError(f'calibration: "{folder}" holds no calibration files; give their folder, or "none yet"')
    return found


def _text(path: Path, key: str) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f'{key}: "{path}" cannot be read: {getattr(error, "strerror", None) or error}') from error
