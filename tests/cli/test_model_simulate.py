"""`pmabench model simulate`: the plant of the mock bench under commands given as options, against closed forms."""

import csv
import io
import json
import math
from functools import partial

import numpy as np
import pytest

from tests import calls

call = partial(calls.call, "model", "simulate")


def simulated(*args):
    data = json.loads(call(*args, "--json").stdout)
    assert data["simulated"] is True
    return {column["name"]: np.array(column["values"]) for column in data["columns"]}


def test_a_step_without_friction_is_first_order_behind_its_dead_time():
    # paper0 at 300 kPa with 58.86 N: K = 6.773 N/mm, B_c = 1.68 N.s/mm, F_ce = 275 N; a load that is a force moves
    # 0.5 kg: the pole of M x'' is 0.3 ms, far below tau = 0.248 s
    found = simulated(
        "paper0",
        "--kind",
        "ideal",
        "--step",
        "300 kPa at 0.5 s",
        "--load",
        "58.86 N",
        "--for",
        "4 s",
        "--every",
        "20 ms",
    )
    t, x = found["time"], found["displacement"]
    tau, final = 1.68 / 6.773, (275 - 58.86) / 6.773e3
    expected = np.where(t > 0.54, final * -np.expm1(-(t - 0.54) / tau), 0)
    np.testing.assert_allclose(x, expected, atol=0.01 * final)
    assert x[-1] == pytest.approx(final, abs=1e-7)
    assert found["force"][-1] == pytest.approx(58.86, abs=1e-3)
    assert (found["pressure_command"] == np.where(t >= 0.5, 300e3, 0)).all()


def test_weights_hang_with_g_of_paper_0_and_a_ramp_takes_its_time():
    found = simulated(
        "paper0", "--kind", "ideal", "--step", "400 kPa at 0 s by 100 kPa/s", "--load", "6 kg", "--for", "8 s"
    )
    assert found["pressure_command"][:3] == pytest.approx([0, 32e3, 64e3])
    assert found["pressure_command"][-1] == 400e3
    assert found["force"][-1] == pytest.approx(6 * 9.81, abs=1e-3)


def test_a_sine_swings_about_the_last_step_and_can_be_made_without_lag():
    options = ("--step", "300 kPa at 0 s", "--sine", "20 kPa, 0.5 Hz at 2 s", "--for", "6 s", "--every", "0.25 s")
    found = simulated("paper0", "--kind", "ideal", "--set", "dead_time=0 s", *options)
    t = found["time"]
    wave = 300e3 + np.where(t >= 2, 20e3 * np.sin(math.pi * (t - 2)), 0)
    np.testing.assert_allclose(found["pressure"], wave, atol=1e-3)


def test_a_driven_end_imposes_its_displacement():
    found = simulated(
        "paper0", "--kind", "ideal", "--step", "300 kPa at 0 s", "--drive", "20 mm +- 10 mm, 0.5 Hz", "--for", "2 s",
        "--every", "0.25 s",
    )  # fmt: skip
    t = found["time"]
    np.testing.assert_allclose(found["displacement"], 0.02 + 0.01 * np.sin(math.pi * t), atol=1e-9)
    # at 1.5 s it turns at 10 mm: F = 275 - 6.773 10 = 207.27 N
    assert found["force"][6] == pytest.approx(207.27, abs=0.01)


def test_a_muscle_whose_law_goes_below_zero_is_stretched():
    """The rubber of paper 3 without pressure: A eps (eps - B1) / (eps + B2), turned to a pull below 0."""
    options = (
        "--kind",
        "ideal",
        "--set",
        "hysteresis=0 N",
        "--step",
        "0 kPa at 0 s",
        "--for",
        "2 s",
        "--every",
        "0.25 s",
    )
    found = simulated("daerden", *options, "--drive", "-2 mm +- 4 mm, 0.5 Hz")
    eps = found["displacement"][found["displacement"] < 0] / 0.2
    assert eps.min() == pytest.approx(-0.03, abs=1e-6)
    force = found["force"][found["displacement"] < 0]
    np.testing.assert_allclose(force, 800 * eps * (eps - 0.22) / (eps + 0.04), atol=1e-6)


def test_friction_can_be_taken_away_by_name():
    options = ("paper0", "--step", "300 kPa at 0 s", "--load", "58.86 N", "--for", "10 s")
    final = (275 - 58.86) / 6.773e3
    assert simulated(*options, "--set", "friction=0")["displacement"][-1] == pytest.approx(final, abs=1e-6)
    assert simulated(*options)["displacement"][-1] < final - 0.5e-3


def test_table_and_csv_hold_the_same_values():
    options = ("serres2009", "--step", "300 kPa at 0.1 s", "--for", "1 s", "--every", "0.1 s")
    found = simulated(*options)
    rows = list(csv.reader(io.StringIO(call(*options, "--csv").stdout)))
    assert rows[0] == [
        "time [s]", "pressure_command [Pa]", "pressure [Pa]", "displacement [m]", "speed [m/s]", "force [N]"
    ]  # fmt: skip
    np.testing.assert_array_equal(np.array(rows[1:], dtype=float)[:, 3], found["displacement"])
    text = call(*options).stdout
    assert text.startswith("SIMULATED: plant serres2009, bench")
    last = text.splitlines()[-1].split()
    assert float(last[3]) == pytest.approx(found["displacement"][-1] * 1e3, rel=1e-5)
    assert call(*options, "-q").stdout.splitlines()[0].startswith("time s")


@pytest.mark.parametrize(
    ("options", "reported"),
    [
        (("paper9", "--step", "1 bar at 0 s"), "paper0"),
        (("paper0",), "nothing is commanded"),
        (("paper0", "--step", "300 kPa"), 'write "300 kPa at 0.5 s"'),
        (("paper0", "--step", "7 bar at 0 s"), "outside 0 kPa to 600 kPa"),
        (("paper0", "--step", "1 bar at 2 s", "--step", "2 bar at 1 s"), "in order of time"),
        (("paper0", "--step", "1 bar at 1 s by 10 kPa/s", "--step", "2 bar at 2 s"), "has ended"),
        (("paper0", "--step", "1 bar at 0 s", "--sine", "2 bar, 1 Hz at 1 s"), "outside 0 kPa to 100 kPa"),
        (("paper0", "--step", "1 bar at 0 s", "--load", "1 kg", "--drive", "20 mm +- 10 mm, 1 Hz"), "not both"),
        (("paper0", "--step", "1 bar at 0 s", "--load", "-1 kg"), "no load"),
        (
            ("paper0", "--step", "1 bar at 0 s", "--drive", "20 mm +- 30 mm, 1 Hz"),
            "driven from 0 mm to 90 mm; its law says nothing",
        ),
        (("daerden", "--step", "1 bar at 0 s", "--drive", "0 mm +- 8 mm, 1 Hz"), "driven from -7 mm to 44 mm"),
        (("arm-30", "--step", "1 bar at 0 s", "--drive", "10 mm +- 8 mm, 1 Hz"), "nothing drives it"),
        (("arm-30", "--step", "1 bar at 0 s", "--load", "1 kg"), "known for 0 to 0.5 kg at its end, not for 1 kg"),
        (("paper0", "--step", "1 bar at 0 s", "--drive", "40 mm +- 40 mm, 5 Hz"), "faster than the actuator"),
        (("paper0", "--step", "1 bar at 0 s", "--set", "frictoin=0"), 'did you mean "friction"?'),
        (("paper0", "--step", "1 bar at 0 s", "--set", "friction=-1"), "cannot be negative"),
        (("paper0", "--step", "1 bar at 0 s", "--set", "friction=nan"), "finite"),
        (("paper0", "--step", "1 bar at 0 s", "--for", "1 s", "--every", "1 us"), "at most 20000"),
        (("paper0", "--step", "1 bar at 0 s", "--for", "1 h"), "outside"),
        (("paper0", "--kind", "perfect", "--step", "1 bar at 0 s"), "ideal, bench"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(options, reported):
    result = call(*options, code=2)
    assert reported in result.stderr
    assert result.stdout == ""


def test_all_that_is_wrong_comes_at_once():
    lines = call("paper0", "--step", "x", "--load", "y", "--for", "z", code=2).stderr.splitlines()
    assert {line.split(":")[0] for line in lines} == {"--step", "--load", "--for"}
