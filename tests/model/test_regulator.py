"""Commands through dead time and lag against closed forms and an independent integration."""

import copy
import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lti, step

from pmabench.model.overrides import Overrides
from pmabench.model.presets import preset
from pmabench.model.regulator import Regulated, Regulator, Trace, Wave, answer, constant, ramp, sine, swung


def test_a_step_arrives_after_the_dead_time_exactly_at_that_sample():
    regulated = Regulated(Regulator(dead_time=0.04))
    regulated.command(constant(1.0, 300e3))
    t = np.array([1.0, 1.038, 1.04, 1.042])
    assert regulated.values(t)[0].tolist() == [0, 0, 300e3, 300e3]


def test_a_step_through_a_lag_is_an_exponential():
    regulated = Regulated(Regulator(dead_time=0.04, lag=0.0955))
    regulated.command(constant(0.0, 400e3))
    t = np.linspace(0.04, 1, 50)
    np.testing.assert_allclose(regulated.values(t)[0], 400e3 * (1 - np.exp(-(t - 0.04) / 0.0955)), rtol=1e-12)


def test_setpoints_are_those_before_the_dead_time():
    regulated = Regulated(Regulator(dead_time=0.04), 10.0)
    regulated.command(constant(1.0, 20.0))
    regulated.command(ramp(2.0, 20.0, 30.0, 10.0))
    t = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5])
    assert regulated.setpoints(t).tolist() == pytest.approx([10, 20, 20, 20, 25, 30, 30])
    assert [regulated.setpoint(float(s)) for s in t] == pytest.approx([10, 20, 20, 20, 25, 30, 30])


def test_a_new_command_ends_the_rest_of_the_old_one():
    regulated = Regulated(Regulator(dead_time=0.04))
    regulated.command(ramp(0.0, 0.0, 100.0, 10.0))
    assert regulated.value(1.0) == pytest.approx(9.6)
    regulated.command(constant(1.0, 5.0))
    assert regulated.values(np.array([1.02, 1.04, 20.0]))[0].tolist() == pytest.approx([9.8, 5.0, 5.0])


@pytest.mark.parametrize(
    "regulator",
    [
        Regulator(0.04, 0.0955),
        Regulator(0.0, 0.22),
        Regulator(0.04, 0.1, vent_ratio=1.5),
        Regulator(0.04, 0.1, vent_ratio=1.5, dead_band=5.0),
        Regulator(0.04, 0.1, dead_band=5.0),
        Regulator(0.04, 0.1, leak=0.8),
        Regulator(0.04, 0.1, vent_ratio=1.5, leak=0.8),
        Regulator(0.04, 0.1, vent_ratio=1.5, dead_band=5.0, leak=0.8),
    ],
)
def test_ramps_and_sines_agree_with_an_independent_integration(regulator):
    waves = [
        (0.5, ramp(0.5, 0.0, 100.0, 80.0)),
        (2.5, sine(2.5, 100.0, 40.0, 0.7, 2)),
        (6.0, ramp(6.0, 100.0, 20.0, 100.0)),
        (7.1, constant(7.1, 60.0)),
    ]
    edges = [0.5, 1.75, 2.5, 2.5 + 2 / 0.7, 6.0, 6.8, 7.1]

    def command(t):
        if t < 0.5:
            return 0.0
        if t < 2.5:
            return min(100.0, 80.0 * (t - 0.5))
        if t < 2.5 + 2 / 0.7:
            return 100 + 40 * math.sin(2 * math.pi * 0.7 * (t - 2.5))
        if t < 6:
            return 100.0
        return max(20.0, 100 - 100 * (t - 6)) if t < 7.1 else 60.0

    def rate(t, y):
        error = command(t - regulator.dead_time) - y[0]
        lost = regulator.leak * y[0]
        if abs(error) <= regulator.dead_band:
            return [-lost]
        pull = error - math.copysign(regulator.dead_band, error)
        return [pull / (regulator.lag * (1 if error > 0 else regulator.vent_ratio)) - lost]

    regulated, values, truth, y = Regulated(regulator), [], [], 0.0
    breaks = [0.0, *(edge + regulator.dead_time for edge in edges), 9.0]
    for begin, end in itertools.pairwise(breaks):
        t = np.linspace(begin, end - 1e-6, 40)
        solution = solve_ivp(rate, (begin, end - 1e-6), [y], t_eval=t, rtol=1e-9, atol=1e-9, max_step=5e-3)
        truth.append(solution.y[0])
        y = solution.y[0][-1]
        for start, wave in list(waves):
            if start <= begin:
                regulated.command(wave)
                waves.remove((start, wave))
        values.append(regulated.values(t)[0])
    np.testing.assert_allclose(np.concatenate(values), np.concatenate(truth), atol=2e-4)


def test_rates_are_the_slope_of_the_values():
    regulated = Regulated(Regulator(dead_time=0.0, lag=0.1), 5.0)
    regulated.command(sine(0.0, 1.0, 2.0, 1.3, 4))
    t = np.linspace(0.01, 3, 200)
    before, after = (copy.copy(regulated).values(t + d)[0] for d in (-1e-6, 1e-6))
    np.testing.assert_allclose(regulated.values(t)[1], (after - before) / 2e-6, atol=1e-5)


def test_an_open_valve_takes_the_output_away_whatever_is_commanded():
    regulated = Regulated(Regulator(0.04, 0.1), 300e3)
    regulated.force(1.0, 0.0, 0.01)
    regulated.command(constant(1.0, 500e3))
    assert regulated.value(1.01) == pytest.approx(300e3 / math.e)
    assert regulated.value(2.0) == pytest.approx(0, abs=1e-9)
    assert regulated.setpoint(2.0) == 500e3


def test_a_valve_that_closes_lets_the_regulator_fill_from_where_the_output_is():
    regulated = Regulated(Regulator(0.04, 0.1), 300e3)
    regulated.force(1.0, 0.0, 0.2)
    regulated.command(constant(1.1, 500e3))
    assert regulated.value(1.2) == pytest.approx(300e3 / math.e)
    regulated.release(1.3)
    t = np.array([1.3, 1.4, 1.8])
    low = 300e3 * math.exp(-0.3 / 0.2)
    np.testing.assert_allclose(regulated.values(t)[0], 500e3 + (low - 500e3) * np.exp(-(t - 1.3) / 0.1), rtol=1e-12)


def test_a_command_under_way_through_the_dead_time_arrives_although_the_valve_closes_meanwhile():
    regulated = Regulated(Regulator(dead_time=0.04), 100.0)
    regulated.force(1.0, 0.0, 0.0)
    regulated.command(constant(1.0, 200.0))
    regulated.release(1.02)
    assert regulated.values(np.array([1.02, 1.03, 1.04]))[0].tolist() == [100.0, 100.0, 200.0]
    assert regulated.piece(2.0)[1] == math.inf


@pytest.mark.parametrize("band", [0.0, 5.0])
def test_a_leak_keeps_the_output_below_the_command(band):
    """Balance of fill and loss: (u - band - y) / T = leak y; from above too, where it first falls through the band."""
    for begin in (0.0, 200.0):
        regulated = Regulated(Regulator(0.0, 0.1, vent_ratio=2.0, dead_band=band, leak=0.5), begin)
        regulated.command(constant(0.0, 100.0))
        assert regulated.value(60.0) == pytest.approx((100 - band) / 1.05, abs=1e-6)


def test_a_dead_band_needs_a_lag():
    with pytest.raises(ValueError, match="lag"):
        Regulator(lag=0.0, dead_band=1.0)


def test_whole_numbers_are_commanded_as_any_others():
    whole, exact = (Regulated(Regulator(lag=0.1)) for _ in range(2))
    whole.command(constant(0.0, 300))
    exact.command(constant(0.0, 300.0))
    t = np.linspace(0.0, 1.0, 11)
    for found, expected in zip(whole.values(t), exact.values(t), strict=True):
        np.testing.assert_array_equal(found, expected)


# -- second order ------------------------------------------------------------------------------------------------

W = 2 * math.pi * 2.5
"""Of a natural frequency of 2.5 Hz [rad/s]."""


def test_equal_poles_give_the_closed_form():
    regulated = Regulated(Regulator(dead_time=0.04, natural_frequency=2.5, damping_ratio=1.0))
    regulated.command(constant(0.0, 400e3))
    t = np.linspace(0.0, 1.5, 200)
    wt = W * np.maximum(t - 0.04, 0.0)
    value, rate = regulated.values(t)
    np.testing.assert_allclose(value, 400e3 * (1 - (1 + wt) * np.exp(-wt)), atol=1e-4)
    np.testing.assert_allclose(rate, 400e3 * W * wt * np.exp(-wt), atol=1e-2)


@pytest.mark.parametrize("damping", [0.1, 0.7, 1.0 - 1e-7, 1.0 + 1e-7, 1.5, 20.0])
def test_a_step_is_that_of_its_transfer_function(damping):
    regulated = Regulated(Regulator(dead_time=0.04, natural_frequency=2.5, damping_ratio=damping))
    regulated.command(constant(0.0, 300e3))
    since = np.arange(297) * 0.01
    _, expected = step(lti([W * W], [1, 2 * damping * W, W * W]), T=since)
    np.testing.assert_allclose(regulated.values(0.04 + since)[0], 300e3 * expected, atol=1e-3)


@pytest.mark.parametrize("damping", [0.2, 1.0, 3.0])
@pytest.mark.parametrize("share", [1.0, 0.9])
def test_ramps_and_sines_of_second_order_agree_with_an_independent_integration(damping, share):
    """And so does a chamber at rest behind it, a lag that comes to `share` of it."""
    regulator = Regulator(dead_time=0.04, natural_frequency=2.5, damping_ratio=damping)
    waves = [
        ramp(0.5, 0.0, 100.0, 80.0),
        sine(2.5, 100.0, 40.0, 0.7, 2),
        ramp(6.0, 100.0, 20.0, 100.0),
        constant(7.1, 60.0),
    ]
    plain = [wave for part in waves for wave in part]
    edges = [0.0, *(wave.start + 0.04 for wave in plain), 9.0]
    regulated, y, P, lag = Regulated(regulator), [0.0, 0.0, 0.0], 0.0, 0.05
    for wave, (begin, end) in zip([Wave(0.0, 0.0), *plain], itertools.pairwise(edges), strict=True):

        def rate(t, y, wave=wave):
            u = wave.value(t - 0.04)
            return [y[1], W * W * (u - y[0]) - 2 * damping * W * y[1], (share * y[0] - y[2]) / lag]

        t = np.linspace(begin, end, 40)
        truth = solve_ivp(rate, (begin, end), y, t_eval=t, rtol=1e-10, atol=1e-9, max_step=5e-3).y
        for part in waves:
            if part[0].start <= begin + 1e-9 < part[-1].start + 0.041:
                regulated.command(part)
        before = np.nextafter(t, 0.0)
        trace = regulated.piece(float(t[0]))[0]
        found = answer(trace, float(t[0]), P, lag, share)
        np.testing.assert_allclose(found.values(t), truth[2], atol=1e-4)
        np.testing.assert_allclose([found.value(float(s)) for s in t], truth[2], atol=1e-4)
        np.testing.assert_allclose(trace.values(before), truth[0], atol=1e-4)
        np.testing.assert_allclose(trace.rates(t), truth[1], atol=1e-3)
        np.testing.assert_allclose([trace.function()(s - trace.start) for s in t.tolist()], truth[0], atol=1e-4)
        y, P = truth[:, -1], float(truth[2][-1])


def test_venting_is_slower_by_the_ratio_where_a_lower_command_arrives():
    regulated = Regulated(Regulator(dead_time=0.0, natural_frequency=2.5, vent_ratio=2.0), 400e3)
    regulated.command(constant(0.0, 0.0))
    assert regulated.value(2 / W) == pytest.approx(400e3 * 2 / math.e, rel=1e-6)


def test_a_valve_that_closes_lets_a_second_order_go_on_from_where_the_output_is():
    regulated = Regulated(Regulator(0.0, natural_frequency=2.5, damping_ratio=0.7), 300e3)
    regulated.force(1.0, 0.0, 0.2)
    regulated.release(1.3)
    low = 300e3 * math.exp(-1.5)
    value, rate = regulated.values(np.array([1.3, 1.3 + 1e-6]))
    assert value == pytest.approx(low, abs=1.0)
    assert rate == pytest.approx(-low / 0.2, rel=1e-3)
    assert regulated.value(9.0) == pytest.approx(300e3)


@pytest.mark.parametrize("damping", [0.05, 0.9, 1.0, 2.0])
def test_settled_is_said_only_where_nothing_comes_after(damping):
    trace = swung(Wave(0.0, 100.0), 0.0, 0.0, 50.0, W, damping)
    t = np.linspace(0, 20, 4001)
    off = np.abs(trace.values(t) - 100.0)
    settled = np.array([trace.settled(float(s), 0.1) for s in t])
    assert settled.any()
    assert off[settled.argmax() :].max() < 0.1
    assert settled.argmax() < 2 * np.flatnonzero(off > 0.1)[-1] + 100


def test_a_lag_next_to_an_equal_pole_is_the_limit():
    """0.1 y' = exp(-s / 0.1) - y from 0: y = (s / 0.1) exp(-s / 0.1)."""
    found, t = answer(Trace(0.0, 0.0, modes=((-10.0, 0.0, 1e5, 0.0),)), 0.0, 0.0, 0.1), np.linspace(0, 1, 100)
    np.testing.assert_allclose(found.values(t), 1e5 * t / 0.1 * np.exp(-t / 0.1), atol=2.0)


@pytest.mark.parametrize(
    "wrong", [{"lag": 0.1, "natural_frequency": 2.0}, {"natural_frequency": -1.0}, {"damping_ratio": 0.0}]
)
def test_orders_exclude_each_other(wrong):
    with pytest.raises(ValueError, match="order|negative|damping ratio"):
        Regulator(**wrong)


def test_a_damping_ratio_needs_a_second_order():
    with pytest.raises(ValueError, match="second order"):
        preset("paper0", "bench", Overrides(damping_ratio=0.5))
    assert preset("paper0", "bench", Overrides(damping_ratio=0.5, natural_frequency=3.0)).regulator.lag == 0
    assert preset("paper0-air", "bench", Overrides(regulator_lag=0.1)).regulator.natural_frequency == 0
