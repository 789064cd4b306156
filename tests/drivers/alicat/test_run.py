"""Whole runs through an emulated controller, over both protocols, in real time.

The controller has no watchdog: a relay with one holds the dump valve shut.
"""

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
PROTOCOLS = {"ascii": [], "modbus": [("protocol: ascii", "protocol: modbus\n      unit: kPa")]}
both_protocols = pytest.mark.parametrize("changes", PROTOCOLS.values(), ids=PROTOCOLS)


@pytest.mark.parametrize(
    "changes", [PROTOCOLS["ascii"], pytest.param(PROTOCOLS["modbus"], marks=pytest.mark.slow)], ids=PROTOCOLS
)
def test_coefficients_come_back(tmp_path, changes):
    with WholeRun(tmp_path, "alicat", *changes, preset="bench") as run:
        assert_gives_back(run, coefficients(50, repeats=2), POLLED, B_OF_POLLED)
        assert_vented(run)
        assert max(run.commanded()) == pytest.approx(400e3)
        assert {entry["setting"] for entry in run.entries("valves")} <= {"", "EXH"}


def test_all_killed_the_controller_keeps_its_set_point_and_the_relay_vents(tmp_path):
    with WholeRun(tmp_path, "alicat") as run:
        entry = assert_dies(run, "all killed", watchdog=0.5)
        assert entry["device"] == "relay"
        assert run.commanded()[-1] >= 100e3


@pytest.mark.slow
@both_protocols
@whoever_dies
def test_whoever_dies(tmp_path, changes, who):
    with WholeRun(tmp_path, "alicat", *changes) as run:
        assert_dies(run, who, watchdog=0.5)


@pytest.mark.slow
def test_emergency_stop(tmp_path):
    with WholeRun(tmp_path, "alicat") as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


@pytest.mark.slow
@both_protocols
def test_a_controller_that_goes_silent_is_vented_by_the_dump_valve(tmp_path, changes):
    with WholeRun(tmp_path, "alicat", *changes) as run:
        _, entry = assert_vents(run, lost("controller", "silence"), 0.5)
        assert entry["device"] == "relay"
