"""Numbers of static loads, sines and searches for the ultimate gain, against closed forms."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from pmabench.analysis.trial import Expected, Quick
from pmabench.display.verdicts import Verdicts, measure
from pmabench.store.records import RunData, TrialData

EXPECTED = Expected(
    source="closed form",
    pressure=np.array([1e5, 5e5]),
    F_ce=np.array([60.0, 500.0]),
    K=np.array([6000.0, 8000.0]),
    B_c=np.array([1500.0, 2000.0]),
    B_r=np.array([1700.0, 2200.0]),
    F_c=5.0,
)


def run(kind, **settings):
    return RunData("r", "r", kind, "running", True, {}, {"settings": settings}, (), {}, 500.0, ())


def trial(point, t=(), channels=None, found=None, status="finished"):
    t = np.asarray(t, dtype=np.float64)
    return TrialData("r", 0, point, 0, False, status, t, channels or {}, np.zeros(len(t), np.uint16), (), found or {})


def reported(kind, this, expected=EXPECTED, **settings):
    numbers, doubts = measure(run(kind, **settings), this, expected, Quick())
    return {number.symbol: number for number in numbers}, doubts


def found(lift, down):
    return {"lift": {"found": True, "pressure": lift}, "set-down": {"found": True, "pressure": down}}


def test_a_static_load_is_lifted_and_set_down():
    numbers, doubts = reported("static-load", trial({"load": 280.0}, found=found(309e3, 293e3)))
    assert doubts == []
    assert (numbers["mean"].value, numbers["half"].value) == (301e3, 8e3)
    assert numbers["mean"].expected == pytest.approx(300e3)  # F_ce = 280 N there


@pytest.mark.parametrize(
    ("result", "doubt"),
    [
        ({"lift": {"found": True, "pressure": 3e5}}, "set-down was not looked for"),
        ({"lift": {"found": False, "reason": "displacement did not cross"}}, "lift: displacement did not cross"),
        (found(293e3, 309e3), "it sets down at a higher pressure than it lifts"),
    ],
)
def test_what_a_static_load_lacks_is_said(result, doubt):
    _, doubts = reported("static-load", trial({"load": 280.0}, found=result))
    assert doubt in doubts


def test_a_mean_far_from_the_prediction_is_doubted_once_repeats_are_not_there():
    verdicts = Verdicts(EXPECTED)
    far = trial({"load": 280.0}, found=found(359e3, 343e3))
    first = verdicts.judge(run("static-load"), far)
    second = verdicts.judge(run("static-load"), replace(far, index=1))
    assert any("mean 17% above expected (300 kPa)" in doubt for doubt in first.doubts)
    assert second.ok


def sine(K, B, frequency=1.0, amplitude=5e-3, mean=10e-3):
    """F = F_ce - K x - B x' along a sine."""
    t = np.arange(0, 11.0, 0.002)
    angle = 2 * pi * frequency * t
    x, v = mean + amplitude * np.sin(angle), 2 * pi * frequency * amplitude * np.cos(angle)
    channels = {"displacement": x, "force": 400.0 - K * x - B * v, "pressure": np.full(len(t), 3e5)}
    point = {"pressure": 3e5, "frequency": frequency, "mean": mean, "amplitude": amplitude, "cycles": 11.0}
    return trial(point, t, channels)


def test_a_sine_gives_stiffness_and_damping_at_its_frequency():
    numbers, doubts = reported("sinusoidal-displacement", sine(7000.0, 1850.0), discard=1)
    assert doubts == []
    assert numbers["K"].value == pytest.approx(7000.0, rel=1e-6)
    assert numbers["B"].value == pytest.approx(1850.0, rel=1e-6)
    assert numbers["K"].expected == pytest.approx(7000.0)
    friction = 4 * 5.0 / (pi * 2 * pi * 5e-3)  # what F_c adds at this speed
    assert numbers["B"].expected == pytest.approx(1850.0 + friction, rel=1e-3)


def test_a_sine_that_is_none_and_one_that_is_too_small_are_doubted():
    good = sine(7000.0, 1850.0)
    x = good.channels["displacement"]
    square = replace(good, channels={**good.channels, "displacement": 10e-3 + 5e-3 * np.sign(x - 10e-3)})
    small = replace(good, channels={**good.channels, "displacement": 10e-3 + 0.5 * (x - 10e-3)})
    assert any("the displacement is no sine" in doubt for doubt in reported("sinusoidal-displacement", square)[1])
    assert any("amplitude 2.5 mm, asked for 5 mm" in doubt for doubt in reported("sinusoidal-displacement", small)[1])


def test_a_sine_that_cannot_be_used_says_why():
    numbers, doubts = reported("sinusoidal-displacement", replace(sine(7e3, 1e3), status="failed"))
    assert numbers["K"].value is None
    assert doubts == ["the trial is failed"]


def test_a_search_without_levels_has_no_ultimate_gain():
    numbers, doubts = reported("ultimate-gain", trial({"setpoint": 0.03}))
    assert (numbers["K_u"].value, doubts) == (None, ["no levels of gain are recorded"])


def test_the_prediction_ends_with_its_points():
    assert EXPECTED.at("K", 3e5) == pytest.approx(7000.0)
    assert (EXPECTED.at("K", 0.9e5), EXPECTED.at("K", 5.1e5)) == (None, None)
    assert (EXPECTED.lifts(280.0), EXPECTED.lifts(59.0), EXPECTED.lifts(501.0)) == (pytest.approx(3e5), None, None)


def test_a_kind_without_a_rule_has_no_numbers_and_is_not_doubted():
    line = Verdicts(EXPECTED).judge(run("isometric"), trial({"pressure": 3e5}))
    assert (line.numbers, line.doubts) == ((), ())
