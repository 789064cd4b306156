"""The session of a joint of two muscles: each fault is named with its muscle; exchanged hoses get a small pressure only."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.session import ensure
from pmabench.session.self_test import run_self_test
from pmabench.session.session import SessionFailed
from pmabench.store.reader import open_run

ROOT = Path(__file__).resolve().parents[2]
BENCHES, SPECIMEN = ROOT / "fixtures" / "benches", ROOT / "fixtures" / "specimens" / "joint-daerden.yaml"
PLUGS = {"pressure_1": {"reads": "pressure_2"}, "pressure_2": {"reads": "pressure_1"}}
EXCHANGED = "muscles 1 and 2 are exchanged: output pressure_1 (plant.pressure_1) moves the pressure of muscle 2"
WRONG_WAY = "both muscles pull the wrong way: their hoses are exchanged, together with the plugs"
FAULTS = {
    "exchanged hoses": ({"hoses": "crossed"}, EXCHANGED, 25e3),
    "exchanged plugs of the sensors": ({"errors": PLUGS}, EXCHANGED, 25e3),
    "exchanged hoses and plugs": ({"hoses": "crossed", "errors": PLUGS}, WRONG_WAY, 100e3),
    "sign of the angle": ({"errors": {"angle": {"factor": -1}}}, "or the sign of the angle is wrong", 100e3),
    "a leak of muscle 1": ({"faults": {"leak_at": 0.0}, "faulty": 1}, "leak of muscle 1 falls by", 100e3),
    "a leak of muscle 2": ({"faults": {"leak_at": 0.0}, "faulty": 2}, "leak of muscle 2 falls by", 100e3),
    "a dead regulator": ({"faults": {"regulator_stuck_at": 0.0}, "faulty": 2}, "muscle 2 does not follow", 25e3),
    "scale of a sensor": ({"errors": {"pressure_2": {"factor": 1.2}}}, "regulator of muscle 2, steady", 50e3),
    "four times too much": ({"errors": {"pressure_1": {"factor": 4.0}}}, "muscle 1 alone pressure_1 rises", 25e3),
    "sign of a sensor": ({"errors": {"pressure_1": {"factor": -1}}}, "the sign of the pressure of muscle 1", 25e3),
    "zero of a sensor": ({"errors": {"pressure_2": {"offset": 8e3}}}, "muscle 2 at rest 8", 0.0),
    "one sensor on both": ({"errors": {"pressure_2": {"reads": "pressure_1"}}}, "also moves muscle 2", 25e3),
}


def joint(name="mock-joint-session", **options):
    made = mount(BENCHES / f"{name}.yaml", SPECIMEN)
    devices = tuple(replace(d, options={**d.options, **options}) for d in made.bench.devices)
    return replace(made, bench=replace(made.bench, devices=devices))


def commanded(run):
    return [e.data["value"] for e in run.events if e.kind == "command" and e.data["output"].startswith("pressure")]


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_ends_the_session_at_its_pressure_and_names_the_muscle(name, tmp_path):
    options, said, highest = FAULTS[name]
    with pytest.raises(SessionFailed) as refused:
        ensure(joint(**options), ConfirmedBeforehand(), tmp_path / "runs")
    assert said in str(refused.value)
    assert refused.value.outcome.vent.confirmed
    assert max(commanded(open_run(refused.value.outcome.folder)), default=0.0) == pytest.approx(highest)


def test_a_good_pair_passes_its_session_and_runs_take_the_zeros_of_both(tmp_path):
    for seed in range(3):
        tables = []
        made = joint(seed=seed)
        ready = ensure(made, ConfirmedBeforehand(), tmp_path / "runs", anew=True, report=tables.append)
        assert {check.verdict for check in tables[0]} <= {"ok", "not measured"}
        assert set(ready.in_session["zeros"]) == {"pressure_1", "pressure_2"}
    names = [check.name for check in tables[0]]
    assert {f"leak of muscle {number}" for number in (1, 2)} <= set(names)
    run = open_run(next(iter(sorted((tmp_path / "runs").iterdir()))))
    leaks = next(e.data["leaks"] for e in run.events if e.kind == "self-test")
    assert leaks["1"]["pressure"] == pytest.approx(100e3)
    assert abs(leaks["1"]["falls"]) < 50


def test_the_leak_that_is_reported_is_that_of_the_plant(tmp_path):
    """It empties with a lag of 20 s: of 100 kPa 95.1 are left after 1 s, and 37.4 of them are lost in 10 s more."""
    tables = []
    made = joint(faults={"leak_at": 0.0}, faulty=2)
    run_self_test(made, ConfirmedBeforehand(), tmp_path / "runs", report=tables.append)
    (leak,) = [check for check in tables[-1] if check.name == "leak of muscle 2"]
    t = [i / 1000 for i in range(10001)]
    y = [100e3 * math.exp(-(1.0 + s) / 20) for s in t]
    slope = sum((s - 5) * v for s, v in zip(t, y, strict=True)) / sum((s - 5) ** 2 for s in t)
    assert leak.verdict == "failed"
    assert float(leak.value.split()[2]) == pytest.approx(-60 * slope / 1e3, rel=0.02)


def test_a_driven_joint_is_judged_by_its_torque(tmp_path):
    """Per muscle 0.96 N.m for 25 kPa: R S(10 %) dP (joints-endurance 1.1, muscle D)."""
    made = mount(BENCHES / "mock-joint-session.yaml", SPECIMEN)
    driven = replace(mount(BENCHES / "mock-joint.yaml", SPECIMEN), session=made.session)
    tables = []
    outcome = run_self_test(driven, ConfirmedBeforehand(), None, report=tables.append)
    assert outcome.exit_code == 0, outcome.why
    (pulls,) = [check for check in tables[-1] if check.name == "muscle 1 pulls"]
    assert float(pulls.value.split()[4]) == pytest.approx(0.96, abs=0.03)


def test_a_platform_has_no_session(tmp_path):
    text = f"include: {BENCHES / 'mock-platform.yaml'}\nsession: {{self_test: {{}}}}\n".replace(f"{BENCHES}/", "")
    for file in (BENCHES / "mock-platform.yaml", *(BENCHES / "calibrations").glob("MOCK-*.yaml")):
        (tmp_path / file.relative_to(BENCHES)).parent.mkdir(exist_ok=True)
        (tmp_path / file.relative_to(BENCHES)).write_text(file.read_text())
    (tmp_path / "ours.yaml").write_text(text)
    with pytest.raises(InvalidFile, match="a platform has valves"):
        mount(tmp_path / "ours.yaml", ROOT / "fixtures" / "specimens" / "platform-daerden.yaml")
