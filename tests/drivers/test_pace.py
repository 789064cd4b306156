"""The pace of samples in virtual time: what is only late now and then is right, what stays late or comes early is not."""

import random

import pytest
from pmabench_drivers.shared.link import Pace


def reported(pace, taken_and_now):
    """The first thing that is wrong, and when [s]."""
    for taken, now in taken_and_now:
        behind = pace.behind(taken, now)
        if behind:
            return behind, now
    return 0.0, None


def arrivals(seconds, rate=100.0, late=lambda t: 0.0):
    """Samples of a perfect clock, each `late` by the way it takes [s]; they never overtake each other."""
    newest = 0.0
    for number in range(int(seconds * rate)):
        taken = number / rate
        newest = max(newest, taken + late(taken))
        yield taken, newest


def test_a_busy_computer_and_a_clock_100_ppm_off_are_right_for_an_hour():
    chance = random.Random(2)

    def late(t):
        stall = 0.4 if t % 7 < 0.4 else 0.0  # for 0.4 s of each 7 s nothing is read
        return 0.01 + chance.random() * 0.02 + max(0.0, stall - t % 7) + 1e-4 * t

    assert reported(Pace(0.1), arrivals(3600, late=late)) == (0.0, None)


def test_samples_that_never_came_make_all_others_late():
    behind, when = reported(Pace(0.1), arrivals(60, late=lambda t: 0.01 + (0.2 if t > 30 else 0.0)))
    assert behind == pytest.approx(0.2, abs=0.01)
    assert 30 < when < 32.5


def test_a_stall_of_three_seconds_is_no_loss():
    assert reported(Pace(0.1), arrivals(60, late=lambda t: max(0.0, 33.0 - t) if 30 < t < 33 else 0.01)) == (0.0, None)


@pytest.mark.parametrize(("error", "sign"), [(0.01, 1.0), (-0.01, -1.0)])
def test_a_rate_that_is_off_by_one_percent_is_found(error, sign):
    behind, when = reported(Pace(0.1), ((taken, taken * (1 + error)) for taken, _ in arrivals(60)))
    assert behind * sign > 0
    assert when < 40
