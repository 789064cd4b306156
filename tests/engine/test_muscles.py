"""Two muscles on one bench through engine and guard: a fault of one ends the run and vents both (S2, S5)."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
from pmabench_drivers.mock import MockBench

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.bench.interface import OutputRecord, ProofTest
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import Outcome, run_plan
from pmabench.protocol.plan import Ask, Hold, Plan, Ramp, Record, Set, TrialRecord

ROOT = Path(__file__).resolve().parents[2]
BENCHES, SPECIMEN = ROOT / "fixtures" / "benches", ROOT / "fixtures" / "specimens" / "joint-daerden.yaml"
PAIR = ("pressure_1", "pressure_2")
FULL = (Set("hold", "pressure_1", 3e5), Set("hold", "pressure_2", 2e5), Hold("hold", 6.0))


def joint(name="mock-joint", **options):
    made = mount(BENCHES / f"{name}.yaml", SPECIMEN)
    devices = tuple(replace(d, options={**d.options, **options}) for d in made.bench.devices)
    return replace(made, bench=replace(made.bench, devices=devices))


def execute(made, *steps) -> Outcome:
    inside = (Record("t", True, 0), *steps, Record("t", False, 0))
    plan = Plan("test", "test", "none", "joint", 500.0, (*PAIR, "angle", "torque"), (TrialRecord(0, {}),), inside)
    return run_plan(plan, made, ConfirmedBeforehand(), out=None)


def commands(outcome, kind):
    return [data for what, _t, data in outcome.events if what == kind]


@pytest.mark.parametrize("faulty", [1, 2])
def test_a_burst_of_one_muscle_trips_and_vents_both(faulty):
    outcome = execute(joint(faulty=faulty, faults={"burst_at": 3.0}), *FULL)
    (trip,) = commands(outcome, "trip")
    assert f"pressure_{faulty} fell by" in trip["reason"]
    assert (outcome.status, outcome.vent.result, outcome.bench_seconds < 9.0) == ("tripped", "confirmed", True)
    assert {f"set {name}: sent" for name in PAIR} <= set(outcome.vent.actions)


@pytest.mark.parametrize("faulty", [1, 2])
def test_one_of_two_muscles_that_does_not_vent_is_an_unconfirmed_vent(faulty):
    stuck = {"regulator_stuck_at": 3.0, "dump_stuck_at": 3.0}
    outcome = execute(joint(faulty=faulty, faults=stuck), *FULL)
    assert outcome.vent.result != "confirmed"
    assert outcome.exit_code != 0
    held = [text for text in outcome.vent.actions if text.startswith(f"confirm pressure_{faulty}")]
    assert len(held) == 1
    assert "not below 20 kPa" in held[0]


def test_a_stuck_regulator_alone_vents_through_the_valve():
    assert execute(joint(faults={"regulator_stuck_at": 3.0}), *FULL).vent.confirmed


def test_the_angle_has_a_limit_to_both_sides():
    for factor in (1.0, -1.0):
        error = {"angle": {"offset": factor * math.radians(50), "at": 3.0}}
        outcome = execute(joint(errors=error), *FULL)
        assert (outcome.status, outcome.vent.result) == ("tripped", "confirmed")
        assert "angle" in commands(outcome, "trip")[0]["reason"]


def test_a_command_above_the_limit_of_muscle_2_only_is_refused(tmp_path):
    path = bench(tmp_path, "  2: {limits: {pressure: {command: 250 kPa}}}")
    made = mount(path, SPECIMEN)
    outputs: dict[str, OutputRecord] = {output.name: output for output in made.bench.outputs}
    assert (outputs["pressure_1"].high, outputs["pressure_2"].high) == (550e3, 250e3)
    assert "changed.yaml" in outputs["pressure_2"].high_from
    above = execute(made, Set("both", "pressure_1", 3e5), Set("both", "pressure_2", 3e5), Hold("both", 1.0))
    assert "300 kPa for pressure_2 is outside" in above.why
    assert above.vent.confirmed


def bench(folder, muscles="", text=""):
    changes = f"include: {BENCHES / 'mock-joint.yaml'}\n".replace(str(BENCHES) + "/", "")
    for file in (*BENCHES.glob("mock-joint*.yaml"), *(BENCHES / "calibrations").glob("MOCK-*.yaml")):
        (folder / file.relative_to(BENCHES)).parent.mkdir(exist_ok=True)
        (folder / file.relative_to(BENCHES)).write_text(file.read_text())
    (folder / "changed.yaml").write_text(changes + (f"muscles:\n{muscles}\n" if muscles else "") + text)
    return folder / "changed.yaml"


WRONG = {
    "one muscle is never confirmed": ("safe_state:\n  - {drive_quick_stop: angle, within: 200 ms}\n"
        "  - {set: pressure_1, within: 1 s, to: 0 kPa}\n  - {set: pressure_2, within: 1 s, to: 0 kPa}\n"
        "  - {open: dump_valve, within: 1 s}\n  - {confirm: pressure_1, below: 20 kPa, within: 5 s}\n",
        "does not look.*confirm: pressure_2"),
    "one muscle is never vented": ("safe_state:\n  - {drive_quick_stop: angle, within: 200 ms}\n"
        "  - {set: pressure_2, within: 1 s, to: 0 kPa}\n  - {open: dump_valve, within: 1 s}\n"
        "  - {confirm: pressure_1, below: 20 kPa, within: 5 s}\n  - {confirm: pressure_2, below: 20 kPa, within: 5 s}\n",
        'does not vent.*"set: pressure_1"'),
    "a wait between two that vent together": ("safe_state:\n  - {drive_quick_stop: angle, within: 200 ms}\n"
        "  - {set: pressure_1, within: 1 s, to: 0 kPa}\n  - {hold: 1 s}\n  - {set: pressure_2, within: 1 s, to: 0 kPa}\n"
        "  - {open: dump_valve, within: 1 s}\n"
        "  - {confirm: pressure_1, below: 20 kPa, within: 5 s}\n  - {confirm: pressure_2, below: 20 kPa, within: 5 s}\n",
        '"vents: together" and "hold"'),
    "another order than declared": ("vents: [pressure_2, pressure_1]\n", "not in the order that is declared"),
    "an order that forgets a muscle": ("vents: [dump_valve, pressure_1]\n", '"pressure_2" is missing'),
    "no limit of the second muscle": ("limits:\n  pressure_2: {trip: null}\n", '"pressure_2" has no trip limit'),
    "a trip above what the second bears": ("limits:\n  pressure_2: {trip: 710 kPa}\n", "muscle 2's never_above"),
    "a muscle that is not there": ("limits:\n  pressure_3: {trip: 600 kPa}\n", 'names no muscle "3"'),
    "a channel without a number": ("channels:\n  pressure: {device: plant, input: pressure_1, unit: Pa, "
                                   "range: [0 kPa, 900 kPa]}\n", 'no channel is called "pressure"'),
    "no limit of the angle": ("limits:\n  angle: {trip_low: null}\n", "limits to both sides"),
    "a drive that reaches its trip": ("limits:\n  angle: {trip_low: -44 deg}\n", "below the lowest command"),
    "no word how they vent": ("vents: null\n", '"muscles" and "vents"'),
    "a session above the limit of muscle 2": ("muscles:\n  2: {limits: {pressure: {command: 250 kPa}}}\n"
        "session: {warm_up: {pressure: 300 kPa}}\n", "300 kPa is above the command limit, 250 kPa"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_bench_that_is_not_safe_for_both_is_refused_at_its_place(name, tmp_path):
    text, reported = WRONG[name]
    with pytest.raises(InvalidFile, match=f"(?s){reported}") as caught:
        mount(bench(tmp_path, text=text), SPECIMEN)
    assert all(problem.line > 0 for problem in caught.value.problems)


def test_a_real_bench_of_two_muscles_says_how_to_add_a_session(tmp_path):
    (said,) = [line for line in mount(bench(tmp_path, text="time: real\n"), SPECIMEN).lacks if "no session" in line]
    assert "self_test: {}" in said
    assert "zeros: {pressure_1: {most: 5 kPa}}" in said


def test_several_problems_are_reported_at_once(tmp_path):
    text = "vents: [pressure_2, pressure_1]\nlimits:\n  pressure_2: {trip: 710 kPa}\n  angle: {trip_low: null}\n"
    with pytest.raises(InvalidFile) as caught:
        mount(bench(tmp_path, text=text), SPECIMEN)
    assert len(caught.value.problems) == 4  # 710 kPa is above what muscle 2 bears, and above the specimen's


def test_the_proof_of_the_vent_path_fills_and_vents_both():
    made = joint()
    made = replace(made, bench=replace(made.bench, proof=ProofTest(50e3, 20e3, 3.0)))
    outcome = execute(made, Hold("t", 0.1))
    assert (outcome.status, len(commands(outcome, "proof-test"))) == ("finished", 1)
    options = {"faulty": 2, "faults": {"regulator_stuck_at": 0.32, "dump_stuck_at": 0.1}}
    devices = tuple(replace(d, options={**d.options, **options}) for d in made.bench.devices)
    failed = execute(replace(made, bench=replace(made.bench, devices=devices)), Hold("t", 0.1))
    assert failed.status == "tripped"
    assert "failed its proof test" in failed.why


def test_hands_wait_for_both_muscles_to_be_vented():
    outcome = execute(joint(), *FULL, Set("v", "pressure_1", 0.0), Hold("v", 3.0), Ask("hands", "look"))
    assert "hands are not let in" in outcome.why
    outcome = execute(joint(), *FULL, *(Set("v", name, 0.0) for name in PAIR), Hold("v", 3.0), Ask("hands", "look"))
    assert outcome.status == "finished"


def test_a_controlled_stop_takes_both_down_and_neither_before_the_other(tmp_path):
    made = joint("mock-joint-free")
    stop = tuple(
        replace(t, high=math.radians(20), action="stop") if t.channel == "angle" else t for t in made.bench.trips
    )
    made = replace(made, bench=replace(made.bench, trips=stop))
    outcome = execute(made, *FULL, Ramp("on", "pressure_1", 3e5, 5e5, 2e4), Hold("on", 2.0))
    assert [data["origin"] for data in commands(outcome, "controlled-stop")] == [pytest.approx(4e5, abs=1e5)]
    assert outcome.vent.confirmed


def test_a_dump_valve_of_one_muscle_empties_that_one_and_the_supply_valve_both():
    """As in a dry run of a lab's bench, where each muscle may have a dump valve."""
    made = joint()
    (device,) = made.bench.devices
    (dump,) = device.valves
    names = ("dump_valve_1", "dump_valve_2", "supply_valve")
    kinds = {"supply_valve": "open"}
    each = tuple(replace(dump, name=name, output=name, energised=kinds.get(name, "closed")) for name in names)
    clock = VirtualClock()
    mock = MockBench(replace(device, valves=each), clock)
    mock.open()
    for name in names:
        mock.switch(name, on=True)
    for name, P in zip(PAIR, (3e5, 2e5), strict=True):
        output = next(one for one in device.outputs if one.name == name)
        mock.write(output.output, output.scale.to_raw(P))
    seen = []
    for name in ("", *names[::2]):
        if name:
            mock.switch(name, on=False)
        clock.wait_until(clock.now() + 3.0)
        seen.append([supply.value(clock.now()) for supply in mock.simulation()._plant.supplies])
    assert seen[0] == pytest.approx([3e5, 2e5], rel=1e-3)
    assert seen[1] == pytest.approx([0.0, 2e5], rel=1e-3, abs=1.0)
    assert seen[2] == pytest.approx([0.0, 0.0], abs=1e3)
