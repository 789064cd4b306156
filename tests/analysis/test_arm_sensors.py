"""Bending angles through sensors with known faults, against the independent simulator: held by intervals, or withheld."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.arm_angle import reduction
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import Command, TrialData
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


def measured(off, step=0.0, creep=0.0, times=(30.0,), backlash=None) -> Analysis:
    """The analysis of a sound arm whose channels read `off` more; the angle in steps of `step` [rad].

    A share `creep` of each motion comes with time constants [s], one of ten holds; `backlash` is half that of a
    sensor [rad], and then both ways are one.
    """
    trials = []
    for trial in arm.campaign("clean", 0.0, 5, ONE):
        channels = {**trial.channels, "displacement": RADIUS * trial.channels["angle"]}
        channels = {name: values + off.get(name, 0.0) for name, values in channels.items()}
        if step or backlash is not None:
            at = [when for c in trial.commands for when in (c.t, c.t + abs(c.value - c.before) / c.rate)]
            P = np.interp(trial.t, at, [value for c in trial.commands for value in (c.before, c.value)])
            still = arm.angle(P, ONE[trial.point["tip_mass"]])
            noise = 1e-4 * np.random.default_rng(len(trials)).standard_normal(len(P))
            channels["angle"] = step * np.round(still / step) if step else played(still + noise, backlash or 0.0)
        if creep:
            still = arm.angle(trial.channels["pressure"], ONE[trial.point["tip_mass"]])
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


@pytest.mark.parametrize("off", [{"pressure": -1500.0}, {"pressure": 1500.0}, {"angle": np.radians(0.1)}])
def test_zeros_within_their_calibration_are_in_the_intervals_of_the_angles_and_coefficients_have_none(off):
    right, analysis = measured({}), measured(off)
    for symbol in ("alpha_0", "alpha_max", "P_flat"):
        for one, other in zip(of(right, symbol, "angle-at-rest"), of(analysis, symbol, "angle-at-rest"), strict=True):
            assert abs(one.value - other.value) <= other.parts.combined
    fits = of(analysis, "alpha_b", "logistic-up")
    assert fits
    assert all(e.value is not None and e.parts.combined is None for e in fits)
    assert not [f for f in analysis.findings if f.level != "note"]


def test_a_pressure_below_none_is_a_zero_that_is_off():
    """Each trial begins without pressure, and 5 kPa less than none is more than the calibration allows."""
    right, off = measured({}), measured({"pressure": -5e3})
    for one, other in zip(of(right, "P_flat", "angle-at-rest"), of(off, "P_flat", "angle-at-rest"), strict=True):
        assert abs(one.value - other.value) <= other.parts.combined
    lost = of(off, "alpha_b", "logistic-up")
    assert lost
    assert all(e.withheld and "zero the gauge" in e.note for e in lost)
    assert any("zero the gauge" in f.text for f in off.findings if f.level == "doubt")


def test_an_angle_that_the_displacement_contradicts_is_wide_and_doubted():
    right, off = measured({}), measured({"angle": np.radians(2.0)})
    for symbol in ("alpha_0", "alpha_max"):
        for one, other in zip(of(right, symbol, "angle-at-rest"), of(off, symbol, "angle-at-rest"), strict=True):
            assert abs(one.value - other.value) <= other.parts.combined
    assert any("one of their zeros is off" in f.text for f in off.findings if f.level == "doubt")
    fits = [e for e in off.estimates if e.method == "logistic-up"]
    assert fits
    assert all(e.parts.combined is None for e in fits)


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
    """It looks like a drift in one hold: the gap was 3 half widths too wide; along the logarithm of time 2
    to 3.
    """
    analysis, right = measured({}, creep=share, times=times), arm.truth("clean", 0.0)
    for symbol in ("alpha_max", "alpha_H"):
        for e in of(analysis, symbol, "angle-at-rest"):
            low, high = right[symbol, "", e.at["tip_mass"]]
            if e.value is None:
                assert "not at rest" in e.note
            else:
                assert low - e.parts.combined <= e.value <= high + e.parts.combined
    fits = of(analysis, "alpha_b", "logistic-up")
    assert fits
    assert all(e.parts.combined is None for e in fits)


def drifting(drift, days=(0.0,), **other):
    """Angles of loads in turn whose sensor's zero moves by `drift` from the first trial of a day to its last [rad].

    `days`: by how much it is off on each [rad]; a later day begins later in its run. `other` as in `day_of`.
    """
    settings: dict[str, object] = {"preload": 50e3, "angle": "measured", "compare": "nothing"}
    known = {name: facts for name, facts in KNOWN.items() if name != "displacement"}
    runs = []
    for day, off in enumerate(days):
        trials = [replace(one, run=f"day {day}") for one in day_of(drift, off, 300.0 * day, **other)]
        runs.append(replace(as_run("arm-angle", trials, 50.0, settings, known), id=f"day {day}"))
    return reduction.reduce(runs)


def day_of(drift, off, late, repeats=4, loads=(0.0, 0.2), left=0.0, lag=0.0):
    """The trials of one day, which begins at `late` [s].

    `left`: where the load was not changed before a trial, the muscle is still emptying, with 1 s [rad]. The angle
    follows the pressure with `lag` [s].
    """
    made: list[TrialData] = []
    for load, number in ((load, number) for load in loads for number in range(repeats)):
        corners, levels = [0.0, 0.5], [0.0, 0.0]
        commands = []
        for phase, level in (("preload", 50e3), ("up", 150e3), ("up", 300e3), ("down", 150e3), ("down", 50e3)):
            commands.append(Command(corners[-1], "pressure", "ramp", level, levels[-1], phase, {"rate": 100e3}))
            corners += [corners[-1] + abs(level - levels[-1]) / 100e3 + 1e-9]
            corners += [corners[-1] + 3.0]
            levels += [level, level]
        t = np.arange(0, corners[-1], 0.02)
        P = np.interp(t, corners, levels)
        rng = np.random.default_rng(len(made) + int(late))
        begin, share = late + 60.0 * len(made), len(made) / (len(loads) * repeats - 1)
        followed = lagged(P, lag, 50.0) if lag else P
        angle = (3e-6 - 2e-6 * load) * followed + off + drift * share + rng.normal(0, 5e-4, len(t))
        angle += left * np.exp(-t) * (number > 0)
        channels = {"pressure": P + rng.normal(0, 300, len(t)), "angle": angle}
        commands = tuple(replace(one, t=begin + one.t) for one in commands)
        made.append(TrialData("a", len(made), {"tip_mass": load}, number, False, "finished", begin + t, channels,
                              np.zeros(len(t), dtype=np.uint16), commands, {}))  # fmt: skip
    return made


def test_a_zero_of_the_angle_that_drifts_from_trial_to_trial_is_held_and_said():
    """0.03 rad: the loads that were tested last were 2.3 half widths off."""
    analysis = drifting(0.03)
    for symbol, P in (("alpha_0", 50e3), ("alpha_max", 300e3)):
        values = of(analysis, symbol, "angle-at-rest")
        assert len(values) == 2
        for e in values:
            assert abs(e.value - (3e-6 - 2e-6 * e.at["tip_mass"]) * P) < e.parts.combined
    assert any("zero of its sensor drifts" in f.text for f in analysis.findings if f.level == "doubt")


def test_a_drift_within_each_of_two_days_is_held_and_said():
    analysis = drifting(0.03, days=(0.0, 3.5e-3))
    assert any("zero of its sensor drifts" in f.text for f in analysis.findings if f.level == "doubt")


@pytest.mark.parametrize("days", [(0.0,), (0.0, 3.5e-3), (0.0, 0.02)])
def test_an_angle_without_drift_has_none(days):
    """Another zero on another day is no drift from trial to trial."""
    analysis = drifting(0.0, days)
    assert not any("drifts" in f.text for f in analysis.findings)
    for e in of(analysis, "alpha_0", "angle-at-rest"):
        assert not any("drift" in line.name for line in e.budget)


def test_what_a_short_wait_leaves_in_the_muscle_is_no_drift():
    """The first trial of each load comes after the time that changing it takes, so each load seems to begin lower."""
    loads = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
    analysis = drifting(0.0, loads=loads, repeats=3, left=3e-3)
    assert not any("drifts" in f.text for f in analysis.findings)
    held = drifting(0.03, loads=loads, repeats=3, left=3e-3)
    assert any("zero of its sensor drifts" in f.text for f in held.findings)


def test_a_gap_of_nothing_is_given_with_what_the_end_of_a_hold_leaves_open():
    """Both ways are one; over the last fifth of a hold of 3 s the angle is still 0.05 % of its step away."""
    gaps = of(drifting(0.0, lag=0.36), "alpha_H", "angle-at-rest")
    assert len(gaps) == 2
    for e in gaps:
        assert e.value is not None, e.note
        assert abs(e.value) < e.parts.combined < 0.01
        assert "motion after the hold" in {line.name for line in e.budget}
