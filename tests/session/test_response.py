"""The arithmetic of steps and delays against closed forms."""

import numpy as np
import pytest

from pmabench.session.guided import Series
from pmabench.session.stepping import delay, step_response

T, RATE = 0.1, 500.0
NOISE = 500.0


def series(f, seconds=2.0, seed=0, noise=NOISE):
    t = np.arange(0, seconds, 1 / RATE)
    return Series(t, f(t) + noise * np.random.default_rng(seed).standard_normal(len(t)))


def lag(t, dead):
    return np.where(t > dead, 1 - np.exp(-(t - dead) / T), 0.0)


@pytest.mark.parametrize("dead", [0.02, 0.15])
@pytest.mark.parametrize("size", [50e3, -50e3])
def test_first_order_step(dead, size):
    found = step_response(series(lambda t: 80e3 + size * lag(t, dead)), 0.0, 80e3, NOISE)
    assert found.dead_time == pytest.approx(dead - T * np.log(0.95), abs=0.008)
    assert found.rise == pytest.approx(T * np.log(9), abs=0.02)
    assert found.settling == pytest.approx(dead + T * np.log(20), abs=0.06)
    assert found.overshoot < 0.02 * abs(size)
    assert found.final == pytest.approx(80e3 + size, abs=100)


@pytest.mark.parametrize("zeta", [0.3, 0.6])
def test_overshoot_of_a_second_order_step(zeta):
    """exp(-pi zeta / sqrt(1 - zeta^2)) of the step."""
    w = 20.0
    d = w * np.sqrt(1 - zeta**2)
    f = lambda t: 1e5 * (1 - np.exp(-zeta * w * t) * (np.cos(d * t) + zeta * w / d * np.sin(d * t)))  # noqa: E731
    found = step_response(series(f), 0.0, 0.0, NOISE)
    assert found.overshoot == pytest.approx(1e5 * np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), abs=1000)


def test_no_step_is_no_response():
    found = step_response(series(lambda t: 0 * t), 0.0, 0.0, NOISE)
    assert (found.dead_time, found.rise, found.settling) == (None, None, None)


@pytest.mark.parametrize("late", [-0.03, 0.0, 0.01, 0.08])
def test_delay_of_a_force_that_follows_the_pressure_by_a_curve(late):
    """F = max(0, 1.08 P - 49), shifted; up and down with different rates."""
    up = lambda t: 1e5 * lag(t, 0.1)  # noqa: E731
    down = lambda t: 1e5 * (1 - np.where(t > 0.1, 1 - np.exp(-(t - 0.1) / (2 * T)), 0.0))  # noqa: E731
    pull = lambda P: np.maximum(0.0, 1.08e-3 * P - 49.0)  # noqa: E731
    pressure = (series(up, seed=1), series(down, seed=2))
    force = (
        series(lambda t: pull(up(t - late)), seed=3, noise=0.3),
        series(lambda t: pull(down(t - late)), seed=4, noise=0.3),
    )
    assert delay(pressure, force) == pytest.approx(late, abs=0.004)


def test_no_delay_where_nothing_follows():
    still = (series(lambda t: 0 * t, noise=0.0), series(lambda t: 0 * t, noise=0.0))
    assert delay(still, still) is None
