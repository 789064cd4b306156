"""Whole runs on the emulated USB-6215 and relay module, in real time: engine, guard and drivers as at a real bench."""

import os
import signal
import subprocess
import sys
import time

import pytest

from pmabench.files.shipped import shipped_folder
from tests.drivers.judged import (
    HARDWARE_TIMED,
    assert_coefficients,
    assert_dies,
    assert_vented,
    assert_vents,
    e_stop,
    lost,
    whoever_dies,
)
from tests.drivers.whole_run import WholeRun, coefficients, one_step

pytestmark = pytest.mark.realtime


def alone():
    """Changes to the bench: no relay module, the dump valve on a line of the USB-6215 itself."""
    text = (shipped_folder("bench") / "ni.yaml").read_text()
    relay = text[text.index("  relay:") : text.index("channels:")]
    return (
        (relay, ""),
        ("dump_valve: {device: relay, output: dump_valve,", "dump_valve: {device: daq, output: port1/line0,"),
    )


def test_coefficients_come_back_without_a_gap(tmp_path):
    with WholeRun(tmp_path, "ni", preset="bench") as run:
        run.carried_out(coefficients(500))
        assert_vented(run)
        steps = run.stream("daq")["time_ns"].diff().dropna()
        assert set(steps[steps < 1e9]) == {2_000_000}  # every sample of each trial, on the device's own clock
        assert_coefficients(run.coefficients(), HARDWARE_TIMED)


def test_all_killed(tmp_path):
    with WholeRun(tmp_path, "ni") as run:
        entry = assert_dies(run, "all killed", watchdog=0.5)
        assert entry["device"] == "relay"
        assert run.commanded()[-1] >= 199e3  # nothing in the USB-6215 knows that the computer is gone


@pytest.mark.slow
def test_with_the_dump_valve_on_the_device_itself(tmp_path):
    with WholeRun(tmp_path, "ni", *alone()) as run:
        run.carried_out(one_step(500))
        assert_vented(run)
        assert max(run.commanded()) == pytest.approx(300e3, abs=31)  # a step of the output is 31 Pa
        assert {entry["device"] for entry in run.entries("switch")} == {"daq"}
        table = run.stream("daq")
        assert table["pressure_command"].max() == pytest.approx(3.0, abs=0.001)  # V: ao0, looped


@pytest.mark.slow
@whoever_dies
def test_whoever_dies(tmp_path, who):
    with WholeRun(tmp_path, "ni") as run:
        assert_dies(run, who, watchdog=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("who", ["engine killed", "engine frozen", "guard killed", "guard frozen"])
def test_whoever_dies_at_a_rig_without_relay_module(tmp_path, who):
    with WholeRun(tmp_path, "ni", *alone()) as run:
        assert_dies(run, who)


@pytest.mark.slow
def test_all_killed_at_a_rig_without_relay_module_vents_nothing(tmp_path):
    """The truth that `check` tells: the device holds pressure and valve, until somebody vents."""
    with WholeRun(tmp_path, "ni", *alone()) as run:
        run.pressurised(one_step(100))
        run.signal("both", signal.SIGKILL)
        time.sleep(2.0)
        assert run.commanded()[-1] >= 199e3
        assert run.entries("switch")[-1]["on"] is True
        vent = [sys.executable, "-m", "pmabench", "vent", str(run.path), "--no-color"]
        environment = {**os.environ, "PMABENCH_STATE": str(tmp_path / "state")}
        done = subprocess.run(vent, capture_output=True, text=True, env=environment, timeout=60)
        assert run.commanded()[-1] == 0.0, done.stdout + done.stderr
        assert run.entries("switch")[-1]["on"] is False


@pytest.mark.slow
def test_emergency_stop(tmp_path):
    with WholeRun(tmp_path, "ni") as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["silence", "reset"])
def test_where_the_server_fails_the_relay_vents(tmp_path, fault):
    with WholeRun(tmp_path, "ni") as run:
        _, entry = assert_vents(run, lost("daq", fault), 1.0)
        assert entry["device"] == "relay"
