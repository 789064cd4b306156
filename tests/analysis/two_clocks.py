"""Trials written as a run of two devices: some channels come from a second one, whose clock is its own; for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.store.reader import open_run
from pmabench.store.records import RunData, TrialData
from pmabench.store.writer import RunWriter

OFFSET, DRIFT = 0.020, 50e-6
"""Of the second device's clock: time of the run = (1 + DRIFT) device time + OFFSET."""
RATE = 500.0
BATCH = 25
QUANTITIES = {"pressure": "pressure", "displacement": "length", "force": "force", "pressure_command": "pressure"}


def record(
    parent: Path,
    kind: str,
    trials: Sequence[TrialData],
    second: Sequence[str],
    *,
    jitter: float = 2e-3,
    reported: dict[str, float] | None = None,
    lag: dict[str, float] | None = None,
) -> RunData:
    """The run, read again. `second`: channels of the second device; none: all are of one.

    Its samples come in up to some `jitter` [s] late, a batch at a time; with `told` (offset, drift, uncertainty) an
    event says what its clock is instead. `lag`: sensor lags [s].
    """
    rng = np.random.default_rng(7)
    manifest = {"kind": kind, "simulated": True, "specimen": {"type": "MAS-20", "serial": "A017"}, "bench": "rig"}
    writer = RunWriter.create(parent, "run", manifest, {"plan.json": b"{}"})
    names = [name for name in trials[0].channels if name in QUANTITIES]
    devices = {"daq": [name for name in names if name not in second], "cell": [n for n in names if n in second]}
    devices = {device: mine for device, mine in devices.items() if mine}
    for device, mine in devices.items():
        writer.open_stream(device, [_column(name, device, (lag or {}).get(name, 0.0)) for name in mine], RATE)
    if reported is not None:
        writer.event("clock", 0.0, stream="cell", **reported)
    for trial in trials:
        about = {"point": dict(trial.point), "repeat": trial.repeat, "reference": False}
        writer.event("trial-begin", float(trial.t[0]), trial=trial.index, **about)
        for command in trial.commands:
            said = {"output": command.output, "before": command.before, "phase": command.phase, "trial": trial.index}
            writer.event("command", command.t, type=command.kind, value=command.value, **said, **command.data)
        for first in range(0, len(trial.t), BATCH):
            rows = slice(first, first + BATCH)
            for device, mine in devices.items():
                true = trial.t[rows]
                clock = true if device == "daq" else (true - OFFSET) / (1 + DRIFT)
                arrived = None
                if device == "cell" and reported is None:
                    arrived = round((float(true[-1]) + rng.exponential(jitter)) * 1e9)
                columns = {name: trial.channels[name][rows] for name in mine}
                time_ns = np.round(clock * 1e9).astype(np.int64)
                writer.append(device, time_ns, columns, np.zeros(len(true), np.uint16), arrived)
            writer._streams[list(devices)[-1]].drain()
        writer.event("trial-end", float(trial.t[-1]), trial=trial.index, status="finished")
    return open_run(writer.close("finished"))


def _column(name: str, device: str, lag: float) -> dict[str, Any]:
    return {
        "name": name, "quantity": QUANTITIES[name], "device": device, "input": name, "raw_type": "float64",
        "raw_unit": "V", "scale": {"slope": 1.0, "offset": 0.0}, "low": -1e9, "high": 1e9,
        "calibration": {"id": "c", "sensor_lag": lag},
    }  # fmt: skip
