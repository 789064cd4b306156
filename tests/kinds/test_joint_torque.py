"""Isometric torques of a joint through protocol, guard and reduction, against the closed form of paper 3 on a pulley."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from pmabench.analysis.trial import Quick
from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount
from pmabench.engine.operator import ConfirmedBeforehand
from pmabench.engine.run import run_plan
from pmabench.kinds.compile import make_plan
from pmabench.kinds.joint_torque.reduction import maps, reduce
from pmabench.kinds.reduce import of_one_trial
from pmabench.store.reader import open_run
from tests.kinds import joint_plant
from tests.kinds.joint_plant import Faults, force_by_pressure, stiffness, torque

ROOT = Path(__file__).resolve().parents[2]
HYSTERESIS, LENGTH, RADIUS, W = 30.0, 0.2, 0.025, 0.006
"""Of the simulated muscles: half gap [N], length [m]; of the pulley [m]; contraction on which a turn fades."""
DEG = math.pi / 180


def bench(seed=1):
    made = mount(ROOT / "fixtures/benches/mock-joint.yaml", ROOT / "fixtures/specimens/joint-daerden.yaml")
    devices = tuple(replace(d, options={**d.options, "seed": seed}) for d in made.bench.devices)
    return replace(made, bench=replace(made.bench, devices=devices))


def compiled(*changes):
    return make_plan(ROOT / "protocols/joint-torque.yaml", bench(), changes)[0]


def ran(folder, pressures_1, pressures_2, *changes, seed=1):
    axes = (("sweep.matrix.pressure_1", pressures_1), ("sweep.matrix.pressure_2", pressures_2))
    outcome = run_plan(compiled(*axes, *changes), bench(seed), ConfirmedBeforehand(), out=folder)
    assert (outcome.status, outcome.vent.result) == ("finished", "confirmed")
    return open_run(outcome.folder)


def mapped(folder, pressures_1, pressures_2, *changes, seed=1):
    return reduce([ran(folder, pressures_1, pressures_2, *changes, seed=seed)])


def of(analysis, symbol):
    return [e for e in analysis.estimates if e.symbol == symbol]


def right(e, truth):
    low, high = e.ci95
    return low < truth < high


@pytest.fixture(scope="module")
def nine(tmp_path_factory):
    """Nine pairs of pressures."""
    return ran(tmp_path_factory.mktemp("runs"), *["[200 kPa, 300 kPa, 400 kPa]"] * 2, ("trial.rest", "0.8 s"))


@pytest.fixture(scope="module")
def whole(nine):
    return reduce([nine])


def test_torque_and_stiffness_are_those_of_the_closed_form(whole):
    torques, slopes = of(whole, "tau"), of(whole, "K_th")
    assert len(torques) == len(slopes) == 9 * 7
    for e in torques:
        true = torque(e.at["angle"], e.at["pressure_1"], e.at["pressure_2"])
        assert e.value == pytest.approx(true, abs=0.02)
        assert right(e, true)
    for e in slopes:
        true = stiffness(e.at["angle"], e.at["pressure_1"], e.at["pressure_2"])
        assert e.value == pytest.approx(true, rel=0.02 if abs(e.at["angle"]) > 25 * DEG else 0.005)
        assert right(e, true)
        assert e.parts.combined < 0.04 * e.value


@pytest.mark.parametrize(
    ("degrees", "P1", "P2", "tau", "K"),
    [(0, 2, 2, 0.0, 9.554), (0, 4, 2, 7.684, 15.505), (0, 4, 4, 0.0, 21.456), (30, 2, 4, -16.380, 18.884)],
)
def test_the_map_holds_the_numbers_of_another_program(whole, degrees, P1, P2, tau, K):
    for symbol, true in (("tau", tau), ("K_th", K)):
        at = {"pressure_1": P1 * 1e5, "pressure_2": P2 * 1e5, "angle": pytest.approx(degrees * DEG)}
        (e,) = [e for e in of(whole, symbol) if e.at == at]
        assert right(e, true)


def test_the_gap_is_four_times_radius_and_half_gap_of_a_muscle(whole):
    for e in of(whole, "H_tau"):
        assert e.value == pytest.approx(4 * RADIUS * HYSTERESIS, rel=0.005)


def test_torque_by_each_pressure_is_section_times_radius(whole):
    for symbol, way in (("s_1", 1), ("s_2", -1)):
        found = of(whole, symbol)
        assert len(found) == 7
        for e in found:
            true = RADIUS * force_by_pressure(0.1 + way * RADIUS * e.at["angle"] / LENGTH)
            assert e.value == pytest.approx(true, rel=0.01)
            assert right(e, true)
    for e in of(whole, "tau_0"):
        assert right(e, torque(e.at["angle"], 0.0, 0.0))


def test_the_display_and_the_figure_show_the_map(whole, tmp_path):
    (trace,) = whole.traces
    assert len(trace.columns) == 1 + 2 * 9
    (drawn,) = maps(whole.traces, whole)
    assert "6 of 9 are shown" in drawn.caption
    plan = compiled(("sweep.matrix.pressure_1", "[300 kPa]"), ("sweep.matrix.pressure_2", "[300 kPa]"))
    run = open_run(run_plan(plan, bench(), ConfirmedBeforehand(), out=tmp_path).folder)
    found, doubts = of_one_trial(run, run.trials[0], None, Quick())
    assert {one.symbol: round(one.value, 1) for one in found} == {"H_tau": 3.0, "tau": 0.0, "K_th": 15.5}
    assert doubts == []


def test_angles_near_a_turn_are_withheld_with_the_overrun_that_would_do(tmp_path):
    found = mapped(tmp_path, "[300 kPa]", "[300 kPa]", ("trial.overrun", "4 deg"))
    withheld = [e for e in of(found, "tau") if e.withheld]
    assert [round(e.at["angle"] / DEG) for e in withheld] == [-30, 30]
    (said,) = re.findall(r"an overrun of at least ([\d.]+) deg", withheld[0].note)
    assert float(said) == pytest.approx(3 * W * LENGTH / RADIUS / DEG, rel=0.05)
    (K,) = of(found, "K_th")
    assert K.withheld
    assert "5 angles are far enough" in K.note


@pytest.mark.parametrize("most", [1, 3])
def test_angles_that_are_too_near_for_the_hysteresis_are_refused(tmp_path, most):
    """Of +-1 and +-3 deg the torque's slope would be that of the hysteresis, three times the stiffness."""
    angles = ", ".join(f"{most * step / 3} deg" for step in range(-3, 4))
    found = mapped(
        tmp_path, "[300 kPa]", "[300 kPa]", ("trial.angles", f"[{angles}]"), ("trial.overrun", "1 deg"),
        ("trial.speed", "2 deg/s"),
    )  # fmt: skip
    assert not [e for e in found.estimates if e.value is not None and e.symbol in ("tau", "K_th")]


@pytest.mark.parametrize(("low", "which"), [pytest.param("40 kPa", "tau", marks=pytest.mark.study), ("5 kPa", "s_1")])
def test_where_a_muscle_is_slack_nothing_is_guessed(tmp_path, low, which):
    """At 40 kPa muscle 1 pulls on one way and at some angles, at 5 kPa nowhere: then 7 torques are those of muscle 2."""
    changes = ("trial.rest", "0.5 s"), ("trial.speed", "40 deg/s")
    found = mapped(tmp_path, f"[{low}, 300 kPa, 400 kPa]", "[200 kPa, 300 kPa, 400 kPa]", *changes)
    at_low = [e for e in of(found, "tau") if e.at["pressure_1"] < 1e5]
    assert all(e.withheld == (which == "tau") for e in at_low)
    for e in of(found, "tau"):
        P1, P2 = e.at["pressure_1"], e.at["pressure_2"]
        if P1 > 1e5:
            assert right(e, torque(e.at["angle"], P1, P2))
        elif not e.withheld:
            eps = 0.1 - RADIUS * e.at["angle"] / LENGTH
            rubber = 800.0 * eps * (eps - 0.22) / (eps + 0.04)
            assert right(e, -RADIUS * (force_by_pressure(eps) * P2 + rubber))
    sections = [e for e in of(found, "s_1") if e.value is not None]
    for e in sections:
        assert right(e, RADIUS * force_by_pressure(0.1 + RADIUS * e.at["angle"] / LENGTH))
    if which == "s_1":
        assert not sections
        assert "a muscle is slack" in of(found, "s_1")[0].note


def test_what_the_drive_cannot_do_is_refused_with_its_place():
    wrong = {
        "trial.overrun": ("20 deg", "above the limit for commanded angle"),
        "trial.speed": ("90 deg/s", "faster than the drive"),
        "trial.angles": ("[0 deg, 0 deg, 10 deg]", "must rise"),
        "sweep.matrix.pressure_2": ("[600 kPa]", "above the limit for commanded pressure_2"),
    }
    for name, (text, said) in wrong.items():
        with pytest.raises(InvalidFile, match=said):
            compiled((name, text), *([("trial.angles", "[-30 deg, 30 deg]")] if name == "trial.overrun" else []))


@pytest.mark.study
def test_intervals_hold_the_truth_on_16_seeds(tmp_path):
    inside, count = {"tau": 0, "K_th": 0}, {"tau": 0, "K_th": 0}
    for seed in range(16):
        found = mapped(tmp_path / str(seed), "[300 kPa]", "[200 kPa, 400 kPa]", seed=seed)
        for symbol, truth in (("tau", torque), ("K_th", stiffness)):
            for e in of(found, symbol):
                inside[symbol] += right(e, truth(e.at["angle"], e.at["pressure_1"], e.at["pressure_2"]))
                count[symbol] += 1
    print(inside, count)
    assert all(inside[symbol] >= 0.95 * count[symbol] for symbol in inside)


def true(e):
    at = [e.at.get(name) for name in ("angle", "pressure_1", "pressure_2")]
    eps = RADIUS * e.at.get("angle", 0.0) / LENGTH
    return {
        "tau": lambda: torque(*at),
        "K_th": lambda: stiffness(*at),
        "H_tau": lambda: 4 * RADIUS * HYSTERESIS,
        "s_1": lambda: RADIUS * force_by_pressure(0.1 + eps),
        "s_2": lambda: RADIUS * force_by_pressure(0.1 - eps),
        "tau_0": lambda: torque(at[0], 0.0, 0.0),
    }[e.symbol]()


def found(run, faults):
    """The analysis of a bench with faults; each value that it gives has an interval with the truth in it."""
    analysis = reduce([joint_plant.measured(run, faults)])
    for e in (e for e in analysis.estimates if e.value is not None):
        assert right(e, true(e)), e
    return analysis


def widest(analysis, symbol):
    return max(e.parts.combined / abs(true(e)) for e in of(analysis, symbol))


def test_a_good_bench_has_all_values_and_narrow_intervals(nine):
    good = found(nine, Faults())
    assert not [e for e in good.estimates if e.withheld]
    assert widest(good, "H_tau") < 0.03
    assert widest(good, "K_th") < 0.04
    assert widest(good, "s_1") < 0.01
    assert not [f for f in good.findings if f.level == "doubt"]


def test_pressures_that_are_not_reached_are_said_and_in_the_intervals(nine):
    analysis = found(nine, Faults(reached=0.95))
    assert any("that were commanded: its regulator or its sensor is off" in f.text for f in analysis.findings)


def test_an_encoder_that_is_off_the_drive_is_said_and_in_the_stiffness(nine):
    """At 30 deg the stiffness changes by 2.6 % in a degree."""
    analysis = found(nine, Faults(zero=DEG))
    assert any("the encoder reads 1 deg where the drive was sent to 0" in f.text for f in analysis.findings)


@pytest.mark.parametrize("play", [0.2, 0.5])
def test_play_between_encoder_and_joint_leaves_no_gap(nine, play):
    """With the joint held by friction the gap is 6 % too small for half a degree, and all cycles agree."""
    analysis = found(nine, Faults(play=play * DEG))
    withheld = [e for e in of(analysis, "H_tau") if e.withheld]
    assert play < 0.5 or len(withheld) == 9
    assert all("play between the encoder and the joint" in e.note for e in withheld)


@pytest.mark.parametrize("play", [0.2, 0.5])
def test_play_that_the_torque_loads_is_in_stiffness_and_gap(nine, play):
    """Where the torque changes its sign the joint goes over to the other flank: half a degree takes 5 % off K."""
    equal = replace(nine, trials=nine.trials[::4])
    found(equal, Faults(loaded=play * DEG))
    assert widest(found(equal, Faults()), "H_tau") < 0.03


def test_a_zero_of_the_torque_that_drifts_is_in_what_the_pressures_do(nine):
    """The pressures follow each other in time, so that a drift looks like an effect of the first of them."""
    good, drifts = found(nine, Faults()), found(nine, Faults(drift=0.1))
    assert widest(drifts, "s_1") > 2 * widest(good, "s_1")
    away = found(nine, Faults(drift=0.4))
    assert all(e.withheld for e in of(away, "s_1"))
    assert "its zero drifts" in of(away, "s_1")[0].note


def test_a_muscle_that_creeps_is_no_zero_that_drifts(nine):
    analysis = reduce([joint_plant.measured(nine, Faults(creep=(1.9, 20.0)))])
    assert not any("its zero drifts" in e.note for e in analysis.estimates)


def test_steps_in_which_the_torque_is_read_are_in_the_stiffness(nine):
    """12 bit over 100 N m, without noise: each angle's torque is up to 12 mN m off in all cycles alike."""
    slopes = of(reduce([joint_plant.measured(nine, Faults(step=100 / 2**12))]), "K_th")
    assert sum(right(e, true(e)) for e in slopes) >= 0.9 * len(slopes)
    assert all(abs(e.value - true(e)) < 1.5 * e.parts.combined for e in slopes)
