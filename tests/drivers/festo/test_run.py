"""A whole protocol through the emulated terminal, in real time: engine, guard and driver as at a real bench."""

import os
import signal
import sys
import time

import pandas as pd
import pytest

from pmabench.files.shipped import shipped_folder
from tests.drivers.wires.test_emulate import ask, emulate, free_port
from tests.drivers.wires.test_run import PROTOCOL, begin, entries, guards_of, until

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@pytest.fixture
def rig(tmp_path):
    """A bench of its own with its emulator, and the command that runs the protocol on it."""
    folder = shipped_folder("bench")
    path, protocol = tmp_path / "festo.yaml", tmp_path / "protocol.yaml"
    path.write_text((folder / "festo.yaml").read_text().replace("127.0.0.1:15021", f"127.0.0.1:{free_port()}"))
    (tmp_path / "calibrations").symlink_to(folder / "calibrations")
    protocol.write_text(PROTOCOL)
    arguments = ["run", str(protocol), "--bench", str(path), "--specimen", "mas-20-250-paper0", "--yes"]
    command = [sys.executable, "-m", "pmabench", *arguments, "--out", str(tmp_path / "runs"), "--no-color"]
    environment = {**os.environ, "PMABENCH_STATE": str(tmp_path / "state")}
    with emulate(path, "--preset", "ideal") as (_process, said):
        ask(said["control"], load={"force": 58.86, "mass": 8.0})
        yield said["control"], command, environment


def pressurised(control):
    return until(lambda: any(e["si"] >= 200e3 for e in entries(control, "set")), 60)


def test_a_protocol_runs_through_the_terminal_and_vents(rig, tmp_path):
    control, process = begin(rig)
    said, _ = process.communicate(timeout=120)
    assert process.returncode in {0, 6}, said  # one trial has no repeats: its verdict may be withheld
    assert "vent confirmed" in said
    assert "SIMULATED" in said
    commanded = [entry["si"] for entry in entries(control, "set")]
    assert max(commanded) == pytest.approx(300e3)
    assert min(commanded) == commanded[-1] == 0.0
    assert entries(control, "switch")[-1]["on"] is False
    assert entries(control, "watchdog") == []
    [folder] = [path for path in (tmp_path / "runs").iterdir() if path.is_dir() and not path.name.startswith(".")]
    stream = pd.read_parquet(folder / "streams" / "terminal.parquet")
    assert stream["pressure"].max() == pytest.approx(9600, abs=20)  # counts, as the terminal gives them
    assert (stream["displacement"].max() * 100 / 32000 - 5) == pytest.approx(31.91, abs=0.2)  # the plant's own example


def test_with_the_guard_killed_the_engine_vents(rig):
    control, process = begin(rig)
    try:
        assert pressurised(control)
        [guard] = guards_of(process.pid)
        os.kill(guard, signal.SIGKILL)
        killed = time.monotonic()
        assert until(lambda: not entries(control, "switch")[-1]["on"], 3)
        assert until(lambda: entries(control, "set")[-1]["si"] == 0.0, 3)
        assert entries(control, "switch")[-1]["t"] - killed < 1.5
        said, _ = process.communicate(timeout=60)
        assert process.returncode not in {0, None}, said
        assert "Traceback" not in said
    finally:
        process.kill()
        process.wait()


def test_with_engine_and_guard_killed_the_terminal_takes_its_outputs_away(rig):
    control, process = begin(rig)
    try:
        assert pressurised(control)
        for pid in (process.pid, *guards_of(process.pid)):
            os.kill(pid, signal.SIGKILL)
        killed = time.monotonic()
        assert until(lambda: entries(control, "watchdog"), 3)
        assert entries(control, "watchdog")[0]["t"] - killed < 1.5
        assert entries(control, "set")[-1]["si"] == 0.0
        assert entries(control, "switch")[-1]["on"] is False
    finally:
        process.kill()
        process.communicate()
