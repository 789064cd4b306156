"""`pmabench model simulate joint` and `platform`: the values of other programs, and what is refused."""

import csv
import io
import math

import pytest

from tests.cli.test_model import call


def table(*options):
    """Columns in SI by name without the unit."""
    rows = list(csv.reader(io.StringIO(call("simulate", *options, "--csv").stdout)))
    return {head.split(" ")[0]: [float(cell) for cell in column] for head, *column in zip(*rows, strict=True)}


def test_a_platform_whose_valves_open_moves_as_another_program_says():
    found = table("platform", "--open", "fill 1, 100 ms to 130 ms", "--open", "exhaust 2, 200 ms to 230 ms",
                  "--for", "1 s", "--every", "10 ms")  # fmt: skip
    assert [math.degrees(found["phi"][row]) for row in (13, 20, 23, 100)] == pytest.approx(
        [-1.3449, -2.4804, -2.8910, -3.2936], abs=0.002
    )
    assert found["pressure_2"][100] == pytest.approx(2.3722e5, abs=20)


@pytest.mark.parametrize(("chain", "overshoot"), [("reference", (0.0, 0.5)), ("measured", (5.4, 7.5))])
def test_a_controlled_platform_overshoots_as_another_program_says(chain, overshoot):
    """0.15 deg [0.01, 0.38] and 6.15 deg there, with an integral gain that is a sixth lower."""
    found = table("platform", "--step", "10 deg, 0 deg at 1 s", "--chain", chain, "--for", "3 s", "--every", "2 ms")
    assert overshoot[0] <= math.degrees(max(found["phi"])) - 10 <= overshoot[1]
    reported = call("simulate", "platform", "--step", "10 deg, 0 deg at 1 s", "--chain", chain, "--for", "3 s").output
    assert "steepest goal 10 deg, steepest tilt 1" in reported


def test_a_driven_joint_has_the_gap_of_its_hysteresis():
    found = table("joint", "--step", "1: 300 kPa at 0 s", "--step", "2: 300 kPa at 0 s",
                  "--drive", "0 deg +- 30 deg, 0.05 Hz", "--for", "40 s", "--every", "10 s")  # fmt: skip
    falling, rising = found["torque"][3:]
    # 4 R H, and what the muscles' damping adds at 9.4 deg/s: 2 R^2 c each way
    assert falling - rising == pytest.approx(3.0 + 4 * 0.025**2 * 150 * math.radians(9.42), rel=0.01)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["joint", "--step", "300 kPa at 0 s"], 'write --step "1: 300 kPa at 0.5 s"'),
        (["joint", "--step", "1: 900 kPa at 0 s"], "is outside 0 kPa to 700 kPa"),
        (["joint", "--drive", "0 deg +- 60 deg, 1 Hz"], "is outside 0 deg to 45.8 deg"),
        (["joint", "--open", "fill 1, 0 s to 1 s"], "--open is for the platform"),
        (["platform", "--open", "fill 4, 0 s to 1 s"], 'write --open "fill 1, 100 ms to 130 ms"'),
        (["platform", "--open", "fill 1, 1 s to 0.5 s"], "shuts before it opens"),
        (["platform", "--step", "1: 300 kPa at 0 s"], 'write --step "10 deg, 0 deg at 1 s"'),
        (["platform", "--step", "15 deg, 15 deg at 0 s"], "a tilt of 21.1 deg is beyond 20 deg"),
        (["platform", "--step", "25 deg, 0 deg at 0 s"], "is outside -20 deg to 20 deg"),
        (["platform", "--step", "5 deg, 0 deg at 0 s", "--open", "fill 1, 0 s to 1 s"], "not both"),
        (["platform", "--chain", "measured"], "--chain is for a platform with --step"),
        (["paper0", "--step", "300 kPa at 0 s", "--chain", "measured"], "--chain is for the platform"),
        (["platform", "--load", "6 kg"], "are for plants of one muscle"),
        (["paper0", "--step", "300 kPa at 0 s", "--open", "fill 1, 0 s to 1 s"], "--open is for the platform"),
    ],
)
def test_what_cannot_be_simulated_is_refused_in_a_sentence(options, sentence):
    assert sentence in call("simulate", *options, code=2).output
