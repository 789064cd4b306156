"""Whole runs through Modbus and text lines, in real time: three devices, three clocks."""

import json

import pytest

from pmabench.files.shipped import shipped_folder
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
from tests.drivers.whole_run import WholeRun, coefficients, one_step

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]


def test_coefficients_come_back(tmp_path):
    with WholeRun(tmp_path, "wires", preset="bench") as run:
        assert_gives_back(run, coefficients(100, repeats=2), POLLED, B_OF_POLLED)
        assert_vented(run)
        assert max(run.commanded()) == 400e3
        kept, own = run.record / "registers", shipped_folder("bench") / "registers"
        assert [path.read_text() for path in kept.iterdir()] == [(own / "pressure-regulator.yaml").read_text()]


def test_all_killed(tmp_path):
    with WholeRun(tmp_path, "wires") as run:
        assert_dies(run, "all killed", watchdog=0.5)


@pytest.mark.slow
def test_after_a_session(tmp_path):
    with WholeRun(tmp_path, "wires", preset="bench", session=True) as run:
        run.carried_out(one_step(100))
        assert_vented(run)
        kinds = {json.loads(path.read_text())["kind"] for path in run.out.glob("*/manifest.json")}
        assert kinds == {"session", "contraction-relaxation"}


@pytest.mark.slow
@whoever_dies
def test_whoever_dies(tmp_path, who):
    with WholeRun(tmp_path, "wires") as run:
        assert_dies(run, who, watchdog=0.5)


@pytest.mark.slow
def test_emergency_stop(tmp_path):
    with WholeRun(tmp_path, "wires") as run:
        said, _ = assert_vents(run, e_stop, 0.2, code=5)
        assert "e-stop" in said


@pytest.mark.slow
@pytest.mark.parametrize("device", ["load_cell", "gauge"])
def test_an_indicator_that_is_lost_ends_the_run(tmp_path, device):
    with WholeRun(tmp_path, "wires") as run:
        said, _ = assert_vents(run, lost(device), 0.2)
        assert device in said


@pytest.mark.slow
def test_a_regulator_that_says_nothing_vents_by_itself(tmp_path):
    with WholeRun(tmp_path, "wires") as run:
        _, entry = assert_vents(run, lost("regulator", "silence"), 0.5)
        assert entry["kind"] == "watchdog"
