"""Numbers of held positions and of validated steps right after a trial, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmabench.store.records import Command
from tests.display.test_quantities import reported, trial

T = np.arange(0, 60, 0.002)
LAW = {"t0": 0.0, "t1": float(T[-1]), "setpoint": 0.03, "ended": "time"}


def position(x, **change):
    return trial({"setpoint": 0.03, "load": 0.0}, T, {"displacement": x}, {"position": {**LAW, **change}})


def test_a_held_position_shows_error_and_overshoot():
    numbers, doubts = reported(
        "positioning", position(np.where(T < 1, 0.036 * T, 0.0297)), window=[20.0, 60.0], band=0.02
    )
    assert numbers["e_ss"].value == pytest.approx(0.01)
    assert numbers["OS"].value == pytest.approx(0.2, abs=0.02)
    assert doubts == []


def test_a_limit_cycle_is_a_reason_to_doubt():
    x = np.where(T < 1, 0.03 * T, 0.03 + 2e-4 * np.sign(np.sin(2 * np.pi * T / 8)))
    numbers, doubts = reported("positioning", position(x), window=[20.0, 60.0], band=0.02)
    assert numbers["T_c"].value == pytest.approx(8.0, rel=1e-3)
    assert doubts == ["stick-slip limit cycle: 0.4 mm peak to peak, 8 s"]
    assert (
        reported("positioning", position(x), window=[20.0, 60.0], band=0.005)[1][0] == "it does not settle in the band"
    )


def test_a_loop_without_an_end_says_why():
    lost = position(0.03 + 0 * T, ended="no signal", reason="displacement gave no number")
    assert reported("positioning", lost)[1] == ["displacement gave no number"]


def test_a_step_is_next_to_what_the_specimen_expects():
    """F_ce 280 N and K 7 N/mm at 300 kPa, 5 N of friction: (280 - 5) / 7 = 39.29 mm."""
    made = trial({"pressure": 3e5, "load": 0.0}, T[:6000], {"displacement": 0.039 + 0 * T[:6000], "pressure": T[:6000]})
    step = replace(made, commands=(Command(0.0, "pressure", "set", 3e5, 0.0, "step"),))
    numbers, doubts = reported("validation", step, window=[8.0, 10.0])
    assert numbers["x"].value == pytest.approx(0.039)
    assert numbers["x"].expected == pytest.approx(275 / 7 * 1e-3)
    assert doubts == []
    assert reported("validation", made)[1] == ["no step of pressure is recorded"]
