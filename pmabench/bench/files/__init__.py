"""Bench, specimen and calibration files as strict models: what people write, each checked by itself.

`bench` is the station, `safety` its limits, watch list and safe state, `specimen` the muscle, `calibration` one
channel's scale.
"""

from pmabench.bench.files.bench import BenchFile, DeviceFile, OutputFile, ValveFile
from pmabench.bench.files.calibration import CalibrationFile
from pmabench.bench.files.parts import Reading
from pmabench.bench.files.safety import LimitFile, SafeActionFile, WatchFile
from pmabench.bench.files.specimen import ExpectedFile, SpecimenFile, any_specimen

__all__ = [
    "BenchFile",
    "CalibrationFile",
    "DeviceFile",
    "ExpectedFile",
    "LimitFile",
    "OutputFile",
    "Reading",
    "SafeActionFile",
    "SpecimenFile",
    "ValveFile",
    "WatchFile",
    "any_specimen",
]
