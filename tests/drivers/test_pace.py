"""The pace of samples in virtual time: what is only late now and then is right, what stays late or comes early is not."""

import random
from functools import partial

import pytest
from pmabench_drivers.shared.link import Flow, Pace


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


def lines(seconds, rate, late=lambda t: 0.0, lost=lambda number: False):
    """When the lines of an indicator arrive [s]; they never overtake each other."""
    return [now for number, (_, now) in enumerate(arrivals(seconds, rate, late)) if not lost(number)]


def first_late(times, slip=0.5):
    flow = Flow(slip)
    return next((now for now in times if flow.behind(now)), None)


def _busy(t):
    return 0.01 + random.Random(round(t * 1e3)).random() * 0.02 + max(0.0, 0.4 - t % 7)


LINES = {
    # lines of an indicator, and from when on they are late [s]
    "a busy computer, an indicator 0.5 % slow": (partial(lines, 1800, 49.75, _busy), None),
    "lines that come in pieces": (partial(lines, 300, 50, lambda t: 0.2 - t % 0.2), None),
    "a line in a hundred is lost": (partial(lines, 600, 50, lost=lambda n: n % 100 == 7), None),
    "every seventh line is glued to the next": (partial(lines, 300, 50, lost=lambda n: n % 7 == 0), None),
    "a buffer that is emptied at the beginning": (partial(lines, 300, 50, lambda t: max(0.0, 0.8 - t)), None),
    "one stall of 3 s": (partial(lines, 60, 50, lambda t: max(0.0, 33.0 - t) if 30 < t < 33 else 0.0), None),
    "10 lines a second, three lost at once": (partial(lines, 300, 10, lost=lambda n: 500 <= n < 503), None),
    "later and later, up to 2 s": (partial(lines, 60, 50, lambda t: min(2.0, 0.5 * max(0.0, t - 30))), 30),
    "later by a tenth": (partial(lines, 60, 10, lambda t: min(2.0, 0.1 * max(0.0, t - 30))), 30),
}


@pytest.mark.parametrize("what", LINES)
def test_lines_without_a_clock_that_come_later_and_later_are_found(what):
    times, since = LINES[what]
    late = first_late(times())
    assert (late is None) if since is None else (since < late < since + 10), late
