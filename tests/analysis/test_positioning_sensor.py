"""Positions read through a sensor with a filter, noise and a zero of its own, against equations integrated by scipy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import cos, exp, pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pmabench.analysis.shared.signals import smooth
from pmabench.kinds.positioning.reduction import reduce
from pmabench.store.analyses.results import Analysis
from pmabench.store.records import Array, TrialData
from tests.analysis.loop_rig import TS, as_run, as_trial
from tests.analysis.test_polled_channels import held, played

BEFORE, HOLD, SETPOINT = 0.5, 12.0, 0.03
SETTINGS = {"window": [6.0, 12.0], "band": 0.02}
FILTER = 0.02
"""Time constant of the sensor of the displacement where it has one [s]."""
PLACES, SPEED, REST = (0.0, 0.03, 0.012, 0.024), 0.02, 1.0
DELAY = 0.1
"""The muscle is where the path was so long ago [s]."""


# -- what is there, and what a sensor reads --------------------------------------------------------------------------


@cache
def stepped(omega: float, zeta: float, lag: float) -> Any:
    """Solution over time: place and speed of a second-order answer to a step [m, m/s], and its filtered place [m]."""

    def rates(t: float, state: Array) -> list[float]:
        x, v, y = state
        return [v, omega**2 * (SETPOINT - x) - 2 * zeta * omega * v, (x - y) / (lag or 1.0)]

    found = solve_ivp(rates, (0, HOLD), [0, 0, 0], "LSODA", rtol=1e-9, atol=1e-12, dense_output=True, max_step=0.05)
    return found.sol


def place(t: Array, late: float = 0.0) -> Array:
    """Where the path is [m] at times after `late` [s]; each move a half cosine at no more than `SPEED`."""
    s, x, now = t - late, np.full(t.shape, PLACES[0]), REST
    for a, b in pairwise(PLACES):
        time = pi * abs(b - a) / 2 / SPEED
        share = np.clip((s - now) / time, 0, 1)
        x, now = x + (b - a) * (1 - np.cos(pi * share)) / 2, now + time + REST
    return x


END = REST + sum(pi * abs(b - a) / 2 / SPEED + REST for a, b in pairwise(PLACES))


@cache
def filtered(lag: float) -> Array:
    """What the sensor reads [m] along the path."""
    t = np.arange(0, END, TS)
    if not lag:
        return place(t, DELAY)
    found = solve_ivp(
        lambda s, y: (place(np.array([s]), DELAY) - y) / lag, (0, END), [0.0], "LSODA", t_eval=t, rtol=1e-7, atol=1e-9,
        max_step=0.05,
    )  # fmt: skip
    return np.asarray(found.y[0])


# -- records -------------------------------------------------------------------------------------------------------


Fault = Callable[[Array, Array, int], Array]
"""What a sensor makes of places at times, and of the number of the trial."""


def as_it_is(_t: Array, x: Array, _index: int) -> Array:
    return x


def trial(read: Array, law: dict[str, Any], index: int, noise: float, zero: float, fault: Fault) -> TrialData:
    """`read` from the begin of the loop on; it rests before."""
    before = round(BEFORE / TS)
    x = zero + np.concatenate((np.zeros(before), read))
    x = x + np.random.default_rng([7, index]).normal(0, noise, len(x))
    t = TS * (np.arange(len(x)) - before) + 5.0
    x = fault(t, np.asarray(x, dtype=np.float64), index)
    law = {"t0": 5.0, "t1": float(t[-1]), "setpoint": SETPOINT, "ended": "time", **law}
    samples = {"t": t, "displacement": x}
    return as_trial(samples, {"position": law}, index, setpoint=SETPOINT, load=0.0, mass=0.5)


def analysed(
    read: Array, law: dict[str, Any], *, declared: float = 0.0, noise: float = 5e-6, zero: float = 0.0,
    fault: Fault = as_it_is,
) -> Analysis:  # fmt: skip
    """Of three repeats, by a displacement whose zero is known to 20 um and whose gain to 0.05 %."""
    trials = [trial(read, law, index, noise, zero, fault) for index in range(3)]
    run = as_run("positioning", trials, SETTINGS)
    info = replace(
        run.channels["displacement"], sensor_lag=declared, offset_uncertainty=2e-5, gain_uncertainty=5e-4
    )  # fmt: skip
    return reduce([replace(run, channels={**run.channels, "displacement": info})])


def of_step(lag: float = 0.0, omega: float = 6.0, zeta: float = 0.55, **more: Any) -> Analysis:
    sol = stepped(omega, zeta, lag)(np.arange(0, HOLD, TS))
    return analysed(sol[2] if lag else sol[0], {}, **more)


def of_path(lag: float = 0.0, **more: Any) -> Analysis:
    path = {"places": PLACES, "speed": SPEED, "rest": REST}
    return analysed(filtered(lag), {"path": path}, **more)


def true_step(omega: float = 6.0, zeta: float = 0.55) -> dict[str, float]:
    """Of the place itself; the overshoot in closed form."""
    t = np.arange(0, HOLD, 1e-4)
    x = stepped(omega, zeta, 0.0)(t)[0]
    outside = np.flatnonzero(np.abs(x - SETPOINT) > 0.02 * SETPOINT)
    rise = [float(t[np.argmax(x >= share * SETPOINT)]) for share in (0.1, 0.9)]
    return {
        "OS": exp(-pi * zeta / sqrt(1 - zeta**2)), "t_s": float(t[outside[-1]]), "t_r": rise[1] - rise[0],
        "IAE": float(np.trapezoid(np.abs(SETPOINT - x), t)), "e_ss": 0.0,
    }  # fmt: skip


def true_path() -> dict[str, float]:
    """The muscle is late and goes nowhere beyond its place."""
    t = np.arange(0, END, 1e-3)
    error = place(t, DELAY) - place(t)
    return {"e_rms": float(np.sqrt(np.mean(error**2))), "e_max": float(np.abs(error).max()), "OS": 0.0}


def checked(analysis: Analysis, truth: dict[str, float], near: dict[str, float]) -> None:
    """Every interval holds the truth, and every value is `near` [as the value] to it."""
    found = {e.symbol: e for e in analysis.estimates}
    for symbol, right in truth.items():
        e = found[symbol]
        assert e.value is not None, symbol
        assert e.ci95 is not None, symbol
        assert e.ci95[0] <= right <= e.ci95[1], (symbol, right, e.value, e.ci95)
        if symbol in near:
            assert e.value == pytest.approx(right, abs=near[symbol]), symbol


def halves(analysis: Analysis) -> dict[str, float]:
    return {e.symbol: e.parts.combined or 0.0 for e in analysis.estimates}


# -- promises ------------------------------------------------------------------------------------------------------


def test_the_filter_that_a_sensor_declares_is_taken_off_a_step() -> None:
    """It is 20 ms late: t_s was 22 ms and IAE 20 ms x 30 mm too large, OS too low."""
    near = {"OS": 3e-4, "t_s": 3e-3, "t_r": 3e-3, "IAE": 1e-4}
    checked(of_step(FILTER, declared=FILTER), true_step(), near)


def test_the_filter_that_a_sensor_declares_is_taken_off_a_path() -> None:
    """The error along a path is its delay times the speed: 20 ms of 100 ms made it a fifth larger."""
    checked(of_path(FILTER, declared=FILTER), true_path(), {"e_rms": 8e-6, "e_max": 15e-6, "OS": 1e-3})


@pytest.mark.parametrize("lag", [0.0, 0.005])
def test_intervals_hold_a_filter_that_nobody_declared(lag: float) -> None:
    step, path = of_step(lag), of_path(lag)
    checked(step, true_step(), {})
    checked(path, true_path(), {})
    most = {"OS": 1.5e-3, "t_s": 0.012, "t_r": 0.015, "IAE": 0.5e-3, "e_ss": 1e-3}
    assert all(half <= most[symbol] for symbol, half in halves(step).items())
    most = {"e_rms": 0.06e-3, "e_max": 0.12e-3, "OS": 2.5e-3}
    assert all(half <= most[symbol] for symbol, half in halves(path).items())


@pytest.mark.parametrize("omega", [6.0, 25.0, 40.0])
def test_a_quick_peak_keeps_its_height(omega: float) -> None:
    """Means over 20 ms took 2.6 % off it: 8 half widths."""
    checked(of_step(omega=omega, zeta=0.4), {"OS": true_step(omega, 0.4)["OS"]}, {"OS": 3e-4})


@pytest.mark.parametrize(("noise", "near"), [(5e-6, 5e-4), (2e-5, 2e-3), (1e-4, 1e-2)])
def test_noise_makes_no_overshoot_and_no_error_along_a_path(noise: float, near: float) -> None:
    """The largest of thousands of samples lies four standard deviations high: 3 % of a move, with 0.1 mm of noise."""
    way = 0.012
    checked(of_path(noise=noise), true_path(), {"OS": near, "e_max": near * way, "e_rms": 3e-6})


def test_noise_adds_little_to_the_integral_of_the_error() -> None:
    """Noise of 0.1 mm at rest made 12 s x 0.08 mm of it."""
    checked(of_step(noise=1e-4), true_step(), {"IAE": 0.2e-3})


@pytest.mark.parametrize("zero", [-2e-5, 2e-5])
def test_a_zero_within_its_uncertainty_is_in_what_the_loop_reads_as_no_error(zero: float) -> None:
    """The loop takes its reading to the set-point, and the place rests off it: IAE knew nothing of that."""
    t = np.arange(0, HOLD, 1e-3)
    off = SETPOINT - (stepped(6.0, 0.55, 0.0)(t)[0] - zero)
    truth = {"IAE": float(np.trapezoid(np.abs(off), t)), "e_ss": zero / SETPOINT, "OS": -float(off.min()) / SETPOINT}
    checked(of_step(), truth, {})


@pytest.mark.parametrize(("zero", "said"), [(0.0, False), (3e-4, True)])
def test_a_rest_far_from_zero_is_said(zero: float, said: bool) -> None:
    """The record cannot tell a zero that is off from a muscle that rests there."""
    lines = [f.text for f in of_step(zero=zero).findings if f.level == "note" and "the zero is off" in f.text]
    assert len(lines) == said
    if said:
        assert lines[0].startswith("before 3 of 3 steps it rested up to 0.3 mm from 0, which is known to 0.02 mm")


# -- the smoothing itself ------------------------------------------------------------------------------------------


def test_a_ramp_through_a_filter_comes_back() -> None:
    """Of x = v t a filter reads v (t - lag (1 - exp(-t / lag)))."""
    t = np.arange(0, 2, TS)
    y = 0.01 * (t - FILTER * (1 - np.exp(-t / FILTER)))
    found = smooth(t, y, FILTER)
    inside = (t > 0.5) & (t < 1.9)
    assert found.y[inside] == pytest.approx(0.01 * t[inside], abs=1e-9)
    assert found.fitted[:, inside] == pytest.approx(np.tile(0.01 * t[inside], (3, 1)), abs=1e-9)


def test_the_noise_that_is_left_is_as_stated() -> None:
    t = np.arange(0, 200, TS)
    found = smooth(t, np.random.default_rng(3).normal(0, 1.0, len(t)), FILTER)
    assert float(found.y.std()) == pytest.approx(found.gain, rel=0.02)
    assert found.fitted.std(axis=1) == pytest.approx(found.gains, rel=0.03)


def test_samples_that_are_missing_move_nothing() -> None:
    t = np.arange(0, 3, TS)
    ok = np.random.default_rng(4).random(len(t)) > 0.05
    x = np.array([0.01 * cos(6 * at) for at in t])
    found, whole = smooth(t[ok], x[ok], FILTER), smooth(t, x, FILTER)
    assert found.y[20:-20] == pytest.approx(whole.y[ok][20:-20], abs=3e-6)
    assert found.peak(0.0) == pytest.approx(0.01 * sqrt(1 + (6 * FILTER) ** 2), rel=1e-3)


# -- sensors that are read seldom, stick or fail -------------------------------------------------------------------


def polled(rate: float, jitter: float = 0.0) -> Fault:
    return lambda t, x, index: held(t, x, rate, jitter, index)


@pytest.mark.parametrize(("rate", "jitter"), [(20.0, 0.0), (100.0, 0.0), (20.0, 0.8)])
def test_a_polled_displacement_swings_in_no_limit_cycle(rate: float, jitter: float) -> None:
    """Its noise, held from one answer to the next, was a cycle of 10 to 15 um, and t_r 20 ms short."""
    found = of_step(fault=polled(rate, jitter))
    checked(found, true_step(), {"t_s": 1.2 / rate, "t_r": 2 / rate})
    assert not [e for e in found.estimates if e.symbol in ("x_pp", "T_c")]
    assert not [f for f in found.findings if "cycle at" in f.text and f.level == "doubt"]


def test_a_path_is_compared_where_a_polled_displacement_is_new() -> None:
    """What was held in between was the path's error: 5 half widths of e_rms, 4 of e_max."""
    checked(of_path(fault=polled(20.0)), true_path(), {"e_rms": 8e-6, "e_max": 3e-5})


def test_a_sensor_with_hysteresis_makes_no_limit_cycle() -> None:
    found = of_step(fault=lambda _t, x, _index: played(x, 1e-5))
    checked(found, true_step(), {"t_s": 6e-3})
    assert not [e for e in found.estimates if e.symbol in ("x_pp", "T_c")]


def test_single_samples_that_stand_out_are_left_out() -> None:
    """A loose wire: one sample in 500 off by 5 mm made t_s 39 s of 1 s."""

    def loose(_t: Array, x: Array, index: int) -> Array:
        rng = np.random.default_rng([3, index])
        return np.asarray(x + 5e-3 * (rng.random(len(x)) < 0.002) * rng.choice([-1.0, 1.0], len(x)))

    step, path = of_step(fault=loose), of_path(fault=loose)
    checked(step, true_step(), {"t_s": 6e-3, "OS": 3e-4})
    checked(path, true_path(), {"e_max": 2e-5, "OS": 5e-4})
    assert all([f for f in one.findings if "stand out alone" in f.text] for one in (step, path))
