"""`process --json` is JSON of any other program's kind, and no library warns, for runs of every kind and broken ones.

In here a warning is an error, so that a library's warning fails the test that it comes up in.
"""

import json
import math
import subprocess
import sys
from dataclasses import replace
from operator import is_
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.kinds.reduce import FORM, reduce_runs, reduction_of, verdicts
from pmabench.kinds.registry import all_kinds, with_part
from pmabench.store.chain import open_chains
from pmabench.store.folder import plain
from pmabench.store.records import Flag

pytestmark = pytest.mark.slow
OLD = Path(__file__).resolve().parents[2] / "fixtures" / "old-runs"
WEIGHTS = ("--specimen", "mas-20-250-paper0")
DRIVEN = ("--specimen", "daerden-20-200")
RUNS = {
    "static-load": ("mock-ideal", *WEIGHTS, "--set", "sweep.matrix.load=[6 kg, 26 kg]", "--set", "sweep.repeat.count=1"),
    "contraction-relaxation": (
        "mock-ideal", *WEIGHTS, "--set", "sweep.matrix.load=[6 kg, 16 kg]", "--set", "sweep.repeat.count=1",
        "--set", "sweep.matrix.pressure=[400 kPa]",
    ),
    "contraction-relaxation-paper1": (
        "mock-dmsp-ideal", "--specimen", "dmsp-40-305", "--set", "sweep.matrix.pressure=[2 bar, 3 bar, 4 bar]",
    ),
    "sinusoidal-displacement": (
        "mock-actuator", *WEIGHTS, "--set", "sweep.repeat.count=1", "--set", "sweep.matrix.frequency=[0.5 Hz, 3 Hz]",
    ),
    "ultimate-gain-open-loop": ("mock-linear", *WEIGHTS, "--set", "sample_rate=200 Hz", "--set", "trial.open_loop.cycles=3"),
    "ultimate-gain-relay": (
        "mock-linear", *WEIGHTS, "--set", "sweep.repeat.count=1", "--set", "trial.relay.periods=8",
    ),
    "isobaric-ramp": ("mock-daerden", *DRIVEN, "--set", "sweep.matrix.pressure=[300 kPa]"),
    "step-displacement": (
        "mock-daerden", *DRIVEN, "--set", "sweep.matrix.step=[5 mm]", "--set", "sweep.matrix.pressure=[4 bar]",
        "--set", "trial.cycles=2",
    ),
    "relaxation": (
        "mock-daerden-relaxing", *DRIVEN, "--set", "sweep.matrix.pressure=[5 bar]", "--set", "trial.hold=60 s",
        "--set", "trial.rest=60 s",
    ),
    "positioning-pi": (
        "mock-ideal", *WEIGHTS, "--set", "sweep.matrix.setpoint=[20 mm]", "--set", "trial.hold=15 s",
        "--set", "trial.window=[10 s, 15 s]",
    ),
    "validation": (
        "mock-ideal", *WEIGHTS, "--set", "model.coefficients=paper0 ideal", "--set", "sweep.matrix.pressure=[300 kPa]",
    ),
    "closed-volume": ("mock-daerden-closed", *DRIVEN, "--set", "sweep.repeat.count=1"),
    "isometric-pressurisation": (
        "mock-contractor-ideal", "--specimen", "contractor-30", "--set", "sweep.matrix.contraction=[0 %, 8 %, 16 %]",
        "--set", "sweep.repeat.count=1",
    ),
    "free-contraction": (
        "mock-contractor-free-ideal", "--specimen", "contractor-30", "--set", "sweep.repeat.count=1",
        "--set", "sweep.matrix.pressure=[0 kPa, 60 kPa, 120 kPa, 180 kPa, 240 kPa, 300 kPa]",
    ),
    "joint-sweep": (
        "mock-joint", "--specimen", "joint-daerden", "--set", "trial.cycles=2", "--set", "sweep.zip.pressure_1=[300 kPa]",
        "--set", "sweep.zip.pressure_2=[300 kPa]", "--set", "sweep.zip.speed=[10 deg/s]",
    ),
    "platform": (
        "mock-platform", "--specimen", "platform-daerden", "--set", "sweep.repeat.count=1",
        "--set", "sweep.zip.phi=[10 deg]", "--set", "sweep.zip.psi=[0 deg]", "--set", "trial.hold=2 s",
    ),
    "joint-step": (
        "mock-joint-free", "--specimen", "joint-daerden", "--set", "sweep.repeat.count=1",
        "--set", "sweep.zip.goal=[10 deg]", "--set", "sweep.zip.integral=[20 N.m/rad/s]",
        "--set", "trial.approach=[8 deg, -4 deg]",
    ),
    "joint-torque": (
        "mock-joint", "--specimen", "joint-daerden", "--set", "sweep.matrix.pressure_1=[300 kPa]",
        "--set", "sweep.matrix.pressure_2=[300 kPa]",
    ),
    "arm-angle": (
        "mock-arm-ideal", "--specimen", "arm-30", "--set", "sweep.matrix.load=[0 kg]", "--set", "sweep.repeat.count=1",
    ),
}  # fmt: skip
"""Protocol -> bench, specimen and what is cut from it."""
IMPORTS = {
    "isometric": "isometric/10mm_13cm_Kinked4mm_Test1.csv",
    "step": "polled/2026-01-05_101500_step_exp/step_data.dat",
    "sine": "polled/2026-01-05_103000_frq_test_rads-6,28_exp/frq_test_rads-6,28_data.dat",
    "pull": "polled/2026-01-05_104000_characterization_exp/characterization_data.dat",
}


def strict(text: str):
    """JSON as its standard has it: neither NaN nor Infinity."""

    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A short run of each kind."""
    out = tmp_path_factory.mktemp("runs")
    for protocol, (bench, *more) in RUNS.items():
        command = ["run", protocol, "--bench", bench, *more, "--yes", "-q", "--out", str(out)]
        result = CliRunner().invoke(main, command, catch_exceptions=False)
        assert result.exit_code == 0, f"{protocol}: {result.output}"
    for name, path in IMPORTS.items():
        command = ["import", str(OLD / path), "--map", str(OLD / f"{name}.yaml"), "--out", str(out), "-q"]
        result = CliRunner().invoke(main, command, catch_exceptions=False)
        assert result.exit_code == 0, f"{name}: {result.output}"
    return open_chains(sorted(out.iterdir()))


def test_every_kind_is_here(runs):
    made = {reduction_of(run) for run in runs}
    assert made == set(all_kinds()) - set(with_part(FORM)), "a form of all tests has no runs"


def test_process_prints_strict_json_and_nothing_else(runs, tmp_path):
    command = [sys.executable, "-m", "pmabench", "process", *(run.path for run in runs), "--json", "--out", tmp_path]
    result = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, timeout=280)
    assert result.returncode in (0, 6), result.stderr
    assert result.stderr == ""
    reported = strict(result.stdout)
    assert {reduction_of(run) for run in runs} <= {analysis["kind"] for analysis in reported["analyses"]}
    for path in tmp_path.rglob("analysis.json"):
        strict(path.read_text(encoding="utf-8"))


def _held(trial, *names):
    """The trial with these channels (or all) at the value that they begin with."""
    held = {n: np.full(len(v), v[0] if len(v) else 0.0) for n, v in trial.channels.items() if not names or n in names}
    return replace(trial, channels={**trial.channels, **held}) if held else trial


def _cut(trial, share):
    n = 3 if share is None else int(share * len(trial.t))
    channels = {name: values[:n] for name, values in trial.channels.items()}
    return replace(trial, t=trial.t[:n], flags=trial.flags[:n], channels=channels)


def _lost(trial):
    channels = {name: np.full(len(values), np.nan) for name, values in trial.channels.items()}
    return replace(trial, channels=channels, flags=trial.flags | np.uint16(Flag.DROPOUT))


BROKEN = {
    "all channels constant": _held,
    "all channels zero": lambda trial: replace(trial, channels={n: 0 * v for n, v in trial.channels.items()}),
    "no motion": lambda trial: _held(trial, "displacement", "angle"),
    "dead pressure": lambda trial: _held(trial, "pressure"),
    "dead force": lambda trial: _held(trial, "force"),
    "every sample lost": _lost,
    "three samples": lambda trial: _cut(trial, None),
    "no sample": lambda trial: _cut(trial, 0.0),
    "the first half": lambda trial: _cut(trial, 0.5),
}


@pytest.mark.parametrize("fault", [*BROKEN, "no trial", "one trial"])
def test_broken_runs_of_every_kind_are_strict_json_without_a_warning(runs, fault):
    for run in runs:
        if fault in BROKEN:
            trials = [tuple(BROKEN[fault](trial) for trial in run.trials)]
            if len(run.trials) > 1:
                trials.append((BROKEN[fault](run.trials[0]), *run.trials[1:]))
        else:
            trials = [run.trials[:1] if fault == "one trial" else ()]
        for some in trials:
            if len(some) == len(run.trials) and all(map(is_, some, run.trials)):
                continue  # it has no such channel, or one trial only: the sound run, which `process` had above
            broken = replace(run, trials=some)
            analyses = reduce_runs([broken])
            reasons = verdicts([broken], analyses)
            reported = [plain(analysis.to_dict()) for analysis in analyses]
            strict(json.dumps([reported, reasons], allow_nan=False))
            for analysis in analyses:
                assert all(e.value is None or math.isfinite(e.value) for e in analysis.estimates), run.kind
                values = [e.value for e in analysis.estimates if e.value is not None]
                assert values or reasons, f"{run.kind}, {fault}: nothing came out, and nothing says so"
