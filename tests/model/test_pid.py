"""The sampled controller against its closed forms and scipy's continuous one; nothing that is no number comes out."""

from __future__ import annotations

from math import inf, isfinite, nan, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from pmabench.model.pid import ANTI_WINDUP, PID

H = 0.002


def test_proportional_is_gain_times_error_from_the_command_in_force():
    p = PID(4.0, start=10.0)
    assert p.update(H, 3.0, 1.0) == 18.0
    assert p.update(H, 3.0, 4.0) == 6.0


def test_the_integral_is_the_sum_of_errors_so_far():
    pi = PID(2.0, 0.5)
    outputs = [pi.update(H, 1.0, 0.0) for _ in range(6)]
    assert outputs == pytest.approx([2.0 + k * 2.0 * H / 0.5 for k in range(6)])


def test_taking_over_at_the_set_point_makes_no_bump():
    for made in (PID(7e6, start=2e5), PID(7e6, 0.3, start=2e5), PID(7e6, 0.3, 0.05, start=2e5)):
        assert [made.update(H, 0.03, 0.03) for _ in range(3)] == pytest.approx([2e5] * 3)


def test_a_step_of_the_set_point_does_not_go_through_the_derivative():
    pid = PID(2.0, inf, 0.1)
    pid.update(H, 0.0, 0.0)
    assert pid.update(H, 1.0, 0.0) == 2.0


@pytest.mark.parametrize(("T_i", "T_d"), [(inf, 0.0), (0.3, 0.0), (inf, 0.05), (0.3, 0.05)])
def test_slow_signals_are_answered_as_by_the_continuous_controller(T_i, T_d):
    """C(s) on 2 Hz by scipy's lsim, which knows no samples: 2.5 % is one step of 2 ms.

    The first tenth of a second is left out: scipy's derivative starts with a jump, ours with its first difference.
    """
    N, K_p = 10.0, 3.0
    t = np.arange(0, 3, H)
    y = np.sin(2 * np.pi * 2.0 * t)
    pid = PID(K_p, T_i, T_d, N=N)
    ours = np.array([pid.update(H, 0.0, value) for value in y])
    theirs = K_p * -y
    if T_i < inf:
        theirs = theirs + lsim(([K_p / T_i], [1.0, 0.0]), -y, t)[1]
    if T_d > 0:
        theirs = theirs + lsim(([K_p * T_d, 0.0], [T_d / N, 1.0]), -y, t)[1]
    assert np.abs(ours - theirs)[50:].max() < 0.025 * np.abs(theirs).max()


@pytest.mark.parametrize("anti_windup", ANTI_WINDUP)
def test_it_leaves_saturation_at_once_where_a_wound_up_integral_would_not(anti_windup):
    """After 10 s against the end of the range the error changes sign: without anti-windup I would be 10/T_i K_p high."""
    pid = PID(1.0, 0.5, low=-1.0, high=1.0, anti_windup=anti_windup)
    for _ in range(5000):
        assert pid.update(H, 5.0, 0.0) == 1.0
    after = [pid.update(H, 0.0, 0.5) for _ in range(1000)]
    assert after[100] < 1.0
    assert min(after) == -1.0


def test_back_calculation_comes_to_rest_where_wanted_less_given_is_the_error_times_its_times():
    """At rest in saturation K_p e / T_i = (v - u) / T_t: v - u = K_p e T_t / T_i."""
    pid = PID(2.0, 0.4, low=0.0, high=1.0, tracking=0.1)
    for _ in range(5000):
        pid.update(H, 3.0, 0.0)
    wanted = 2.0 * 3.0 + pid._integral
    assert wanted - 1.0 == pytest.approx(2.0 * 3.0 * 0.1 / 0.4, rel=1e-6)


def test_the_tracking_time_follows_from_the_form():
    assert PID(1.0, 0.3).tracking == 0.3
    assert PID(1.0, 0.4, 0.1).tracking == pytest.approx(sqrt(0.04))


def test_what_is_not_finite_changes_nothing():
    pid, twin = PID(2.0, 0.5, 0.1, low=-10, high=10), PID(2.0, 0.5, 0.1, low=-10, high=10)
    for k in range(20):
        y = 0.1 * k
        assert pid.update(H, 1.0, y) == twin.update(H, 1.0, y)
        for bad in (nan, inf, -inf):
            assert pid.update(H, 1.0, bad) == pid.output
            assert pid.update(nan, 1.0, y) == pid.output


anything = st.one_of(st.floats(), st.sampled_from([nan, inf, -inf, 1e308, -1e308, 0.0, 5e-324]))


@settings(max_examples=300, deadline=None)
@given(
    st.floats(1e-3, 1e9), st.floats(1e-4, 1e6), st.floats(0, 1e3), st.sampled_from(ANTI_WINDUP),
    st.lists(st.tuples(anything, anything, anything), max_size=30),
)  # fmt: skip
def test_the_output_is_a_number_inside_its_range_whatever_comes_in(K_p, T_i, T_d, anti_windup, samples):
    pid = PID(K_p, T_i, T_d, low=0.0, high=6e5, anti_windup=anti_windup)
    for h, setpoint, y in samples:
        output = pid.update(h, setpoint, y)
        assert isfinite(output)
        assert 0.0 <= output <= 6e5
    assert isfinite(pid.update(H, 0.03, 0.0))


@pytest.mark.parametrize(
    ("wrong", "reported"),
    [
        ({"K_p": 0.0}, "K_p"), ({"K_p": nan}, "K_p"), ({"T_i": 0.0}, "T_i"), ({"T_d": -1.0}, "T_d"),
        ({"N": 0.0}, "N must"), ({"low": 1.0, "high": 1.0}, "range"), ({"low": 1.0}, "at the start"),
        ({"anti_windup": "none"}, "anti-windup"), ({"tracking": 0.0}, "tracking"),
    ],
)  # fmt: skip
def test_what_no_controller_can_have_is_refused(wrong, reported):
    with pytest.raises(ValueError, match=reported):
        PID(**{"K_p": 1.0, **wrong})
