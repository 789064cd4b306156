"""Steps and sines of a joint through protocol, law, guard and reduction, against another program and a loop written anew."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmabench.analysis.trial import Quick
from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.engine.laws.joint_loop import JointLoop
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.compile import make_plan
from pmabench.kinds.joint_step.reduction import courses, reduce
from pmabench.kinds.joint_torque.reduction import reduce as reduce_torques
from pmabench.kinds.reduce import of_one_trial
from pmabench.model.many.joint import Joint, JointPlant
from pmabench.model.regulator import constant
from pmabench.store.analyses.folder import write_analysis
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.reader import open_run

ROOT = Path(__file__).resolve().parents[2]
DEG = math.pi / 180
FRESH = ("trial.approach", "[]")
"""The joint is at angle 0 and never was elsewhere, as in the other program."""


def bench(name="mock-joint-free", **options):
    made = mount(ROOT / f"fixtures/benches/{name}.yaml", ROOT / "fixtures/specimens/joint-daerden.yaml")
    devices = tuple(replace(d, options={**d.options, **options}) for d in made.bench.devices)
    return replace(made, bench=replace(made.bench, devices=devices))


def compiled(*changes, made=None):
    return make_plan(ROOT / "protocols/joint-step.yaml", made or bench(), changes)[0]


def stepped(folder, integral, *changes, goal="20 deg", **options):
    points = ("sweep.zip.goal", f"[{goal}]"), ("sweep.zip.integral", f"[{integral} N.m/rad/s]")
    made = bench(**options)
    outcome = run_plan(
        compiled(*points, ("sweep.repeat.count", "1"), *changes, made=made), made, ConfirmedBeforehand(), out=folder
    )
    assert (outcome.status, outcome.vent.result) == ("finished", "confirmed")
    run = open_run(outcome.folder)
    return run, {e.symbol: e for e in reduce([run]).estimates}


def test_with_integral_action_a_step_settles_within_a_second(tmp_path):
    run, found = stepped(tmp_path, 20, FRESH)
    assert found["t_s"].value == pytest.approx(0.78, abs=0.03)  # another program
    assert found["e_th"].value == pytest.approx(0.0, abs=0.05 * DEG)
    assert found["OS_th"].value < 0.1 * DEG
    (trial,) = run.trials
    shown, doubts = of_one_trial(run, trial, None, Quick())
    assert [one.value for one in shown] == [found["e_th"].value, found["t_s"].value]
    assert doubts == []
    analysis = reduce([run])
    assert len(courses(analysis.traces, analysis)) == 1
    late = trial.channels["angle"][trial.t > trial.t[0] + 2.0 + 1.0]
    assert np.abs(late / DEG - 20).max() < 0.5


@pytest.mark.parametrize(("goal", "miss"), [("20 deg", -4.31), ("10 deg", -3.85), ("-20 deg", 4.31)])
def test_feed_forward_alone_misses_by_the_hysteresis_and_says_so(tmp_path, goal, miss):
    """Numbers of another program for the same muscles."""
    _, found = stepped(tmp_path, 0, FRESH, goal=goal)
    assert found["e_th"].value / DEG == pytest.approx(miss, abs=0.05)
    assert found["t_s"].value is None
    assert f"they end {miss:.2f}"[:13] in found["t_s"].note


@pytest.mark.study
def test_swings_that_become_smaller_make_every_trial_like_the_first(tmp_path):
    made = bench()
    run = open_run(run_plan(compiled(), made, ConfirmedBeforehand(), out=tmp_path).folder)
    found = {(e.symbol, e.at["integral"]): e for e in reduce([run]).estimates}
    for symbol, integral, true, unit in (("e_th", 0.0, -4.31, DEG), ("e_th", 20.0, 0.0, DEG), ("t_s", 20.0, 0.78, 1.0)):
        e = found[symbol, integral]
        assert e.n == 3
        assert e.ci95[0] / unit < true < e.ci95[1] / unit


def muscle(eps):
    """S, its slope, F_e, its slope (paper 3, eqs. 8-10)."""
    area, tan, sin = math.pi / 4 * 0.02**2, math.tan(25 * DEG) ** 2, math.sin(25 * DEG) ** 2
    bent = 800 * ((2 * eps - 0.22) * (eps + 0.04) - eps * (eps - 0.22)) / (eps + 0.04) ** 2
    return (
        area * (3 * (1 - eps) ** 2.6 / tan - 1 / sin), -area * 7.8 * (1 - eps) ** 1.6 / tan,
        800 * eps * (eps - 0.22) / (eps + 0.04), bent,
    )  # fmt: skip


def both(angle):
    """The two muscles on the pulley at an angle [rad]."""
    return muscle(0.1 + 0.025 * angle / 0.2), muscle(0.1 - 0.025 * angle / 0.2)


def pressures(angle, torque, K):
    """Of both muscles [Pa], from torque and stiffness: the equations of section 1.1 of the joint, solved by hand."""
    (S1, s1, F1, f1), (S2, s2, F2, f2) = both(angle)
    return np.linalg.solve([[S1, -S2], [-s1, -s2]], [torque / 0.025 - F1 + F2, K * 0.2 / 0.025**2 + f1 + f2])


def swung(frequency, amplitude, K, K_i, seconds):
    """Angle of the plant under a loop written anew [rad], every 10 ms."""
    plant = JointPlant(Joint())
    extra, angles = 0.0, []
    for muscle_number, P in enumerate(pressures(0.0, 0.0, K)):
        plant.command(muscle_number, constant(0.0, P))
    plant.advance(2.0)
    for n in range(round(seconds / 0.01)):
        wanted = amplitude * math.sin(2 * math.pi * frequency * n * 0.01)
        extra += K_i * 0.01 * (wanted - plant.angle)
        for muscle_number, P in enumerate(pressures(wanted, extra, K)):
            plant.command(muscle_number, constant(plant.time, P))
        plant.advance(plant.time + 0.01)
        angles.append(plant.angle)
    return np.array(angles)


def test_a_sine_has_the_gain_and_phase_of_a_loop_written_anew(tmp_path):
    changes = [FRESH, ("trial.hold", "10 s"), ("trial.window", "[4 s, 10 s]"), ("sweep.zip.frequency", "[0.5 Hz]")]
    _, found = stepped(tmp_path, 20, *changes, goal="10 deg")
    angles = swung(0.5, 10 * DEG, 20.0, 20.0, 10.0)
    t = (np.arange(len(angles)) + 1) * 0.01
    late = t >= 4.0
    wave = np.exp(-2j * math.pi * 0.5 * t[late])
    answer = np.sum(angles[late] * wave) / np.sum(10 * DEG * np.sin(math.pi * t[late]) * wave)
    assert found["g_th"].value == pytest.approx(abs(answer), rel=0.01)
    assert found["phi_th"].value == pytest.approx(np.angle(answer), abs=1.0 * DEG)
    assert found["g_th"].parts.combined < 0.05
    assert found["phi_th"].value < -5 * DEG  # regulators and muscles are late


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """An analysis of joint-torque with what the equations give at 7 angles."""
    angles = np.arange(-30, 31, 10) * DEG
    rows = []
    for angle in angles:
        (S1, _, F1, _), (S2, _, F2, _) = both(angle)
        rows += [(angle, "tau_0", 0.025 * (F1 - F2)), (angle, "s_1", 0.025 * S1), (angle, "s_2", 0.025 * S2)]
    estimates = [Estimate(symbol, value, "", "torque", "plane", {"angle": angle}) for angle, symbol, value in rows]
    return write_analysis(Analysis("joint-torque", ("made",), True, tuple(estimates)), tmp_path_factory.mktemp("map"))


def test_a_measured_map_gives_the_pressures_of_the_equations(measured):
    changes = ("model", "null"), ("map", str(measured))
    (control, *_) = [step for step in compiled(*changes).steps if step.kind == "control"]
    table = control.parameters["table"]
    assert table["angle"][0] == pytest.approx(-13 * DEG)
    for n, angle in enumerate(table["angle"]):
        P_1, P_2 = pressures(angle, 0.0, 20.0)
        assert [table["pressure_1"][n], table["pressure_2"][n]] == pytest.approx([P_1, P_2], rel=2e-3)
        more = pressures(angle, 1.0, 20.0)
        assert [table["gain_1"][n], table["gain_2"][n]] == pytest.approx([more[0] - P_1, more[1] - P_2], rel=2e-3)


def test_a_map_that_does_not_reach_is_refused(measured):
    changes = ("model", "null"), ("map", str(measured))
    with pytest.raises(InvalidFile, match="reaches from -30 deg to 30 deg"):
        compiled(*changes, ("sweep.zip.goal", "[35 deg, 35 deg]"))
    with pytest.raises(InvalidFile, match="ask for another stiffness"):
        compiled(*changes, ("controller.stiffness", "28 N.m/rad"))
    with pytest.raises(InvalidFile, match="needs one of model and map"):
        compiled(("map", str(measured)))


@pytest.mark.study
def test_the_map_of_a_run_is_as_good_as_the_model(tmp_path):
    """Torques measured on the driven joint, then steps of the free one: the feed-forward misses as with the model."""
    made = bench("mock-joint")
    plan = make_plan(ROOT / "protocols/joint-torque.yaml", made)[0]
    run = open_run(run_plan(plan, made, ConfirmedBeforehand(), out=tmp_path / "runs").folder)
    folder = write_analysis(reduce_torques([run]), tmp_path / "found")
    changes = ("model", "null"), ("map", str(folder)), FRESH
    _, alone = stepped(tmp_path / "alone", 0, *changes)
    _, whole = stepped(tmp_path / "whole", 20, *changes)
    assert alone["e_th"].value / DEG == pytest.approx(-4.31, abs=0.3)
    assert whole["t_s"].value == pytest.approx(0.78, abs=0.1)
    assert whole["e_th"].value / DEG == pytest.approx(0.0, abs=0.1)


def test_a_burst_in_the_loop_vents_both(tmp_path):
    made = bench(faulty=2, faults={"burst_at": 4.0})
    outcome = run_plan(compiled(made=made), made, ConfirmedBeforehand(), out=None)
    assert (outcome.status, outcome.vent.result) == ("tripped", "confirmed")
    assert "pressure_2 fell by" in outcome.why


def test_a_law_cannot_leave_the_pressures_of_its_step():
    plan = compiled()
    steps = tuple(
        replace(step, aims={**step.aims, "pressure_1": (20e3, 300e3)}) if step.kind == "control" else step
        for step in plan.steps
    )
    outcome = run_plan(replace(plan, steps=steps), bench(), ConfirmedBeforehand(), out=None)
    assert 'the law "joint" wants' in outcome.why
    assert outcome.vent.confirmed


def loop(**changes):
    table = {"angle": [0.0, 0.4], "pressure_1": [3e5, 4e5], "pressure_2": [3e5, 2e5], "gain_1": [2e4] * 2,
             "gain_2": [-2e4] * 2}  # fmt: skip
    known = {"goals": [[0.0, 0.0], [1.0, 0.2]], "duration": 3.0, "K_i": 20.0, "reference_lag": 0.05}
    return JointLoop(table=table, low=2e4, high=5.5e5, **(known | changes))


def test_the_law_adds_the_integral_of_the_error_as_a_torque():
    made, t = loop(reference_lag=0.0), 0.0
    while t < 0.995:
        orders = made.update(t, {"angle": 0.0})
        t += 0.01
    assert orders.sets == pytest.approx({"pressure_1": 3e5, "pressure_2": 3e5})
    for _ in range(100):
        t += 0.01
        orders = made.update(t, {"angle": 0.1})  # 0.1 rad short for 1 s: 2 N.m
    assert orders.sets["pressure_1"] == pytest.approx(3.5e5 + 2.0 * 2e4, rel=0.02)
    assert orders.sets["pressure_2"] == pytest.approx(2.5e5 - 2.0 * 2e4, rel=0.02)


def test_at_a_limit_the_integral_waits():
    made, t = loop(duration=100.0), 0.0
    for _ in range(3000):
        t += 0.01
        held = made.update(t, {"angle": -0.2})
    assert held.sets["pressure_1"] <= 5.5e5
    assert made.result()["torque"] < 12.6
    assert made.result()["saturated"] > 0.5


def test_without_an_angle_the_law_ends_and_sends_nothing():
    made = loop()
    assert made.update(0.0, {"angle": math.nan}).sets == {}
    assert made.done
    assert made.result()["found"] is False


def test_what_the_joint_cannot_do_is_refused_with_its_place():
    wrong = {
        "controller.stiffness": ("28 N.m/rad", "cannot be held there"),
        "sweep.zip.goal": ("[20 deg, 50 deg]", "lie in the stroke of the joint"),
        "trial.window": ("[4 s, 6 s]", "lie inside the hold"),
        "controller.output": ("[20 kPa, 580 kPa]", "above the limit for commanded pressure_1"),
        "trial.approach": ("[50 deg]", "trial.approach:1:8 .*stroke of the joint"),
    }
    for name, (text, said) in wrong.items():
        with pytest.raises(InvalidFile, match=said):
            compiled((name, text))
    with pytest.raises(InvalidFile, match="one that turns freely"):
        compiled(made=bench("mock-joint"))
