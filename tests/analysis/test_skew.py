"""Channels of devices with clocks of their own: 20 ms and 50 ppm are found, and what is left enters the intervals (R6, R11)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import atan, pi, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pmabench.kinds.contraction_relaxation import reduction as contraction
from pmabench.kinds.sinusoidal_displacement import reduction as sine
from pmabench.kinds.ultimate_gain.reduction import reduce as reduce_gain
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import ChannelInfo, ClockInfo, RunData, TrialData
from tests.analysis.loop_rig import as_run
from tests.analysis.simulate import contraction_run, rig
from tests.analysis.sine_rig import Muscle51, value
from tests.analysis.test_ultimate_gain import clean
from tests.analysis.two_clocks import DRIFT, OFFSET, record

K, B = 6773.0, 1900.0
STIFF = Muscle51(B_c=0.1 * K / (2 * pi * 3.0), B_r=0.1 * K / (2 * pi * 3.0))
"""tan(phi) = 0.1 at 3 Hz."""


def sines(muscle: Muscle51 = Muscle51()) -> list[TrialData]:  # noqa: B008  (a frozen record)
    return muscle.trials()


def of(analysis: Analysis, symbol: str, method: str, **at: float) -> Estimate:
    found: Estimate = value(analysis, symbol, method, at)
    return found


def with_clocks(run: RunData, second: str, uncertainty: float) -> RunData:
    """The run had `second` been recorded by another device whose clock is known so well [s]."""
    channels = {name: replace(info, stream="cell" if name == second else "daq") for name, info in run.channels.items()}
    clocks = {"daq": ClockInfo(), "cell": ClockInfo(uncertainty=uncertainty, how="host arrivals")}
    return replace(run, channels=channels, clocks=clocks)


def test_a_clock_that_is_off_by_20_ms_and_50_ppm_is_found_and_its_rest_is_in_the_interval(tmp_path: Path) -> None:
    run = record(tmp_path, "sinusoidal-displacement", sines(), ["force"])
    clock = run.clocks["cell"]
    assert clock.drift == pytest.approx(DRIFT, abs=5e-6)
    middle = clock.reference_ns / 1e9
    assert abs(clock.at - ((1 + DRIFT) * middle + OFFSET)) <= clock.uncertainty < 2e-3
    found = sine.reduce([run])
    for method in ("sine-harmonic", "loop-width"):
        e = of(found, "B", method)
        assert e.parts.skew == pytest.approx(run.skew("displacement", "force") * K, rel=0.15)
        assert e.ci95 is not None
        assert e.ci95[0] < B < e.ci95[1]
        assert e.ci95[1] - e.ci95[0] < 0.05 * B
    assert of(found, "K", "sine-harmonic").value == pytest.approx(K, rel=1e-3)


def test_2_ms_at_3_hz_and_a_tangent_of_a_tenth_are_38_percent_and_refused() -> None:
    """omega delta / tan(phi) = 0.377."""
    true = as_run("sinusoidal-displacement", sines(STIFF))
    late = as_run("sinusoidal-displacement", sines(replace(STIFF, skew=0.002)))
    off = of(sine.reduce([late]), "B", "sine-harmonic").value
    assert off is not None
    assert off / STIFF.B_c - 1 == pytest.approx(-0.377, abs=0.02)
    for run in (true, late):
        found = sine.reduce([with_clocks(run, "force", 0.002)])
        for method in ("sine-harmonic", "loop-width"):
            e = of(found, "B", method)
            assert e.value is None
            assert "displacement and force may be 2 ms apart" in e.note
        phase = of(found, "phi", "sine-harmonic", frequency=3.0)
        assert phase.value is None
        K_found = of(found, "K", "sine-harmonic")
        assert K_found.ci95 is not None
        assert K_found.ci95[0] < K < K_found.ci95[1]
        assert any(f.level == "doubt" and "withheld: displacement and force" in f.text for f in found.findings)


@pytest.mark.parametrize("skew", [-0.3e-3, 0.3e-3])
def test_what_can_be_borne_widens_the_interval_and_holds_the_truth(skew: float) -> None:
    """0.3 ms are 5.7 % of B: told, with that in the interval and beside it."""
    run = as_run("sinusoidal-displacement", sines(replace(STIFF, skew=skew)))
    e = of(sine.reduce([with_clocks(run, "force", 0.3e-3)]), "B", "sine-harmonic")
    assert e.parts.skew == pytest.approx(0.0565 * STIFF.B_c, rel=0.1)
    assert e.ci95 is not None
    assert e.ci95[0] < STIFF.B_c < e.ci95[1]
    blind = of(sine.reduce([run], {"time_skew": 1e-7}), "B", "sine-harmonic")
    assert blind.ci95 is not None
    assert not blind.ci95[0] < STIFF.B_c < blind.ci95[1]


@pytest.mark.parametrize("late", [-0.004, 0.004])
def test_a_filter_that_nobody_declared_is_in_the_interval(late: float) -> None:
    """Up to 5 ms; B is off by K times that, or by what undoing them changes where that is more: exact for a delay."""
    omega = 2 * pi * np.array([0.1, 0.5, 1.0, 3.0])

    def by(delay: float) -> float:
        return float(np.polyfit(omega, B * omega * np.cos(omega * delay) - K * np.sin(omega * delay), 1)[0])

    off = max(0.005 * K, abs(by(late - 0.005 * np.sign(late)) - by(late)))
    e = of(sine.reduce([as_run("sinusoidal-displacement", sines(Muscle51(skew=late)))]), "B", "sine-harmonic")
    assert e.value is not None
    assert e.parts.combined is not None
    assert abs(e.value - 0.5 * (1680.0 + 2120.0)) < e.parts.combined
    assert e.parts.combined == pytest.approx(off, rel=0.2)


def test_one_device_has_no_skew_and_its_own_clock_changes_nothing() -> None:
    run = as_run("sinusoidal-displacement", sines())
    channels = {name: replace(info, stream="daq") for name, info in run.channels.items()}
    own = replace(run, channels=channels, clocks={"daq": ClockInfo(uncertainty=0.005, how="host arrivals")})
    assert sine.reduce([own]).to_dict() == sine.reduce([run]).to_dict()


@pytest.mark.parametrize(
    ("daq", "cell", "doubted"),
    [
        (ClockInfo(), ClockInfo(), True),
        (ClockInfo(), ClockInfo(uncertainty=1e-4, how="clock event"), True),
        (ClockInfo(uncertainty=1e-4, how="host arrivals"), ClockInfo(uncertainty=1e-14, how="host arrivals"), True),
        (ClockInfo(uncertainty=1e-4, how="host arrivals"), ClockInfo(uncertainty=1e-4, how="host arrivals"), False),
    ],
)
def test_times_that_nothing_bounds_are_reported(daq: ClockInfo, cell: ClockInfo, doubted: bool) -> None:
    """Of two devices, one at least is only said to keep the run's time, or stamps samples as they come in."""
    run = with_clocks(as_run("sinusoidal-displacement", sines()[1::2]), "force", 1e-4)
    found = sine.reduce([replace(run, clocks={"daq": daq, "cell": cell})])
    said = [f.text for f in found.findings if f.level == "doubt" and "nothing bounds the time" in f.text]
    assert [text.partition(" come")[0] for text in said] == ["displacement and force"] * doubted


@pytest.mark.parametrize("name", ["displacement", "force"])
def test_a_first_order_sensor_is_taken_off_phase_area_and_width_alike(name: str) -> None:
    """The exact answer of a first-order lag to the sine; without friction all is in the first harmonic."""
    lag, trials = 0.004, []
    for trial in sines():
        omega = 2 * pi * trial.point["frequency"]
        t = trial.t - trial.t[0]
        G = 1 / (1 + 1j * omega * lag)
        x = np.exp(1j * omega * t) * -1j * trial.point["amplitude"]
        F = -(K + 1j * omega * B) * x
        clean = {"displacement": (x, trial.point["mean"]), "force": (F, 300.0)}
        channels = {key: c + np.real(y * (G if key == name else 1)) for key, (y, c) in clean.items()}
        trials.append(replace(trial, channels={**trial.channels, **channels}))
    run = as_run("sinusoidal-displacement", trials)
    info = ChannelInfo(name, "", "", 1.0, 0.0, -1e9, 1e9, sensor_lag=lag)
    found = sine.reduce([replace(run, channels={**run.channels, name: info})])
    for method in ("sine-harmonic", "loop-width"):
        assert of(found, "B", method).value == pytest.approx(B, rel=1e-3)
    at = {"frequency": 3.0}
    omega, A = 2 * pi * 3.0, 0.005
    assert of(found, "phi", "sine-harmonic", **at).value == pytest.approx(atan(B * omega / K), rel=1e-3)
    assert of(found, "W", "loop-width", **at).value == pytest.approx(pi * B * omega * A**2, rel=2e-3)
    ignored = of(sine.reduce([run]), "B", "loop-width").value
    assert ignored is not None
    assert abs(ignored / B - 1) > 0.005
    assert abs(omega * lag / tan(atan(B * omega / K))) > 0.01


LOADS = (107.91, 206.01, 304.11)
CELLS = [(load, P) for P in (300e3, 400e3) for load in LOADS if load < 1.01e-3 * P]


@cache
def strokes() -> RunData:
    return contraction_run(rig(), CELLS, repeats=2)


def delayed(run: RunData, name: str, first: float, last: float) -> RunData:
    """The run with one channel stamped too late: `first` [s] in the first trial, `last` [s] in the last one."""
    begins = np.array([trial.t[0] for trial in run.trials])
    course = np.interp(begins, begins[[0, -1]], [first, last]) if len(begins) > 1 else [first]
    trials = [
        replace(trial, channels={**trial.channels, name: np.interp(trial.t - by, trial.t, trial.channels[name])})
        for trial, by in zip(run.trials, course, strict=True)
    ]
    return replace(run, trials=tuple(trials))


def reported(analysis: Analysis, method: str = "measured-pressure") -> dict[tuple[Any, ...], Estimate]:
    return {(e.symbol, e.coordinate, *sorted(e.at.items())): e for e in analysis.estimates if e.method == method}


def test_step_fits_have_the_skew_of_the_pressure_in_every_interval() -> None:
    """What a pressure that is 20 ms late or early, or drifts from one to the other, does is what the part says."""
    plain = reported(contraction.reduce([strokes()]))
    off = [
        reported(contraction.reduce([with_clocks(delayed(strokes(), "pressure", first, last), "pressure", 0.02)]))
        for first in (0.02, -0.02)
        for last in (0.02, -0.02)
    ]
    found = reported(contraction.reduce([with_clocks(strokes(), "pressure", 0.02)]))
    seen = 0
    for key, e in found.items():
        if e.value is None or plain[key].value is None:
            continue
        change = max(abs((one[key].value or 0.0) - (plain[key].value or 0.0)) for one in off)
        repeats = e.parts.repeats or 0.0
        assert e.parts.skew >= 0.8 * change - repeats, key
        assert e.value == plain[key].value
        if change > 3 * repeats:
            assert e.parts.skew == pytest.approx(change, rel=0.4), key
            seen += 1
    assert seen >= 3, "the skew is the largest part of some"
    assert all(e.parts.skew == 0 for e in plain.values())


def test_dead_times_have_the_skew_itself() -> None:
    found = reported(contraction.reduce([with_clocks(strokes(), "pressure", 0.002)]), "onset")
    for key, e in found.items():
        assert e.parts.skew == (0.0 if key[1] == "command-to-motion" else 0.002), key
    late = reported(contraction.reduce([with_clocks(strokes(), "pressure", 0.2)]), "onset")
    for key, e in late.items():
        assert (e.value is None) == (key[1] != "command-to-motion"), key
        assert e.value is not None or "pressure" in e.note


def test_a_skew_of_100_ms_leaves_no_damping_where_the_pressure_changes() -> None:
    found = contraction.reduce([with_clocks(strokes(), "pressure", 0.1)])
    for symbol in ("B_c", "B_r"):
        e = reported(found)[symbol, "", ("pressure", 300e3)]
        assert e.value is None
        assert "may be 100 ms apart" in e.note
    assert any("withheld: pressure, displacement and force may be 100 ms apart" in f.text for f in found.findings)


def test_a_run_of_steps_on_two_clocks_gives_what_one_clock_gives(tmp_path: Path) -> None:
    run = record(tmp_path, "contraction-relaxation", strokes().trials, ["pressure"])
    plain, found = reported(contraction.reduce([strokes()])), reported(contraction.reduce([run]))
    compared = 0
    for key, e in found.items():
        if e.value is not None and plain[key].value is not None:
            half = np.hypot(e.parts.skew, 0.5 * (e.parts.repeats or 0.0))
            assert abs(e.value - (plain[key].value or 0.0)) <= half, key
            compared += 1
    assert compared >= 5


def test_a_rising_gain_has_no_clock() -> None:
    trial, K_u, _ = clean()
    apart = reduce_gain([with_clocks(as_run("ultimate-gain", [trial]), "pressure", 0.05)])
    gain = next(e for e in apart.estimates if e.symbol == "K_u")
    assert gain.value == pytest.approx(K_u, rel=0.01), "the gain is the law's own"
