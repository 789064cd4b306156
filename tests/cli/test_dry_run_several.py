"""`check --simulate` of a lab's own joint and platform: scales, limits and times of the bench file, no device opened."""

import json
import math
import socket

import pytest
from click.testing import CliRunner
from serial import Serial

from pmabench.cli.main import main
from tests.cli.lab_benches import lab_bench

SWEEP = ("joint-sweep", "--set", "sweep.zip={pressure_1: [400 kPa], pressure_2: [200 kPa], speed: [5 deg/s]}")
TORQUE = ("joint-torque", "--set", "sweep.matrix={pressure_1: [400 kPa], pressure_2: [200 kPa]}")
STEP = ("joint-step", "--set", "sweep.zip={goal: [20 deg], integral: [20 N.m/rad/s]}", "--set", "sweep.repeat.count=1")
PLATFORM = ("platform", "--set", "sweep.zip={phi: [10 deg], psi: [0 deg]}", "--set", "sweep.repeat.count=1")
OF = {"platform": "platform-daerden"}


@pytest.fixture(autouse=True)
def _no_device(monkeypatch):
    """Sockets and serial ports that cannot be opened; the benches' own driver cannot be made."""

    def refuse(*_args, **_kwargs):
        raise AssertionError("a dry run opened a device")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(Serial, "open", refuse)


def check(bench, protocol, *words, code=0):
    specimen = OF.get(protocol, "joint-daerden")
    given = ["check", protocol, "--bench", str(bench), "--specimen", specimen, *words]
    done = CliRunner().invoke(main, given)
    assert done.exit_code == code, done.output
    return done


def simulated(bench, *words, code=0):
    return json.loads(check(bench, *words, "--simulate", "--json", code=code).stdout)["simulated"]


def force(P, eps):
    """Of one muscle without hysteresis, by paper 3 eqs. 8-10 with the numbers of the specimen [N]."""
    area, angle = math.pi / 4 * 0.02**2, math.radians(25)
    section = 3 * area / math.tan(angle) ** 2 * (1 - eps) ** 2.6 - area / math.sin(angle) ** 2
    return section * P + 800 * eps * (eps - 0.22) / (eps + 0.04)


def most_torque(pulley, angle):
    """Of a joint at 4 and 2 bar at the angle [rad] to negative angles, on the upper branch of 30 N [N.m]."""
    way = pulley * angle / 0.2
    return pulley * (force(4e5, 0.1 - way) - force(2e5, 0.1 + way) + 2 * 30)


@pytest.mark.parametrize("pulley", [25, 20])
def test_a_sweep_of_a_joint_reaches_the_torque_of_its_own_pulley(pulley, tmp_path):
    bench = lab_bench(tmp_path, "joint", ("pulley: 25 mm", f"pulley: {pulley} mm"))
    found = simulated(bench, *SWEEP)
    assert (found["status"], found["trials_failed"], found["saturated"], found["beyond"]) == ("finished", [], [], [])
    expected = most_torque(1e-3 * pulley, math.radians(30))
    assert found["measured"]["torque"]["highest"] == pytest.approx(expected, rel=0.01)
    assert found["measured"]["pressure_1"]["highest"] == pytest.approx(4e5, rel=0.01)
    assert math.degrees(found["measured"]["angle"]["lowest"]) == pytest.approx(-30, abs=0.2)
    assert "2 muscles of paper 3 of 20 mm and 25 deg" in found["muscle"]
    assert found["duration"] > 6 * 60 / 5  # three cycles of 60 degrees both ways at 5 deg/s


def test_torque_and_steps_of_a_joint_are_simulated_and_peaks_are_printed(tmp_path):
    torque = simulated(lab_bench(tmp_path, "joint"), *TORQUE)
    assert torque["status"] == "finished"
    assert torque["measured"]["torque"]["highest"] == pytest.approx(most_torque(0.025, math.radians(40)), rel=0.01)
    bench = lab_bench(tmp_path, "free joint")
    step = simulated(bench, *STEP)
    assert (step["status"], step["saturated"]) == ("finished", [])
    assert math.degrees(step["measured"]["angle"]["highest"]) == pytest.approx(20, abs=1)
    human = check(bench, *STEP, "--simulate").stdout
    assert "kPa of 600 kPa, " in human
    assert "deg of 46 deg" in human


def test_a_limit_that_is_crossed_ends_it_and_is_named(tmp_path):
    bench = lab_bench(tmp_path, "joint", ("torque: {trip: 40 N.m", "torque: {trip: 15 N.m"))
    found = simulated(bench, *SWEEP, code=5)
    assert found["status"] == "tripped"
    assert "torque" in found["why"]
    assert "15 N" in found["why"]


def test_commands_at_a_limit_and_the_end_of_a_range_are_findings(tmp_path):
    held = ("--set", "controller.output=[20 kPa, 460 kPa]")
    low = lab_bench(tmp_path, "joint", ("  torque: {trip: 40 N.m, trip_low: -40 N.m, action: vent}\n", ""),
                    ("range: [-45 N.m, 45 N.m]", "range: [-15 N.m, 15 N.m]"))  # fmt: skip
    found = simulated(low, *SWEEP)
    assert found["beyond"] == ["torque"]
    human = check(low, *SWEEP, "--simulate").stdout
    assert "at the end of the range of the channel: torque" in human
    saturated = simulated(lab_bench(tmp_path, "free joint"), *STEP, *held)
    assert [one["trial"] for one in saturated["saturated"]] == [1]
    assert 0 < saturated["saturated"][0]["share"] <= 1


def test_a_platform_is_simulated_by_the_numbers_of_its_bench_file(tmp_path):
    """At 10 degrees muscles 2 and 3 hold it with 2.79 bar, muscle 1 with 1.92 (joints-endurance 2.2)."""
    found = simulated(lab_bench(tmp_path, "platform"), *PLATFORM)
    assert (found["status"], found["trials_failed"]) == ("finished", [])
    assert found["measured"]["pressure_2"]["highest"] > 2.7e5
    assert "3 muscles of paper 3" in found["muscle"]
    heavy = simulated(lab_bench(tmp_path, "platform", ("mass: 2 kg", "mass: 12 kg")), *PLATFORM)
    assert heavy["measured"]["pressure_2"]["highest"] < found["measured"]["pressure_2"]["highest"]


def test_what_cannot_be_simulated_is_refused_in_a_sentence(tmp_path):
    bare = lab_bench(tmp_path, "joint", (", pulley: 25 mm, contraction: 10 %", ""))
    said = check(bare, *SWEEP, "--simulate", code=2).stderr
    assert "contraction and pulley missing" in said
    assert 'add "pulley: 25 mm, contraction: 10 %"' in said
    check(bare, *SWEEP)  # limits and times are still checked
    plant = tmp_path / "plant.yaml"
    plant.write_text("schema: pmabench.plant/1\n")
    said = check(lab_bench(tmp_path, "joint"), *SWEEP, "--muscle", str(plant), code=2).stderr
    assert "has several muscles, and an analysis or a plant file describes one" in said


def test_valves_of_a_device_that_keeps_no_time_of_pulses_are_refused(tmp_path):
    bench = lab_bench(tmp_path, "platform", ('driver: "tests.cli.lab_benches:Ours"', "driver: labjack"))
    said = check(bench, *PLATFORM, code=3).stderr
    assert 'the driver "labjack" opens no valve for a time that it keeps by itself' in said
