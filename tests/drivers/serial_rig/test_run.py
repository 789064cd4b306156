"""Whole runs on three serial devices with a clock each: Alicat PCD, serial-line DAQ, laser."""

import pytest

from tests.drivers.judged import (
    B_OF_POLLED,
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


def test_coefficients_come_back(tmp_path):
    with WholeRun(tmp_path, "serial", preset="bench") as run:
        assert_gives_back(run, coefficients(500), POLLED, B_OF_POLLED)
        assert_vented(run)


def test_all_killed_the_controller_keeps_its_set_point_and_the_board_vents(tmp_path):
    with WholeRun(tmp_path, "serial") as run:
        assert assert_dies(run, "all killed", watchdog=0.5)["device"] == "board"
        assert run.commanded()[-1] >= 100e3


@pytest.mark.slow
@whoever_dies
def test_whoever_dies(tmp_path, who):
    with WholeRun(tmp_path, "serial") as run:
        assert_dies(run, who, watchdog=0.5)


@pytest.mark.slow
def test_emergency_stop(tmp_path):
    with WholeRun(tmp_path, "serial") as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


@pytest.mark.slow
@pytest.mark.parametrize(("device", "vents"), [("controller", "board"), ("board", ""), ("laser", "")])
def test_a_device_that_is_lost_ends_the_run_and_the_others_vent(tmp_path, device, vents):
    with WholeRun(tmp_path, "serial") as run:
        said, entry = assert_vents(run, lost(device), 0.5)
        assert device in said
        assert entry["device"] == (vents or entry["device"])
