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
from pmabench.kinds.joint_torque.figures import maps, measure
from pmabench.kinds.joint_torque.reduction import reduce
from pmabench.store.reader import open_run

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


def mapped(folder, pressures_1, pressures_2, *changes, seed=1):
    axes = (("sweep.matrix.pressure_1", pressures_1), ("sweep.matrix.pressure_2", pressures_2))
    outcome = run_plan(compiled(*axes, *changes), bench(seed), ConfirmedBeforehand(), out=folder)
    assert (outcome.status, outcome.vent.result) == ("finished", "confirmed")
    return reduce([open_run(outcome.folder)])


def of(analysis, symbol):
    return [e for e in analysis.estimates if e.symbol == symbol]


def section_and_rubber(eps):
    """Paper 3, eqs. 8-10, written anew: force by pressure [m2], and the rubber's force [N]."""
    angle, area = 25 * DEG, math.pi / 4 * 0.02**2
    section = area * (3 * (1 - eps) ** 2.6 / math.tan(angle) ** 2 - 1 / math.sin(angle) ** 2)
    return section, 800.0 * eps * (eps - 0.22) / (eps + 0.04)


def torque(angle, P1, P2):
    """Two such muscles on a pulley, both taut [N m]."""
    (S1, F1), (S2, F2) = (section_and_rubber(0.1 + way * RADIUS * angle / LENGTH) for way in (1, -1))
    return RADIUS * (S1 * P1 + F1 - S2 * P2 - F2)


def stiffness(angle, P1, P2):
    """Minus its slope, by differences of the closed form [N m/rad]."""
    return (torque(angle - 1e-5, P1, P2) - torque(angle + 1e-5, P1, P2)) / 2e-5


def right(e, truth):
    low, high = e.ci95
    return low < truth < high


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return mapped(tmp_path_factory.mktemp("runs"), *["[200 kPa, 300 kPa, 400 kPa]"] * 2, ("trial.rest", "0.8 s"))


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
            true = RADIUS * section_and_rubber(0.1 + way * RADIUS * e.at["angle"] / LENGTH)[0]
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
    found, doubts = measure(run, run.trials[0], None, Quick())
    assert [round(one.value, 1) for one in found] == [15.5, 3.0]
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
            section, rubber = section_and_rubber(0.1 - RADIUS * e.at["angle"] / LENGTH)
            assert right(e, -RADIUS * (section * P2 + rubber))
    sections = [e for e in of(found, "s_1") if e.value is not None]
    for e in sections:
        assert right(e, RADIUS * section_and_rubber(0.1 + RADIUS * e.at["angle"] / LENGTH)[0])
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
