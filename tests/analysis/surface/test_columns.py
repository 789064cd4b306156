"""Splines, stops and lags against closed forms."""

import itertools

import numpy as np
import pytest

from pmabench.analysis.surface.muscle import (
    INTERVALS_P,
    SLIDING,
    STOPS_P,
    STOPS_X,
    SURFACE,
    TIMES,
    VISCOUS,
    Axis,
    Frame,
    Muscle,
    lags,
    stops,
)
from pmabench.analysis.surface.trials import rows_of


@pytest.mark.parametrize("amplitude", [1.0, 2.5, 7.0])
def test_area_and_gap_of_a_stop_are_those_of_a_slip_element(amplitude):
    """A slip element of half width 1 and strength 1 moved by +-A: area 4 (A - 1), gap at the centre 2 min(1, A - 1)."""
    u = amplitude * np.sin(np.linspace(0, 4 * np.pi, 40_001))
    S = stops(u, np.array([1.0]), np.zeros(1))[:, 0]
    last = slice(20_000, 40_001)
    assert np.trapezoid(S[last], u[last]) == pytest.approx(4 * (amplitude - 1.0), abs=1e-3)
    rising, falling = S[40_000], S[30_000]
    assert rising - falling == pytest.approx(2 * min(1.0, amplitude - 1.0), abs=1e-2)


def test_a_small_loop_comes_back_to_where_it_began_and_the_large_one_goes_on_as_without_it():
    points = [0.0, 6.0, 4.5, 6.0, 9.0]
    u = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(points)])
    radii = np.array([0.5, 2.0, 4.0])
    S = stops(u, radii, np.zeros(3))
    assert S[599] == pytest.approx(S[199])
    assert S[-1] == pytest.approx(stops(np.linspace(0, 9, 500), radii, np.zeros(3))[-1])


def test_loops_of_a_muscle_are_those_that_its_stops_draw():
    frame = Frame.over((200e3, 600e3), (0.0, 50e-3))
    rng = np.random.default_rng(1)
    P, amplitude = 320e3, 9e-3
    weights = {SLIDING: rng.uniform(1, 3, 2), STOPS_X: rng.uniform(0, 9, 10), STOPS_P: rng.uniform(0, 9, 8)}
    muscle = Muscle(frame, {SURFACE: np.zeros(48), VISCOUS: np.zeros(4), **weights})
    x = 20e-3 + amplitude * np.sin(np.linspace(0, 4 * np.pi, 40_001))
    share = (P - 200e3) / 400e3
    strength = np.concatenate([weights[SLIDING], weights[STOPS_X]])
    each = (1 - share) * np.concatenate([strength[:1], strength[2:7]]) + share * np.concatenate(
        [strength[1:2], strength[7:]]
    )
    F = -stops(x, frame.radii, np.zeros(6)) @ each
    assert muscle.area(P, amplitude) == pytest.approx(-np.trapezoid(F[20_000:], x[20_000:]), rel=1e-3)
    assert muscle.gap(P, amplitude) == pytest.approx(F[30_000] - F[40_000], rel=1e-2)
    P = 400e3 + 150e3 * np.sin(np.linspace(0, 4 * np.pi, 40_001))
    S = stops(P, frame.pressure_radii, np.zeros(4))
    each = 0.6 * weights[STOPS_P][:4] + 0.4 * weights[STOPS_P][4:]
    assert muscle.pressure_gap(20e-3, 150e3) == pytest.approx((S[40_000] - S[30_000]) @ each, rel=1e-2)


def test_a_lag_of_a_step_and_of_a_ramp_are_the_textbook_ones():
    t = np.concatenate([np.arange(0.0, 30.0, 0.04), np.arange(30.0, 90.0, 0.5)])
    T = np.array(TIMES)
    step = lags(t, np.ones(len(t)))
    assert step == pytest.approx(1 - np.exp(-t[:, None] / T), abs=1e-12)
    ramp = lags(t, 2.0 * t)
    assert ramp == pytest.approx(2.0 * (t[:, None] - T * (1 - np.exp(-t[:, None] / T))), abs=1e-9)


def test_splines_add_up_to_one_give_slopes_and_go_on_straight():
    axis = Axis(-3.0, 7.0, (0.0, 0.1, 0.4, 1.0))
    at = np.linspace(-3, 7, 57)
    assert axis.functions(at).sum(axis=1) == pytest.approx(1.0)
    h = 1e-6
    numeric = (axis.functions(at[1:-1] + h) - axis.functions(at[1:-1] - h)) / (2 * h)
    assert axis.functions(at[1:-1], slope=True) == pytest.approx(numeric, abs=1e-6)
    ends = axis.functions(np.array([7.0, 8.0, 9.0]))
    assert ends[2] - ends[1] == pytest.approx(ends[1] - ends[0])


def test_a_parabola_has_no_bends_and_a_cubic_has():
    axis = Axis(2.0, 12.0, (0.0, 0.077, 0.19, 0.38, 0.62, 1.0))
    at = np.linspace(2, 12, 200)
    for power, bent in ((0, False), (1, False), (2, False), (3, True)):
        weights = np.linalg.lstsq(axis.functions(at), at**power, rcond=None)[0]
        assert (np.abs(axis.bends() @ weights).max() > 1.0) == bent


def test_rows_are_means_and_the_speed_is_the_slope_within_each():
    t = np.arange(0, 4, 0.005)
    x = 0.01 * np.sin(2 * np.pi * 0.3 * t)
    usable = np.ones(len(t), dtype=bool)
    usable[100:140] = False
    at, P, places, F, v = rows_of(t, 3.0 * t, x, -t, usable, rate=25.0)
    assert len(at) == 100 - 4, "four rows lie wholly among the samples that cannot be used"
    assert pytest.approx(3.0 * at) == P
    assert pytest.approx(-at) == F
    assert places == pytest.approx(0.01 * np.sin(2 * np.pi * 0.3 * at), abs=1e-5)
    assert v == pytest.approx(0.01 * 2 * np.pi * 0.3 * np.cos(2 * np.pi * 0.3 * at), abs=1e-4)


def test_any_range_has_splines_that_add_up_to_1():
    """Rounding puts low + (high - low) beside high in one of 16 ranges; the splines must not notice."""
    random = np.random.default_rng(8)
    for low, high in zip(random.uniform(0.0, 2e5, 300), random.uniform(3e5, 7e5, 300), strict=True):
        found = Axis(low, high, INTERVALS_P).functions(np.array([low, 0.5 * (low + high), high]))
        np.testing.assert_allclose(found.sum(axis=1), 1.0, rtol=1e-12)
