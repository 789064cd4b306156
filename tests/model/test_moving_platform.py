"""A platform behind its valves: delays, a dump, an accelerometer, against closed forms and an independent table."""

import math

import pytest

from pmabench.model.many.platform import (
    DELAY,
    LEVEL,
    G,
    Inverse,
    Platform,
    PlatformPlant,
    contractions,
    on_time,
    tilt,
)
from tests.model.openings import Opening, simulate

BAR, DEG = 1e5, math.pi / 180


def test_pulses_between_samples_are_what_openings_are():
    """Fill 1 for 30 ms and exhaust 2 for 30 ms, both 2 ms after the command, sampled every 2 ms."""
    plant = PlatformPlant()
    for number in range(1, 501):
        if number == 51:
            plant.pulse("fill", 0, 0.0303)
        if number == 101:
            plant.pulse("exhaust", 1, 0.0297)
        plant.advance(number * 0.002)
    openings = [Opening("fill", 0, 0.1 + DELAY, 0.1303 + DELAY), Opening("exhaust", 1, 0.2 + DELAY, 0.2297 + DELAY)]
    (state,) = simulate(Platform(), openings, [1.0])
    assert plant.state == pytest.approx(state, rel=1e-4, abs=1e-5)


def test_pulses_that_meet_are_one_opening():
    plant = PlatformPlant()
    for number in range(4):
        plant.advance(0.02 * number)
        plant.pulse("fill", 0, 0.02)
    plant.advance(0.2)
    (state,) = simulate(Platform(), [Opening("fill", 0, DELAY, 0.08 + DELAY)], [0.2])
    assert plant.state == pytest.approx(state, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize(("emptied", "remain"), [("exhaust", 5.2), ("dump", 1.0)])
def test_an_exhaust_valve_cannot_vent_a_muscle_whose_fill_valve_is_stuck_open(emptied, remain):
    """Pressures [bar] that remain against C times 1 and 4: computed by another program."""
    plant = PlatformPlant()
    plant.stuck["fill", 0] = True
    plant.stuck["exhaust", 0] = emptied == "exhaust"
    plant.dump = emptied == "dump"
    plant.advance(3.0)
    assert plant.state[4] / BAR == pytest.approx(remain, abs=0.06)
    plant.supply, plant.dump = False, True
    plant.advance(4.0)
    assert plant.state[4] < 0.2 * BAR


@pytest.mark.parametrize("attitude", [(10.0, 0.0), (-7.0, 12.0), (20.0, -5.0)])
def test_an_accelerometer_at_rest_shows_the_attitude(attitude):
    phi, psi = (angle * DEG for angle in attitude)
    plant = PlatformPlant(height=0.0, state=(phi, psi, *LEVEL[2:]))
    values = plant.measure()
    forces = [values[f"acceleration_{axis}"] for axis in "xyz"]
    assert tilt(*forces) == pytest.approx((phi, psi), abs=1e-12)
    assert math.hypot(*forces) == pytest.approx(G)


def test_an_accelerometer_above_the_joint_reads_too_much():
    """f_y = g phi - h phi'' near level: 1 + h w2 / g of a swing."""
    state = (0.01, 0.0, *LEVEL[2:])
    turning = Platform().rates(state, (0.0,) * 3, (0.0,) * 3)[2]
    plant = PlatformPlant(height=0.05, state=state)
    assert plant.measure()["acceleration_y"] == pytest.approx(G * math.sin(0.01) - 0.05 * turning, rel=1e-9)
    assert abs(turning) > 1


def test_a_platform_that_goes_back_in_time_does_the_same_again():
    plant = PlatformPlant()
    plant.pulse("fill", 1, 0.05)
    plant.advance(0.02)
    kept = plant.snapshot()
    plant.advance(0.2)
    first = plant.measure()
    plant.restore(kept)
    plant.advance(0.2)
    assert plant.measure() == first


TABLE = [
    (0, 0, 2.5, 2.5, 2.5),
    (10, 0, 1.9246, 2.7877, 2.7877),
    (20, 0, 1.2888, 3.1056, 3.1056),
    (-20, 0, 4.0112, 1.7444, 1.7444),
    (0, 20, 2.3012, 1.4261, 3.7727),
]
"""phi, psi [deg] and the pressures that hold it [bar], by another program."""


@pytest.mark.parametrize(("phi", "psi", "one", "two", "three"), TABLE)
def test_pressures_that_hold_an_attitude_and_the_attitude_that_they_hold(phi, psi, one, two, three):
    inverse, at, pressures = Inverse(), (phi * DEG, psi * DEG), (one * BAR, two * BAR, three * BAR)
    assert inverse.wanted(at, (0.0, 0.0)).pressures == pytest.approx(pressures, abs=6.0)
    assert inverse.rest(pressures, (0.0, 0.0)) == pytest.approx(at, abs=0.002 * DEG)


def test_a_moment_that_limits_forbid_is_clipped_and_said():
    wanted = Inverse().wanted((0.0, 0.0), (60.0, 0.0))
    assert wanted.clipped
    assert all(0.2 * BAR <= P <= 5.5 * BAR for P in wanted.pressures)


def test_contractions_are_those_of_the_table():
    found = contractions(Platform(), (20 * DEG, 20 * DEG))
    assert found == pytest.approx((0.00581, 0.07017, 0.22260), abs=5e-6)


def test_on_times_by_the_flows_of_the_reference():
    """At 2.5 bar and level: fill 24 bar/s, exhaust 10.6 bar/s, to three digits by another program."""
    assert on_time(Platform(), 2.5 * BAR, 2.74 * BAR, 0.10) == pytest.approx(0.24 / 24, rel=0.02)
    assert on_time(Platform(), 2.5 * BAR, 2.394 * BAR, 0.10) == pytest.approx(-0.106 / 10.6, rel=0.02)
