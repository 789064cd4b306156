"""The platform under its law: steps and faults against a table that another program made (12 seeds, medians)."""

import math

import pytest

from pmabench.engine.laws import Orders
from pmabench.engine.laws.platform_loop import PlatformLoop
from pmabench.engine.platform_watch import PlatformLimits, PlatformWatch
from pmabench.model.many.platform import PlatformPlant
from tests.engine.closed_platform import closed_loop

SEEDS = range(16)
TEN = [(0.0, 10.0, 0.0)]


def asked_of_ten_degrees(seed):
    course = closed_loop(TEN, seed)
    found = course.judged(10.0)
    assert course.trip is None
    assert found["settled"] <= 0.5
    assert found["end"] <= 0.3
    assert found["switchings"] <= 5
    return found


def test_ten_degrees():
    found = asked_of_ten_degrees(0)
    assert found["overshoot"] < 0.5


@pytest.mark.study
def test_ten_degrees_with_all_seeds():
    rows = [asked_of_ten_degrees(seed) for seed in SEEDS]
    for name in rows[0]:
        values = sorted(row[name] for row in rows)
        print(f"{name}: {values[8]:.3f} [{values[0]:.3f}, {values[-1]:.3f}]")


@pytest.mark.parametrize(
    ("goal", "law", "rise", "settled", "overshoot"),
    [
        ((5.0, 0.0), {}, 0.65, (0.35, 0.52), (-0.1, 0.5)),
        ((10.0, 0.0), {}, 0.35, (0.31, 0.37), (-0.1, 0.5)),
        ((20.0, 0.0), {}, 0.30, (1.6, 2.0), (1.7, 2.15)),
        ((10.0, 0.0), {"K_p": 5.0, "K_i": 75.0}, 0.71, (0.6, 0.8), (-0.1, 0.4)),
        ((10.0, 0.0), {"K_p": 20.0, "K_i": 300.0}, 0.20, (0.18, 0.22), (0.5, 0.75)),
        ((10.0, 0.0), {"chain": "measured"}, 0.40, (1.0, 2.8), (5.4, 6.4)),
    ],
    ids=["5 deg", "10 deg", "20 deg", "half the gains", "twice the gains", "as paper 3 prints it"],
)
def test_other_steps_and_gains(goal, law, rise, settled, overshoot):
    """The table's gains. Rise within 0.08 s, and the rest within its scatter, which it prints for two rows only."""
    course = closed_loop([(0.0, *goal)], 0, lasts=3.5, **({"K_i": 150.0} | law))
    found = course.judged(goal[0])
    assert course.trip is None
    assert found["rise"] == pytest.approx(rise, abs=0.08)
    assert settled[0] <= found["settled"] <= settled[1]
    assert overshoot[0] <= found["overshoot"] <= overshoot[1]


def test_late_sensor_and_high_gains_never_rest():
    """P 20, I 200, sensor 50 mm above the joint: 37 switchings a second in the table, 0.5 with the gains that are used.

    Here there are 25: it hunts, though less than the table's 1.7 deg from peak to peak.
    """
    course = closed_loop(TEN, 0, lasts=3.0, K_p=20.0, K_i=200.0, plant=PlatformPlant(height=0.05))
    assert course.judged(10.0)["switchings"] > 15


def test_a_gyroscope_makes_up_for_a_sensor_above_the_joint():
    """The same gains and place with angular speeds: they are not late, and what cycled is quiet."""

    class WithGyroscope(PlatformPlant):
        def measure(self):
            phi_rate, psi_rate, psi = self.state[2], self.state[3], self.state[1]
            turns = {"turn_x": phi_rate * math.cos(psi), "turn_y": psi_rate}
            return super().measure() | turns

    course = closed_loop(TEN, 0, lasts=3.0, K_p=20.0, K_i=200.0, plant=WithGyroscope(height=0.05))
    last = course.phi[-1000:]
    assert course.trip is None
    assert max(last) - min(last) < 0.4
    assert course.judged(10.0)["switchings"] < 10
    assert course.judged(10.0)["end"] <= 0.3


def test_an_on_time_is_no_multiple_of_the_sample_period():
    plant, seconds = PlatformPlant(), []
    pulse = plant.pulse
    plant.pulse = lambda kind, muscle, on: (seconds.append(on), pulse(kind, muscle, on))
    closed_loop(TEN, 0, lasts=0.5, plant=plant)
    off = [abs(on / 0.002 - round(on / 0.002)) for on in seconds if on < 0.02]
    assert len(off) > 10
    assert sum(part > 0.05 for part in off) > 0.7 * len(off)


GOALS = [(10.0, 0.0), (-10.0, 0.0), (0.0, 10.0), (20.0, 0.0), (-20.0, 0.0), (0.0, -20.0), (14.0, -14.0)]


@pytest.mark.study
@pytest.mark.parametrize("goal", GOALS)
def test_no_false_trip_with_all_seeds(goal):
    """With the lags that the protocol takes for wide steps; through those of 10 deg a step of 20 deg meets the trip."""
    lag = max(1.0, math.hypot(*goal) / 10.0) / 20
    for seed in SEEDS:
        assert closed_loop([(0.0, *goal)], seed, lasts=3.0, reference_lag=lag).trip is None


def test_the_chain_of_paper_3_runs_into_the_stop_at_20_degrees():
    """Its 6 deg of overshoot at 10 deg are more at 20 deg, and the stops are at 24 deg; the other chain has 1.9 deg."""
    assert max(closed_loop([(0.0, 20.0, 0.0)], 0, lasts=1.0, chain="measured").phi) == pytest.approx(24.0)


@pytest.mark.parametrize("stop", [(0.41, 0.0), (-0.3, 0.41)])
def test_a_platform_without_pressure_is_lifted_from_its_stop(stop):
    plant = PlatformPlant(state=(*stop, *(0.0,) * 8))
    course = closed_loop([(0.0, 0.0, 0.0)], 0, lasts=1.5, plant=plant)
    assert course.trip is None
    assert max(abs(course.phi[-1]), abs(course.psi[-1])) < 1.0


def test_no_false_trip_where_the_pressure_falls_by_motion_alone():
    """The steepest step lengthens one muscle and shortens two: 1.4 bar change that no valve made."""
    assert closed_loop([(0.0, -20.0, 0.0)], 3, lasts=2.0).trip is None


def test_a_tilt_beyond_the_limit_trips():
    watch, steep = PlatformWatch(limits=PlatformLimits(lift=0.0)), (0.4, 0.0, 0.0, 0.0, *(2.5e5,) * 3, *(0.0,) * 3)
    plant = PlatformPlant(state=steep, height=0.0)
    said = [watch.look(0.002 * number, plant.measure(), Orders()) for number in range(40)]
    assert said[20] == ""
    assert "beyond 22 deg" in said[27]


def test_a_goal_outside_the_cone_is_refused():
    """Both angles at 20 deg are a tilt of 28 deg."""
    with pytest.raises(ValueError, match=r"tilt of 28 deg is beyond 20 deg"):
        PlatformLoop(goals=[(0.0, math.radians(20), math.radians(20))], duration=1.0)


def test_a_channel_without_a_number_ends_the_law_without_a_command():
    loop = PlatformLoop(goals=[(0.0, 0.0, 0.0)], duration=1.0)
    values = PlatformPlant().measure() | {"pressure_2": math.nan}
    orders = loop.update(0.002, values)
    assert (orders.aims, orders.pulses, loop.done) == ({}, (), True)
    assert loop.result()["found"] is False


def test_the_first_pulses_wait_until_those_of_a_loop_before_are_over():
    """They last 20 ms at most, and both valves of a muscle are shut for 1 ms between; the muscles are far off here."""
    plant, loop = PlatformPlant(state=(0.0,) * 10), PlatformLoop(goals=[(0.0, 0.0, 0.0)], duration=1.0)
    first = []
    for number in range(1, 30):
        plant.advance(0.002 * number)
        if loop.update(plant.time, plant.measure()).pulses:
            first.append(plant.time)
    assert first[0] == pytest.approx(0.002 + 0.022, abs=1e-6)
