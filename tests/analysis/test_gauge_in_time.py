"""The regulator's times, and the loop by model, under sensors with filters and delays; the muscle is integrated by scipy."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

from pmabench.kinds.contraction_relaxation.bandwidth import Late, Response
from pmabench.kinds.contraction_relaxation.reduction import reduce
from pmabench.kinds.ultimate_gain.model_gain import by_model
from tests.analysis.test_contraction_sensors import DEAD, RATE, TAU, TRUE, recorded
from tests.analysis.test_ultimate_gain import theory
from tests.judge.record import lagged


@cache
def times(channel, filtered, declared=0.0):
    """`t_d` and `tau_P` over all pressures by coordinate, and the onset of the pressure, with a filter of a channel."""
    run = recorded(
        read_as=lambda name, values, _chance: lagged(values, filtered, RATE) if name == channel else values,
        known={channel: {"sensor_lag": declared}} if declared else None,
    )
    found = reduce([run], {"regulator": True, "replays": 0}).estimates
    return {
        e.coordinate: e
        for e in found
        if not e.at and e.value is not None and e.method in ("regulator-response", "onset")
    }


def holds(e, true):
    return abs(e.value - true) < e.parts.combined


def test_a_filter_of_another_sensor_is_no_lag_of_the_regulator():
    """A second lag of 20.8 +- 0.05 ms was reported, and with a filter of 10 ms a dead time of 40.6 +- 0.02 ms of 30."""
    for filtered in (0.01, 0.02):
        found = times("displacement", filtered)
        assert "second lag" not in found
        assert found["lag"].value == pytest.approx(TAU, rel=0.01)
        assert found["dead time"].value == pytest.approx(DEAD, abs=2e-4)
        assert found["displacement sensor or tube"].value == pytest.approx(filtered, rel=0.1)


@pytest.mark.parametrize(("filtered", "declared"), [(0.003, 0.0), (0.02, 0.0), (0.005, 0.005), (0.04, 0.04)])
def test_a_filter_of_the_gauge_is_no_dead_time_and_no_lag_of_the_regulator(filtered, declared):
    """It was taken off as a delay and shown as a second lag: t_d 25.1, 5.8, 22.1 and -12.8 ms of 28."""
    found = times("pressure", filtered, declared)
    assert "second lag" not in found
    assert found["lag"].value == pytest.approx(TAU, rel=0.01)
    assert holds(found["dead time"], DEAD)
    assert found["dead time"].parts.combined < 1.2e-3
    assert holds(found["command-to-pressure"], DEAD)


def test_a_filter_shorter_than_a_sample_period_is_in_the_interval_of_the_dead_time():
    assert holds(times("pressure", 0.0019)["dead time"], DEAD)
    assert times("", 0.0)["dead time"].parts.combined < 1e-4


def test_a_declared_delay_of_the_gauge_is_taken_off_as_one():
    late = recorded(
        read_as=lambda name, values, _chance: np.roll(values, 10) if name == "pressure" else values,
        known={"pressure": {"sensor_lag": 0.02}},
    )
    found = reduce([late], {"regulator": True, "replays": 0}).estimates
    mine = {e.coordinate: e for e in found if e.method == "regulator-response" and not e.at}
    assert {*mine} == {"dead time", "lag"}
    assert mine["dead time"].value == pytest.approx(DEAD, abs=2e-4)
    assert mine["dead time"].parts.combined < 5e-4


def test_with_another_second_lag_the_gauge_may_have_either():
    slow = Response((0.05, 0.09, 0.03), (1e-4, 1e-4, 1e-4), 0.01, 0.0)
    assert slow.of_regulator(Late(0.01, 0.002, 1e-3, 1e-3), 2e-3).unsure == (0.012, 0.0, 0.0)
    brief = Response((0.05, 0.09, 0.004), (1e-4, 1e-4, 1e-4), 0.01, 0.0)
    assert brief.of_regulator(Late(), 2e-3).unsure == (0.0, 0.0, 0.004)


@pytest.mark.parametrize("declared", [0.02, 0.0])
def test_the_loop_by_model_waits_for_its_displacement_sensor(declared):
    """Declared and true it was left out: K_u of the muscle alone, 10 half widths too large, T_u 128 too short."""
    run = recorded(
        read_as=lambda name, values, _chance: np.roll(values, 10) if name == "displacement" else values,
        known={"displacement": {"sensor_lag": declared}} if declared else None,
    )
    load, x = 100.0, 0.015
    P = brentq(lambda P: TRUE["F_ce"](P) - load - TRUE["K"](P) * x, 2e5, 5e5)
    F_slope, K_slope = (TRUE[name](P + 50) / 100 - TRUE[name](P - 50) / 100 for name in ("F_ce", "K"))
    K, B = TRUE["K"](P), 0.5 * (TRUE["B_c"](P) + TRUE["B_r"](P))
    true = theory((F_slope - K_slope * x) / K, DEAD + 0.02 + 0.5 / RATE, TAU, B / K)
    found = by_model(reduce([run], {"regulator": True, "replays": 0}), [x], load, 0.0, 1 / RATE)
    for e, value in zip(found.estimates, true, strict=True):
        assert abs(e.value - value) < e.parts.combined < 0.08 * value
    assert any("waits for its displacement sensor or a tube to the muscle, 0.02 s" in f.text for f in found.findings)
