"""A whole protocol through the wires, in real time: engine, guard and drivers as at a real bench, the plant behind them."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from pmabench.files.shipped import shipped_folder
from tests.drivers.wires.test_emulate import ask, emulate, own_bench

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

PROTOCOL = """\
schema: pmabench.protocol/1
kind: contraction-relaxation
name: one step up, one down
source: made for this test
needs: {free_end: weights}
sample_rate: 50 Hz
record: [pressure, displacement, force, pressure_command]
prepare: {precondition: {cycles: 1, pressure: 200 kPa, hold: 500 ms}}
sweep: {matrix: {load: [6 kg], pressure: [300 kPa]}, order: as-written, repeat: {count: 1, as: blocks}}
trial: {baseline: 200 ms, contract: {hold: 3 s}, relax: {by: 100 kPa, hold: 1 s, then: 0 kPa, hold_at_end: 1 s}}
"""


@pytest.fixture
def rig(tmp_path):
    """A bench of its own with its emulator, and the command that runs the protocol on it."""
    path, protocol = own_bench(tmp_path), tmp_path / "protocol.yaml"
    protocol.write_text(PROTOCOL)
    arguments = ["run", str(protocol), "--bench", str(path), "--specimen", "mas-20-250-paper0", "--yes"]
    command = [sys.executable, "-m", "pmabench", *arguments, "--out", str(tmp_path / "runs"), "--no-color"]
    environment = {**os.environ, "PMABENCH_STATE": str(tmp_path / "state")}
    with emulate(path, "--preset", "ideal") as (_process, said):
        ask(said["control"], load={"force": 58.86, "mass": 8.0})
        yield said["control"], command, environment


def entries(control, kind):
    return ask(control, log=kind)["entries"]


def begin(rig):
    control, command, environment = rig
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
    return control, process


def until(condition, within):
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return False


def test_a_protocol_runs_through_the_wires_and_vents(rig, tmp_path):
    control, process = begin(rig)
    said, _ = process.communicate(timeout=120)
    assert process.returncode in {0, 6}, said  # one trial has no repeats: its verdict may be withheld
    assert "vent confirmed" in said
    commanded = [entry["si"] for entry in entries(control, "set")]
    assert max(commanded) == 300e3
    assert min(commanded) == commanded[-1] == 0.0
    assert entries(control, "switch")[-1]["on"] is False
    assert entries(control, "watchdog") == []
    [folder] = [path for path in (tmp_path / "runs").iterdir() if path.is_dir() and not path.name.startswith(".")]
    streams = {name: pd.read_parquet(folder / "streams" / f"{name}.parquet") for name in ("regulator", "gauge")}
    assert streams["regulator"]["pressure"].max() == pytest.approx(300.0, abs=0.5)  # kPa, as the device gives it
    assert streams["gauge"]["displacement"].max() == pytest.approx(31.91, abs=0.2)  # the plant's own example
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert [e["data"]["sent"] for e in events if e["kind"] == "command"][-1] == 0.0
    assert (folder / "registers" / "pressure-regulator.yaml").read_text() == (
        shipped_folder("bench") / "registers" / "pressure-regulator.yaml"
    ).read_text()


def guards_of(pid):
    """Processes that the run has started and that are guards."""
    found = []
    for path in Path("/proc").iterdir():
        if path.name.isdecimal():
            try:
                parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
                words = (path / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if parent == pid and b"pmabench.guard" in words:
                found.append(int(path.name))
    return found


def test_with_the_guard_killed_the_engine_vents(rig):
    control, process = begin(rig)
    try:
        assert until(lambda: any(e["si"] >= 200e3 for e in entries(control, "set")), 60)
        [guard] = guards_of(process.pid)
        os.kill(guard, signal.SIGKILL)
        killed = time.monotonic()
        assert until(lambda: not entries(control, "switch")[-1]["on"], 3)
        assert entries(control, "set")[-1]["si"] == 0.0
        assert entries(control, "switch")[-1]["t"] - killed < 1.0
        said, _ = process.communicate(timeout=60)
        assert process.returncode not in {0, None}, said
        assert "Traceback" not in said
    finally:
        process.kill()
        process.wait()


def test_with_engine_and_guard_killed_the_devices_own_watchdog_vents(rig):
    control, process = begin(rig)
    try:
        assert until(lambda: any(e["si"] >= 200e3 for e in entries(control, "set")), 60)
        for pid in (process.pid, *guards_of(process.pid)):
            os.kill(pid, signal.SIGKILL)
        killed = time.monotonic()
        assert until(lambda: entries(control, "watchdog"), 3)
        assert entries(control, "watchdog")[0]["t"] - killed < 1.0
    finally:
        process.kill()
        process.communicate()


def test_the_emergency_stop_on_the_wire_vents(rig):
    control, process = begin(rig)
    try:
        assert until(lambda: any(e["si"] >= 200e3 for e in entries(control, "set")), 60)
        ask(control, plant="e_stop")
        pressed = time.monotonic()
        assert until(lambda: entries(control, "set")[-1]["si"] == 0.0, 3)
        assert entries(control, "set")[-1]["t"] - pressed < 1.0
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 5, said
        assert "e-stop" in said
    finally:
        process.kill()
        process.wait()
