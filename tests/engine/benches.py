"""Mounted mock benches and small plans for the tests of the engine."""

from dataclasses import replace
from pathlib import Path

from pmabench.bench.compile import mount
from pmabench.protocol.plan import Ask, Follow, Hold, Plan, Ramp, Record, Seek, Set, TrialRecord, WaitUntil

ROOT = Path(__file__).resolve().parents[2]
SPECIMEN = ROOT / "fixtures" / "specimens" / "mas-20-250-paper0.yaml"
CHANNELS = ("pressure", "displacement", "force", "pressure_command")
LIFT = {
    "channel": "displacement", "threshold": 2e-5, "direction": "up", "rate": 2000.0, "approach_rate": 2e4,
    "back_off": 25e3, "window": 0.01, "settle": 1.0,
}  # fmt: skip


def mounted(name="mock", **options):
    """A shipped mock bench with other options of the simulated plant."""
    made = mount(ROOT / "fixtures" / "benches" / f"{name}.yaml", SPECIMEN)
    devices = tuple(replace(d, options={**d.options, **options}) for d in made.bench.devices)
    return replace(made, bench=replace(made.bench, devices=devices))


def plan(*steps, trials=1, record=CHANNELS):
    """A plan of the given steps."""
    points = tuple(TrialRecord(i, {"load": 58.86, "mass": 8.0, "pressure": 3e5}) for i in range(trials))
    return Plan("contraction-relaxation", "test", "no paper", "weights", 500.0, record, points, tuple(steps))


def one_trial(*inside):
    """A recorded trial with steps inside, the load on."""
    return plan(Ask("load", "put it on", "vented", (58.86, 8.0)), Record("t", True, 0), *inside, Record("t", False, 0))


STEPS = {
    "hold": (Set("contract", "pressure", 3e5), Hold("contract", 5.0)),
    "ramp": (Ramp("up", "pressure", 0.0, 3e5, 5e4),),
    "wait-until": (Set("w", "pressure", 3e5), WaitUntil("w", "displacement", "above", 0.2, 0.1, 5.0, "flag")),
    "seek scripted": (Seek("lift", "ramp-until", "pressure", 0.0, 5.8e5, 500.0, LIFT),),
    "seek sampled": (
        Seek("p", "pid", "pressure", 0.0, 5e5, 500.0,
             {"setpoint": 0.02, "start": 2e5, "K_p": 1e6, "low": 0.0, "high": 5e5, "duration": 4.0}),
    ),
    "follow": (Set("s", "pressure", 3e5), Follow("s", "pressure", 3e5, 5e4, 0.5, 3)),
}  # fmt: skip
