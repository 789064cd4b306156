"""Dead time and lags from command to pressure come back from steps of known form, and from the mock bench's regulator."""

from __future__ import annotations

import numpy as np
import pytest

from pmabench.kinds.contraction_relaxation.bandwidth import METHOD, response, step
from pmabench.kinds.contraction_relaxation.reduction import reduce
from tests.analysis.simulate import LOADS, contraction_run, rig

T = np.arange(-0.1, 2.0, 0.002)


def shaken(y: np.ndarray, seed: int = 0) -> np.ndarray:
    return y + 1e-3 * np.random.default_rng(seed).standard_normal(len(y))


def test_the_step_is_that_of_two_lags_in_a_row():
    """dy/dt of the second lag, integrated by small steps."""
    t = np.arange(0.0, 1.0, 1e-5)
    first = -np.expm1(-t / 0.2)
    y = np.zeros(len(t))
    for i in range(1, len(t)):
        y[i] = y[i - 1] + 1e-5 / 0.05 * (0.5 * (first[i] + first[i - 1]) - y[i - 1])
    assert np.abs(step(t + 0.03, (0.03, 0.2, 0.05)) - y).max() < 1e-4


@pytest.mark.parametrize("times", [(0.03, 0.2), (0.04, 0.0955), (0.0, 0.5), (0.03, 0.2, 0.05), (0.01, 0.06, 0.03)])
def test_times_come_back_with_their_errors(times: tuple[float, ...]):
    found = [response(T, shaken(step(T, times), seed)) for seed in range(8)]
    assert all(one is not None and len(one.times) == len(times) for one in found)
    off = np.array([np.subtract(one.times, times) / one.errors for one in found if one is not None])
    assert np.abs(off).max() < 5.0
    assert 0.3 < np.std(off) < 2.0
    assert np.abs([np.subtract(one.times, times) for one in found if one is not None]).max() < 3e-3


def test_a_second_lag_is_not_made_of_noise():
    lags = [len(response(T, shaken(step(T, (0.04, 0.0955)), seed)).times) - 1 for seed in range(20)]
    assert lags == [1] * 20


@pytest.mark.parametrize("y", [np.zeros(len(T)), np.full(len(T), 0.5), -step(T, (0.0, 0.1))])
def test_what_does_not_rise_has_no_times(y: np.ndarray):
    assert response(T, shaken(y)) is None


def test_the_regulator_of_the_bench_comes_back():
    bench = rig()
    analysis = reduce([contraction_run(bench, [(LOADS[0], 2e5), (LOADS[0], 4e5)])], {"regulator": True, "replays": 0})
    mine = [e for e in analysis.estimates if e.method == METHOD]
    assert {e.coordinate for e in mine} == {"dead time", "lag"}
    for e in mine:
        true = bench.setup.regulator.dead_time if e.symbol == "t_d" else bench.setup.regulator.lag
        assert abs(e.value - true) < 2 * e.parts.combined < 2e-3
    assert any(f.text.startswith("regulator: dead time and lag describe") for f in analysis.findings)
    assert not [e for e in reduce([contraction_run(bench, [(LOADS[0], 2e5)])]).estimates if e.method == METHOD]
