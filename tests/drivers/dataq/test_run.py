"""Whole runs through DATAQ, laser and regulator in real time: three devices, three clocks."""

import json
from itertools import pairwise

import pytest

from pmabench.bench.compile import mount
from pmabench.files.shipped import shipped_folder
from tests.drivers.judged import (
    B_OF_POLLED,
    HARDWARE_TIMED,
    assert_dies,
    assert_gives_back,
    assert_vented,
    assert_vents,
    lost,
    whoever_dies,
)
from tests.drivers.whole_run import LONGEST, SPECIMEN, WholeRun, coefficients, one_step

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]


def test_only_the_regulator_is_the_guards():
    mounted = mount(shipped_folder("bench") / "dataq.yaml", shipped_folder("specimen") / f"{SPECIMEN}.yaml")
    assert {device.name: device.guarded for device in mounted.bench.devices} == {
        "regulator": True,
        "daq": False,
        "laser": False,
    }


def test_coefficients_come_back(tmp_path):
    with WholeRun(tmp_path, "dataq", preset="bench") as run:
        sharp = {"K": HARDWARE_TIMED["K"], "F_ce": HARDWARE_TIMED["F_ce"]}
        assert_gives_back(run, coefficients(500), sharp, B_OF_POLLED)  # the pressure is polled
        assert_vented(run)


def test_all_killed_the_regulator_vents_by_its_watchdog(tmp_path):
    with WholeRun(tmp_path, "dataq") as run:
        assert assert_dies(run, "all killed", watchdog=0.5)["device"] == "regulator"


@pytest.mark.slow
def test_a_loss_on_the_way_is_a_gap_in_the_record(tmp_path):
    with WholeRun(tmp_path, "dataq") as run:
        run.pressurised(one_step(500), 299e3)
        run.ask(device="laser", fault="lost", count=20)
        run.ask(device="daq", fault="truncated", value=1, count=1)
        assert run.process.wait(LONGEST) in {0, 6}, run.said
        for name, missing in (("laser", 21), ("daq", None)):
            found = run.stream(name)
            steps = [later - earlier for earlier, later in pairwise(found["time_ns"])]
            gaps = [step for step in steps if step > 3_000_000]
            assert len(gaps) == 1, name
            assert (found["flags"] & 1).sum() == 1
            if missing is not None:
                assert round(gaps[0] / 2e6) == missing + 1
        lines = (run.record / "events.jsonl").read_text().splitlines()
        [end] = [json.loads(line) for line in lines if '"kind":"end"' in line]
        assert end["data"]["counts"]["gaps"] >= 2


@pytest.mark.slow
@whoever_dies
def test_whoever_dies(tmp_path, who):
    with WholeRun(tmp_path, "dataq") as run:
        assert_dies(run, who, watchdog=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("device", ["daq", "laser"])
def test_a_device_that_is_lost_ends_the_run(tmp_path, device):
    with WholeRun(tmp_path, "dataq") as run:
        said, _ = assert_vents(run, lost(device), 0.2)
        assert device in said


@pytest.mark.slow
def test_a_laser_that_sees_nothing_ends_the_run(tmp_path):
    with WholeRun(tmp_path, "dataq") as run:
        said, _ = assert_vents(run, lost("laser", "over"), 0.5, code=5)
        assert "displacement" in said
