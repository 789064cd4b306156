"""Bandwidth of contraction under pressure command: closed forms, and a muscle whose coefficients are known."""

from math import pi, sqrt

import pytest

from pmabench.kinds.contraction_relaxation.bandwidth import MODEL, of_model
from pmabench.kinds.contraction_relaxation.reduction import reduce
from tests.analysis.simulate import LOADS, contraction_run, rig


def test_one_lag_and_two_alike_and_a_maximally_flat_pair():
    """1/(2 pi T); sqrt(sqrt 2 - 1) of that; sqrt(K/M)/(2 pi) where the damping ratio is 1/sqrt 2."""
    assert of_model(7000.0, 1400.0, 0.0, []) == pytest.approx(1 / (2 * pi * 0.2), rel=1e-6)
    assert of_model(7000.0, 0.0, 0.0, [0.1]) == pytest.approx(1 / (2 * pi * 0.1), rel=1e-6)
    assert of_model(7000.0, 700.0, 0.0, [0.1]) == pytest.approx(sqrt(sqrt(2) - 1) / (2 * pi * 0.1), rel=1e-6)
    B = sqrt(2 * 7000.0 * 50.0)
    assert of_model(7000.0, B, 50.0, []) == pytest.approx(sqrt(7000.0 / 50.0) / (2 * pi), rel=1e-6)


def test_nothing_is_reported_of_what_does_not_fall():
    assert of_model(7000.0, 0.0, 0.0, []) is None
    assert of_model(-7000.0, 100.0, 1.0, [0.1]) is None


def test_that_of_a_known_muscle_comes_back():
    bench = rig("paper0", "ideal")
    cells = [(load, P) for load in LOADS[:3] for P in (2e5, 3e5, 4e5)]
    analysis = reduce([contraction_run(bench, cells)], {"replays": 2})
    at = {"pressure": 3e5, "load": LOADS[0]}
    (model,) = [e for e in analysis.estimates if (e.symbol, e.method) == ("f_b", MODEL) and e.at == at]
    kPa = 300.0
    K, B_c, B_r = 1e3 * (5.6 + 1e-3 * kPa + 9.7e-6 * kPa**2), 1e3 * (1.2 + 1.6e-3 * kPa), 1e3 * (1.1 + 3.4e-3 * kPa)
    lag = bench.setup.regulator.lag
    lags = [lag] if lag else []
    mass = bench.mass(LOADS[0])
    truth = of_model(K, 0.5 * (B_c + B_r), mass, lags)
    assert model.value == pytest.approx(truth, rel=0.01)
    apart = 0.5 * abs(of_model(K, B_c, mass, lags) - of_model(K, B_r, mass, lags))
    assert model.parts.method == pytest.approx(apart, rel=0.05)
