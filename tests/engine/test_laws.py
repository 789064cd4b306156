"""The laws that run at every sample: what they command, when they end, what they write down."""

from __future__ import annotations

import json
from math import nan
from typing import Any

import numpy as np
import pytest

from pmabench.engine.laws.gain_steps import GainSteps
from pmabench.engine.laws.position_loop import PositionLoop
from tests.analysis.loop_rig import LinearPlant, close_loop
from tests.engine.loop_cost import MOST, plain_calls

K_U = 9.4637 / 1.5e-7
"""Of gain 1.5e-7 m/Pa, dead time 40 ms, lags 0.0955 and 0.25 s [Pa/m]; T_u is 0.3426 s."""
T_U = 0.3426


def plant(noise: float = 2e-6) -> LinearPlant:
    return LinearPlant(1.5e-7, 0.04, (0.0955, 0.25), noise=(noise, 500.0))


def law(**change: Any) -> GainSteps:
    given = {"setpoint": 0.0, "bias": 0.0, "start": 0.7 * K_U, "low": -2e5, "high": 2e5, **change}
    return GainSteps(**given)


def test_gain_rises_in_steps_until_swings_grow() -> None:
    steps = law()
    samples = close_loop(plant(), steps, 120.0)
    found = steps.result()
    gains = np.array([level["gain"] for level in found["levels"]])
    assert found["ended"] == "growth"
    assert found["found"]
    assert gains[0] == pytest.approx(0.7 * K_U)
    assert np.diff(np.log(gains)) == pytest.approx(np.log(1.08))
    assert 1.0 < gains[-1] / K_U < 1.09
    for level in found["levels"]:
        long_enough = level["t1"] - level["t0"] >= 8 * T_U / 2 * 0.98
        assert level["half_periods"] >= 8 or level["t1"] - level["t0"] >= 4.0
        assert long_enough
    assert np.abs(samples["displacement"]).max() < 5e-3
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_no_step_is_larger_than_eight_percent() -> None:
    with pytest.raises(ValueError, match="factor"):
        law(factor=1.09)
    with pytest.raises(ValueError, match=r"half_periods.*start"):
        law(half_periods=6, start=0.0)
    with pytest.raises(ValueError, match="outside the range"):
        law(bias=3e5)


def test_it_kicks_only_a_loop_that_does_not_swing() -> None:
    steps = law(kick=4e-4)
    close_loop(plant(), steps, 120.0)
    levels = steps.result()["levels"]
    assert [level["kick"] for level in levels[:3]] == [4e-4, -4e-4, 4e-4]
    assert [level["aim"] for level in levels[:3]] == pytest.approx([2e-4, -2e-4, 2e-4])
    assert levels[-1]["kick"] == 0.0


def test_settling_trims_the_bias_to_the_set_point() -> None:
    steps = law(setpoint=2e-3, kick=1e-4)
    samples = close_loop(plant(), steps, 4.0, start=0.0)
    assert samples["displacement"][-100:].mean() == pytest.approx(2e-3 - 0.5e-4, abs=2e-5)
    untrimmed = law(setpoint=2e-3, kick=1e-4, trim=0.0)
    close_loop(plant(), untrimmed, 4.0)
    assert untrimmed.result()["bias"] == 0.0


def test_it_ends_where_the_swings_leave_the_window() -> None:
    steps = law(start=1.4 * K_U, settle=0.0, window=2e-3, low=-1e6, high=1e6)
    samples = close_loop(plant(), steps, 60.0)
    assert steps.result()["ended"] == "amplitude"
    assert np.abs(samples["displacement"][:-1]).max() <= 2e-3
    assert samples["pressure_command"][-1] == steps.bias


def test_it_ends_where_the_command_saturates() -> None:
    steps = law(start=0.7 * K_U, low=-5e3, high=5e3)
    samples = close_loop(plant(), steps, 60.0)
    found = steps.result()
    assert found["ended"] == "saturated"
    assert not found["found"]
    assert "range" in found["reason"]
    assert np.abs(samples["pressure_command"]).max() <= 5e3


def test_it_ends_without_a_signal_and_after_its_levels() -> None:
    blind = law()
    blind.update(0.0, {"displacement": 0.0})
    assert blind.update(0.002, {"displacement": nan}) == 0.0
    assert blind.done
    assert blind.result()["ended"] == "no signal"
    few = law(start=0.3 * K_U, levels=3, level_time=2.0)
    close_loop(plant(), few, 60.0)
    assert few.result()["ended"] == "levels"
    assert len(few.result()["levels"]) == 3
    stopped = law()
    close_loop(plant(), stopped, 6.0)
    assert stopped.result()["ended"] == "limit"
    assert "reason" not in stopped.result()


def test_noise_alone_is_no_swing() -> None:
    steps = law(start=0.05 * K_U, levels=2, level_time=4.0, noise=2e-5, kick=1e-4)
    close_loop(plant(noise=2e-5), steps, 60.0)
    assert max(level["half_periods"] for level in steps.result()["levels"]) <= 1


def test_proportional_leaves_the_error_that_it_must() -> None:
    p = PositionLoop(setpoint=1e-3, start=0.0, K_p=0.3 * K_U, duration=10.0, low=-2e5, high=2e5)
    close_loop(plant(noise=0.0), p, 20.0)
    found = p.result()
    assert found["ended"] == "time"
    assert found["t1"] - found["t0"] == pytest.approx(10.0, abs=2.1e-3)
    assert found["error"] == pytest.approx(1e-3 / (1 + 0.3 * 9.4637), rel=1e-3)
    assert found["saturated"] == 0.0


def test_proportional_is_clamped_and_stops_without_a_signal() -> None:
    p = PositionLoop(setpoint=1.0, start=0.0, K_p=1e6, duration=1.0, low=-1e3, high=1e3)
    assert p.update(0.0, {"displacement": 0.0}) == 1e3
    assert p.update(0.1, {"displacement": 2.0}) == -1e3
    assert p.result()["saturated"] == 1.0
    assert p.update(0.2, {}) == -1e3, "the command stays, and the run ends"
    assert p.done
    assert p.result()["ended"] == "no signal"
    assert not p.result()["found"]


def test_an_update_costs_few_plain_calls() -> None:
    assert plain_calls(law(start=0.1 * K_U, settle=0.0, levels=200, window=1.0)) < MOST
