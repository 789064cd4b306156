"""Whole runs over one line, in real time."""

import json

import pytest

from tests.drivers.judged import (
    HARDWARE_TIMED,
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
    with WholeRun(tmp_path, "serial-line-daq", preset="bench") as run:
        assert_gives_back(run, coefficients(500), HARDWARE_TIMED)
        assert_vented(run)
        sent = run.entries("set")
        assert max(entry["raw"] for entry in sent) == 1638  # 400 kPa of 4095 for 1000 kPa
        assert sent[-1]["raw"] == 0
        assert run.entries("armed")[0]["seconds"] == 0.5
        assert run.stream("board")["pressure_command"].max() == 1638
        manifest = json.loads((run.record / "manifest.json").read_text())
        assert manifest["devices"]["board"]["firmware"] == "line-daq 1"


def test_all_killed(tmp_path):
    with WholeRun(tmp_path, "serial-line-daq") as run:
        assert_dies(run, "all killed", watchdog=0.5)


@pytest.mark.slow
@whoever_dies
def test_whoever_dies(tmp_path, who):
    with WholeRun(tmp_path, "serial-line-daq") as run:
        assert_dies(run, who, watchdog=0.5)


@pytest.mark.slow
def test_emergency_stop(tmp_path):
    with WholeRun(tmp_path, "serial-line-daq") as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


@pytest.mark.slow
def test_a_torn_line_ends_the_run_and_the_board_vents_by_itself(tmp_path):
    with WholeRun(tmp_path, "serial-line-daq") as run:
        said, entry = assert_vents(run, lost("board", "silence"), 0.5)
        assert entry["kind"] == "watchdog"
        assert "board" in said
