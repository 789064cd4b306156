"""Bending angles through sensors with known faults, against the independent simulator: held by intervals, or withheld."""

from __future__ import annotations

import numpy as np
import pytest

from pmabench.kinds.arm_angle import reduction
from pmabench.store.analyses.results import Analysis, Estimate
from tests.analysis.judged_forms import as_run, as_trials
from tests.analysis.test_polled_channels import played
from tests.judge import arm
from tests.judge.record import lagged

RADIUS = 0.03
KNOWN = {
    "pressure": {"offset_uncertainty": 1500.0, "gain_uncertainty": 0.002},
    "angle": {"offset_uncertainty": np.radians(0.1), "gain_uncertainty": 0.001},
    "displacement": {"offset_uncertainty": 2e-5, "gain_uncertainty": 5e-4},
}
ONE = {0.0: arm.LOADS[0.0]}
SIX = {mass: arm.by_powers(mass) for mass in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)}


def measured(off, loads=ONE, step=0.0, creep=0.0, times=(30.0,), backlash=None) -> Analysis:
    """The analysis of a sound arm whose channels read `off` more; the angle in steps of `step` [rad].

    A share `creep` of each motion comes with time constants [s], one of ten holds; `backlash` is half that of a
    sensor [rad], and then both ways are one.
    """
    trials = []
    for trial in arm.campaign("clean", 0.0, 5, loads):
        channels = {**trial.channels, "displacement": RADIUS * trial.channels["angle"]}
        channels = {name: values + off.get(name, 0.0) for name, values in channels.items()}
        if step or backlash is not None:
            at = [when for c in trial.commands for when in (c.t, c.t + abs(c.value - c.before) / c.rate)]
            P = np.interp(trial.t, at, [value for c in trial.commands for value in (c.before, c.value)])
            still = arm.angle(P, loads[trial.point["tip_mass"]])
            noise = 1e-4 * np.random.default_rng(len(trials)).standard_normal(len(P))
            channels["angle"] = step * np.round(still / step) if step else played(still + noise, backlash or 0.0)
        if creep:
            still = arm.angle(trial.channels["pressure"], loads[trial.point["tip_mass"]])
            channels["angle"] = channels["angle"] - creep * np.mean(
                [still - lagged(still, one, arm.RATE) for one in times], axis=0
            )
        trials.append((trial, channels))
    made = as_trials([trial for trial, _ in trials])
    for one, (_, channels) in zip(made, trials, strict=True):
        one.channels.update(channels)
    settings: dict[str, object] = {"preload": arm.PRELOAD, "angle": "measured", "compare": "nothing", "radius": RADIUS}
    return reduction.reduce([as_run("arm-angle", made, arm.RATE, settings, KNOWN)])


def of(analysis: Analysis, symbol: str, method: str) -> list[Estimate]:
    return [e for e in analysis.estimates if (e.symbol, e.method) == (symbol, method)]


def scores(analysis: Analysis, method: str) -> list[float]:
    """Distances of the coefficients from those that were put in, in half widths; friction may take half a gap off a."""
    found = []
    for e in of(analysis, "alpha_b", method):
        name, _, power = e.coordinate.partition("_")
        put_in = arm.POWERS[name] if power else arm.LOADS[e.at["tip_mass"]]
        value = (*put_in, 0.0, 0.0, 0.0)[int(power) if power else "abcd".index(name)]
        low = value - arm.GAP / 2 if e.coordinate in ("a", "a_0") else value
        assert e.value is not None
        assert e.parts.combined is not None
        found.append(max(low - e.value, e.value - value, 0.0) / e.parts.combined)
    return found


@pytest.mark.parametrize("off", [{"pressure": -1500.0}, {"pressure": 1500.0}, {"angle": np.radians(0.1)}])
def test_zeros_within_their_calibration_are_in_the_intervals_of_the_coefficients(off):
    """They were up to 24 half widths off: no calibration part."""
    analysis = measured(off)
    assert max(scores(analysis, "logistic-up")) < 1.1
    assert not [f for f in analysis.findings if f.level != "note"]


def test_the_powers_of_the_load_hold_the_zero_of_the_pressure():
    assert max(scores(measured({"pressure": -1500.0}, SIX), "logistic-loads")) < 1.1


def test_a_pressure_below_none_is_a_zero_that_is_off():
    """Each trial begins without pressure, and 5 kPa less than none is more than the calibration allows."""
    right, off = measured({}), measured({"pressure": -5e3})
    for one, other in zip(of(right, "P_flat", "angle-at-rest"), of(off, "P_flat", "angle-at-rest"), strict=True):
        assert abs(one.value - other.value) <= other.parts.combined
    lost = [e for e in of(off, "alpha_b", "logistic-up") if e.coordinate == "d"]
    assert all(e.withheld and "zero the gauge" in e.note for e in lost)
    assert any("zero the gauge" in f.text for f in off.findings if f.level == "doubt")


def test_an_angle_that_the_displacement_contradicts_is_wide_and_doubted():
    right, off = measured({}), measured({"angle": np.radians(2.0)})
    for symbol in ("alpha_0", "alpha_max"):
        for one, other in zip(of(right, symbol, "angle-at-rest"), of(off, symbol, "angle-at-rest"), strict=True):
            assert abs(one.value - other.value) <= other.parts.combined
    assert max(scores(off, "logistic-up")) < 1.1
    assert any("one of their zeros is off" in f.text for f in off.findings if f.level == "doubt")


def test_steps_that_no_noise_averages_out_are_in_the_gap():
    """Repeats read the same steps and scatter by nothing, and each way may be half a step off."""
    for e in of(measured({}, step=2e-3), "alpha_H", "angle-at-rest"):
        assert 1e-3 < e.parts.combined < 3e-3


@pytest.mark.parametrize("share", [0.0, 1 / 3, 1.0])
def test_hysteresis_of_the_sensor_up_to_its_uncertainty_is_in_the_gap(share):
    """Backlash of 0.1 deg was 3 to 5 half widths of the gap; a third of that is there without being seen."""
    (found,) = of(measured({}, backlash=share * np.radians(0.1)), "alpha_H", "angle-at-rest")
    assert abs(found.value) < found.parts.combined
    assert share > 0 or found.parts.combined < 0.8 * np.radians(0.1)


@pytest.mark.parametrize(
    ("share", "times"), [(0.02, (30.0,)), (0.1, (30.0,)), (0.05, tuple(np.geomspace(0.3, 300.0, 8)))]
)
def test_creep_that_is_slower_than_a_hold_is_in_the_intervals(share, times):
    """It looks like a drift in one hold: the gap was 3 half widths too wide, and a 1.7 half widths off; along the
    logarithm of time 2 to 3.
    """
    analysis, right = measured({}, creep=share, times=times), arm.truth("clean", 0.0)
    for symbol in ("alpha_max", "alpha_H"):
        for e in of(analysis, symbol, "angle-at-rest"):
            low, high = right[symbol, "", e.at["tip_mass"]]
            if e.value is None:
                assert "not at rest" in e.note
            else:
                assert low - e.parts.combined <= e.value <= high + e.parts.combined
    assert max(scores(analysis, "logistic-up")) < 1.1
