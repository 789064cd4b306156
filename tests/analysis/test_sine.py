"""Driven sines of plant 5.1 at 300 kPa against its own coefficients: K 6773, B_c 1680, B_r 2120, F_c 6 N."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from math import pi, sqrt
from typing import Any

import numpy as np
import pytest

from pmabench.kinds.sinusoidal_displacement.reduction import reduce
from pmabench.model.driven import Actuator, DrivenPlant
from pmabench.model.presets import preset
from pmabench.model.regulator import constant, sine
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import ChannelInfo, Flag, TrialData
from tests.analysis.loop_rig import as_run
from tests.analysis.sine_rig import Muscle51, value

K, B, F_C, F_CE = 6773.0, 1900.0, 6.0, 275.0
A = 0.005
FREQUENCIES = (0.1, 0.5, 1.0, 3.0)
BENCH = Muscle51(F_s=10.0, F_c=6.0, noise=(2e-6, 0.3, 500.0), lag=0.005)


def analysis_of(trials: list[TrialData], settings: dict[str, Any] | None = None, **info: Any) -> Analysis:
    return reduce([as_run("sinusoidal-displacement", trials, {"discard": 1, **(settings or {})}, **info)])


@cache
def ideal() -> Analysis:
    return analysis_of(Muscle51().trials())


@cache
def bench() -> Analysis:
    return analysis_of(BENCH.trials(repeats=3))


def number(analysis: Analysis, symbol: str, method: str, **at: float) -> float:
    found = value(analysis, symbol, method, at).value
    assert found is not None
    return float(found)


def test_ideal_stiffness_at_every_frequency() -> None:
    assert number(ideal(), "K", "sine-harmonic") == pytest.approx(K, rel=1e-3)
    for frequency in FREQUENCIES:
        assert number(ideal(), "K", "sine-harmonic", frequency=frequency) == pytest.approx(K, rel=5e-3)


def test_ideal_damping_is_the_mean_of_both_directions() -> None:
    assert number(ideal(), "B", "sine-harmonic") == pytest.approx(B, rel=2e-3)
    assert number(ideal(), "B", "loop-width") == pytest.approx(B, rel=2e-3)
    assert number(ideal(), "F_c", "sine-harmonic") == pytest.approx(0.0, abs=0.01)
    assert value(ideal(), "B", "sine-harmonic").note == "(B_c + B_r)/2"


def test_ideal_loops_enclose_what_damping_loses() -> None:
    for frequency in FREQUENCIES:
        omega = 2 * pi * frequency
        assert number(ideal(), "W", "loop-width", frequency=frequency) == pytest.approx(pi * B * omega * A**2, rel=2e-3)
        assert number(ideal(), "H", "loop-width", frequency=frequency) == pytest.approx(2 * B * omega * A, rel=2e-3)
        phase = np.arctan2(B * omega, K)
        assert number(ideal(), "phi", "sine-harmonic", frequency=frequency) == pytest.approx(phase, rel=1e-3)


def test_mean_force_shows_f_ce_though_friction_and_two_dampings_move_it() -> None:
    """At 3 Hz B_r - B_c of 440 N.s/m shifts the mean force by 440 omega A / pi = 13 N: the line over speed ends that."""
    assert number(ideal(), "F", "sine-mean") == pytest.approx(F_CE - K * 0.01, rel=1e-3)
    found = value(analysis_of(BENCH.trials(repeats=2, mean=0.004)), "F_ce", "sine-mean")
    assert found.value == pytest.approx(F_CE, rel=5e-3)
    assert found.ci95 is not None
    assert found.ci95[0] < F_CE < found.ci95[1]
    alone = value(analysis_of([BENCH.trial(i, 3.0, 31, mean=0.004) for i in range(3)]), "F_ce", "sine-mean")
    assert 5.0 < alone.value - F_CE < 440 * 6 * pi * A / pi
    assert alone.parts.method > B * 6 * pi * A / pi, "and what a bent curve may hide behind unlike dampings"
    assert "one frequency only" in alone.note


@pytest.mark.parametrize("frequencies", [(0.1,), (0.1, 0.5)])
def test_one_trial_a_frequency_gives_f_ce_with_an_interval_by_its_cycles(frequencies: tuple[float, ...]) -> None:
    trials = [BENCH.trial(i, f, 5, mean=0.004) for i, f in enumerate(frequencies)]
    for symbol, truth in (("F_ce", F_CE), ("F", F_CE - K * 0.004)):
        found = value(analysis_of(trials), symbol, "sine-mean")
        assert found.parts.repeats > 0
        assert found.ci95[0] < truth < found.ci95[1]
        assert "scatter of its cycles" in found.note


def test_one_trial_of_one_cycle_gives_no_force() -> None:
    found = analysis_of([BENCH.trial(0, 0.1, 2, mean=0.004)])
    for symbol in ("F_ce", "F"):
        empty = value(found, symbol, "sine-mean")
        assert empty.value is None
        assert empty.note == "no repeats part: one trial of one cycle"


def test_f_ce_is_reported_for_the_set_pressure_where_its_slope_is_known() -> None:
    """The regulator stands 2 kPa low at both pressures, 1.01 N/kPa."""
    trials = []
    for P in (3e5, 4e5):
        low = Muscle51().trials(pressure=P - 2e3, mean=0.004)
        trials += [replace(trial, point={**trial.point, "pressure": P}) for trial in low]
    both = analysis_of(trials)
    for P, truth in ((3e5, F_CE), (4e5, F_CE + 101.0)):
        assert number(both, "F_ce", "sine-mean", pressure=P) == pytest.approx(truth, rel=1e-3)
    single = value(analysis_of(trials[: len(trials) // 2]), "F_ce", "sine-mean")
    assert single.value == pytest.approx(F_CE - 2.02, rel=1e-3)
    assert "as at the measured pressure" in single.note


def test_bench_damping_and_friction() -> None:
    assert number(bench(), "K", "sine-harmonic") == pytest.approx(K, rel=5e-3)
    for method in ("sine-harmonic", "loop-width"):
        assert number(bench(), "B", method) == pytest.approx(B, rel=0.01)
        assert number(bench(), "F_c", method) == pytest.approx(F_C, rel=0.03)
    assert number(bench(), "H", "loop-width", frequency=0.0) == pytest.approx(2 * F_C, abs=0.2)


def test_bench_intervals_hold_the_truth_and_name_their_parts() -> None:
    for symbol, method, truth in (
        ("K", "sine-harmonic", K),
        ("B", "sine-harmonic", B),
        ("B", "loop-width", B),
        ("F_c", "sine-harmonic", F_C),
        ("F_c", "loop-width", F_C),
    ):
        found = value(bench(), symbol, method)
        low, high = found.ci95
        assert low < truth < high, (symbol, method)
        assert high - low < 0.1 * truth
        assert found.n == 12
        assert found.parts.repeats is not None
        assert found.parts.method is not None
        assert found.corrected


def test_friction_below_1_mm_per_s_bends_the_harmonic_line_and_is_owned_up_to() -> None:
    harmonic, width = value(bench(), "F_c", "sine-harmonic"), value(bench(), "F_c", "loop-width")
    assert harmonic.parts.method >= abs(harmonic.value - width.value) - 1e-9


def test_calibration_and_time_skew_widen_the_interval() -> None:
    found = analysis_of(Muscle51().trials(), {"time_skew": 0.002}, gain_uncertainty=0.01)
    parts = value(found, "B", "sine-harmonic").parts
    assert parts.calibration == pytest.approx(sqrt(2) * 0.01 * B, rel=1e-3)
    assert parts.skew == pytest.approx(0.002 * K, rel=0.12), "delta K, and a part of second order"
    assert value(found, "F_c", "sine-harmonic").parts.skew < 0.01
    assert value(found, "phi", "sine-harmonic", {"frequency": 3.0}).parts.skew == pytest.approx(2 * pi * 3.0 * 0.002)
    assert "2 ms apart" in found.findings[0].text
    late = analysis_of(Muscle51(skew=0.002).trials(), {"time_skew": 0.002})
    low, high = value(late, "B", "sine-harmonic").ci95
    assert low < B < high
    assert number(late, "B", "sine-harmonic") == pytest.approx(B - 0.002 * K, rel=2e-3)


def test_sensor_lags_are_taken_off() -> None:
    run = as_run("sinusoidal-displacement", Muscle51().trials(), {"discard": 1})
    plain = reduce([run])
    channels = dict(run.channels)
    channels["force"] = ChannelInfo("force", "force", "N", 1.0, 0.0, -1e9, 1e9, sensor_lag=0.002)
    lagging = reduce([replace(run, channels=channels)])
    G = -K - 1j * 2 * pi * 3.0 * B
    undone = G * (1 + 2j * pi * 3.0 * 0.002)
    assert number(plain, "K", "sine-harmonic", frequency=3.0) == pytest.approx(-G.real, rel=1e-3)
    assert number(lagging, "K", "sine-harmonic", frequency=3.0) == pytest.approx(-undone.real, rel=1e-3)


def test_pressure_that_swings_along_is_taken_off() -> None:
    moved = Muscle51(drag=-1e6, noise=(0.0, 0.0, 10.0))
    trials = moved.trials() + [replace(t, index=10 + i) for i, t in enumerate(moved.trials(pressure=4e5))]
    for i, trial in enumerate(trials[4:]):
        point = {**trial.point, "pressure": 4e5}
        trials[4 + i] = replace(trial, point=point)
    found = analysis_of(trials)
    assert number(found, "K", "sine-harmonic", pressure=3e5) == pytest.approx(K, rel=5e-3)
    alone = analysis_of(moved.trials())
    assert "give force_per_pressure" in alone.findings[0].text
    assert number(alone, "K", "sine-harmonic") == pytest.approx(K + 1.01e-3 * 1e6, rel=5e-3)
    reported = reduce([as_run("sinusoidal-displacement", moved.trials())], {"force_per_pressure": 1.01e-3})
    assert number(reported, "K", "sine-harmonic") == pytest.approx(K, rel=5e-3)


def test_what_cannot_be_used_is_dropped_with_its_reason() -> None:
    good = Muscle51().trials()
    slack_flags = good[1].flags.copy()
    slack_flags[3000:3040] = Flag.SLACK
    gap_flags = good[2].flags.copy()
    gap_flags[::20] = Flag.GAP
    weak = Muscle51(F_ce=200.0).trial(3, 3.0, 31)
    weak = replace(weak, channels={**weak.channels, "force": np.maximum(weak.channels["force"], 0.0)})
    trials = [
        good[0],
        replace(good[1], flags=slack_flags),
        replace(good[2], flags=gap_flags),
        weak,
        replace(good[3], index=4, status="excluded"),
        replace(good[3], index=5, channels={"force": good[3].channels["force"]}),
        Muscle51().trial(6, 0.1, 1),
    ]
    reasons = {d.trial: d.reason for d in analysis_of(trials).dropped}
    assert reasons == {
        "r1/2": "the specimen was slack: force down to 164 N",
        "r1/3": "5% of the samples are flagged",
        "r1/4": "the specimen was slack: force down to 0 N",
        "r1/5": "the trial is excluded",
        "r1/6": "displacement not recorded",
        "r1/7": "it holds no whole cycle beyond those left out",
    }


def test_one_frequency_cannot_show_damping_from_friction() -> None:
    found = analysis_of([Muscle51().trial(0, 1.0, 11)])
    assert value(found, "B", "sine-harmonic").value is None
    assert "one frequency only" in value(found, "F_c", "sine-harmonic").note
    assert number(found, "K", "sine-harmonic") == pytest.approx(K, rel=1e-3)
    assert json.dumps(found.to_dict(), allow_nan=False)
    assert any("one frequency only" in finding.text for finding in found.findings)
    (loop,) = [trace for trace in found.traces if trace.figure == "loop"]
    assert "model" not in loop.columns, "a line without damping is none of this muscle"
    assert "model" in next(trace for trace in ideal().traces if trace.figure == "loop").columns


def test_a_wrong_sign_and_a_bent_sine_are_reported() -> None:
    swapped = [
        replace(t, channels={**t.channels, "displacement": 0.02 - t.channels["displacement"]})
        for t in Muscle51().trials()
    ]
    assert "a sign is wrong" in analysis_of(swapped).findings[0].text
    bent = Muscle51().trial(0, 1.0, 11)
    x = bent.channels["displacement"] + 5e-4 * np.sin(4 * pi * (bent.t - bent.t[0]))
    said = analysis_of([replace(bent, channels={**bent.channels, "displacement": x})]).findings
    assert "10% of the measured displacement is no sine" in said[0].text


def test_discarded_cycles_and_the_command_bound_the_window() -> None:
    trial = BENCH.trial(0, 1.0, 11)
    longer = replace(trial, t=np.concatenate([trial.t[0] - 1.0 + np.arange(500) / 500.0, trial.t]),
                     flags=np.zeros(len(trial.t) + 500, dtype=np.uint16),
                     channels={k: np.concatenate([np.full(500, v[0]), v]) for k, v in trial.channels.items()})  # fmt: skip
    plain, padded = analysis_of([trial]), analysis_of([longer])
    assert number(plain, "K", "sine-harmonic") == pytest.approx(number(padded, "K", "sine-harmonic"), rel=1e-9)
    assert plain.facts["lines"][0]["cycles"] == [10]
    assert analysis_of([trial], {"discard": 3}).facts["lines"][0]["cycles"] == [8]


def test_traces_and_json() -> None:
    loops = [trace for trace in bench().traces if trace.figure == "loop"]
    (bode,) = [trace for trace in bench().traces if trace.figure == "bode"]
    assert [trace.marks["frequency"] for trace in loops] == list(FREQUENCIES)
    for trace in bench().traces:
        assert set(trace.columns) == set(trace.quantities)
        assert len({len(column) for column in trace.columns.values()}) == 1
        assert len(next(iter(trace.columns.values()))) <= 1500
    for trace in loops:
        left = trace.columns["force"] - trace.columns["model"]
        assert np.sqrt(np.mean(left**2)) < 0.13 * np.ptp(trace.columns["force"])
    assert bode.columns["gain"] == pytest.approx(np.hypot(K, bode.columns["loss"] / A), rel=0.01)
    assert json.loads(json.dumps(bench().to_dict(), allow_nan=False))["facts"]["trials"] == 12


@pytest.mark.parametrize(
    ("kind", "B_within", "F_c", "width_within"), [("ideal", 0.02, 0.0, 0.1), ("bench", 0.05, 6.0, 1.0)]
)
def test_the_projects_own_driven_plant(kind: str, B_within: float, F_c: float, width_within: float) -> None:
    setup = preset("paper0", kind)
    plant = DrivenPlant(setup.muscle, setup.regulator, Actuator(lag=setup.follow_lag), pressure=3e5)
    plant.move(constant(0.0, 0.01))
    plant.advance(2.0)
    rng = np.random.default_rng(5)
    trials = []
    for index, (frequency, cycles) in enumerate(((0.1, 4), (0.5, 6), (1.0, 11), (3.0, 31)) * 2):
        start = round(plant.time, 3)
        plant.move(sine(start, 0.01, A, frequency, cycles))
        t = start + np.arange(int(cycles / frequency * 500)) / 500.0
        motion = plant.advance(start + cycles / frequency, t)
        plant.advance(plant.time + 1.0)
        noise = [rng.standard_normal(len(t)) for _ in range(3)]
        template = Muscle51().trial(index, frequency, cycles)
        trials.append(
            replace(
                template,
                t=t,
                commands=(replace(template.commands[0], t=start),),
                channels={
                    "displacement": motion.x + setup.noise.displacement * noise[0],
                    "force": motion.F + setup.noise.force * noise[1],
                    "pressure": motion.P + setup.noise.pressure * noise[2],
                },
            )
        )
    found = analysis_of(trials)
    assert not found.dropped
    stiffness = float(setup.muscle.K(3e5))
    damping = float(setup.muscle.B_c(3e5) + setup.muscle.B_r(3e5)) / 2
    assert (stiffness, damping) == pytest.approx((6773.0, 1900.0))
    assert number(found, "K", "sine-harmonic") == pytest.approx(stiffness, rel=5e-3)
    for method in ("sine-harmonic", "loop-width"):
        assert number(found, "B", method) == pytest.approx(damping, rel=B_within)
        assert number(found, "F_c", method) == pytest.approx(F_c, abs=0.1 * 6.0)
    assert number(found, "H", "loop-width", frequency=0.0) == pytest.approx(2 * F_c, abs=width_within)
    for frequency in FREQUENCIES:
        lost = pi * damping * 2 * pi * frequency * A**2 + 4 * F_c * A
        assert number(found, "W", "loop-width", frequency=frequency) == pytest.approx(lost, rel=0.01)


@pytest.mark.parametrize("share", [1.06, 0.97])
@pytest.mark.parametrize("mean", [0.004, 0.02])
def test_a_pressure_off_its_command_is_in_every_interval_and_said(share: float, mean: float) -> None:
    """Values at 300 kPa were given for the command: K 2 % off within 0.3 %; F at 20 mm changes as much as F_ce."""
    set_ = 3e5 / share
    trials = [replace(t, point={**t.point, "pressure": set_}) for t in BENCH.trials(repeats=2, mean=mean)]
    analysis, kPa = analysis_of(trials), set_ / 1e3
    closed = {
        ("K", "sine-harmonic"): 5600 + kPa + 9.7e-3 * kPa**2,
        ("B", "sine-harmonic"): 1150 + 2.5 * kPa,
        ("F", "sine-mean"): 1.08 * kPa - 49 - (5.6 + kPa * 1e-3 + 9.7e-6 * kPa**2) * 1e3 * mean,
    }
    for (symbol, method), truth in closed.items():
        (e,) = [e for e in analysis.estimates if (e.symbol, e.method) == (symbol, method) and "frequency" not in e.at]
        assert e.ci95 is not None
        assert e.ci95[0] <= truth <= e.ci95[1], (symbol, e.value, e.ci95, truth)
    assert any("the regulator or the gauge is off" in finding.text for finding in analysis.findings)
