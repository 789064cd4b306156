"""Bench, specimen and calibration files as strict models: what people write, each checked by itself.

`bench` is the station with its limits, watch list, safe state and session, `specimen` the muscle and the calibration of
one channel, `plant` what simulated benches are made of.
"""

from pmabench.bench.files.bench import (
    BenchFile,
    DeviceFile,
    LimitFile,
    OutputFile,
    SafeActionFile,
    ValveFile,
    WatchFile,
)
from pmabench.bench.files.parts import Reading
from pmabench.bench.files.specimen import CalibrationFile, ExpectedFile, SpecimenFile, any_specimen

__all__ = [
    "BenchFile", "CalibrationFile", "DeviceFile", "ExpectedFile", "LimitFile", "OutputFile", "Reading",
    "SafeActionFile", "SpecimenFile", "ValveFile", "WatchFile", "any_specimen",
]  # fmt: skip
