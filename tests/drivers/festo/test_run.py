"""Whole runs through the emulated terminal, in real time."""

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
    with WholeRun(tmp_path, "festo", preset="bench") as run:
        assert_gives_back(run, coefficients(100, repeats=2), POLLED, B_OF_POLLED)
        assert_vented(run)
        assert max(run.commanded()) == pytest.approx(400e3)


def test_all_killed_the_terminal_takes_its_outputs_away(tmp_path):
    with WholeRun(tmp_path, "festo") as run:
        assert_dies(run, "all killed", watchdog=0.5)
        assert run.commanded()[-1] == 0.0
        assert run.entries("switch")[-1]["on"] is False


@pytest.mark.slow
@whoever_dies
def test_whoever_dies(tmp_path, who):
    with WholeRun(tmp_path, "festo") as run:
        assert_dies(run, who, watchdog=0.5)


@pytest.mark.slow
def test_emergency_stop(tmp_path):
    with WholeRun(tmp_path, "festo") as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


@pytest.mark.slow
def test_a_terminal_that_says_nothing_vents_by_itself(tmp_path):
    with WholeRun(tmp_path, "festo") as run:
        _, entry = assert_vents(run, lost("terminal", "silence"), 0.5)
        assert entry["kind"] == "watchdog"
