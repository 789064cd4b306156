"""Small runs with known numbers, for the tests of the store."""

from dataclasses import asdict

import numpy as np

from pmabench.bench.interface import CalibrationRecord, ChannelRecord, Scale
from pmabench.store.writer import RunWriter

RATE = 500.0
PERIOD = 2_000_000
CALIBRATION = CalibrationRecord("P-0231", "DPI-104", "2026-03-01", "2027-03-01", 1500.0, 0.001, 0.002, "ab" * 32)
CHANNELS = [
    ChannelRecord(
        "pressure", "pressure", "daq", "AIN0", "int32", "count", Scale(0.25, -500.0), 0.0, 1e6, "gauge", CALIBRATION
    ),
    ChannelRecord("displacement", "length", "daq", "AIN1", "int32", "count", Scale(-1e-6, 0.05), 0.0, 0.1),
    ChannelRecord("force", "force", "daq", "AIN2", "float64", "V", Scale(200.0, 3.0), -50.0, 2000.0),
]
COLUMNS = [asdict(channel) for channel in CHANNELS]
SNAPSHOTS = {
    "protocol.yaml": b"schema: pmabench.protocol/1\n",
    "plan.json": b'{"schema": "pmabench.plan/1", "trials": [{"index": 0}, {"index": 1}]}',
    "calibrations/P-0231.yaml": b"id: P-0231\n",
}
MANIFEST = {
    "kind": "contraction-relaxation",
    "simulated": True,
    "specimen": {"type": "MAS-20", "serial": "A017"},
    "bench": "rig",
}


def block(first, count):
    """Rows `first` ... of the only truth: time [ns], raw columns and flags as functions of the row's number."""
    n = np.arange(first, first + count, dtype=np.int64)
    raw = {
        "pressure": (n * 7919 % 1_000_003).astype(np.int32) - 500_000,
        "displacement": (n * 104_729 % 99_991).astype(np.int32),
        "force": np.sin(n * 0.37) * 1.1,
    }
    return n * PERIOD, raw, ((n % 50 == 13) * 4).astype(np.uint16)


def begin(parent, name="run", **manifest):
    """A run with one open stream and nothing in it."""
    writer = RunWriter.create(parent, name, MANIFEST | manifest, SNAPSHOTS)
    writer.open_stream("daq", COLUMNS, RATE)
    return writer


def record(writer, rows=2000):
    """Two trials of half the rows each, with commands, a finding and a vent."""
    half = rows // 2
    for trial in range(2):
        t0, t1 = trial * half / RATE, (trial * half + half - 1) / RATE
        writer.event(
            "trial-begin", t0, trial=trial, point={"load": 58.8, "pressure": 3e5}, repeat=trial, reference=not trial
        )
        command = {"output": "pressure", "before": 0.0, "phase": "contract", "trial": trial}
        writer.event("command", t0 + 0.1, type="set", value=3e5, sent=3.0001e5, **command)
        writer.event("command", t0 + 0.2, type="ramp", value=1e5, rate=5e4, **command)
        for first in range(trial * half, trial * half + half, 100):
            writer.append("daq", *block(first, min(100, half)))
        writer.event(
            "found",
            t1,
            phase="lift",
            law="ramp-until",
            trial=trial,
            result={"found": True, "pressure": np.float64(1.5e5)},
        )
        writer.event("trial-end", t1, trial=trial, status=["finished", "failed"][trial])
    writer.event("vent", rows / RATE, result="confirmed", actions=[])


def closed(parent, name="run", rows=2000, status="finished", **manifest):
    """A closed run's folder."""
    writer = begin(parent, name, **manifest)
    record(writer, rows)
    return writer.close(status, vent={"result": "confirmed"})


def unclosed(parent, rows=2000):
    """A run as a dead writer leaves it: everything handed to the operating system, no end mark, no seal."""
    writer = begin(parent)
    record(writer, rows)
    die(writer)
    return writer.folder


def die(writer):
    """Let the writer in this process go without closing the run, and let its process count as dead."""
    writer._halt()
    writer._events.close()
    for stream in writer._streams.values():
        stream.file.close()
