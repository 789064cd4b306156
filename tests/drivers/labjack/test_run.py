"""Whole runs on the emulated T7, in real time: engine, guard and driver as at a real bench."""

import pytest

from tests.drivers.judged import (
    B_OF_POLLED,
    HARDWARE_TIMED,
    POLLED,
    assert_dies,
    assert_gives_back,
    assert_vented,
    assert_vents,
    e_stop,
    lost,
    whoever_dies,
)
from tests.drivers.whole_run import WholeRun, coefficients

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]


def test_coefficients_come_back_without_a_gap(tmp_path):
    with WholeRun(tmp_path, "labjack", preset="bench") as run:
        assert_gives_back(run, coefficients(500), HARDWARE_TIMED)
        assert_vented(run)
        assert max(run.commanded()) == pytest.approx(400e3, abs=250)  # a step of the DAC is 244 Pa
        table = run.stream("t7")
        assert table["pressure_command"].max() == pytest.approx(2.0, abs=0.01)  # V: DAC0, looped
        steps = table["time_ns"].diff().dropna()
        assert set(steps[steps < 1e9]) == {2_000_000}  # every scan of each trial, on the T7's own clock


@pytest.mark.slow
def test_coefficients_come_back_through_a_t8(tmp_path):
    with WholeRun(tmp_path, "labjack-t8", preset="bench") as run:
        assert_gives_back(run, coefficients(100), POLLED, B_OF_POLLED)
        assert_vented(run)
        assert run.stream("t8")["pressure_command"].max() == pytest.approx(4.0, abs=0.01)  # V: DAC0, looped


@pytest.mark.slow
def test_all_killed_with_a_t8(tmp_path):
    with WholeRun(tmp_path, "labjack-t8") as run:
        assert_dies(run, "all killed", watchdog=2.0)


def test_all_killed(tmp_path):
    with WholeRun(tmp_path, "labjack") as run:
        assert_dies(run, "all killed", watchdog=2.0)


@pytest.mark.slow
@whoever_dies
def test_whoever_dies(tmp_path, who):
    with WholeRun(tmp_path, "labjack") as run:
        assert_dies(run, who, watchdog=2.0 if who == "all frozen" else 0.0)


@pytest.mark.slow
def test_emergency_stop(tmp_path):
    with WholeRun(tmp_path, "labjack") as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


@pytest.mark.slow
def test_a_t7_that_says_nothing_vents_by_itself(tmp_path):
    with WholeRun(tmp_path, "labjack") as run:
        _, entry = assert_vents(run, lost("t7", "silence"), 2.0)
        assert entry["kind"] == "watchdog"
