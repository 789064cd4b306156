"""Feed-forward from the inverse of a muscle: closed forms of a muscle of straight lines, with its stops."""

from itertools import pairwise

import numpy as np
import pytest

from pmabench.model.identified.plant import free_run, led, pressures, rising_root
from pmabench.model.pid import PID, ReferencePath
from pmabench.model.regulator import Regulator
from tests.model.test_identified import PER_PRESSURE, STIFF, muscle

ENDS = (0.0, 600e3)


def along(path, every=0.02):
    t = np.arange(0.0, path.duration, every)
    return t, np.array([path.place(float(now)) for now in t]), np.array([path.speed(float(now)) for now in t])


def test_a_path_goes_to_its_places_in_time():
    """A cosine move of d at a highest speed of s takes pi d / (2 s); its speed is the slope of its place."""
    path = ReferencePath([0.0, 30e-3, 10e-3], speed=20e-3, rest=0.5)
    assert path.duration == pytest.approx(1.5 + np.pi / 2 * (30 + 20) / 20)
    t, x, v = along(path, 1e-3)
    assert np.abs(v).max() == pytest.approx(20e-3, rel=1e-4)
    assert np.gradient(x, t) == pytest.approx(v, abs=2e-5)
    assert x.max() == pytest.approx(30e-3)
    assert x[-1] == pytest.approx(10e-3)
    with pytest.raises(ValueError, match="two places"):
        ReferencePath([0.0], 1.0, 1.0)


def test_the_pressure_of_each_branch_is_that_of_its_stop():
    """Surface 2.5 P - 20 x, a stop of r = 1 mm and 10 N: contracting (20 x + F_L + 10) / 2.5 kPa, back 10 less."""
    path = ReferencePath([0.0, 20e-3, 10e-3, 15e-3], speed=10e-3, rest=1.0)
    t, x, v = along(path)
    P = pressures(muscle(((1e-3, 10.0),), damping=(0.0, 0.0)), t, x, v, 200.0, ENDS)
    inside = [
        (t > start + 0.6 * time) & (t < start + time) for start, time in zip(path.starts, path.times, strict=True)
    ]
    for sign, rows in zip((1, -1, 1), inside, strict=True):
        assert PER_PRESSURE * P[rows] == pytest.approx(STIFF * x[rows] + 200.0 + 10.0 * sign, abs=0.05)


def test_what_it_gives_takes_the_load_along_the_path():
    """Put into the muscle as it is simulated with a small mass, the pressure leads it along the path."""
    one = muscle(((1e-3, 10.0), (4e-3, 20.0)), ((20e3, 8.0),), ((0.5, 0.02), (5.0, 0.03)))
    path = ReferencePath([0.0, 20e-3, 8e-3, 16e-3], speed=10e-3, rest=1.0)
    t, x, v = along(path, 5e-3)
    P = pressures(one, t, x, v, 200.0, ENDS)
    assert np.abs(free_run(one, t, P, 200.0, 0.5)[0] - x).max() < 0.05e-3
    plain = (STIFF * x + 200.0) / PER_PRESSURE
    assert np.abs(free_run(one, t, plain, 200.0, 0.5)[0] - x).max() > 1e-3


def test_a_pressure_that_is_not_there_is_the_nearest_end():
    assert rising_root(lambda P: P - 700e3, *ENDS) == 600e3
    assert rising_root(lambda P: P + 1.0, *ENDS) == 0.0
    assert rising_root(lambda P: P - 123456.0, *ENDS) == pytest.approx(123456.0, abs=1.0)


def test_a_led_command_makes_the_pressure_behind_dead_time_and_lag():
    """dP/dt = (u(t - t_d) - P) / T, integrated here by Euler steps."""
    t = np.arange(0.0, 6.0, 1e-3)
    wanted = 300e3 + 100e3 * np.sin(t)
    u = led(t, wanted, Regulator(dead_time=0.05, lag=0.1), ENDS)
    P = [wanted[0]]
    for now, later in pairwise(t):
        P.append(P[-1] + (later - now) * (np.interp(now - 0.05, t, u) - P[-1]) / 0.1)
    late = (t > 1.0) & (t < 5.9)
    assert np.array(P)[late] == pytest.approx(wanted[late], abs=0.4e3)


def test_a_feed_forward_is_added_and_its_range_is_kept():
    controller = PID(1.0, 2.0, low=0.0, high=10.0)
    assert controller.update(0.0, 1.0, 0.0, 4.0) == pytest.approx(5.0)
    assert controller.update(0.1, 1.0, 1.0, 30.0) == 10.0
    assert controller.saturated
