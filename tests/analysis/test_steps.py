"""Exponentials, the regression of K, dead times and curves against closed forms (paper 0)."""

from __future__ import annotations

import numpy as np
import pytest

from pmabench.analysis.shared.samples import dead_times, onset
from pmabench.kinds.contraction_relaxation.exponentials import exponentials, regress
from pmabench.kinds.contraction_relaxation.values import curve, polynomial
from pmabench.store.analyses.results import Estimate, Parts

T = np.arange(0, 10, 0.002)


def rise(tau: float, t_d: float, start: float = 0.0, end: float = 0.04) -> np.ndarray:
    return start + (end - start) * (1 - np.exp(-np.maximum(0.0, T - t_d) / tau))


@pytest.mark.parametrize(("start", "end"), [(0.0, 0.04), (0.05, 0.03)])
def test_exponential_with_free_delay(start: float, end: float):
    x = rise(0.25, 0.04, start, end) + 10e-6 * np.random.default_rng(1).standard_normal(len(T))
    (found,) = exponentials(T[None], x[None], np.array([[start]]))
    assert found.end == pytest.approx(end, abs=2e-6)
    assert found.tau == pytest.approx(0.25, rel=2e-3)
    assert found.t_d == pytest.approx(0.04, abs=1e-3)
    assert found.rms == pytest.approx(10e-6, rel=0.1)


def test_regression_of_k_needs_two_loads():
    load = np.array([50.0, 100.0, 150.0, 200.0])
    x = (300.0 - load) / 6000.0
    found = regress(load, x)
    assert (found.K, found.F_ce, found.n) == (pytest.approx(6000.0), pytest.approx(300.0), 4)
    assert found.se_K == pytest.approx(0.0, abs=1e-6)
    assert regress(load[:1], x[:1]) is None
    assert regress(load[:2], x[:2]).se_K is None


def test_standard_errors_of_the_regression():
    generator = np.random.default_rng(4)
    load = np.linspace(50, 500, 9)
    found = [regress(load, (600.0 - load) / 7000.0 + 50e-6 * generator.standard_normal(9)) for _ in range(300)]
    for value, error in (("K", "se_K"), ("F_ce", "se_F_ce")):
        spread = np.std([getattr(f, value) for f in found])
        assert np.mean([getattr(f, error) for f in found]) == pytest.approx(spread, rel=0.15)


def test_onset_of_a_rise_and_of_a_jump():
    t = np.arange(-0.2, 2, 0.002)
    noise = 2e-6 * np.random.default_rng(2).standard_normal(len(t))
    x = 0.04 * (1 - np.exp(-np.maximum(0.0, t - 0.04) / 0.25))
    assert onset(t, x + noise, 0.0, 10e-6) == pytest.approx(0.04, abs=1e-3)
    jump = np.where(t >= 0.04 - 1e-9, 5e5, 0.0)
    assert onset(t, jump, 0.0, 200.0) == pytest.approx(0.04)
    assert onset(t, np.zeros(len(t)), 0.0, 200.0) is None
    ok = np.ones(len(t), dtype=np.bool_)
    times = dead_times(t, {"pressure": jump, "displacement": x}, ok, 0.0)
    assert times["command-to-motion"] == pytest.approx(0.04, abs=1e-3)
    assert times["pressure-to-motion"] == pytest.approx(0.0, abs=1e-3)


def test_polynomial_through_points():
    P = np.arange(150e3, 501e3, 50e3)
    found = polynomial(P, 5600 + 1e-3 * P + 9.7e-9 * P**2, np.full(len(P), 10.0), 2)
    assert found.terms == pytest.approx([5600.0, 1e-3, 9.7e-9])
    assert found.r2 == pytest.approx(1.0)


def test_a_curve_carries_its_domain_and_its_interval():
    points = [
        Estimate(
            "F_ce", 1.08e-3 * P - 49.0, "N", "force", "m", {"pressure": P}, Parts(1.0, 0.0, 0.0), 3, trials=("r/1",)
        )
        for P in (1e5, 2e5, 3e5, 4e5)
    ]
    line = curve(points, 1)
    intercept, slope = line.terms
    assert line.domain == (1e5, 4e5)
    assert (intercept.value, slope.value) == (pytest.approx(-49.0), pytest.approx(1.08e-3))
    # four points with half width 1 N: slope 1 / sqrt(sum of squares about the mean)
    assert slope.parts.repeats == pytest.approx(1 / np.sqrt(5e10), rel=0.05)
    assert slope.coordinate == "slope"
    assert curve(points[:1], 1) is None
