"""Figures of residuals and of contraction over pressure: their numbers are those of a process that is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pmabench.plotting.motion import over_pressure, residuals
from pmabench.store.analyses.results import Trace


def free_run(noise, name="a"):
    t = 0.01 * np.arange(len(noise))
    model = 0.01 * (1 - np.exp(-t))
    columns = {"t": t, "pressure": 3e5 * np.ones(len(t)), "displacement": model + 1e-5 * noise, "model": model}
    quantities = {"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"}
    return Trace(name, "overlay", f"{name}: measured and fitted", columns, quantities, {})


def test_the_autocorrelation_is_that_of_the_process():
    """x(k) = 0.9 x(k-1) + e has the autocorrelation 0.9^k."""
    noise = lfilter([1.0], [1.0, -0.9], np.random.default_rng(1).standard_normal(40_000))
    (picture,) = residuals([free_run(noise)], False)
    reported = dict(zip(picture.table["lag [s]"], map(float, picture.table["autocorrelation 1, a"]), strict=True))
    for lag, value in reported.items():
        assert value == pytest.approx(0.9 ** (float(lag) / 0.01), abs=0.04)
    assert len(reported) > 10
    assert "0.023 mm rms" in picture.caption  # 1e-5 m / sqrt(1 - 0.81)


def test_quantiles_of_a_uniform_residual_are_its_own():
    """Uniform of standard deviation 1 ends at sqrt(3); its 1 % and 99 % quantiles are 0.98 of that."""
    noise = np.random.default_rng(2).uniform(-1, 1, 20_000)
    (picture,) = residuals([free_run(noise)], True)
    assert "quantiles of residuals from -1.7 to 1.7 standard deviations" in picture.alt
    assert "a normal distribution has -2.3 to 2.3" in picture.alt
    assert picture.simulated


def test_nothing_is_drawn_where_there_is_nothing_to_see():
    assert residuals([], False) == []
    assert residuals([free_run(np.zeros(1000))], False) == []
    assert residuals([free_run(np.ones(50))], False) == []
    assert over_pressure([free_run(np.ones(50))], False) == []
    repeats = [free_run(np.random.default_rng(n).standard_normal(1000)) for n in range(3)]
    heads = residuals(repeats, False)[0].table.columns
    assert len(set(heads)) == 1 + 3, "the lags, and a column for each repeat although repeats have one title"
    (picture,) = over_pressure([free_run(np.ones(50), name) for name in "ab"], False)
    assert "for a; b" in picture.alt
