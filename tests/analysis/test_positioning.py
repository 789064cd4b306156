"""Held positions: measures against closed forms, limit cycles of an independent plant against the papers' numbers."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import cache
from math import exp, pi, sqrt
from typing import Any

import numpy as np
import pytest

from pmabench.analysis.shared.signals import Cycle, cycle_of, respond
from pmabench.engine.laws.position_loop import PositionLoop
from pmabench.kinds.positioning.reduction import reduce
from pmabench.model.overrides import Overrides
from pmabench.model.presets import Described, preset
from pmabench.report.document.tables import cell
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import Array, TrialData
from tests.analysis.judged_forms import placed_of
from tests.analysis.loop_rig import TS, Plant51, as_run, as_trial
from tests.judge import placed

T = np.arange(0, 40, TS)
WINDOW = (10.0, 40.0)


# -- one response ------------------------------------------------------------------------------------------------


def second_order(zeta: float, omega: float, t: Array) -> Array:
    """Step response of a second-order lag [1]."""
    fast = omega * sqrt(1 - zeta**2)
    return 1 - np.exp(-zeta * omega * t) * (np.cos(fast * t) + zeta / sqrt(1 - zeta**2) * np.sin(fast * t))


@pytest.mark.parametrize("zeta", [0.2, 0.5, 0.7])
def test_overshoot_and_settling_of_a_second_order_lag(zeta: float) -> None:
    """Overshoot exp(-pi zeta / sqrt(1 - zeta^2)); settled no later than ln(1/(0.02 sqrt(1 - zeta^2))) / (zeta omega)."""
    omega = 4.0
    seen = respond(T, 0.03 * second_order(zeta, omega, T), 0.03, WINDOW, 0.02)
    assert seen.overshoot == pytest.approx(exp(-pi * zeta / sqrt(1 - zeta**2)), rel=2e-3)
    latest = -np.log(0.02 * sqrt(1 - zeta**2)) / (zeta * omega)
    assert seen.settling is not None
    assert latest - pi / omega / sqrt(1 - zeta**2) < seen.settling <= latest + TS
    assert seen.cycle is None


@pytest.mark.parametrize("origin", [0.0, 0.002])
def test_rise_time_and_integral_of_a_first_order_lag(origin: float) -> None:
    """10 to 90 % takes tau ln 9, the integral of the error is the step times tau, 2 % is reached after tau ln 50."""
    tau, end = 0.4, 0.03
    x = end - (end - origin) * np.exp(-T / tau)
    seen = respond(T, x, end, WINDOW, 0.02, origin=origin)
    assert seen.rise == pytest.approx(tau * np.log(9), abs=2 * TS)
    assert seen.IAE == pytest.approx((end - origin) * tau, rel=1e-3)
    assert seen.settling == pytest.approx(tau * np.log(50), abs=2 * TS)
    assert seen.overshoot == pytest.approx(0.0, abs=1e-9)
    assert seen.cycle is None


def test_steady_state_error_is_the_mean_in_the_window_with_its_sign() -> None:
    noise = np.random.default_rng(1).normal(0, 2e-6, len(T))
    seen = respond(T, 0.0297 + noise, 0.03, WINDOW, 0.005)
    assert seen.error == pytest.approx(0.3e-3, abs=0.1e-6)
    assert seen.settling is None
    assert seen.rise is not None


def test_noise_makes_neither_overshoot_nor_cycle() -> None:
    noise = np.random.default_rng(2).normal(0, 2e-6, len(T))
    seen = respond(T, 0.03 * (1 - np.exp(-T / 0.3)) + noise, 0.03, WINDOW, 0.02)
    assert seen.overshoot < 1e-4
    assert seen.cycle is None
    assert seen.wander < seen.smallest


def stick_slip(size: float, period: float, t: Array) -> Array:
    """Stands still for half a period, jumps within 50 ms."""
    return size * (np.clip(np.abs(((t / period) % 1.0) - 0.5) * period / 0.05 - 0.25 * period / 0.05 + 0.5, 0, 1) - 0.5)


def test_a_jumping_cycle_has_its_size_and_period_and_sticks() -> None:
    noise = np.random.default_rng(3).normal(0, 2e-6, len(T))
    found = cycle_of(T, 0.03 + stick_slip(0.4e-3, 8.1, T) + noise, 24e-6)
    assert found is not None
    assert found.size == pytest.approx(0.4e-3, rel=0.02)
    assert found.period == pytest.approx(8.1, rel=2e-3)
    assert found.count == 4
    assert found.sticks


@pytest.mark.parametrize("period", [0.35, 2.0, 8.0])
def test_a_sine_is_a_cycle_that_does_not_stick(period: float) -> None:
    noise = np.random.default_rng(4).normal(0, 2e-6, len(T))
    found = cycle_of(T, 0.03 + 0.2e-3 * np.sin(2 * pi * T / period) + noise, 24e-6)
    assert found is not None
    assert found.size == pytest.approx(0.4e-3, rel=0.03)
    assert found.period == pytest.approx(period, rel=5e-3)
    assert not found.sticks


def test_what_dies_out_creeps_or_is_too_slow_is_no_cycle() -> None:
    dying = [1e-3 * np.exp(-T / tau) * np.sin(2 * pi * T) for tau in (3, 33)]
    for x in (*dying, 1e-4 * T / 40, 1e-3 * np.exp(-T / 20), 2e-4 * np.sin(2 * pi * T / 25)):
        assert cycle_of(T, 0.03 + x, 24e-6) is None


def test_what_cannot_be_measured_is_said() -> None:
    with pytest.raises(ValueError, match="samples"):
        respond(T[:100], np.zeros(100), 0.03, WINDOW, 0.02)
    with pytest.raises(ValueError, match="beyond the set-point"):
        respond(T, np.full(len(T), 0.03), 0.01, WINDOW, 0.02, origin=0.03)


# -- limit cycles (papers digest 5.4) ----------------------------------------------------------------------------


@cache
def held(K_p: float, T_i: float, setpoint: float, friction: bool = True, noise: bool = True) -> TrialData:
    """A PI loop around the plant of tests/analysis/loop_rig, which has no mass, from rest."""
    F_s, F_c = (10.0, 6.0) if friction else (0.0, 0.0)
    plant = Plant51(same_B=False, F_s=F_s, F_c=F_c, noise=(2e-6, 500.0) if noise else (0.0, 0.0))
    plant.queue = deque([0.0] * 20)
    hold = 60.0
    law = PositionLoop(setpoint=setpoint, duration=hold, K_p=K_p * 1e6, T_i=T_i, low=0.0, high=6e5)
    rows, command = [], 0.0
    for k in range(-100, 10**9):
        t, values = 5.0 + k * TS, plant.read()
        command = law.update(t, values) if k >= 0 else 0.0
        rows.append((t, values["displacement"], values["pressure"], command))
        if law.done:
            break
        plant.step(command)
    t, x, P, u = np.array(rows).T
    samples = {"t": t, "displacement": x, "pressure": P, "pressure_command": u}
    return as_trial(samples, {"position": law.result()}, 0, setpoint=setpoint, load=0.0, mass=0.5)


def reduced(*trials: TrialData, **settings: Any) -> Analysis:
    return reduce([as_run("positioning", trials, {"window": [20.0, 60.0], "band": 0.02, **settings})])


def value(analysis: Analysis, symbol: str, method: str = "closed-loop") -> Estimate:
    return next(e for e in analysis.estimates if (e.symbol, e.method) == (symbol, method))


def number(estimate: Estimate) -> float:
    assert estimate.value is not None
    return estimate.value


def test_stick_slip_at_30_mm_cycles_in_8_seconds() -> None:
    """K_p 7.1 kPa/mm, T_i 0.3 s: 8.1 s, 0.41 mm peak to peak."""
    analysis = reduced(held(7.1, 0.3, 0.03))
    assert value(analysis, "T_c").value == pytest.approx(8.1, rel=0.03)
    assert value(analysis, "x_pp").value == pytest.approx(0.41e-3, rel=0.08)
    (doubt,) = [f.text for f in analysis.findings if f.level == "doubt"]
    assert doubt.startswith("stick-slip limit cycle at 30 mm: 0.3")
    assert "period 8.1" in doubt


@pytest.mark.parametrize(("setpoint", "size", "period"), [(0.010, 0.33e-3, 1.7), (0.030, 0.30e-3, 2.4)])
def test_the_true_ziegler_nichols_gains_hunt_with_friction(setpoint: float, size: float, period: float) -> None:
    """K_p 28.8 kPa/mm, T_i 0.29 s: 3.3 % at 10 mm in 1.7 s, 1.0 % at 30 mm in 2.4 s."""
    analysis = reduced(held(28.8, 0.29, setpoint))
    assert value(analysis, "x_pp").value == pytest.approx(size, rel=0.03)
    assert value(analysis, "T_c").value == pytest.approx(period, rel=0.03)


def test_without_friction_nothing_hunts_and_no_error_is_left() -> None:
    analysis = reduced(held(28.8, 0.29, 0.03, friction=False))
    assert not any(e.symbol in ("x_pp", "T_c") for e in analysis.estimates)
    assert abs(number(value(analysis, "e_ss"))) < 1e-5
    (reported,) = [f.text for f in analysis.findings if "limit cycle" in f.text]
    assert reported.startswith("no limit cycle at 30 mm")


# -- beside the simulation ---------------------------------------------------------------------------------------


def model(kind: str = "bench", **change: float) -> dict[str, Any]:
    setup = preset("paper0", kind, Overrides(**change))
    return Described(setup.muscle, setup.regulator, "preset paper0", (0.0, 1e6)).to_dict()


def test_the_simulated_loop_follows_the_independent_plant() -> None:
    """Without friction both are the same equations; the independent plant steps by Euler at half a millisecond."""
    analysis = reduced(held(28.8, 0.29, 0.03, friction=False), model=model(friction=0.0))
    assert value(analysis, "e_sim", "closed-loop, simulated").value == pytest.approx(0.0, abs=60e-6)


def test_a_wrong_model_is_seen() -> None:
    trial = held(28.8, 0.29, 0.03, friction=False)
    right = value(reduced(trial, model=model(friction=0.0)), "e_sim", "closed-loop, simulated").value
    late = value(reduced(trial, model=model(friction=0.0, dead_time=0.05)), "e_sim", "closed-loop, simulated").value
    assert right is not None
    assert late is not None
    assert late > 3 * right


def test_what_friction_kept_from_before_is_where_the_step_begins() -> None:
    """Resting at 1 mm, 31 mm is 1 mm over a step of 29 mm, and the simulated muscle rests there too."""
    t = 5.0 + np.arange(-0.2, 40.0, TS)
    after = t - 5.0
    rise = 1e-3 + 30e-3 * np.clip(after, 0, 1)
    x = np.where(after < 3, rise, 30e-3)
    reported = {
        "t0": 5.0,
        "t1": float(t[-1]),
        "setpoint": 0.03,
        "ended": "time",
        "K_p": 28.8e6,
        "T_i": 0.29,
        "T_d": 0.0,
    }
    law = {**reported, "N": 10.0, "low": 0.0, "high": 6e5, "anti_windup": "clamping", "tracking": None, "start": 0.0}
    samples = {"t": t, "displacement": x, "pressure": 0 * t}
    trial = as_trial(samples, {"position": law}, setpoint=0.03, load=0.0, mass=2.0)
    analysis = reduced(trial, model=model())
    assert value(analysis, "OS").value == pytest.approx(1 / 29, rel=0.02)
    assert value(analysis, "t_r").value == pytest.approx(0.8 * 29 / 30, abs=0.01)
    (trace,) = analysis.traces
    early = (trace.columns["t"] < 0.04) & (trace.columns["t"] > -0.1)
    assert trace.columns["model"][early] == pytest.approx(1e-3)


def test_the_description_of_a_model_comes_back() -> None:
    reported = model()
    assert Described.of(reported).to_dict() == reported


# -- what is not used --------------------------------------------------------------------------------------------


def test_a_loop_that_lost_its_signal_is_dropped_with_the_reason() -> None:
    good = held(28.8, 0.29, 0.03)
    lost = {**good.found["position"], "ended": "no signal", "found": False, "reason": "displacement gave no number"}
    bad = replace(good, found={"position": lost}, index=1)
    analysis = reduced(good, bad)
    assert [d.reason for d in analysis.dropped] == ["displacement gave no number"]
    assert value(analysis, "e_ss").n == 1


def test_repeats_give_an_interval_and_one_run_says_why_it_has_none() -> None:
    trial = held(28.8, 0.29, 0.03, False)
    again = TrialData(**{**trial.__dict__, "index": 1, "channels": {
        **trial.channels, "displacement": trial.channels["displacement"] - 10e-6}})  # fmt: skip
    one, two = value(reduced(trial), "e_ss"), value(reduced(trial, again), "e_ss")
    assert one.ci95 is None
    assert "repeats" in one.note
    assert two.value is not None
    assert one.value is not None
    assert two.value - one.value == pytest.approx(5e-6 / 0.03, rel=1e-3)
    assert two.parts.repeats == pytest.approx(12.706 * 5e-6 / 0.03, rel=1e-3)  # t(0.975, 1) s / sqrt(2)


def test_trials_of_two_runs_that_have_the_same_name_are_both_used() -> None:
    """A name is the run's id and a number, and nothing keeps two folders from the same id."""
    trial = held(28.8, 0.29, 0.03, False)
    channels = {**trial.channels, "displacement": trial.channels["displacement"] - 10e-6}
    runs = [as_run("positioning", (one,), {"window": [20.0, 60.0], "band": 0.02})
            for one in (trial, replace(trial, channels=channels))]  # fmt: skip
    both = reduce(runs)
    assert both.facts["trials"] == 2
    found = number(value(both, "e_ss")) - number(value(reduced(trial), "e_ss"))
    assert found == pytest.approx(5e-6 / 0.03, rel=1e-3)


def test_the_scale_of_the_displacement_counts() -> None:
    """With a gain that may be 1 % off the true position is: e_ss by (1 + e) 1 %, the cycle by 1 % of itself."""
    settings = {"window": [20.0, 60.0]}
    steady, hunting = (
        reduce([as_run("positioning", [held(28.8, 0.29, 0.03, friction)], settings, gain_uncertainty=0.01)])
        for friction in (False, True)
    )
    assert value(steady, "e_ss").parts.calibration == pytest.approx(0.01, rel=1e-3)
    cycle = value(hunting, "x_pp")
    assert cycle.value is not None
    assert cycle.parts.calibration == pytest.approx(0.01 * cycle.value, rel=1e-3)


def test_a_cycle_is_what_it_says() -> None:
    assert Cycle(1e-3, 1.0, 3, 0.5).sticks
    assert not Cycle(1e-3, 1.0, 3, 0.1).sticks


@pytest.mark.parametrize(("cause", "size", "most"), [("tail", 1.0, 0.02), ("drift", 0.25, 0.022)])
def test_a_loop_that_still_moves_has_a_bound_and_no_steady_state_error(cause: str, size: float, most: float) -> None:
    """A value was printed with an interval of up to 22 times its size; the true error is 0.2 %."""
    found = [e for e in placed_of(cause, size, 1).estimates if e.symbol == "e_ss"]
    assert [(e.value, e.withheld) for e in found] == [(None, False)] * len(placed.SETPOINTS)
    for e in found:
        assert e.bound is not None
        assert placed.OFFSET <= e.bound <= most
        assert e.note.startswith(
            f"not more than {100 * e.bound:.3g} % of the set-point either way: it moves in the win"
        )
        assert cell(e) == f"≤ {100 * e.bound:.3g}"


def test_a_loop_that_hunts_has_a_bound_and_no_steady_state_error() -> None:
    """Its mean over 60 s is off by no more than half of a cut cycle: 0.5 x 0.30 mm x 2.4 s / 40 s of 30 mm."""
    e = value(reduced(held(28.8, 0.29, 0.03)), "e_ss")
    assert e.value is None
    assert e.bound is not None
    assert 0.03e-2 <= e.bound <= 0.06e-2
    assert "of the set-point either way: it swings in the window" in e.note


def test_a_loop_at_rest_has_its_error_as_a_value() -> None:
    found = [e for e in placed_of("clean", 0.0, 1).estimates if e.symbol == "e_ss"]
    assert [number(e) for e in found] == pytest.approx([placed.OFFSET] * 2, abs=3 * placed.SCATTER)
